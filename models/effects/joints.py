"""Springs, ripples and stops of joints: one effect a class.

joint_coupling   a spring across two joints: potential ½ k (θ_i − r θ_j − θ₀)²
joint_limit      a stop, a spring and damper that never pull: ∓max(0, k e ± d θ̇) at a depth e = ±(θ − θ_lim) > 0
joint_stiffness  a spring in a joint: −k (θ − θ₀)
torque_ripple    a torque that repeats with the motor's angle: A sin(N θ + φ), the cogging of its poles
"""

import math

import numpy as np
import torch
from pyro.distributions import HalfNormal, LogNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import (
    ABRUPT,
    STOPS,
    Effect,
    Parameter,
    Scale,
    Situation,
    Values,
    as_variant,
    change,
    quantiles,
)


class JointCoupling(Effect):
    """Torque T₀ − k (θ_i − r θ_j) at the second joint named, i, and r times its opposite at the first, j.

    What a muscle or a tendon over two joints does, which is slack in some posture: T₀ = k θ₀. Motion of one joint
    against the other distinguishes it from their own stiffness. As a fixed ``tendon`` with a ``springlength`` in
    MuJoCo.
    """

    site = "pair"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, torque T₀ with both angles at zero, N·m, and ratio r of the two lever arms, a pure
        number of either sign.
        """
        ratio, torque = Normal(0.0, 0.9), scale.torque[self.place[1]]
        return (
            Parameter("stiffness", "N·m/rad", HalfNormal(0.5 * torque)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
            Parameter("ratio", "1", ratio, None, quantiles(ratio, 6)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """(T₀ − k (θ_i − r θ_j)) (e_i − r e_j)."""
        j, i = self.place
        pull = p["torque"] - p["stiffness"] * (now.q[..., i : i + 1] - p["ratio"] * now.q[..., j : j + 1])
        return now.at(i, pull) - now.at(j, p["ratio"] * pull)


class JointStiffness(Effect):
    """Torque −k (θ − θ₀) at a joint: passive tissue, a cable, a counterbalance.

    Given by its stiffness and by its torque where θ = 0, T₀ = k θ₀; it is linear in both. Rest pose and frequency
    distinguish it from a tilt or an armature. ``stiffness``, ``springref`` in MuJoCo.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Stiffness k, N·m/rad, and torque at angle zero T₀, N·m, for rest angles anywhere on a circle."""
        j = self.place[0]
        torque = scale.torque[j]
        return (
            change("stiffness", "N·m/rad", 0.5 * torque, scale.filed("stiffness", j)),
            Parameter("torque", "N·m", Normal(0.0, 0.9 * torque)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """T₀ − k θ."""
        return now.at(self.place[0], p["torque"] - p["stiffness"] * self.own(now.q))


PERIODS = (4, 5, 6, 7, 8, 9, 10, 11, 12, 14, 16, 18, 20, 24, 28, 32, 36, 40, 48)  # a turn


class TorqueRipple(Effect):
    """Torque a sin Nθ + b cos Nθ = A sin(Nθ + φ) at a joint.

    Slow sweeps over many periods distinguish it from a spring. As ``cogging`` in MuJoCo. Poles are no perfect sines:
    the variant has the second harmonic, a₂ sin 2Nθ + b₂ cos 2Nθ, too.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Parts a and b, N·m, and periods N a revolution, which the motor's build makes whole; a₂ and b₂."""
        typical = 0.05 * scale.effort[self.place[0]]
        first, second = Normal(0.0, typical), Normal(0.0, 0.5 * typical)
        return (
            Parameter("sine", "N·m", first),
            Parameter("cosine", "N·m", first),
            Parameter("periods", "1", LogNormal(2.4, 0.7), None, tuple(map(float, PERIODS))),
            *(Parameter(f"second_{part}", "N·m", second) for part in ("sine", "cosine") if self.variant),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """Of both harmonics."""
        angle = p["periods"] * self.own(now.q)
        torque = p["sine"] * angle.sin() + p["cosine"] * angle.cos()
        if self.variant:
            torque = torque + p["second_sine"] * (2 * angle).sin() + p["second_cosine"] * (2 * angle).cos()
        return now.at(self.place[0], torque)


SHALLOW, POINTS = 0.01, 12
"""Smallest depth, rad, to which a joint is supposed to have been pressed into its stop, and number of depths tried."""
TINY = 1e-12  # rad, of a joint at rest
RIGID = 1500.0
"""1/s², typical stiffness of a regularised stop over the joint's inertia, critically damped; MuJoCo's default has
2,630."""


class JointLimit(Effect):
    """A stop at an angle, ``JointLimit("elbow", "upper")`` against larger angles, "lower" against smaller ones.

    With the depth e = ±(θ − θ_lim) > 0 the torque is ∓max(0, k e ± d θ̇). As ``range`` in MuJoCo, whose solver of
    contacts regularises a stop that would take any load (Todorov 2014, "Convex and analytically invertible dynamics
    with contacts and constraints"). With a the joint's acceleration but for stops and dry friction, A its mobility and
    A_0 that of the arm stretched out, 1/(kg·m²), the variant's torque is, with a ``softness`` R,

        ∓max(0, (±a + A_0 (k e ± d θ̇)) / (A + A_0 R))

    so that a steady torque τ presses it in by R τ / k. MuJoCo's defaults have R = .05 to .11.
    """

    site = "stop"
    max_substep = ABRUPT

    def __init__(self, joint: str, side: str = "upper"):
        if side not in STOPS:
            raise ValueError(f"{self.name}: expected a side among {', '.join(STOPS)}, got {side!r}")
        super().__init__(joint, side)
        self.sign = 1.0 if side == "upper" else -1.0

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle θ_lim, rad, anywhere on the circle; stiffness k, N·m/rad; damping d, N·m·s/rad."""
        j = self.place[0]
        angle = Normal(0.0, 1.8)
        stiffness, damping = 12.0 * scale.torque[j], 3.0 * scale.torque[j] / scale.speed[j]
        if self.variant:  # what solvers choose follows the inertia alone
            stiffness = max(stiffness, RIGID * scale.inertia[j])
            damping = max(damping, 2 * RIGID**0.5 * scale.inertia[j])
        return (
            Parameter("angle", "rad", angle, None, self._angles(scale) or quantiles(angle, POINTS)),
            Parameter("stiffness", "N·m/rad", HalfNormal(stiffness)),
            Parameter("damping", "N·m·s/rad", HalfNormal(damping)),
            *((Parameter("softness", "1", HalfNormal(0.2), math.inf),) if self.variant else ()),
        )

    def _angles(self, scale: Scale) -> tuple[float, ...]:
        """Angles short of the farthest that has been seen, the closer to it the denser: a stop gives way a little."""
        if scale.range is None:
            return ()
        lowest, highest = scale.range[self.place[0]].tolist()
        farthest = highest if self.sign > 0 else lowest
        depths = np.geomspace(SHALLOW, max(0.75 * (highest - lowest), 2 * SHALLOW), POINTS)
        return tuple((farthest - self.sign * depths).tolist())

    def force(self, p: Values, now: Situation) -> Tensor:
        """∓max(0, k e ± d θ̇) where e > 0; the damper's onset, a jump, is a ramp of one sub-step about it."""
        j = self.place[0]
        depth, speed = self.sign * (self.own(now.q) - p["angle"]), self.sign * self.own(now.qd)
        # At constant speed its sum over Runge–Kutta's stages is exact wherever within a sub-step the joint arrives.
        entered = (0.5 + depth / (speed.abs() * now.step + TINY)).clamp(0.0, 1.0)
        push = p["stiffness"] * depth.clamp_min(0.0) + p["damping"] * speed * entered
        if self.variant:
            free = self.sign * self.own(now.dynamics.forward(now.q, now.qd, now.motor, now.body))
            unit = now.at(j, torch.ones_like(depth))
            mobility, usual = (
                self.own(now.dynamics.response(q, unit, now.body)) for q in (now.q, torch.zeros_like(now.q))
            )
            push = (free * entered + usual * push) / (mobility + usual * p["softness"])
        return now.at(j, -self.sign * push.clamp_min(0.0))


def regularised_stop(effect: Effect) -> Effect:
    """Of a stop its variant, which acts after all other forces: it yields to their sum."""
    other = as_variant(effect)
    other.order = 3
    return other

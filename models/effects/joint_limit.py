"""A stop of a joint, a spring and damper that never pull: ∓max(0, k e ± d θ̇) at a depth e = ±(θ − θ_lim) > 0."""

import math
from collections.abc import Mapping, Sequence
from typing import ClassVar, Self

import numpy as np
import torch
from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import ABRUPT, MARGIN, Effect
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.parameter import Parameter, Values, quantiles
from invdyn.models.effects.scale import Scale

SIDES = {"upper": 1.0, "lower": -1.0}
SHALLOW, POINTS = 0.01, 12
"""Smallest depth, rad, that a joint is supposed to have been pressed into its stop, and how many depths are tried."""
TINY = 1e-12  # rad, of a joint at rest
OVERDAMPED = 3.0
"""Damping ratio d / 2√(k I) from which on a stop would not push a joint back, but only slow it down on one side;
stops that were found where there were some had .48 at most."""
SOFTNESS = 0.3
"""From which the search of a softer stop begins."""
RIGID = 1500.0
"""1/s², typical stiffness of a softer stop over the joint's inertia, critically damped; MuJoCo's default has 2,630."""
FREE, ROOM = 0.5, 0.1
"""Of the range that a joint has been seen in: what a stop leaves free at least, and what two leave between them. One
that mostly presses is a spring, as two are that meet; stops that were found where there were some left .79 or more."""


class JointLimit(Effect):
    """A stop at an angle, ``JointLimit("elbow", "upper")`` against larger angles, "lower" against smaller ones.

    With the depth e = ±(θ − θ_lim) > 0 the torque is ∓max(0, k e ± d θ̇). As ``range`` in MuJoCo, whose solver of
    contacts softens a stop that would take whatever presses the joint into it (Todorov 2014, "Convex and analytically
    invertible dynamics with contacts and constraints"). With a the joint's acceleration but for stops and dry
    friction, A its mobility and A_0 that of the arm stretched out, 1/(kg·m²), the softer form's torque is, with a
    ``softness`` R,

        ∓max(0, (±a + A_0 (k e ± d θ̇)) / (A + A_0 R))

    so that a steady torque τ presses it in by R τ / k. MuJoCo has, unless told otherwise, R = .05 to .11.
    """

    phrase = "a joint limit"
    meaning = "a stop that the joint runs into"
    shown_by = "repeated slow sweeps into the end of the range"
    form_words: ClassVar[Mapping[str, str]] = {
        "softness": "softer than a spring, it gives way to whatever presses the joint into it",
    }

    located = ("angle",)

    def __init__(self, joint: str, side: str = "upper"):
        if side not in SIDES:
            raise ValueError(f"{self.name}: expected a side among {', '.join(SIDES)}, got {side!r}")
        super().__init__(joint)
        self.where, self.sign = (joint, side), SIDES[side]

    def bound(self, body: ArticulatedBody) -> Self:
        """Look up the joint; see :meth:`Effect.bound`."""
        return self._bound(body, self.where[:1])

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """Both stops of every joint."""
        return [cls(joint, side) for joint in body.joint_names for side in SIDES]

    longest: ClassVar[float] = ABRUPT
    softens: ClassVar[bool] = True

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Angle θ_lim, rad, anywhere on the circle; stiffness k, N·m/rad; damping d, N·m·s/rad."""
        j = self.place[0]
        angle = Normal(0.0, 1.8)
        stiffness, damping = 12.0 * scale.torque[j], 3.0 * scale.torque[j] / scale.speed[j]
        if self.soft:  # those that solvers choose follow the inertia alone
            stiffness = max(stiffness, RIGID * scale.inertia[j])
            damping = max(damping, 2 * RIGID**0.5 * scale.inertia[j])
        return (
            Parameter("angle", "rad", angle, None, self._angles(scale) or quantiles(angle, POINTS)),
            Parameter("stiffness", "N·m/rad", HalfNormal(stiffness)),
            Parameter("damping", "N·m·s/rad", HalfNormal(damping)),
            *((Parameter("softness", "1", HalfNormal(0.2), math.inf),) if self.soft else ()),
        )

    @property
    def yields(self) -> bool:
        """A softer stop does."""
        return self.soft

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """A steady torque τ presses it as deep: e = τ / k of the ideal form, τ R / k of the softer one."""
        return {**ideal, "stiffness": ideal["stiffness"] * SOFTNESS, "softness": SOFTNESS}

    def _angles(self, scale: Scale) -> tuple[float, ...]:
        """Angles short of the farthest that has been seen, the closer to it the denser: a stop gives way a little."""
        if scale.range is None:
            return ()
        lowest, highest = scale.range[self.place[0]].tolist()
        farthest = highest if self.sign > 0 else lowest
        depths = np.geomspace(SHALLOW, max(0.75 * (highest - lowest), 2 * SHALLOW), POINTS)
        return tuple((farthest - self.sign * depths).tolist())

    def described(self, values: Values) -> dict[str, tuple[Tensor, str]]:
        """The parameters, and the side: 1 above the angle, −1 below it."""
        units = {"angle": "rad", "stiffness": "N·m/rad", "damping": "N·m·s/rad"}
        if self.soft:
            units["softness"] = "1"
        side = values["angle"].new_full(values["angle"].shape, self.sign)
        return {**{name: (values[name], unit) for name, unit in units.items()}, "side": (side, "1")}

    def credible(self, mean: Mapping[str, float], sd: Mapping[str, float], scale: Scale) -> bool:
        """A stop that pushes back, and that the joint has been seen free of."""
        j = self.place[0]
        stiffness = mean["stiffness"] + MARGIN * sd["stiffness"]
        pushes = mean["damping"] <= OVERDAMPED * 2 * math.sqrt(stiffness * scale.inertia[j])
        if scale.range is None:
            return pushes
        lowest, highest = scale.range[j].tolist()
        free = mean["angle"] - lowest if self.sign > 0 else highest - mean["angle"]
        return pushes and free > FREE * (highest - lowest)

    def force(self, p: Values, now: Situation) -> Tensor:
        """∓max(0, k e ± d θ̇) where e > 0; the damper's onset, a jump, spread over a sub-step about it."""
        j = self.place[0]
        depth = self.sign * (now.q[..., j : j + 1] - p["angle"])
        speed = self.sign * now.qd[..., j : j + 1]
        # At constant speed its sum over Runge–Kutta's stages is exact wherever within a sub-step the joint arrives.
        entered = (0.5 + depth / (speed.abs() * now.step + TINY)).clamp(0.0, 1.0)
        push = p["stiffness"] * depth.clamp_min(0.0) + p["damping"] * speed * entered
        if self.soft:
            free = self.sign * now.dynamics.forward(now.q, now.qd, now.motor, now.body)[..., j : j + 1]
            unit = now.at(j, torch.ones_like(depth))
            mobility, usual = (
                now.dynamics.response(q, unit, now.body)[..., j : j + 1] for q in (now.q, torch.zeros_like(now.q))
            )
            push = (free * entered + usual * push) / (mobility + usual * p["softness"])
        return now.at(j, -self.sign * push.clamp_min(0.0))


def have_room(effects: Sequence[Effect], values: Mapping[str, float], scale: Scale) -> bool:
    """Whether every joint moves freely between its stops, if it has two; ``values`` by "<effect key>.<parameter>"."""
    ends: dict[int, dict[float, float]] = {}
    for stop in effects:
        if isinstance(stop, JointLimit):
            ends.setdefault(stop.place[0], {})[stop.sign] = values[f"{stop.key}.angle"]
    pairs = {j: angles[1.0] - angles[-1.0] for j, angles in ends.items() if len(angles) == len(SIDES)}
    seen = {j: 0.0 if scale.range is None else float(scale.range[j][1] - scale.range[j][0]) for j in pairs}
    return all(room > ROOM * seen[j] for j, room in pairs.items())

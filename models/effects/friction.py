"""Friction of joints, one effect a class.

viscous_friction   viscous friction of a joint: −b θ̇
coulomb_friction   dry friction of a joint: −τ_c sgn θ̇
stribeck_friction  dry friction that falls with speed: −(τ_c + (τ_s − τ_c) e^{−(θ̇/ω_s)²}) sgn θ̇
drifting_friction  viscous friction that changes over the recording: −(b₀ + s t) θ̇
load_friction      friction that grows with the load on the gear: −k |τ_motor − τ_external| sgn θ̇
quadratic_drag     drag of a joint in the square of its speed: −c θ̇ |θ̇|
"""

import torch
from pyro.distributions import HalfNormal, LogNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import ABRUPT, Effect, Parameter, Scale, Situation, Values, change, quantiles
from invdyn.models.effects.regularised_friction import RegularisedFriction

SHARES = (0.01, 0.1, 0.4, 1.2)
"""Of the prior's width, where a screen looks: doubled damping of a light link stops it within a row all the same."""


class ViscousFriction(Effect):
    """Torque −b θ̇ at a joint. As ``damping`` in MuJoCo.

    Motion at several amplitudes distinguishes it from Coulomb friction.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Damping b, N·m·s/rad."""
        j = self.place[0]
        typical = 0.2 * scale.torque[j] / scale.speed[j]
        filed = scale.filed("damping", j) + scale.servo_damping(j)
        return (change("damping", "N·m·s/rad", typical, filed, SHARES),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−b θ̇."""
        return now.at(self.place[0], -p["damping"] * self.own(now.qd))


class CoulombFriction(RegularisedFriction):
    """Torque −τ_c sgn θ̇ at a joint, at any speed; a joint at rest sticks. As ``frictionloss`` in MuJoCo.

    Motion at several amplitudes distinguishes it from viscous friction.
    """

    steady = True

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction torque τ_c, N·m."""
        j = self.place[0]
        return (change("torque", "N·m", 0.2 * scale.torque[j], scale.filed("friction", j)),)

    def friction(self, p: Values, now: Situation) -> Tensor:
        """τ_c."""
        return p["torque"]


class StribeckFriction(RegularisedFriction):
    """Coulomb friction τ_c in motion, more of it, τ_s, when slow: below about ω_s.

    Linear in τ_c and τ_s for a given ω_s. Slow reversals distinguish it from Coulomb friction.
    """

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction in motion τ_c and near rest τ_s, N·m; speed ω_s of the change, rad/s."""
        j = self.place[0]
        velocity = LogNormal(torch.tensor(0.35 * scale.speed[j]).log().item(), 0.6)
        return (
            Parameter("coulomb", "N·m", HalfNormal(0.2 * scale.torque[j])),
            Parameter("static", "N·m", HalfNormal(0.4 * scale.torque[j])),
            Parameter("velocity", "rad/s", velocity, None, quantiles(velocity, 5)),
        )

    def friction(self, p: Values, now: Situation) -> Tensor:
        """τ_c (1 − e) + τ_s e with e = exp(−(θ̇/ω_s)²)."""
        slow = torch.exp(-((self.own(now.qd) / p["velocity"]) ** 2))
        return p["coulomb"] * (1 - slow) + p["static"] * slow


class DriftingFriction(Effect):
    """Damping that warms up or wears in, linear in the time t since the first row; never below 0.

    A repeated motion distinguishes it from constant viscous friction.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Damping at the start b₀, N·m·s/rad, and its slope s, N·m/rad."""
        j = self.place[0]
        damping = 0.2 * scale.torque[j] / scale.speed[j]
        return (
            Parameter("damping", "N·m·s/rad", HalfNormal(damping)),
            Parameter("slope", "N·m/rad", Normal(0.0, 2 * damping / scale.duration)),
        )

    def force(self, p: Values, now: Situation) -> Tensor:
        """−max(0, b₀ + s t) θ̇."""
        damping = (p["damping"] + p["slope"] * now.elapsed).clamp_min(0.0)
        return now.at(self.place[0], -damping * self.own(now.qd))


class LoadFriction(RegularisedFriction):
    """Friction in proportion to what the gear carries: the motor on one side, the arm on the other.

    The arm exerts −(h + c), its gravity, Coriolis and centrifugal torques; a motor that holds it up, u = c, loads the
    gear from both sides. A varied load distinguishes it from Coulomb friction. Servo models let friction follow what
    gravity alone exerts. The variant is between the two: only a share s of h counts.
    """

    max_substep = ABRUPT / 2
    """Compared with 3 ms, 22 recordings with it lose up to 258 nats (median .35) with 6 ms."""

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction per load k, a pure number."""
        return (Parameter("coefficient", "1", HalfNormal(0.2)),)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """In the variant s as well, a pure number."""
        share = Parameter("coriolis_share", "1", Normal(1.0, 0.5), None, (1.0,))
        return (*super().parameters(scale), *([share] if self.variant else []))

    def friction(self, p: Values, now: Situation) -> Tensor:
        """The load |u + s h + c| times k."""
        load = now.motor + now.bias
        if self.variant:
            load = load - (1 - p["coriolis_share"]) * (now.bias - now.dynamics.gravity_load(now.q, now.body))
        return p["coefficient"] * self.own(load).abs()


class QuadraticDrag(Effect):
    """Torque ``−c θ̇ |θ̇|`` at a joint, as of a paddle in water or air. As ``density`` in MuJoCo.

    Large amplitudes distinguish it from viscous friction.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Drag c, N·m·s²/rad²."""
        j = self.place[0]
        return (Parameter("drag", "N·m·s²/rad²", HalfNormal(0.15 * scale.torque[j] / scale.speed[j] ** 2)),)

    def force(self, p: Values, now: Situation) -> Tensor:
        """−c θ̇ |θ̇|."""
        speed = self.own(now.qd)
        return now.at(self.place[0], -p["drag"] * speed * speed.abs())

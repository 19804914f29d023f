"""Friction that grows with the load on the gear: −k |τ_motor − τ_external| sgn θ̇."""

from collections.abc import Mapping, Sequence
from typing import ClassVar

from pyro.distributions import HalfNormal, Normal
from torch import Tensor

from invdyn.models.effects.base import ABRUPT, Parameter, Values
from invdyn.models.effects.effect_context import Situation
from invdyn.models.effects.regularised_friction import RegularisedFriction
from invdyn.models.effects.scale import Scale


class LoadFriction(RegularisedFriction):
    """Friction in proportion to what the gear carries: the motor on one side, the arm on the other.

    The arm exerts −(h + c), its gravity, Coriolis and centrifugal torques; a motor that holds it up, u = c, loads the
    gear from both sides. Told apart from Coulomb friction by varying the load. Friction that rather goes with what
    gravity alone exerts, as servo models have it, is its softer form: only a share s of h counts.
    """

    phrase = "load-dependent friction"
    meaning = "friction that grows with the torque that the joint carries"
    shown_by = "the same motion under a changed load"
    form_words: ClassVar[Mapping[str, str]] = {
        **RegularisedFriction.form_words,
        "coriolis_share": "loaded by this share of the Coriolis and centrifugal torques",
    }

    longest: ClassVar[float] = ABRUPT / 2
    """Beside 3 ms, 22 recordings with it lose up to 258 nats (median .35) with 6 ms."""

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction per load k, a pure number."""
        return (Parameter("coefficient", "1", HalfNormal(0.2)),)

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """If it is soft s as well, a pure number."""
        share = Parameter("coriolis_share", "1", Normal(1.0, 0.5), None, (1.0,))
        return (*super().parameters(scale), *([share] if self.soft else []))

    def as_soft(self, ideal: Mapping[str, float]) -> dict[str, float]:
        """All of h."""
        return {**super().as_soft(ideal), "coriolis_share": 1.0}

    def at_level(self, level: float, scale: Scale) -> Sequence[Mapping[str, float]]:
        """As the level over the typical load: a motor that holds the joint loads its gear twice.

        A servo's command is no torque of its motor; there, what the joint needs is typical.
        """
        j, parts = self.place[0], scale.parts
        servo = bool(parts) and (own := parts[j]) is not None and own.servo is not None
        given = None if scale.command is None or servo else float(scale.command[:, j].abs().mean())
        load = scale.torque[j] if given is None else 2 * given
        return [{"coefficient": level / load}] if level > 0 and load > 0 else []

    def friction(self, p: Values, now: Situation) -> Tensor:
        """The load |u + s h + c| times k."""
        j, load = self.place[0], now.motor + now.bias
        if self.soft:
            load = load - (1 - p["coriolis_share"]) * (now.bias - now.dynamics.gravity_load(now.q, now.body))
        return p["coefficient"] * load[..., j : j + 1].abs()

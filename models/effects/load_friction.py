"""Friction that grows with the load on the gear: −k |τ_motor − τ_external| sgn θ̇."""

from typing import ClassVar

from pyro.distributions import HalfNormal
from torch import Tensor

from invdyn.models.effects.base import ABRUPT, Parameter, Values
from invdyn.models.effects.rubbing import Rubbing
from invdyn.models.effects.scale import Scale
from invdyn.models.effects.situation import Situation


class LoadFriction(Rubbing):
    """Friction in proportion to what the gear carries: the motor on one side, the arm on the other.

    The arm exerts −(h + c), its gravity, Coriolis and centrifugal torques; a motor that holds it up, u = c, loads the
    gear from both sides. Told apart from Coulomb friction by varying the load.
    """

    longest: ClassVar[float] = ABRUPT / 2
    """Beside 3 ms, 22 recordings with it lose up to 258 nats (median .35) with 6 ms."""
    scan: ClassVar = {"coefficient": (0.08, 0.16, 0.28)}

    def levels(self, scale: Scale) -> tuple[Parameter, ...]:
        """Friction per load k, a pure number."""
        return (Parameter("coefficient", "1", HalfNormal(0.2)),)

    def friction(self, p: Values, now: Situation) -> Tensor:
        """The load |u + h + c| times k."""
        j = self.place[0]
        return p["coefficient"] * (now.motor + now.bias)[..., j : j + 1].abs()

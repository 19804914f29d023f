"""A camera whose scale is off: p → s p about the frame's origin."""

from pyro.distributions import LogNormal
from torch import Tensor

from invdyn.models.effects.base import Parameter, Values
from invdyn.models.effects.optics import Optics
from invdyn.models.effects.scale import Scale


class CameraScale(Optics):
    """All points s times as far from the origin as they are.

    Cannot be told from longer links unless the base is off the origin or gravity's strength is known.
    """

    phrase = "a camera scale error"
    meaning = "positions larger or smaller by one factor"
    shown_by = "an object of known size in view"

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Factor s, a pure number."""
        return (Parameter("scale", "1", LogNormal(0.0, 0.07), 1.0),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """S p."""
        return p["scale"].unsqueeze(-1) * points

"""A camera whose scale is off: p → s p about the frame's origin."""

from pyro.distributions import LogNormal
from torch import Tensor

from invdyn.models.effects.base import Parameter, Scale, Values
from invdyn.models.effects.optics import Optics


class CameraScale(Optics):
    """All points s times as far from the origin as they are.

    Only a base off the origin or a known strength of gravity distinguishes it from longer links.
    """

    def about_origin(self, scale: Scale) -> tuple[Parameter, ...]:
        """Factor s, a pure number."""
        return (Parameter("scale", "1", LogNormal(0.0, 0.07), 1.0),)

    def seen(self, p: Values, points: Tensor) -> Tensor:
        """S p."""
        return p["scale"].unsqueeze(-1) * points

"""A point mass m at the tip t, of which the body file says nothing: the inertia about the joint is I + m t²."""

from collections.abc import Sequence
from typing import Any, Self

from pyro.distributions import HalfNormal

from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Scale, Values
from invdyn.models.effects.inertias import has_inertias, inertia_of, point_of, with_inertia

SHARE, LEAST = 0.5, 0.05
"""Prior width of its mass: of the link that carries it, and of the whole body at least."""


class Payload(Effect):
    """A mass m carried at the tip: that link's mass, centre of mass and inertia change together.

    The tip is the body's own (`hand`): the last link's, or of a gripper's fingers what they hang on. Two
    postures and two speeds distinguish it from an error of the link's inertial parameters.
    """

    site = "arm"

    @classmethod
    def fits(cls, body: ArticulatedBody) -> bool:
        """Whether the body has one tip."""
        return has_inertias(body) and body.hand is not None

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        assert body.hand is not None  # it fits
        other.place = body.hand
        return other

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Mass m, kg."""
        mass = scale.body.mass
        width = max(SHARE * mass[self.place[0]].item(), LEAST * mass.sum().item())
        return (Parameter("mass", "kg", HalfNormal(width)),)

    def body(self, p: Values, body: Any) -> Any:
        """The link with the load."""
        link, site = self.place
        own = inertia_of(body, link).loaded(p["mass"], point_of(body, link, site))
        return with_inertia(body, link, own)

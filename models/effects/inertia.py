"""What links and rotors weigh, other than the file says: one effect a class.

armature        the inertia of a geared motor's rotor at its joint: I_a θ̈
payload         a point mass m at the tip t: the inertia about the joint is I + m t²
inertial_error  a link that is not as its body file says: m + Δm, com + Δcom, I + ΔI
"""

from collections.abc import Sequence
from typing import Any, Self

import torch
from pyro.distributions import HalfNormal, Normal, StudentT
from torch import Tensor

from invdyn.models.bodies.point_mass import Inertia
from invdyn.models.bodies.protocol import AXES, ArticulatedBody
from invdyn.models.effects.base import Effect, Parameter, Scale, Values, change
from invdyn.models.effects.inertias import has_inertias, inertia_of, point_of, size_of, with_inertia
from invdyn.models.shapes import join


class Armature(Effect):
    """Inertia on the diagonal of the mass matrix, without weight. As ``armature`` in MuJoCo.

    Statics distinguish it from a payload, the frequency from stiffness.
    """

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Inertia I_a behind the gear, kg·m²."""
        j = self.place[0]
        return (change("inertia", "kg·m²", 0.4 * scale.inertia[j], scale.filed("armature", j)),)

    def inertia(self, p: Values, joints: int) -> Tensor:
        """I_a at the joint."""
        return self.at_joints(p["inertia"], joints)


LOAD_SHARE, MIN_LOAD_SHARE = 0.5, 0.05
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
        width = max(LOAD_SHARE * mass[self.place[0]].item(), MIN_LOAD_SHARE * mass.sum().item())
        return (Parameter("mass", "kg", HalfNormal(width)),)

    def body(self, p: Values, body: Any) -> Any:
        """The link with the load."""
        link, site = self.place
        own = inertia_of(body, link).loaded(p["mass"], point_of(body, link, site))
        return with_inertia(body, link, own)


MIN_SHARE = 0.02
"""Of the file's mass and inertia that is always left."""
MAX_LOSS = 0.8
"""Of them that may plausibly be missing: arms without mass explain any recording. Twice as much may be there."""


class InertialError(Effect):
    """Differences Δm, Δcom and ΔI (about the centre of mass) of one link from its file.

    In the plane the centre of mass moves along the link. In space it moves along the three axes of the link's frame,
    and all moments change by one factor, their mean by ΔI: what was a possible body stays one. Known but for a common
    factor when no torque and no weight is.
    """

    site = "link"
    coms: tuple[str, ...] = ("com",)
    """Names of the centre of mass's coordinates."""

    @classmethod
    def fits(cls, body: ArticulatedBody) -> bool:
        """Whether its links' numbers are known."""
        return has_inertias(body)

    @classmethod
    def everywhere(cls, body: ArticulatedBody, keypoints: Sequence[str]) -> list[Self]:
        """At every link that has a mass."""
        found = super().everywhere(body, keypoints)
        return [each for each in found if body.parameters().mass[each._bound(body, each.where).place[0]] > 0]

    def _bound(self, body: ArticulatedBody, where: Sequence[str]) -> Self:
        other = super()._bound(body, where)
        other.coms = ("com",) if body.dimensions == 2 else tuple(f"com_{axis}" for axis in AXES)
        return other

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Differences of mass, kg, centre of mass, m, and inertia, kg·m²."""
        own, length = inertia_of(scale.body, self.place[0]), size_of(scale.body, self.place[0])
        mass, inertia = own.mass.item(), own.mean.item()
        turning = max(inertia, mass * length**2 / 12)
        return (
            Parameter("mass", "kg", StudentT(3.0, 0.0, 0.15 * mass), least=-MAX_LOSS * mass),
            *(Parameter(name, "m", Normal(0.0, 0.1 * length)) for name in self.coms),
            Parameter("inertia", "kg·m²", StudentT(3.0, 0.0, 0.15 * turning), least=-MAX_LOSS * turning),
        )

    def body(self, p: Values, body: Any) -> Any:
        """The link with other numbers; mass and inertia stay positive."""
        own = inertia_of(body, self.place[0])
        change = torch.maximum(p["inertia"], (MIN_SHARE - 1) * own.mean)
        other = Inertia(
            (own.mass + p["mass"]).maximum(MIN_SHARE * own.mass),
            own.com + join(*(p[name] for name in self.coms)),
            own.moments + change * own.shape,
        )
        return with_inertia(body, self.place[0], other)

"""A link whose mass, centre of mass and inertia are not those of the body file."""

from collections.abc import Mapping, Sequence

from pyro.distributions import Normal, StudentT

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.effects.base import Effect, Parameter, Values, with_entry
from invdyn.models.effects.payload import Payload
from invdyn.models.effects.scale import Scale

LEAST = 0.02
"""Of the file's mass and inertia that is always left."""
LOST = 0.8
"""Of them that may plausibly be missing: arms without mass explain whatever there is. Twice as much may be there."""


class InertialError(Effect):
    """Differences Δm, Δcom (along the link) and ΔI (about the centre of mass) of one link from its file.

    Known but for a common factor when no torque and no weight is.
    """

    phrase = "an inertial error"
    meaning = "a link whose mass, centre of mass or inertia is not as stated"
    shown_by = "two postures held still, then fast motion"

    planar = True
    site = "link"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Differences of mass, kg, centre of mass, m, and inertia, kg·m²."""
        mass, length, inertia = (
            value[self.place[0]].item() for value in (scale.body.mass, scale.body.length, scale.body.inertia)
        )
        turning = max(inertia, mass * length**2 / 12)
        return (
            Parameter("mass", "kg", StudentT(3.0, 0.0, 0.15 * mass), least=-LOST * mass),
            Parameter("com", "m", Normal(0.0, 0.1 * length)),
            Parameter("inertia", "kg·m²", StudentT(3.0, 0.0, 0.15 * turning), least=-LOST * turning),
        )

    def body(self, p: Values, body: BodyParameters) -> BodyParameters:
        """The link with other numbers; mass and inertia stay positive."""
        k = self.place[0]
        mass, com, inertia = (value[..., k : k + 1] for value in (body.mass, body.com, body.inertia))
        return body._replace(
            mass=with_entry(body.mass, k, (mass + p["mass"]).maximum(LEAST * mass)),
            com=with_entry(body.com, k, com + p["com"]),
            inertia=with_entry(body.inertia, k, (inertia + p["inertia"]).maximum(LEAST * inertia)),
        )

    def starts_of(self, other: Effect, values: Mapping[str, float], scale: Scale) -> Sequence[Mapping[str, float]]:
        """Of a payload, where the link is the last: a mass m at the tip, a length l from the joint, adds

        m l to the moment of its weight about the joint, and m l² to its inertia; either may be known alone.
        """
        k = self.place[0]
        if not isinstance(other, Payload) or k != len(scale.body.mass) - 1:
            return ()
        mass, com, length = (float(numbers[k]) for numbers in (scale.body.mass, scale.body.com, scale.body.length))
        heavier, further = mass + values["mass"], com + values["com"]
        by_weight = (heavier * further - mass * com) / length
        by_inertia = (values["inertia"] + heavier * further**2 - mass * com**2) / length**2
        return [{"mass": load} for load in (by_weight, by_inertia) if load > 0]

"""A point mass at the last link's tip, of which the body file says nothing."""

from pyro.distributions import HalfNormal

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.effects.base import Effect, Parameter, Values, with_entry
from invdyn.models.effects.scale import Scale


class Payload(Effect):
    """A mass m carried at the last tip: the last link's mass, centre of mass and inertia change together.

    Told apart from an error of the last link's inertial parameters by two postures and two speeds.
    """

    phrase = "a payload"
    meaning = "a mass at the tip that the simulation does not carry"
    shown_by = "two postures and two speeds"

    planar = True
    site = "arm"

    def parameters(self, scale: Scale) -> tuple[Parameter, ...]:
        """Mass m, kg."""
        return (Parameter("mass", "kg", HalfNormal(0.5 * scale.body.mass[-1].item())),)

    def body(self, p: Values, body: BodyParameters) -> BodyParameters:
        """The last link with the load: masses add, inertias by the parallel-axis theorem."""
        mass, com, length = (value[..., -1:] for value in (body.mass, body.com, body.length))
        total = mass + p["mass"]
        reduced = mass * p["mass"] / total
        return body._replace(
            mass=with_entry(body.mass, -1, total),
            com=with_entry(body.com, -1, (mass * com + p["mass"] * length) / total),
            inertia=with_entry(body.inertia, -1, body.inertia[..., -1:] + reduced * (length - com) ** 2),
        )

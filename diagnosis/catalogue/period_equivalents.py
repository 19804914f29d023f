"""Effects of which a swinging link shows nothing but its period: exact stand-ins for one another.

One link that hangs from a fixed hinge and is left to itself obeys θ̈ = −ω² sin φ, φ its angle from the vertical. What
changes its inertia I about the hinge, its static moment m c or the clock changes ω² = m c g / I alone, and with it the
square of the period by one factor,

    ρ = (I'/I) (m c / m'c') (δ/δ')²        δ'/δ of the true time of a step to the stated one

so whichever of them made the recording, each of the others has a size that makes the same one, in the range of periods
that it can have:

    armature          I_a = (ρ − 1) I
    inertial_error    ΔI = (ρ − 1) I
    payload           m_p = (ρ − 1) I / (l² − ρ I l / (m c))        its mass falls and resists
    clock_rate        s = √ρ

Units: kg, m, s.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from invdyn.models.bodies.planar import BodyParameters
from invdyn.models.effects.base import Effect
from invdyn.models.effects.composition import Composition
from invdyn.models.effects.inertia import MIN_SHARE


def factor(effect: Effect, values: Mapping[str, float], body: BodyParameters) -> float:
    """ρ of an effect with these parameters, by name, on a body of one link; 1 for one that leaves the period alone.

    Not positive or not finite where the link does not hang, or no longer does.
    """
    p = {f"effect.{effect.key}.{name}": torch.tensor([value], dtype=torch.float64) for name, value in values.items()}
    alone = Composition((effect,))
    changed, own = alone.through("body", p, body), alone.inertia(p, 1)
    inertia = _inertia(changed) + (0.0 if own is None else own)
    step = alone.through("interval", p, torch.ones(1, dtype=torch.float64))
    return float(inertia / _inertia(body) * _moment(body) / _moment(changed) / step**2)


def armature(rho: float, body: BodyParameters) -> dict[str, float] | None:
    """Parameters of a rotor that has the factor ρ; None where none has."""
    more = (rho - 1) * float(_inertia(body))
    return {"inertia": more} if more > 0 else None


def inertial_error(rho: float, body: BodyParameters) -> dict[str, float] | None:
    """The same of an error of the link's inertia."""
    more = (rho - 1) * float(_inertia(body))
    return {"inertia": more} if more > (MIN_SHARE - 1) * float(body.inertia) else None


def payload(rho: float, body: BodyParameters) -> dict[str, float] | None:
    """The same of a payload."""
    inertia, length = float(_inertia(body)), float(body.length)
    more, slowing = (rho - 1) * inertia, length**2 - rho * inertia * length / float(_moment(body))
    return {"mass": more / slowing} if more * slowing > 0 else None


def clock_rate(rho: float, body: BodyParameters) -> dict[str, float] | None:
    """The same of a clock."""
    return {"rate": rho**0.5}


def _inertia(body: BodyParameters) -> Tensor:
    return body.inertia + body.mass * body.com**2


def _moment(body: BodyParameters) -> Tensor:
    return body.mass * body.com

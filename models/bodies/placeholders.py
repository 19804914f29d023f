"""Moments of inertia that no link of that mass and size has, though a rigid body could: placeholders of robots' files.

An exporter that knows no moment writes ixx = 1. Of a link with mass m, moment J and reach r, the farthest that anything
of it is known to be from its joint, mass would lie √(J/m) from the centre; a rod's lies .29 r from it. A placeholder is
a power of ten, which a number in another unit hardly is.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

ROUND, FAR = 1e-3, 3.0
"""Relative: how near a placeholder is to a power of ten. In reaches: √(J/m), which short links of real arms exceed with
moments of their own."""


@dataclass(frozen=True)
class Moment:
    """A link's largest moment of inertia, kg·m², with its mass, kg, and reach, m, 0 where it is not known."""

    link: str
    moment: float
    mass: float
    reach: float

    @property
    def strange(self) -> bool:
        """Whether it is a placeholder, and no link of that size has it."""
        known = self.mass > 0 and self.reach > 0
        return known and placeholder(self.moment) and self.moment > self.mass * (FAR * self.reach) ** 2


def placeholder(moment: float) -> bool:
    """Whether a number is a power of ten, as a file has where the value is unknown."""
    return moment > 0 and math.isclose(moment, 10.0 ** round(math.log10(moment)), rel_tol=ROUND)


def placeholder_warning(moments: Iterable[Moment]) -> str | None:
    """Which of them are strange, and what to do; None where none is."""
    found = [each for each in moments if each.strange]
    if not found:
        return None
    first = found[0]
    others = f"; likewise {', '.join(repr(each.link) for each in found[1:])}" if len(found) > 1 else ""
    return (
        f"link '{first.link}': an inertia of {first.moment:.4g} kg·m² is as of its {first.mass:.3g} kg "
        f"{math.sqrt(first.moment / first.mass):.3g} m away from the centre of mass, and the link reaches "
        f"{first.reach:.3g} m: a placeholder, or in another unit? Write its own, in kg·m²; a rod's would be "
        f"{first.mass * first.reach**2 / 12:.2g}{others}"
    )

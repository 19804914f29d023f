"""Inertia tensors as six numbers, and their properties.

About the centre of mass, in the link's frame, kg·m²: (xx, yy, zz, xy, xz, yz), products as in the matrix (so MuJoCo
and URDF write them). A rigid body has principal moments that are not negative, and none is larger than the two others
together. That is checked only where it matters: of a link that can turn about one direction alone, the moment about
that; of one that cannot turn, nothing.

A moment that no link of that mass and size has, though a rigid body could, is a placeholder: an exporter that knows no
moment writes ixx = 1. Of a link with mass m, moment J and reach r, the farthest that anything
of it is known to be from its joint, mass would lie √(J/m) from the centre; a rod's lies .29 r from it. A placeholder is
a power of ten, which a number in another unit hardly is.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from invdyn.models.bodies.scalars import BodyError

NAMES = ("xx", "yy", "zz", "xy", "xz", "yz")
PLACES = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
SLACK = 1e-3
"""Of the largest moment: published tensors are rounded."""


def tensor(six: np.ndarray) -> np.ndarray:
    """The symmetric matrix (3, 3) of six numbers."""
    xx, yy, zz, xy, xz, yz = six
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def six(matrix: np.ndarray) -> np.ndarray:
    """The six numbers of a symmetric matrix (3, 3)."""
    return np.array([matrix[place] for place in PLACES])


def check_inertia(matrix: np.ndarray, turning: np.ndarray, where: str) -> None:
    """Raise `BodyError` where a tensor (3, 3) cannot be a rigid body's, in what `turning` needs of it.

    `turning` (n, 3): directions, in the link's frame, that its angular velocity may have; none where it cannot turn.
    """
    if not len(turning):
        return
    if np.linalg.matrix_rank(turning, tol=1e-9) == 1:
        moment = turning[0] @ matrix @ turning[0] / (turning[0] @ turning[0])
        if moment < 0:
            raise BodyError(f"{where}: expected a moment of inertia about its hinge ≥ 0, got {moment:.4g} kg·m²")
        return
    smallest, middle, largest = np.linalg.eigvalsh(matrix)
    if smallest < -SLACK * abs(largest):
        raise BodyError(f"{where}: expected principal moments of inertia ≥ 0, got {smallest:.4g} kg·m²")
    if largest > (smallest + middle) + SLACK * largest:
        raise BodyError(
            f"{where}: its largest principal moment of inertia, {largest:.4g} kg·m², exceeds the sum of the two "
            f"others, {smallest + middle:.4g}, as in no rigid body: give xx, yy, zz, xy, xz, yz, about the centre of "
            "mass"
        )


ROUND, MAX_GYRATION = 1e-3, 3.0
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
        return known and placeholder(self.moment) and self.moment > self.mass * (MAX_GYRATION * self.reach) ** 2


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

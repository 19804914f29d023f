"""Inertia tensors as six numbers, and their properties.

About the centre of mass, in the link's frame, kg·m²: (xx, yy, zz, xy, xz, yz), products as in the matrix (so MuJoCo
and URDF write them). A rigid body has principal moments that are not negative, and none is larger than the two others
together. That is checked only where it matters: of a link that can turn about one direction alone, the moment about
that; of one that cannot turn, nothing.
"""

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

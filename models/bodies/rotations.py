"""Rotations as numbers: matrices out of axes, quaternions and roll–pitch–yaw.

A rotation R (3, 3) has the axes of the rotated frame as its columns, so that v_outer = R v_inner. Quaternions are
(w, x, y, z), angles are rad, roll–pitch–yaw are URDF's: R = Rz(yaw) Ry(pitch) Rx(roll). What is within 1e-12 of 0 or
±1 becomes it: right angles are meant, and structural zeros make the dynamics short.
"""

from collections.abc import Iterable

import numpy as np
from scipy.spatial.transform import Rotation

from invdyn.models.bodies.scalars import BodyError, number

IDENTITY = np.eye(3)
UNTURNED = tuple(map(tuple, IDENTITY.tolist()))
"""The same as rows."""
LETTERS = {letter: IDENTITY[place] for place, letter in enumerate("xyz")}
EXACT = 1e-12  # of entries, so close to a whole number: rounding
ROUND = 2 * np.pi
ROUNDED = 1e-3
"""How far from length 1 a printed unit quaternion or axis may be; it is then normalised."""


def numbers(values: object, count: int, what: str) -> np.ndarray:
    """Return `count` finite numbers as an array. Raises `BodyError`, which begins with `what`."""
    if isinstance(values, str) or not isinstance(values, Iterable) or len(values := list(values)) != count:
        raise BodyError(f"{what}: expected {count} numbers, got {values!r:.60}")
    return np.array([number(value.item() if isinstance(value, np.generic) else value, what) for value in values])


def clean(matrix: np.ndarray) -> np.ndarray:
    """The same with entries that are 0 or ±1 but for rounding made so."""
    whole = np.round(matrix)
    return np.where(np.abs(matrix - whole) < EXACT, whole, matrix) + 0.0


def unit(values: object, count: int, what: str) -> np.ndarray:
    """Return `count` numbers of length 1. Raises `BodyError` for another length."""
    vector = numbers(values, count, what)
    length = float(np.linalg.norm(vector))
    if abs(length - 1) > ROUNDED:
        raise BodyError(f"{what}: expected length 1, got length {length:.4g}; divide all of it by that")
    return vector if abs(length - 1) < EXACT else vector / length


def about(axis: np.ndarray, angle: float) -> np.ndarray:
    """The rotation by `angle` rad about a unit axis, (3, 3)."""
    return clean(Rotation.from_rotvec(angle * axis).as_matrix())


def from_quaternion(quaternion: object, what: str) -> np.ndarray:
    """The rotation of a unit quaternion (w, x, y, z). Raises `BodyError`, which begins with `what`."""
    w, *vector = unit(quaternion, 4, f"{what}, a quaternion (w, x, y, z)")
    return clean(Rotation.from_quat([*vector, w]).as_matrix())


def from_rpy(rpy: object, what: str) -> np.ndarray:
    """The rotation of roll, pitch and yaw, rad. Raises `BodyError`, which begins with `what`."""
    what = f"{what}, roll, pitch and yaw in rad"
    angles = numbers(rpy, 3, what)
    if np.abs(angles).max() > ROUND:
        raise BodyError(f"{what}: expected angles within a turn, {ROUND:.2f} rad, got {rpy!r:.60}; are these degrees?")
    return clean(Rotation.from_euler("xyz", angles).as_matrix())


def from_axes(axes: object, what: str) -> np.ndarray:
    """The rotation whose columns are the x, y and z axes given. Raises `BodyError` unless right-handed, orthonormal."""
    what = f"{what}, as x, y and z axes"
    if isinstance(axes, str) or not isinstance(axes, Iterable) or len(axes := list(axes)) != 3:
        raise BodyError(f"{what}: expected three axes of three numbers, got {axes!r:.60}")
    matrix = np.stack([unit(axis, 3, f"{what}: {letter}") for axis, letter in zip(axes, "xyz", strict=True)], 1)
    if np.abs(matrix.T @ matrix - IDENTITY).max() > ROUNDED:
        raise BodyError(f"{what}: expected axes at right angles to each other")
    if np.linalg.det(matrix) < 0:
        raise BodyError(f"{what}: expected right-handed axes, z = x × y, got left-handed ones; turn one round")
    if np.abs(matrix.T @ matrix - IDENTITY).max() > EXACT:
        u, _, v = np.linalg.svd(matrix)  # the nearest rotation: printed digits are rounded
        matrix = u @ v
    return clean(matrix)


def from_rows(rows: object, what: str) -> tuple[tuple[float, ...], ...]:
    """The rows of a rotation, given as rows. Raises `BodyError` as `from_axes` does."""
    if isinstance(rows, str) or not isinstance(rows, Iterable) or len(rows := list(rows)) != 3:
        raise BodyError(f"{what}: expected three rows of three numbers, got {rows!r:.60}")
    matrix = from_axes(np.transpose([numbers(row, 3, what) for row in rows]), what)
    return tuple(map(tuple, matrix.tolist()))


def onto(axis: np.ndarray) -> np.ndarray:
    """A rotation that takes z to a unit axis; of zeros and ±1 alone where the axis is x, y or z, or against one."""
    place = int(np.abs(axis).argmin())
    x = np.cross(np.cross(axis, IDENTITY[place]), axis)
    x /= np.linalg.norm(x)
    return clean(np.stack([x, np.cross(axis, x), axis], 1))

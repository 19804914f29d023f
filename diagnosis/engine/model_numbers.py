"""How numbers of a compiled MuJoCo model are read and changed, at joints, tendons, contacts, actuators and bodies.

An ``MjModel`` that is changed here is the one that MuJoCo would compile of a file with that number: what depends on it
(inverse inertias, lengths in the reference pose, radii that bound a shape) is computed again by ``mj_setConst``.

MuJoCo mixes the properties of two shapes that touch (Computation: contact): friction is the larger one, time constants
and impedances are averages. A contact's friction is therefore that of its pairs, and is set at both shapes.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

Pair = tuple[int, int]
HINGE, SLIDE = 3, 2
"""MuJoCo's numbers of joints."""


@dataclass(frozen=True)
class Place:
    """Where an effect acts.

    Attributes:
        kind: "joint", "tendon", "contact", "equality", "actuator", "link" or "" for the whole.
        name: of it.
        number: of the joint, tendon, geom, …
        pairs: of geoms, of contacts.
    """

    kind: str
    name: str
    number: int
    pairs: tuple[Pair, ...] = ()


Read = Callable[[Any, Place], float]
Write = Callable[[Any, Place, float], None]


def changed(model: Any, changes: list[tuple[Write, Place, float]]) -> Any:
    """A copy of a compiled ``model`` with other numbers."""
    import mujoco

    other = copy.copy(model)
    for write, place, value in changes:
        write(other, place, value)
    data = mujoco.MjData(other)
    mujoco.mj_setConst(other, data)
    return other


def of_dofs(field: str) -> tuple[Read, Write]:
    """A field of a joint's degrees of freedom."""

    def dofs(model: Any, place: Place) -> np.ndarray:
        return np.flatnonzero(model.dof_jntid == place.number)

    def write(model: Any, place: Place, value: float) -> None:
        _of(model, field)[dofs(model, place), 0] = value

    return lambda model, place: float(_of(model, field)[dofs(model, place)[0], 0]), write


def of_row(field: str, *columns: int) -> tuple[Read, Write]:
    """Entries of a field's row; several that are one number, of which the first is read."""

    def write(model: Any, place: Place, value: float) -> None:
        for column in columns:
            _of(model, field)[place.number, column] = value

    return lambda model, place: float(_of(model, field)[place.number, columns[0]]), write


def _of(model: Any, field: str) -> np.ndarray:
    """A field (n, c), whose columns some versions of MuJoCo do not have."""
    values = getattr(model, field)
    return values if values.ndim > 1 else values[:, None]


def read_rest(model: Any, place: Place) -> float:
    """Of a joint's spring."""
    return float(model.qpos_spring[model.jnt_qposadr[place.number]])


def write_rest(model: Any, place: Place, value: float) -> None:
    """The same."""
    model.qpos_spring[model.jnt_qposadr[place.number]] = value


def read_mass(model: Any, place: Place) -> float:
    """Of a body."""
    return float(model.body_mass[place.number])


def write_mass(model: Any, place: Place, value: float) -> None:
    """Of a body, of the same shape: its inertia grows with it."""
    model.body_inertia[place.number] *= value / model.body_mass[place.number]
    model.body_mass[place.number] = value


def one(model: Any, place: Place) -> float:
    """A factor, of which the file's own is one."""
    return 1.0


def write_strength(model: Any, place: Place, value: float) -> None:
    """A factor on an actuator's force."""
    import mujoco

    a = place.number
    if model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_MUSCLE):
        # Entry 2 is the peak force; where it is negative, entry 3 scales it.
        for field in (model.actuator_gainprm, model.actuator_biasprm):
            field[a, 2 if field[a, 2] >= 0 else 3] *= value
        return
    model.actuator_gainprm[a, :3] *= value
    model.actuator_biasprm[a, :3] *= value


def write_slower(model: Any, place: Place, value: float) -> None:
    """A factor on the time constants of an actuator's activation; a muscle has two."""
    import mujoco

    a = place.number
    muscle = model.actuator_dyntype[a] == int(mujoco.mjtDyn.mjDYN_MUSCLE)
    model.actuator_dynprm[a, : 2 if muscle else 1] *= value


# -- contacts ------------------------------------------------------------------------------------
def pair_friction(model: Any, pair: Pair) -> float:
    """Of sliding between two geoms."""
    explicit = _explicit(model, pair)
    if explicit is not None:
        return float(model.pair_friction[explicit, 0])
    one, other = pair
    above = int(model.geom_priority[one]) - int(model.geom_priority[other])
    own = model.geom_friction[list(pair), 0]
    return float(own.max() if above == 0 else own[0 if above > 0 else 1])


def read_friction(model: Any, place: Place) -> float:
    """The first pair's."""
    return pair_friction(model, place.pairs[0])


def write_friction(model: Any, place: Place, value: float) -> None:
    """Of all pairs: lowered at both shapes, raised at the one that has it."""
    for pair in place.pairs:
        explicit = _explicit(model, pair)
        if explicit is not None:
            model.pair_friction[explicit, :2] = value
            continue
        before = pair_friction(model, pair)
        for geom in pair:
            own = float(model.geom_friction[geom, 0])
            model.geom_friction[geom, 0] = value if own == before else min(own, value)


def geoms(place: Place) -> list[int]:
    """Of all pairs."""
    return sorted({geom for pair in place.pairs for geom in pair})


def read_softness(model: Any, place: Place) -> float:
    """Factor one."""
    return 1.0


def write_softness(model: Any, place: Place, value: float) -> None:
    """A factor on the time constant of a contact; a stiffness, which is negative, falls by it squared."""
    rows = [(model.pair_solref, e) for pair in place.pairs if (e := _explicit(model, pair)) is not None]
    rows += [(model.geom_solref, geom) for geom in geoms(place)]
    for field, row in rows:
        field[row, 0] *= value if field[row, 0] > 0 else value**-2


def read_yielding(model: Any, place: Place) -> float:
    """1 − d, d the impedance far inside."""
    return float(1 - np.mean(model.geom_solimp[geoms(place), 1]))


def write_yielding(model: Any, place: Place, value: float) -> None:
    """The same, and at the surface in proportion."""
    factor = value / max(read_yielding(model, place), 1e-9)
    for geom in geoms(place):
        model.geom_solimp[geom, :2] = np.clip(1 - factor * (1 - model.geom_solimp[geom, :2]), 1e-4, 0.9999)


def _explicit(model: Any, pair: Pair) -> int | None:
    """Number of the file's own ``pair`` of two geoms."""
    for number in range(model.npair):
        if {int(model.pair_geom1[number]), int(model.pair_geom2[number])} == set(pair):
            return number
    return None


def read_radius(model: Any, place: Place) -> float:
    """Of a sphere, capsule or cylinder."""
    return float(model.geom_size[place.number, 0])


def write_radius(model: Any, place: Place, value: float) -> None:
    """The same, with what bounds the shape; its mass stays."""
    g = place.number
    grown = value - float(model.geom_size[g, 0])
    model.geom_size[g, 0] = value
    model.geom_rbound[g] += max(grown, 0.0)
    model.geom_aabb[g, 3:] += max(grown, 0.0)


def nothing(model: Any, place: Place) -> float:
    """Zero in the file."""
    return 0.0


def up(model: Any) -> np.ndarray:
    """(3,) against gravity; the z axis without any."""
    size = float(np.linalg.norm(model.opt.gravity))
    return -model.opt.gravity / size if size > 0 else np.array([0.0, 0.0, 1.0])


def write_height(model: Any, place: Place, value: float) -> None:
    """Of a shape that is fixed in the world, against gravity."""
    model.geom_pos[place.number] += value * up(model)


def tilted(axis: int) -> Write:
    """Turn a shape that is fixed in the world about one of the world's axes, through the origin of the shape."""

    def write(model: Any, place: Place, value: float) -> None:
        import mujoco

        turn, out = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.eye(3)[axis], value)
        mujoco.mju_mulQuat(out, turn, model.geom_quat[place.number])
        model.geom_quat[place.number] = out

    return write


def shifted(axis: int) -> Write:
    """Move the point of the first body that a ``connect`` holds."""

    def write(model: Any, place: Place, value: float) -> None:
        model.eq_data[place.number, axis] += value

    return write

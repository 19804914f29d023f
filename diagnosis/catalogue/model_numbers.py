"""How numbers of a compiled MuJoCo model are read and set, at joints, tendons, contacts, actuators and bodies.

An ``MjModel`` that is changed here is the one that MuJoCo would compile of a file with that number: what depends on it
(inverse inertias, lengths in the reference pose, radii that bound a shape) is computed again by ``mj_setConst``. What
differs in it is what :mod:`..write_back.mjcf_writer` writes.

MuJoCo mixes the properties of two shapes that touch (Computation: contact): friction is the larger one, time constants
and impedances are averages. A contact's friction is therefore that of its pairs, and is set at both shapes. A ``pair``
of the file has its own.
"""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

Pair = tuple[int, int]
HINGE, SLIDE = 3, 2
"""MuJoCo's numbers of joints."""


@dataclass(frozen=True)
class Place:
    """Where a number is.

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

    def word(self, name: str) -> str:
        """What a number there is called: "damping" of a joint, "tendon damping"."""
        return name if self.kind in ("joint", "link") else f"{self.kind} {name}"


Read = Callable[[Any, Place], float]
Write = Callable[[Any, Place, float], None]
Rows = Callable[[Any, Place], Sequence[int] | np.ndarray]


def changed(model: Any, changes: Sequence[tuple[Write, Place, float]]) -> Any:
    """A copy of a compiled ``model`` with other numbers."""
    import mujoco

    other = copy.copy(model)
    for write, place, value in changes:
        write(other, place, value)
    mujoco.mj_setConst(other, mujoco.MjData(other))
    return other


def entries(
    array: str, columns: Sequence[int] = (0,), rows: Rows = lambda model, place: [place.number]
) -> tuple[Read, Write]:
    """Entries of an array that are one number, of which the first is read."""

    def values(model: Any) -> np.ndarray:
        own: np.ndarray = getattr(model, array)
        return own if own.ndim > 1 else own[:, None]  # damping and stiffness have columns in some versions

    def write(model: Any, place: Place, value: float) -> None:
        for row in rows(model, place):
            values(model)[row, list(columns)] = value

    return lambda model, place: float(values(model)[rows(model, place)[0], columns[0]]), write


def _dofs(model: Any, place: Place) -> np.ndarray:
    return np.flatnonzero(model.dof_jntid == place.number)


DAMPING, FRICTION, ARMATURE = (entries(f"dof_{name}", rows=_dofs) for name in ("damping", "frictionloss", "armature"))
STIFFNESS = entries("jnt_stiffness")
REST = entries("qpos_spring", rows=lambda model, place: [model.jnt_qposadr[place.number]])
MASS = entries("body_mass")


def as_filed(value: float) -> Read:
    """Of a factor, 1, or of a shift, 0: the file's own."""
    return lambda model, place: value


def write_mass(model: Any, place: Place, value: float) -> None:
    """Of a body, of the same shape: its inertia grows with it."""
    model.body_inertia[place.number] *= value / model.body_mass[place.number]
    model.body_mass[place.number] = value


def write_strength(model: Any, place: Place, value: float) -> None:
    """A factor on an actuator's force.

    On the gear of a motor, whose gain depends on no speed. Else on gain and bias, as where the force is limited before
    the gear, or where there is none, of adhesion.
    """
    import mujoco

    a = place.number
    geared = model.actuator_trntype[a] != int(mujoco.mjtTrn.mjTRN_BODY) and not model.actuator_forcelimited[a]
    fixed = model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED) and not model.actuator_biastype[a]
    if model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_MUSCLE):
        # Entry 2 is the peak force; where it is negative, entry 3 scales it.
        for field in (model.actuator_gainprm, model.actuator_biasprm):
            field[a, 2 if field[a, 2] >= 0 else 3] *= value
    elif fixed and geared:
        model.actuator_gear[a] *= value
    else:
        model.actuator_gainprm[a, :3] *= value
        model.actuator_biasprm[a, :3] *= value


def write_slower(model: Any, place: Place, value: float) -> None:
    """A factor on the time constants of an actuator's activation; a muscle has two."""
    import mujoco

    muscle = model.actuator_dyntype[place.number] == int(mujoco.mjtDyn.mjDYN_MUSCLE)
    model.actuator_dynprm[place.number, : 2 if muscle else 1] *= value


# -- contacts ------------------------------------------------------------------------------------
def _explicit(model: Any, pair: Pair) -> int | None:
    """Number of the file's own ``pair`` of two geoms."""
    for number in range(model.npair):
        if {int(model.pair_geom1[number]), int(model.pair_geom2[number])} == set(pair):
            return number
    return None


def _contact(model: Any, place: Place, name: str) -> list[np.ndarray]:
    """Rows of ``name``: of the file's own pairs, and of both shapes of other pairs."""
    found: dict[tuple[str, int], None] = {}
    for pair in place.pairs:
        number = _explicit(model, pair)
        found |= dict.fromkeys([("geom", g) for g in pair] if number is None else [("pair", number)])
    return [getattr(model, f"{kind}_{name}")[number] for kind, number in found]


def pair_friction(model: Any, pair: Pair) -> float:
    """Of sliding between two geoms."""
    explicit = _explicit(model, pair)
    if explicit is not None:
        return float(model.pair_friction[explicit, 0])
    one, other = pair
    above = int(model.geom_priority[one]) - int(model.geom_priority[other])
    own = model.geom_friction[list(pair), 0]
    return float(own.max() if above == 0 else own[0 if above > 0 else 1])


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


def write_softness(model: Any, place: Place, value: float) -> None:
    """A factor on the time constant of a contact; a stiffness, which is negative, falls by it squared."""
    for row in _contact(model, place, "solref"):
        row[0] *= value if row[0] > 0 else value**-2


def read_yielding(model: Any, place: Place) -> float:
    """1 − d, d the impedance far inside."""
    return float(1 - np.mean([row[1] for row in _contact(model, place, "solimp")]))


def write_yielding(model: Any, place: Place, value: float) -> None:
    """The same, and at the surface in proportion."""
    times = value / max(read_yielding(model, place), 1e-9)
    for row in _contact(model, place, "solimp"):
        row[:2] = np.clip(1 - times * (1 - row[:2]), 1e-4, 0.9999)


def write_radius(model: Any, place: Place, value: float) -> None:
    """Of a sphere, capsule or cylinder, with what bounds the shape; its mass stays."""
    g = place.number
    grown = max(value - float(model.geom_size[g, 0]), 0.0)
    model.geom_size[g, 0] = value
    model.geom_rbound[g] += grown
    model.geom_aabb[g, 3:] += grown


def write_height(model: Any, place: Place, value: float) -> None:
    """Of a shape that is fixed in the world, against gravity; along the z axis without any."""
    size = float(np.linalg.norm(model.opt.gravity))
    model.geom_pos[place.number] += value * (-model.opt.gravity / size if size > 0 else np.eye(3)[2])


def tilted(axis: int) -> Write:
    """Turn a shape that is fixed in the world about one of the world's axes, through the origin of the shape."""

    def write(model: Any, place: Place, value: float) -> None:
        import mujoco

        turn, out = np.zeros(4), np.zeros(4)
        mujoco.mju_axisAngle2Quat(turn, np.eye(3)[axis], value)
        mujoco.mju_mulQuat(out, turn, model.geom_quat[place.number])
        model.geom_quat[place.number] = out

    return write

"""What moves a MuJoCo model and is not known: torques at joints, its own actuators' controls, a wrench at a body.

A drive's K numbers z follow a torque process (:mod:`invdyn.models.torques`). A control with limits [l, u], as a
muscle's excitation in [0, 1], is squashed into them: c = l + (u − l) Φ(z − m), Φ the normal distribution function. At a
stationary sd of 1 and m = 0 all controls are equally probable before anything is seen; muscles have m = 1, by which
half of their time they are excited to less than .16.

Shapes: z (B, K), inputs (B, C) of the drive's field of ``mujoco.mjtState``.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from scipy.special import ndtr

from invdyn.models.bodies.scalars import BodyError

MUSCLE_OFFSET = 1.0
"""m of a muscle."""
WRENCH = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")


@dataclass(frozen=True)
class Drive(ABC):
    """K unknown numbers and which of MuJoCo's inputs they fill; all but the unknown ones are known once bound.

    Attributes:
        places: of the K inputs in the field.
        names: of the K numbers.
        units: of the K inputs.
    """

    places: tuple[int, ...] = field(default=(), kw_only=True)
    names: tuple[str, ...] = field(default=(), kw_only=True)
    units: tuple[str, ...] = field(default=(), kw_only=True)

    fills: ClassVar[str]
    """Name of the field in ``mujoco.mjtState``, without its prefix."""

    @abstractmethod
    def bound(self, model: Any) -> "Drive":
        """The drive of a compiled model. Raises BodyError for a name that the model does not have."""

    @abstractmethod
    def scale(self, model: Any, typical: np.ndarray) -> np.ndarray:
        """Usual size (K,) of z, given typical generalised forces (nv,)."""

    def inputs(self, z: np.ndarray) -> np.ndarray:
        """The K inputs (…, K), in their units, of z (…, K); z itself by default."""
        return z


def turning_dofs(model: Any) -> np.ndarray:
    """Which degrees of freedom (nv,) turn; slides, and the first three of a free joint, shift."""
    joints = model.dof_jntid
    first = np.arange(model.nv) - model.jnt_dofadr[joints]
    kinds = model.jnt_type[joints]
    return ~((kinds == 2) | ((kinds == 0) & (first < 3)))


def dof_names(model: Any) -> tuple[str, ...]:
    """Names (nv,) of a compiled model's degrees of freedom: a joint's, with an axis where it has several."""
    names: list[str] = []
    for j in range(model.njnt):
        own = model.joint(j).name or f"joint{j}"
        axes = {0: ("x", "y", "z", "turn_x", "turn_y", "turn_z"), 1: ("turn_x", "turn_y", "turn_z")}
        names += [f"{own}_{axis}" for axis in axes.get(int(model.jnt_type[j]), ())] or [own]
    return tuple(names)


@dataclass(frozen=True)
class JointTorques(Drive):
    """Generalised forces at joints, N·m or N; at all hinges and slides by default, without the file's actuators."""

    joints: tuple[str, ...] | None = None

    fills: ClassVar[str] = "QFRC_APPLIED"

    def bound(self, model: Any) -> "JointTorques":
        """See :class:`Drive`; a ball has three numbers, a free joint six."""
        own = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
        usual = tuple(name for name, kind in zip(own, model.jnt_type, strict=True) if kind in (2, 3))
        wanted = usual if self.joints is None else self.joints
        if unknown := [name for name in wanted if name not in own]:
            raise BodyError(f"expected joints among {', '.join(own)}, got {unknown[0]!r}: correct the name")
        if not wanted:
            raise BodyError("expected a hinge or a slide to drive, got none: choose actuators or a wrench")
        numbers = [own.index(name) for name in wanted]
        dofs = [v for v in range(model.nv) if model.dof_jntid[v] in numbers]
        names = dof_names(model)
        units = tuple("N·m" if turns else "N" for turns in turning_dofs(model)[dofs])
        return JointTorques(tuple(wanted), places=tuple(dofs), names=tuple(names[v] for v in dofs), units=units)

    def scale(self, model: Any, typical: np.ndarray) -> np.ndarray:
        """The typical ones."""
        return typical[list(self.places)]


@dataclass(frozen=True)
class Controls(Drive):
    """Controls of the file's own actuators: motors, servos, muscles; of all of them by default."""

    actuators: tuple[str, ...] | None = None
    low: tuple[float, ...] = field(default=())
    width: tuple[float, ...] = field(default=())
    offset: tuple[float, ...] = field(default=())

    fills: ClassVar[str] = "CTRL"

    def bound(self, model: Any) -> "Controls":
        """See :class:`Drive`."""
        own = [model.actuator(a).name or f"actuator{a}" for a in range(model.nu)]
        wanted = tuple(own) if self.actuators is None else self.actuators
        if unknown := [name for name in wanted if name not in own]:
            raise BodyError(f"expected actuators among {', '.join(own) or 'none'}, got {unknown[0]!r}: correct it")
        if not wanted:
            raise BodyError("expected a file with actuators, got none: drive its joints")
        numbers = [own.index(name) for name in wanted]
        limited = model.actuator_ctrllimited[numbers].astype(bool)
        muscle = is_muscle(model)[numbers]
        free = np.where(muscle[:, None], [0.0, 1.0], [0.0, np.nan])  # a muscle's own law cuts excitations there
        low, high = np.where(limited[:, None], model.actuator_ctrlrange[numbers], free).T
        return Controls(
            tuple(wanted),
            tuple(low.tolist()),
            tuple((high - low).tolist()),
            tuple(np.where(muscle, MUSCLE_OFFSET, 0.0).tolist()),
            places=tuple(numbers),
            names=tuple(wanted),
            units=("1",) * len(wanted),
        )

    def scale(self, model: Any, typical: np.ndarray) -> np.ndarray:
        """One, of those with limits; else what makes, by gain and gear, the largest typical force that they act at."""
        gain = np.abs(model.actuator_gainprm[list(self.places), 0] * model.actuator_gear[list(self.places), 0])
        moved = _moved_by(model, self.places) or slice(None)
        free = typical[moved].max() / np.where(gain > 0, gain, 1.0)
        return np.where(np.isfinite(self.width), 1.0, free)

    def inputs(self, z: np.ndarray) -> np.ndarray:
        """Squashed into their limits, where they have any."""
        width = np.asarray(self.width)
        squashed = np.asarray(self.low) + np.nan_to_num(width) * ndtr(z - np.asarray(self.offset))
        return np.where(np.isfinite(width), squashed, z)


@dataclass(frozen=True)
class Wrench(Drive):
    """An unknown force and torque at a body's centre of mass, in the world's frame, N and N·m."""

    body: str

    fills: ClassVar[str] = "XFRC_APPLIED"

    def bound(self, model: Any) -> "Wrench":
        """See :class:`Drive`."""
        own = [model.body(b).name for b in range(model.nbody)]
        if self.body not in own[1:]:
            raise BodyError(f"expected a body among {', '.join(filter(None, own[1:]))}, got {self.body!r}: correct it")
        first, names = 6 * own.index(self.body), tuple(f"{self.body}_{name}" for name in WRENCH)
        return Wrench(self.body, places=tuple(range(first, first + 6)), names=names, units=("N",) * 3 + ("N·m",) * 3)

    def scale(self, model: Any, typical: np.ndarray) -> np.ndarray:
        """A share of the weight, and of that at a tenth of the model's extent."""
        weight = 0.3 * float(model.body_subtreemass[1:].max()) * max(float(np.linalg.norm(model.opt.gravity)), 1.0)
        return np.repeat([weight, weight * 0.1 * float(model.stat.extent)], 3)


def is_muscle(model: Any) -> np.ndarray:
    """Which actuators (nu,) have a muscle's gain."""
    import mujoco

    return np.asarray(model.actuator_gaintype == int(mujoco.mjtGain.mjGAIN_MUSCLE))


def _moved_by(model: Any, actuators: Sequence[int]) -> list[int]:
    """Degrees of freedom of actuators' moments in the default pose; of those between bodies not the base's."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rows = [slice(start := data.moment_rowadr[a], start + data.moment_rownnz[a]) for a in actuators]
    return [int(v) for row in rows for v in data.moment_colind[row][np.abs(data.actuator_moment[row]) > 1e-9]]


@dataclass(frozen=True)
class Given:
    """Inputs that are known, each from a row to the next: controls (T, nu) and generalised forces (T, nv), or None."""

    controls: np.ndarray | None = None
    forces: np.ndarray | None = None

    @property
    def fields(self) -> dict[str, np.ndarray]:
        """By their names in ``mujoco.mjtState``."""
        found = {"CTRL": self.controls, "QFRC_APPLIED": self.forces}
        return {name: values for name, values in found.items() if values is not None}


class Inputs:
    """Several drives as one: their numbers, and all of MuJoCo's inputs made of them.

    Inputs of no drive are zero but for those that are ``given``: a file's actuators then rest, and are switched off
    where nothing controls them.
    """

    def __init__(self, drives: Sequence[Drive], model: Any, given: Given | None = None):
        import mujoco

        self.drives = tuple(each.bound(model) for each in drives)
        self.given = (given or Given()).fields
        self.names = tuple(name for each in self.drives for name in each.names)
        self.units = tuple(unit for each in self.drives for unit in each.units)
        fields = {"CTRL", *self.given} | {each.fills for each in self.drives}
        bits = {name: int(getattr(mujoco.mjtState, f"mjSTATE_{name}")) for name in fields}
        order = sorted(bits, key=bits.__getitem__)
        sizes = [mujoco.mj_stateSize(model, bits[name]) for name in order]
        ends = np.cumsum(sizes)
        self._places = {name: slice(end - size, end) for name, end, size in zip(order, ends, sizes, strict=True)}
        self.spec, self.width = sum(bits.values()), int(ends[-1])
        if len(set(self.names)) < len(self.names):
            raise BodyError(f"expected a name of its own for each driven number, got {', '.join(self.names)}")

    @property
    def size(self) -> int:
        """K of all."""
        return len(self.names)

    def pushed(self, model: Any) -> tuple[int, ...]:
        """Degrees of freedom that a drive's generalised forces act at, or its actuators in the default pose."""
        found: list[int] = []
        for each in self.drives:
            if each.fills == "QFRC_APPLIED":
                found += each.places
            elif each.fills == "CTRL":
                found += _moved_by(model, each.places)
        return tuple(found)

    @property
    def controls_actuators(self) -> bool:
        """Whether a drive, or what is given, sets the file's own actuators."""
        return "CTRL" in self.given or any(isinstance(each, Controls) for each in self.drives)

    def _parts(self, z: np.ndarray) -> list[np.ndarray]:
        return np.split(z, np.cumsum([len(each.names) for each in self.drives])[:-1], -1)

    def scale(self, model: Any, typical: np.ndarray) -> np.ndarray:
        """Usual size (K,) of z."""
        return np.concatenate([each.scale(model, typical) for each in self.drives])

    def values(self, z: np.ndarray) -> np.ndarray:
        """The inputs (…, K), in their units."""
        return np.concatenate([each.inputs(part) for each, part in zip(self.drives, self._parts(z), strict=True)], -1)

    def fields(self, z: np.ndarray, since: np.ndarray | None = None) -> np.ndarray:
        """MuJoCo's inputs (…, C) of z (…, K), with what is given ``since`` rows (…)."""
        out = np.zeros((*z.shape[:-1], self.width))
        for each, part in zip(self.drives, self._parts(z), strict=True):
            out[..., self._places[each.fills]][..., list(each.places)] = each.inputs(part)
        for name, values in self.given.items() if since is not None else ():
            out[..., self._places[name]] += values[since]
        return out

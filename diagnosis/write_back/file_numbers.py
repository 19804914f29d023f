"""The numbers of an MJCF file that a log may correct, as one vector, and the compiled model that has them.

    positive numbers    z = log v        damping (with a servo's own), friction, armature, gain; mass
    others              z = v            a link's centre of mass, m in the body's frame, of a chain along the link
    friction impedance  z = log(1 − d)   one for all joints

MuJoCo's dry friction is soft: under a torque below its limit a joint creeps by about (1 − d)/d of what would hold it
(MuJoCo documentation, Computation: friction loss, solver parameters). A real gear stands still, so d is a number of the
file like any other. A link's moments about its centre stay the file's.

A servo's damping is moved into its joint, which MuJoCo's Euler steps implicitly. A servo damps by the velocity before a
step: of a light joint that shakes the dry friction loose, and a file then plays otherwise at another time step.

The prior is Gaussian in z, about the file's number, or that of a regression where one is given. What a regression
says of links' moments, and of joints without a motor, stays.
Shapes: N numbers. Units: SI, rad.
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import IMPEDANCE, OF_LINK, SERVO_DAMPING, FileChange
from invdyn.diagnosis.write_back.mjcf import BodyNumbers, body_of, groups, shares_its_mass
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.body_mjcf import compiled
from invdyn.models.bodies.joint_parts_mjcf import actuators_of, joint_names
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.effects.inertias import inertia_of
from invdyn.models.effects.scale import typical_torque

UNITS = {
    "damping": "N·m·s/rad",
    SERVO_DAMPING: "N·m·s/rad",
    "friction": "N·m",
    "armature": "kg·m²",
    "servo gain": "1",
    "motor gain": "1",
    IMPEDANCE: "1",
    "mass": "kg",
}


@dataclass(frozen=True)
class Number:
    """One number: of a joint, a link or the whole (""), with its value in the file and its prior in z."""

    place: str
    quantity: str
    filed: float
    mean: float
    sd: float

    @property
    def is_log(self) -> bool:
        """Whether z is a logarithm."""
        return not self.quantity.startswith("com")

    def value(self, z: float) -> float:
        """The number in its own unit."""
        if self.quantity == IMPEDANCE:
            return float(1 - np.exp(min(z, np.log(1 - FIXED.min_friction_impedance))))
        return float(np.exp(z)) if self.is_log else float(z)


class FileNumbers:
    """An MJCF file's numbers (N,) at the driven joints of a body.

    Args:
        robot: the file, or a ``mujoco.MjSpec`` or ``MjModel``.
        body: as read from it.
        found: what a regression changes, by place and quantity; these values become the priors' means.

    `filed` is the compiled file, `nominal` has what `kept` changes too. Raises BodyError where MuJoCo cannot read it.
    """

    def __init__(self, robot: Any, body: ArticulatedBody, found: Sequence[FileChange] = ()):
        self.body = body
        self.filed = self.nominal = compiled(robot)
        after = {(each.place, each.quantity): each.after for each in found}
        numbers = [joint_names(self.nominal).index(name) for name in body.joint_names]
        self.driven = [  # joints (k, number in the model) that have one motor, of their own
            (k, number)
            for k, (number, parts) in enumerate(zip(numbers, body.joint_parts, strict=True))
            if parts.motor and len(actuators_of(mujoco, self.nominal, number)) == 1
        ]
        self._of_body = BodyNumbers(self.filed, body)
        self.numbers = (*self._of_joints(after), *self._of_links(after))
        own = {(each.place, each.quantity) for each in self.numbers}
        driven = {body.joint_names[k] for k, _ in self.driven}
        others = (c for c in found if c.place not in driven or c.quantity.startswith(OF_LINK))
        self.kept = tuple(c for c in others if (c.place, c.quantity) not in own)
        self.nominal = self.changed(self.kept)

    def starts(self) -> np.ndarray:
        """Vectors (C, N) to start a fit from: the priors' means, and the file's with gains of a ladder."""
        found = [self.mean]
        for factor in FIXED.start_gains:
            z = self.mean
            for n, each in enumerate(self.numbers):
                if each.quantity.endswith("gain"):
                    z[n] = np.log(factor)
                elif each.quantity in ("damping", "friction", "armature") and each.filed > 0:
                    z[n] = np.log(each.filed) + (each.quantity == "damping") * np.log(factor) / 2
            found.append(z)
        return np.array(found)

    def about(self, mean: Sequence[float]) -> "FileNumbers":
        """The same with priors about other means (N,)."""
        other = copy.copy(self)
        other.numbers = tuple(replace(each, mean=float(z)) for each, z in zip(self.numbers, mean, strict=True))
        return other

    @property
    def mean(self) -> np.ndarray:
        """Of the prior (N,)."""
        return np.array([each.mean for each in self.numbers])

    @property
    def sd(self) -> np.ndarray:
        """Of the prior (N,)."""
        return np.array([each.sd for each in self.numbers])

    def _of_joints(self, after: Mapping[tuple[str, str], float]) -> list[Number]:
        found = []
        dynamics, own = dynamics_for(self.body), self.body.parameters()
        typical = typical_torque(dynamics, own).tolist()
        inertia = dynamics.typical_inertia(own).tolist()
        for k, _ in self.driven:
            name, parts = self.body.joint_names[k], self.body.joint_parts[k]
            drag = parts.servo_damping
            damping = after.get((name, "damping"), parts.damping) + after.get((name, SERVO_DAMPING), drag)
            gain = "motor gain" if parts.servo is None else "servo gain"
            small = FIXED.least_number
            for quantity, filed, least, sd in (
                ("damping", parts.damping + drag, small * typical[k], FIXED.friction_sd),
                ("friction", parts.friction, small * typical[k], FIXED.friction_sd),
                ("armature", parts.armature, small * inertia[k], FIXED.armature_sd),
                (gain, 1.0, small, FIXED.servo_gain_sd),
            ):
                value = damping if quantity == "damping" else after.get((name, quantity), filed)
                found.append(Number(name, quantity, filed, float(np.log(max(value, least))), sd))
        if found:
            dofs = self.nominal.jnt_dofadr[[number for _, number in self.driven]]
            soft = float(1 - self.nominal.dof_solimp[dofs, 0].max())
            found.append(Number("", IMPEDANCE, 1 - soft, float(np.log(soft)), FIXED.impedance_sd))
        return found

    def _of_links(self, after: Mapping[tuple[str, str], float]) -> list[Number]:
        """Masses and centres of the links that a driven joint moves, each alone on its body."""
        found = []
        for k, name in enumerate(self.body.link_names):
            if not self.body.moved_by(k) or shares_its_mass(self.filed, body_of(self.filed, self.body, k)):
                continue
            own = inertia_of(self.body.parameters(), k)
            mass, com = own.mass.item(), own.com.tolist()
            if mass <= 0:
                continue
            size = FIXED.excite_link_share * max(float(np.linalg.norm(com)), float(np.sqrt(own.mean.item() / mass)))
            z = float(np.log(after.get((name, "mass"), mass)))
            found.append(Number(name, "mass", mass, z, FIXED.excite_link_share))
            for axis, value in zip(("_x", "_y", "_z") if len(com) == 3 else ("",), com, strict=True):
                found.append(Number(name, f"com{axis}", value, after.get((name, f"com{axis}"), value), size))
        return found

    def model(self, z: np.ndarray) -> "mujoco.MjModel":
        """The compiled file with the numbers ``z`` (N,)."""
        return self.changed(self._changes(z, z[None]))

    def changed(self, changes: Sequence[FileChange]) -> "mujoco.MjModel":
        """A copy of the compiled file with ``changes`` besides."""
        model = copy.copy(self.nominal)
        for several in groups(changes):
            self._of_body.put(model, several)
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    def changes(self, z: np.ndarray, draws: np.ndarray) -> tuple[FileChange, ...]:
        """What a file with ``z`` (N,) has otherwise, with central 90 % ranges of ``draws`` (D, N)."""
        numbers = zip(self.numbers, z, strict=True)
        same = {n.place for n, own in numbers if n.quantity == "damping" and _is_same(n.value(own), n.filed)}
        found = (c for c in self._changes(z, draws) if c.place not in same or "damping" not in c.quantity)
        return (*(c for c in found if not _is_same(c.after, c.before)), *self.kept)

    def _changes(self, z: np.ndarray, draws: np.ndarray) -> list[FileChange]:
        """Of every number: of damping in the joint and in its servo, of the impedance at each joint."""
        found: list[FileChange] = []
        for number, own, ends in zip(self.numbers, z, np.quantile(draws, [0.05, 0.95], axis=0).T, strict=True):
            low, high = sorted(map(number.value, ends))
            place, quantity, unit = number.place, number.quantity, UNITS.get(number.quantity, "m")
            change = FileChange(place, quantity, number.filed, number.value(own), (low, high), unit, "output error")
            if quantity == IMPEDANCE:
                found += [replace(change, place=self.body.joint_names[k]) for k, _ in self.driven]
            elif quantity == "damping":
                drag = self.body.joint_parts[self.body.joint_names.index(place)].servo_damping
                found.append(replace(change, before=number.filed - drag))
                if drag:
                    found.append(
                        replace(change, quantity=SERVO_DAMPING, before=drag, after=0.0, interval_90=(0.0, 0.0))
                    )
            else:
                found.append(change)
        return found


def _is_same(after: float, before: float) -> bool:
    return abs(after - before) <= FIXED.same_number * abs(before)

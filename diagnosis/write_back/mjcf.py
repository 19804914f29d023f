"""A body's numbers in the compiled model of its MJCF file, and changes of them written into a copy of the file.

    damping, friction, armature, stiffness, rest    of a joint
    encoder zero                                    where a joint is counted from, with its stops and its spring's rest
    friction impedance                              of a joint; the file's width and midpoint stay
    motor gain, limit, delay                        gear, range of force and delay of the joint's actuator
    servo gain, damping                             of the joint's position or velocity servo
    mass, com, inertia of a link                    of the body that it begins with
    gravity
    payload                                         a body of that mass at the tip, in the file alone

Joints and bodies are found by their number, which follows the file's order, so that they need no names.
"""

import copy
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.catalogue import model_numbers as own
from invdyn.diagnosis.catalogue.model_numbers import Place
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import IMPEDANCE, OF_LINK, SERVO_DAMPING, ZERO, FileChange, comment_of
from invdyn.diagnosis.write_back.mjcf_writer import INCLUDED, Writer
from invdyn.diagnosis.write_back.xml_text import XmlText
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts import JointParts
from invdyn.models.bodies.joint_parts_mjcf import actuators_of, joint_names
from invdyn.models.bodies.protocol import AXES
from invdyn.models.effects.inertias import point_of

OF_JOINT = {"damping": own.DAMPING, "friction": own.FRICTION, "armature": own.ARMATURE, "stiffness": own.STIFFNESS}


def rewritten(
    content: bytes, path: str, body: ArticulatedBody, changes: Sequence[FileChange]
) -> tuple[bytes, dict[str, str]]:
    """The content with the changes; and what could not be written: words → why.

    ``path`` is the file that the content is of, which MuJoCo reads. Raises ValueError where it cannot.
    """
    model = mujoco.MjModel.from_xml_path(path)
    numbers, text = BodyNumbers(model, body), XmlText(content)
    writer, now = Writer(text, model), model
    unsaid: dict[str, str] = {}
    for several in groups(changes):
        if several[0].quantity == "payload":
            why = numbers.hang(writer, several[0])
        else:
            after = copy.copy(now)
            why = numbers.put(after, several) or writer.write(now, after, comment_of(several))
            now = now if why else after
        if why:
            unsaid |= {each.words: why for each in several}
    return text.changed(), unsaid


def groups(changes: Sequence[FileChange]) -> list[list[FileChange]]:
    """Changes that are made at once: those of a link's inertia, and those of gravity."""
    found: dict[tuple[str, str], list[FileChange]] = {}
    for each in changes:
        kinds = [kind for kind in (*OF_LINK, "gravity") if each.quantity.startswith(kind)]
        kind = "inertia" if kinds and kinds[0] in OF_LINK else kinds[0] if kinds else each.quantity
        found.setdefault((each.place, kind), []).append(each)
    return list(found.values())


class BodyNumbers:
    """Where numbers of a ``body`` are in the compiled ``model`` of its file."""

    def __init__(self, model: Any, body: ArticulatedBody):
        self.model, self.body, self.joints = model, body, joint_names(model)

    @cached_property
    def data(self) -> Any:
        """Of the reference pose."""
        data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, data)
        return data

    def put(self, model: Any, changes: Sequence[FileChange]) -> str | None:
        """Set one of :func:`groups` in a copy of the model; why it cannot be, or None."""
        (change, *_) = changes
        if change.quantity.startswith(OF_LINK):
            return self._put_in_link(model, changes)
        if change.quantity.startswith("gravity"):
            flat = self.body.dimensions == 2
            axes = self._plane(joint_of(model, self.body, 0)) if flat else (0, 1, 2)
            for each in changes:
                model.opt.gravity[axes[AXES.index(each.quantity[-1])]] = each.after
            return None
        return self._put_in_joint(model, self.joints.index(change.place), change)

    def _put_in_joint(self, model: Any, joint: int, change: FileChange) -> str | None:
        place, parts = Place("joint", change.place, joint), self._parts(change.place)
        if change.quantity in OF_JOINT:
            OF_JOINT[change.quantity][1](model, place, change.after)
        elif change.quantity == "rest":
            own.REST[1](model, place, parts.sign * (change.after - parts.zero))
        elif change.quantity == IMPEDANCE:
            model.dof_solimp[model.jnt_dofadr[joint], :2] = change.after
        elif change.quantity == ZERO:
            off, adr = parts.sign * change.after, model.jnt_qposadr[joint]
            model.qpos0[adr] += off
            model.qpos_spring[adr] += off * bool(model.jnt_stiffness[joint])
            model.jnt_range[joint] += off * bool(model.jnt_limited[joint])
        else:
            return self._put_in_motor(model, joint, change)
        return None

    def _put_in_motor(self, model: Any, joint: int, change: FileChange) -> str | None:
        actuators = actuators_of(mujoco, model, joint)
        if len(actuators) != 1:
            return "the joint has no actuator of its own"
        (a,) = actuators
        gear, gain, bias = float(model.actuator_gear[a, 0]), model.actuator_gainprm[a], model.actuator_biasprm[a]
        if change.quantity == "motor gain":
            model.actuator_gear[a, 0] *= change.after
        elif change.quantity == "servo gain":
            gain[0] *= change.after
            bias[1 if bias[1] else 2] *= change.after  # of a velocity servo, gain and bias are one number
        elif change.quantity == SERVO_DAMPING:
            bias[2] = -change.after / gear**2
        elif change.quantity == "motor limit":
            model.actuator_forcelimited[a] = True
            model.actuator_forcerange[a] = abs(change.after / gear) * np.array([-1.0, 1.0])
        elif not hasattr(model, "actuator_delay"):
            return f"MuJoCo {mujoco.__version__} has no delay of an actuator"
        else:
            model.actuator_delay[a] = change.after
        return None

    def _put_in_link(self, model: Any, changes: Sequence[FileChange]) -> str | None:
        link = self.body.link_names.index(changes[0].place)
        number = body_of(model, self.body, link)
        if shares_its_mass(model, number):
            return "the link is of several bodies that are fixed to each other"
        flat = np.zeros(9)
        mujoco.mju_quat2Mat(flat, model.body_iquat[number])
        turn = flat.reshape(3, 3)
        before = tensor = turn @ np.diag(model.body_inertia[number]) @ turn.T
        for change in changes:
            if change.quantity == "mass":
                model.body_mass[number] = change.after
            elif change.quantity.startswith("com"):
                one = np.eye(self.body.dimensions if self.body.dimensions == 3 else 1)
                axis = one[AXES.index(change.quantity[-1]) if len(one) == 3 else 0]
                here, there = (self._in_body(number, link, far * axis) for far in (change.before, change.after))
                model.body_ipos[number] += there - here
            elif change.quantity == "inertia":
                # all moments by one factor: what was a possible body stays one
                tensor = tensor * (change.after / change.before if change.before else 1.0)
            else:
                more, (i, j) = np.zeros((3, 3)), (AXES.index(axis) for axis in change.quantity[-2:])
                more[i, j] = more[j, i] = change.after - change.before
                tensor = tensor + more
        if tensor is before:
            return None
        moments, turn = np.linalg.eigh(tensor)
        if moments[0] <= 0 or moments[2] > moments[0] + moments[1]:
            return "no body has such moments of inertia"
        turn[:, 0] *= np.linalg.det(turn)
        model.body_inertia[number] = moments
        mujoco.mju_mat2Quat(model.body_iquat[number], turn.ravel())
        return None

    def hang(self, writer: Writer, change: FileChange) -> str | None:
        """Write a payload: a body at the tip; why it cannot be, or None."""
        number, place = self.tip()
        element = writer.element("body", number)
        if element is None:
            return INCLUDED
        at = " ".join(f"{x:.7g}" for x in place.round(12) + 0.0)
        moments = " ".join([str(FIXED.point_inertia)] * 3)
        inertial = f'<inertial pos="0 0 0" mass="{change.after:.7g}" diaginertia="{moments}"/>'
        writer.text.insert(element, f'<body name="payload" pos="{at}">{inertial}</body>', change.comment)
        return None

    def tip(self) -> tuple[int, np.ndarray]:
        """The compiled model's body that a payload hangs on, and where (3,) m in its frame."""
        assert self.body.hand is not None  # as a payload was found there
        link, site = self.body.hand
        number = body_of(self.model, self.body, link)
        return number, self._in_body(number, link, point_of(self.body.parameters(), link, site).numpy())

    def _parts(self, joint: str) -> JointParts:
        return self.body.joint_parts[self.body.joint_names.index(joint)]

    def _plane(self, joint: int) -> tuple[int, int]:
        """The file's axes that a planar chain's x and y are, across the axis of one of its hinges."""
        return ((1, 2), (0, 2), (0, 1))[int(np.abs(self.data.xaxis[joint]).argmax())]

    def _in_body(self, number: int, link: int, point: np.ndarray) -> np.ndarray:
        """A ``point`` of a link (n,) m, on a line in the plane or in its frame, in the frame of a body of it."""
        joint = joint_of(self.model, self.body, link)
        if len(point) == 3:  # a link's frame is that of its first body, at its last hinge
            hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            return np.asarray(point + self.model.jnt_pos[joint] * hinge)
        heading, far = sum(self._parts(name).zero for name in self.body.joint_names[: link + 1]), point.item()
        u, v = self._plane(joint)
        point = self.data.xanchor[joint].copy()
        point[u] += far * np.cos(heading)
        point[v] += far * np.sin(heading)
        return np.asarray(self.data.xmat[number].reshape(3, 3).T @ (point - self.data.xpos[number]))


def joint_of(model: Any, body: ArticulatedBody, link: int) -> int:
    """The last joint that moves a link, in the compiled model."""
    return joint_names(model).index(body.joint_names[body.moved_by(link)[-1]])


def body_of(model: Any, body: ArticulatedBody, link: int) -> int:
    """The compiled model's body that a link begins with."""
    return int(model.jnt_bodyid[joint_of(model, body, link)])


def shares_its_mass(model: Any, number: int) -> bool:
    """Whether bodies that weigh something are fixed to that one."""
    fixed = {number}
    for child in range(number + 1, model.nbody):
        if not model.body_jntnum[child] and int(model.body_parentid[child]) in fixed:
            fixed.add(child)
    return any(model.body_mass[child] > 0 for child in fixed - {number})

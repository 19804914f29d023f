"""Changes written into a copy of an MJCF file (mujoco.readthedocs.io, XML reference).

    damping, friction, armature, stiffness, rest    damping, frictionloss, armature, stiffness, springref of a joint
    encoder zero                                    ref of a joint, with its range and springref
    motor gain, limit, delay                        gear, forcerange, delay of the joint's actuator
    friction impedance                              solimpfriction of a joint, the file's width and midpoint
    servo gain                                      kp or kv of the joint's position or velocity servo
    payload                                         a body of that mass at the tip
    mass, com, inertia of a link                    its inertial element, made explicit from what MuJoCo compiled
    gravity                                         gravity of the option

Joints and bodies are found by their number, which follows the file's order, so that they need no names. Of elements
that an included file has, nothing is written: what is included may belong to others.
"""

from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.changes import IMPEDANCE, OF_LINK, ZERO, FileChange
from invdyn.diagnosis.write_back.xml_text import Element, XmlText
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts import NOTHING, JointParts
from invdyn.models.bodies.joint_parts_mjcf import actuators_of, joint_names
from invdyn.models.bodies.protocol import AXES
from invdyn.models.effects.inertias import inertia_of, point_of

JOINT = {"damping": "damping", "friction": "frictionloss", "armature": "armature", "stiffness": "stiffness"}
INCLUDED = "its element is not in this file itself; write it where it stands"
SERVO = "its actuator says gain and bias otherwise than by kp or kv alone; multiply both by that factor"
DAMPING = "its actuator says its damping otherwise than by kv alone; lower it there"
POINT = "1e-9 1e-9 1e-9"
"""kg·m² of a payload, which is a point: MuJoCo wants some."""


def rewritten(
    content: bytes, path: str, body: ArticulatedBody, changes: Sequence[FileChange]
) -> tuple[bytes, dict[str, str]]:
    """The content with the changes; and what could not be written: words → why.

    ``path`` is the file that the content is of, which MuJoCo reads. Raises ValueError where it cannot.
    """
    model = mujoco.MjModel.from_xml_path(path)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    text = XmlText(content)
    writer = Writer(text, model, data, body)
    unsaid: dict[str, str] = {}
    inertial: dict[str, list[FileChange]] = {}
    gravity = [change for change in changes if change.quantity.startswith("gravity")]
    for change in (each for each in changes if each not in gravity):
        if change.quantity.startswith(OF_LINK):
            inertial.setdefault(change.place, []).append(change)
        elif (why := writer.write(change)) is not None:
            unsaid[change.words] = why
    for place, several in inertial.items():
        if (why := writer.write_inertial(place, several)) is not None:
            unsaid |= {change.words: why for change in several}
    if gravity and (why := writer.write_gravity(gravity)) is not None:
        unsaid |= {change.words: why for change in gravity}
    return text.changed(), unsaid


class Writer:
    """Puts changes into a text of the compiled ``model``, whose ``data`` is in the reference pose."""

    def __init__(self, text: XmlText, model: Any, data: Any, body: ArticulatedBody):
        self.text, self.model, self.data, self.body = text, model, data, body
        self.joints = [e for e in text.found("joint", "worldbody") if not e.inside("default")]
        self.bodies = text.found("body", "worldbody")
        self.whole = not text.found("include")
        compilers = text.found("compiler")
        self.degrees = not any(c.attributes.get("angle") == "radian" for c in compilers)

    def write(self, change: FileChange) -> str | None:
        """Why a change could not be written; None where it was."""
        if change.quantity == "payload":
            return self._payload(change)
        number = joint_names(self.model).index(change.place)
        element = self._joint(number)
        if element is None:
            return INCLUDED
        if change.quantity in JOINT:
            self.text.change(element, change.comment, **{JOINT[change.quantity]: _said(change.after)})
            return None
        if change.quantity == IMPEDANCE:
            solimp = self.model.dof_solimp[self.model.jnt_dofadr[number]].copy()
            solimp[:2] = change.after
            self.text.change(element, change.comment, solimpfriction=_row(solimp))
            return None
        parts = self._parts(change.place)
        if change.quantity == ZERO:
            self._zero(element, number, parts.sign * change.after, change.comment)
            return None
        if change.quantity == "rest":
            rest = parts.sign * (change.after - parts.zero)
            self.text.change(element, change.comment, springref=_said(np.degrees(rest) if self.degrees else rest))
            return None
        return self._motor(number, change)

    def _zero(self, element: Element, joint: int, off: float, comment: str) -> None:
        """A joint counted from elsewhere; its stops and its spring's rest stay where they are in the world."""
        adr, limited = self.model.jnt_qposadr[joint], bool(self.model.jnt_limited[joint])
        in_degrees = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE and self.degrees
        angles = {"ref": [self.model.qpos0[adr]]}
        angles |= {"springref": [self.model.qpos_spring[adr]]} if self.model.jnt_stiffness[joint] else {}
        angles |= {"range": self.model.jnt_range[joint]} if limited else {}
        moved = {key: np.asarray(value) + off for key, value in angles.items()}
        said = {key: _row(np.degrees(value) if in_degrees else value) for key, value in moved.items()}
        self.text.change(element, comment, **said)

    def _parts(self, joint: str) -> JointParts:
        return self.body.joint_parts[self.body.joint_names.index(joint)] or NOTHING

    def _joint(self, number: int) -> Element | None:
        named = [e for e in self.joints if e.attributes.get("name") == self.model.joint(number).name]
        if len(named) == 1:
            return named[0]
        return self.joints[number] if self.whole and len(self.joints) == self.model.njnt else None

    def _motor(self, joint: int, change: FileChange) -> str | None:
        own = actuators_of(mujoco, self.model, joint)
        elements = [child for parent in self.text.found("actuator") for child in self._children(parent)]
        if len(own) != 1:
            return "the joint has no actuator of its own"
        if not self.whole or len(elements) != self.model.nu:
            return INCLUDED
        element, gear = elements[own[0]], self.model.actuator_gear[own[0]].copy()
        if change.quantity == "motor gain":
            gear[0] *= change.after
            self.text.change(element, change.comment, gear=" ".join(map(_said, np.trim_zeros(gear, "b"))))
        elif change.quantity == "servo gain":
            key = {"position": "kp", "velocity": "kv"}.get(element.tag)
            if key is None or "dampratio" in element.attributes:
                return SERVO
            gain = float(self.model.actuator_gainprm[own[0], 0]) * change.after
            self.text.change(element, change.comment, **{key: _said(gain)})
        elif change.quantity == "servo damping":
            if element.tag != "position" or "dampratio" in element.attributes:
                return DAMPING
            self.text.change(element, change.comment, kv=_said(change.after / gear[0] ** 2))
        elif change.quantity == "motor limit":
            force = abs(change.after / gear[0])
            self.text.change(element, change.comment, forcelimited="true", forcerange=f"{_said(-force)} {_said(force)}")
        else:
            samples = int(np.ceil(change.after / self.model.opt.timestep)) + FIXED.extra_samples
            self.text.change(element, change.comment, delay=_said(change.after), nsample=str(samples))
        return None

    def _children(self, parent: Element) -> list[Element]:
        return [e for e in self.text.elements if e.parent is parent]

    def _payload(self, change: FileChange) -> str | None:
        assert self.body.hand is not None  # as a payload was found there
        link, site = self.body.hand
        number = body_of(self.model, self.body, link)
        element = self._body(number)
        if element is None:
            return INCLUDED
        place = self._in_body(number, link, point_of(self.body.parameters(), link, site).numpy())
        self.text.insert(
            element,
            f'<body name="payload" pos="{_row(place)}">'
            f'<inertial pos="0 0 0" mass="{_said(change.after)}" diaginertia="{POINT}"/></body>',
            change.comment,
        )
        return None

    def write_gravity(self, changes: Sequence[FileChange]) -> str | None:
        """The option's gravity, of a chain in the plane the coordinates across its hinges."""
        axes = (0, 1, 2) if self.body.dimensions == 3 else self._plane(joint_of(self.model, self.body, 0))
        gravity = self.model.opt.gravity.copy()
        for change in changes:
            gravity[axes[AXES.index(change.quantity[-1])]] = change.after
        options = [e for e in self.text.found("option") if e.parent is not None and e.parent.tag == "mujoco"]
        said = [e for e in options if "gravity" in e.attributes]
        if not self.whole and not said:
            return INCLUDED
        comment = "invdyn: " + "; ".join(change.comment.removeprefix("invdyn: ") for change in changes)
        if said or options:
            self.text.change((said or options)[-1], comment, gravity=_row(gravity))
        else:
            self.text.insert(self.text.elements[0], f'<option gravity="{_row(gravity)}"/>', comment)
        return None

    def write_inertial(self, link: str, changes: Sequence[FileChange]) -> str | None:
        """A link's inertial element with other numbers; None where that could be done, else why not."""
        k = self.body.link_names.index(link)
        number = body_of(self.model, self.body, k)
        element = self._body(number)
        if element is None:
            return INCLUDED
        if shares_its_mass(self.model, number):
            return "the link is of several bodies that are fixed to each other"
        if any(c.attributes.get("inertiafromgeom") == "true" for c in self.text.found("compiler")):
            return 'its compiler takes all inertias from geoms (inertiafromgeom="true")'
        to = {change.quantity: change.after for change in changes}
        own_com = inertia_of(self.body.parameters(), k).com.numpy()
        com = own_com.copy()
        for change in changes:
            if change.quantity.startswith("com"):
                com[AXES.index(change.quantity[-1]) if len(com) == 3 else 0] = change.after
        shift = self._in_body(number, k, com) - self._in_body(number, k, own_com)
        flat = np.zeros(9)
        mujoco.mju_quat2Mat(flat, self.model.body_iquat[number])
        turn = flat.reshape(3, 3)
        tensor = turn @ np.diag(self.model.body_inertia[number]) @ turn.T
        for change in changes:
            if change.quantity == "inertia" and change.before:
                # all moments by one factor: what was a possible body stays one
                tensor = tensor * (change.after / change.before)
            elif change.quantity.startswith("inertia_"):
                i, j = (AXES.index(axis) for axis in change.quantity[-2:])
                tensor[i, j] = tensor[j, i] = tensor[i, j] + change.after - change.before
        least, middle, most = np.linalg.eigvalsh(tensor)
        if least <= 0 or most > least + middle:
            return "no body has such moments of inertia"
        place = self.model.body_ipos[number] + shift
        mass = to.get("mass", float(self.model.body_mass[number]))
        full = " ".join(_said(tensor[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))
        given = {"pos": _row(place), "mass": _said(mass), "fullinertia": full}
        said = "; ".join(change.comment.removeprefix("invdyn: ") for change in changes)
        own = [e for e in self._children(element) if e.tag == "inertial"]
        if own:
            gone = dict.fromkeys(("diaginertia", "quat", "euler", "axisangle", "xyaxes", "zaxis"))
            self.text.change(own[0], f"invdyn: {said}", **gone, **given)
        else:
            attributes = " ".join(f'{key}="{value}"' for key, value in given.items())
            self.text.insert(element, f"<inertial {attributes}/>", f"invdyn: {said}")
        return None

    def _body(self, number: int) -> Element | None:
        named = [e for e in self.bodies if e.attributes.get("name") == self.model.body(number).name]
        if len(named) == 1:
            return named[0]
        return self.bodies[number - 1] if self.whole and len(self.bodies) == self.model.nbody - 1 else None

    def _plane(self, joint: int) -> tuple[int, int]:
        """The file's axes that a planar chain's x and y are, across the axis of one of its hinges."""
        return ((1, 2), (0, 2), (0, 1))[int(np.abs(self.data.xaxis[joint]).argmax())]

    def _in_body(self, number: int, link: int, point: np.ndarray) -> np.ndarray:
        """A ``point`` of a link (n,) m, on a line in the plane or in its frame, in the frame of a body of it."""
        joint = joint_of(self.model, self.body, link)
        if len(point) == 3:  # a link's frame is that of its first body, at its last hinge
            hinge = self.model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
            return point + self.model.jnt_pos[joint] * hinge
        heading, far = sum(self._parts(name).zero for name in self.body.joint_names[: link + 1]), point.item()
        u, v = self._plane(joint)
        point = self.data.xanchor[joint].copy()
        point[u] += far * np.cos(heading)
        point[v] += far * np.sin(heading)
        return self.data.xmat[number].reshape(3, 3).T @ (point - self.data.xpos[number])


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


def _said(value: float) -> str:
    return f"{value:.7g}"


def _row(values: np.ndarray) -> str:
    return " ".join(f"{0.0 if abs(x) < 1e-12 else x:.7g}" for x in values)

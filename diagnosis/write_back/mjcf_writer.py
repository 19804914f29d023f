"""Numbers in which two compiled models differ, written into the text of their MJCF file (MuJoCo, XML reference).

    joint       damping, frictionloss, armature, stiffness, springref, ref, range, solimpfriction
    tendon      stiffness, springlength, damping, frictionloss
    geom        friction, solref, solimp, size, pos, quat
    pair        friction, solref, solimp
    equality    polycoef, anchor
    actuator    gear, forcerange, delay, timeconst; kp and kv of a servo, force or scale of a muscle
    body        its inertial element, which is added where there is none
    option      gravity

Elements are found by their names, or by their order where the file includes no other. What an included file has is not
written, for it may belong to others.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.model_numbers import HINGE
from invdyn.diagnosis.write_back.xml_text import Element, XmlText

Attributes = dict[str, str | None]
SPHERE, CONNECT = 2, 0
"""MuJoCo's numbers of a shape and of an equality."""
TURNS = ("euler", "axisangle", "xyaxes", "zaxis")
INCLUDED = "its element is not in this file itself; write it where it stands"
SERVO = "its actuator says gain and bias otherwise than by kp, kv, gear or force: multiply both by that factor"
LIMITED = "its force is limited before the gear: multiply gear and forcerange as the motor has it"
LAG = "its actuator says its lag otherwise than by timeconst: multiply it there"
FROM_SHAPE = "its inertia follows from its shape: write an inertial element beside it"
FROM_GEOMS = 'its compiler takes all inertias from geoms (inertiafromgeom="true")'
ENDS = "the shape is placed by its ends: write it there"
ELSEWHERE = "it is placed by a frame, or by a mesh's centre: move it there"
OF_SITES = "its ends are sites: move one of them"


class Writer:
    """Writes into a ``text``, whose compiled model is ``model``."""

    def __init__(self, text: XmlText, model: Any):
        self.text, self.model = text, model
        self.whole = not text.found("include")
        compilers = text.found("compiler")
        self.degrees = not any(each.attributes.get("angle") == "radian" for each in compilers)
        self.from_geoms = any(each.attributes.get("inertiafromgeom") == "true" for each in compilers)
        outside = [e for e in text.elements if not e.inside("default")]
        bodies = [e for e in outside if e.tag == "body" and e.inside("worldbody")]

        def within(section: str, *tags: str) -> list[Element]:
            own = [e for e in outside if e.parent is not None and e.parent.tag == section]
            return [e for e in own if not tags or e.tag in tags]

        def of_bodies(*tags: str) -> list[Element]:
            """In MuJoCo's order: body by body, and within one as the text has them."""
            own = [e for e in outside if e.tag in tags and e.inside("worldbody")]
            return sorted(own, key=lambda e: bodies.index(body) if (body := _body(e)) is not None else -1)

        self.kinds = {
            "joint": (of_bodies("joint", "freejoint"), model.njnt),
            "tendon": (within("tendon"), model.ntendon),
            "geom": (of_bodies("geom"), model.ngeom),
            "pair": (within("contact", "pair"), model.npair),
            "equality": (within("equality"), model.neq),
            "actuator": (within("actuator"), model.nu),
            "body": (bodies, model.nbody - 1),
        }

    def element(self, kind: str, number: int) -> Element | None:
        """Of that number in the compiled model; None where it cannot be found."""
        elements, count = self.kinds[kind]
        name = getattr(self.model, kind)(number).name
        named = [e for e in elements if name and e.attributes.get("name") == name]
        if len(named) == 1:
            return named[0]
        index = number - (kind == "body")
        return elements[index] if self.whole and len(elements) == count else None

    def child(self, parent: Element | None, tag: str) -> Element | None:
        """The last element of a tag that stands in another one itself."""
        own = [e for e in self.text.found(tag) if e.parent is parent]
        return own[-1] if own else None

    def write(self, before: Any, after: Any, comment: str) -> str | None:
        """Write all numbers in which ``after`` differs from ``before``; if one cannot be written none is, and why."""
        edits: dict[tuple[str, int], tuple[Element, Element | None, Attributes]] = {}
        for array, (kind, said) in WRITTEN.items():
            for row in _differing(before, after, array):
                number = _joint(self.model, array, row) if kind == "joint" else row
                element = self.element(kind, number)
                if element is None:
                    return INCLUDED
                new = said(self, after, element, number) if callable(said) else {said: _row(getattr(after, array)[row])}
                if isinstance(new, str):
                    return new
                own = self.child(element, "inertial") if kind == "body" else element
                edits.setdefault((kind, number), (element, own, {}))[2].update(new)
        if (before.opt.gravity != after.opt.gravity).any():
            own = self.child(self.text.elements[0], "option")
            if not self.whole and (own is None or "gravity" not in own.attributes):
                return INCLUDED  # another option may stand there
            edits["option", 0] = self.text.elements[0], own, {"gravity": _row(after.opt.gravity)}
        for (kind, _), (element, own, new) in edits.items():
            if own is not None:
                self.text.change(own, comment, **new)
            else:
                given = " ".join(f'{name}="{value}"' for name, value in new.items() if value is not None)
                self.text.insert(element, f"<{'inertial' if kind == 'body' else kind} {given}/>", comment)
        return None


# -- what an element has of a changed model, or why not -------------------------------------------
Said = Callable[[Writer, Any, Element, int], Attributes | str]


def _angle(name: str, array: str) -> Said:
    """Of a joint, in degrees where the file has these."""

    def said(writer: Writer, after: Any, joint: Element, number: int) -> Attributes:
        row = number if array == "jnt_range" else int(after.jnt_qposadr[number])
        value = getattr(after, array)[row]
        return {name: _row(np.degrees(value) if writer.degrees and after.jnt_type[number] == HINGE else value)}

    return said


def _size(writer: Writer, after: Any, geom: Element, number: int) -> Attributes | str:
    """A sphere's radius, and of other round shapes half a length besides."""
    body = int(after.geom_bodyid[number])
    if body and writer.child(writer.element("body", body), "inertial") is None:
        return FROM_SHAPE
    count = 1 if after.geom_type[number] == SPHERE or "fromto" in geom.attributes else 2
    return {"size": _row(after.geom_size[number, :count])}


def _placed(name: str) -> Said:
    def said(writer: Writer, after: Any, geom: Element, number: int) -> Attributes | str:
        if "fromto" in geom.attributes:
            return ENDS
        if geom.inside("frame") or after.geom_dataid[number] >= 0:
            return ELSEWHERE
        away: Attributes = dict.fromkeys(TURNS) if name == "quat" else {}
        return {name: _row(getattr(after, f"geom_{name}")[number]), **away}

    return said


def _equality(writer: Writer, after: Any, element: Element, number: int) -> Attributes | str:
    if after.eq_type[number] != CONNECT:
        return {"polycoef": _row(after.eq_data[number, :5])}
    return {"anchor": _row(after.eq_data[number, :3])} if "body1" in element.attributes else OF_SITES


def _servo(writer: Writer, after: Any, element: Element, number: int) -> Attributes | str:
    """Gain and bias by the words of the element's tag, those alone that differ."""
    gain, bias, old = after.actuator_gainprm[number], after.actuator_biasprm[number], writer.model
    if element.tag == "muscle":
        words = {
            "force": (gain[2], old.actuator_gainprm[number, 2]),
            "scale": (gain[3], old.actuator_gainprm[number, 3]),
        }
    elif element.tag == "motor":
        return LIMITED
    elif element.tag == "position" and "dampratio" not in element.attributes:
        words = {"kp": (gain[0], old.actuator_gainprm[number, 0]), "kv": (-bias[2], -old.actuator_biasprm[number, 2])}
    elif element.tag == "velocity":
        words = {"kv": (gain[0], old.actuator_gainprm[number, 0])}
    else:
        return SERVO
    return {word: _row(new) for word, (new, was) in words.items() if new != was}


def _gear(writer: Writer, after: Any, element: Element, number: int) -> Attributes:
    return {"gear": _row(np.trim_zeros(after.actuator_gear[number], "b"))}


def _lag(writer: Writer, after: Any, element: Element, number: int) -> Attributes | str:
    if element.tag == "general":
        return LAG
    return {"timeconst": _row(after.actuator_dynprm[number, : 2 if element.tag == "muscle" else 1])}


def _limit(writer: Writer, after: Any, element: Element, number: int) -> Attributes:
    return {"forcelimited": "true", "forcerange": _row(after.actuator_forcerange[number])}


def _delay(writer: Writer, after: Any, element: Element, number: int) -> Attributes:
    delay = after.actuator_delay[number]
    return {"delay": _row(delay), "nsample": str(int(np.ceil(delay / after.opt.timestep)) + FIXED.extra_samples)}


def _inertial(writer: Writer, after: Any, body: Element, number: int) -> Attributes | str:
    """Mass, and what differs besides; all of them where the body has no such element."""
    if writer.from_geoms:
        return FROM_GEOMS
    said: Attributes = {"mass": _row(after.body_mass[number])}
    old, new = writer.model, writer.child(body, "inertial") is None
    if new or (after.body_ipos[number] != old.body_ipos[number]).any():
        said["pos"] = _row(after.body_ipos[number])
    if new or any((getattr(after, a)[number] != getattr(old, a)[number]).any() for a in ("body_inertia", "body_iquat")):
        said |= dict.fromkeys((*TURNS, "fullinertia"))
        said |= {"quat": _row(after.body_iquat[number]), "diaginertia": _row(after.body_inertia[number])}
    return said


WRITTEN: dict[str, tuple[str, str | Said]] = {
    "dof_damping": ("joint", "damping"),
    "dof_frictionloss": ("joint", "frictionloss"),
    "dof_armature": ("joint", "armature"),
    "dof_solimp": ("joint", "solimpfriction"),
    "jnt_stiffness": ("joint", "stiffness"),
    "jnt_range": ("joint", _angle("range", "jnt_range")),
    "qpos_spring": ("joint", _angle("springref", "qpos_spring")),
    "qpos0": ("joint", _angle("ref", "qpos0")),
    "tendon_stiffness": ("tendon", "stiffness"),
    "tendon_damping": ("tendon", "damping"),
    "tendon_frictionloss": ("tendon", "frictionloss"),
    "tendon_lengthspring": ("tendon", "springlength"),
    "geom_friction": ("geom", "friction"),
    "geom_solref": ("geom", "solref"),
    "geom_solimp": ("geom", "solimp"),
    "geom_size": ("geom", _size),
    "geom_pos": ("geom", _placed("pos")),
    "geom_quat": ("geom", _placed("quat")),
    "pair_friction": ("pair", "friction"),
    "pair_solref": ("pair", "solref"),
    "pair_solimp": ("pair", "solimp"),
    "eq_data": ("equality", _equality),
    "actuator_gear": ("actuator", _gear),
    "actuator_gainprm": ("actuator", _servo),
    "actuator_biasprm": ("actuator", _servo),
    "actuator_dynprm": ("actuator", _lag),
    "actuator_forcerange": ("actuator", _limit),
    "actuator_delay": ("actuator", _delay),
    "body_mass": ("body", _inertial),
    "body_inertia": ("body", _inertial),
    "body_ipos": ("body", _inertial),
    "body_iquat": ("body", _inertial),
}
"""Arrays of a model: the kind of element that a row is of, and its attribute."""


def _joint(model: Any, array: str, row: int) -> int:
    """The joint that a row is of."""
    if array.startswith("dof"):
        return int(model.dof_jntid[row])
    return int(np.searchsorted(model.jnt_qposadr, row, "right")) - 1 if array.startswith("qpos") else row


def _differing(before: Any, after: Any, array: str) -> list[int]:
    """Rows."""
    one, other = (getattr(each, array) for each in (before, after))
    return [row for row in range(len(one)) if not np.array_equal(one[row], other[row])]


def _body(element: Element) -> Element | None:
    """The body that an element stands in; None in the world."""
    parent = element.parent
    while parent is not None and parent.tag not in ("body", "worldbody"):
        parent = parent.parent
    return parent if parent is not None and parent.tag == "body" else None


def _row(values: Any) -> str:
    return " ".join(f"{0.0 if abs(x) < 1e-12 else x:.7g}" for x in np.atleast_1d(values))

"""Numbers in which two compiled models differ, written into the text of their MJCF file (MuJoCo, XML reference).

:data:`WRITTEN` says which array is which attribute of which element. A link has its mass in its inertial element,
which is added where there is none, and in its only shape where the compiler takes inertias from these.

What an included file has is not written, for it may belong to others.
"""

from collections.abc import Callable
from typing import Any

import numpy as np

from invdyn.diagnosis.catalogue.model_numbers import HINGE
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.write_back.mjcf_elements import Elements
from invdyn.diagnosis.write_back.xml_text import Element

Attributes = dict[str, str | None]
SPHERE, CONNECT = 2, 0
"""MuJoCo's numbers of a shape and of an equality."""
TURNS = ("euler", "axisangle", "xyaxes", "zaxis")
INCLUDED = "its element is not in this file itself; write it where it stands"
SERVO = "its actuator says gain and bias otherwise than by kp, kv, gear or force: multiply both by that factor"
DAMPING = "its actuator says its damping otherwise than by kv alone; change it there"
LIMITED = "its force is limited before the gear: multiply gear and forcerange as the motor has it"
LAG = "its actuator says its lag otherwise than by timeconst: multiply it there"
FROM_SHAPE = "its inertia follows from its shape: write an inertial element next to it"
FROM_GEOMS = 'its compiler takes all inertias from geoms (inertiafromgeom="true"): change these'
ENDS = "the shape is placed by its ends: write it there"
ELSEWHERE = "it is placed by a frame, or by a mesh's centre: move it there"
OF_SITES = "its ends are sites: move one of them"


class Writer(Elements):
    """Writes into a ``text``, whose compiled model is ``model``."""

    def write(self, before: Any, after: Any, comment: str) -> str | None:
        """Write all numbers in which ``after`` differs from ``before``; if one cannot be written none is, and why."""
        edits: dict[tuple[str, int], tuple[Element, Element | None, Attributes]] = {}
        for array, (kind, said) in WRITTEN.items():
            for row in rows_differing(before, after, array):
                number = joint_of_row(self.model, array, row) if kind == "joint" else row
                element = self.element(kind, number)
                if element is None:
                    return INCLUDED
                new = said(self, after, element, number) if callable(said) else {said: _row(getattr(after, array)[row])}
                if isinstance(new, str):
                    return new
                own = self.weighed(element) if kind == "body" else element
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


WORDS = {
    "position": {"kp": (0, 0, 1), "kv": (1, 2, -1)},
    "intvelocity": {"kp": (0, 0, 1), "kv": (1, 2, -1)},
    "velocity": {"kv": (0, 0, 1)},
    "damper": {"kv": (0, 2, -1)},
    "adhesion": {"gain": (0, 0, 1)},
    "muscle": {"force": (0, 2, 1), "scale": (0, 3, 1)},
}
"""Of an actuator's tag, attributes: entries of gain (0) or bias (1), and their signs."""


# -- what an element has of a changed model, or why not -------------------------------------------
Said = Callable[[Elements, Any, Element, int], Attributes | str]


def _angle(name: str, array: str) -> Said:
    """Of a joint, in degrees where the file has these."""

    def said(file: Elements, after: Any, joint: Element, number: int) -> Attributes:
        row = number if array == "jnt_range" else int(after.jnt_qposadr[number])
        value = getattr(after, array)[row]
        return {name: _row(np.degrees(value) if file.degrees and after.jnt_type[number] == HINGE else value)}

    return said


def _size(file: Elements, after: Any, geom: Element, number: int) -> Attributes | str:
    """A sphere's radius, and of other round shapes half a length besides."""
    body = int(after.geom_bodyid[number])
    if body and (file.from_geoms or file.child(file.element("body", body), "inertial") is None):
        return FROM_GEOMS if file.from_geoms else FROM_SHAPE
    count = 1 if after.geom_type[number] == SPHERE or "fromto" in geom.attributes else 2
    return {"size": _row(after.geom_size[number, :count])}


def _placed(name: str) -> Said:
    def said(file: Elements, after: Any, geom: Element, number: int) -> Attributes | str:
        if "fromto" in geom.attributes:
            return ENDS
        if geom.inside("frame") or after.geom_dataid[number] >= 0:
            return ELSEWHERE
        away: Attributes = dict.fromkeys(TURNS) if name == "quat" else {}
        return {name: _row(getattr(after, f"geom_{name}")[number]), **away}

    return said


def _equality(file: Elements, after: Any, element: Element, number: int) -> Attributes | str:
    if after.eq_type[number] != CONNECT:
        return {"polycoef": _row(after.eq_data[number, :5])}
    return {"anchor": _row(after.eq_data[number, :3])} if "body1" in element.attributes else OF_SITES


def _servo(file: Elements, after: Any, element: Element, number: int) -> Attributes | str:
    """Gain and bias by the words of the element's tag, those alone that differ."""
    arrays = "actuator_gainprm", "actuator_biasprm"
    rows = [[getattr(model, array)[number] for array in arrays] for model in (file.model, after)]
    columns = [(k, column) for k in (0, 1) for column in np.flatnonzero(rows[0][k] != rows[1][k]).tolist()]
    words = WORDS.get(element.tag, {})
    damped = any("dampratio" in e.attributes for e in file.text.elements if e is element or e.inside("default"))
    if element.tag == "motor":
        return LIMITED
    if columns == [(1, 2)] and (damped or (1, 2, -1) not in words.values()):
        return DAMPING
    if not words or damped:
        return SERVO
    return {word: _row(sign * rows[1][k][i]) for word, (k, i, sign) in words.items() if (k, i) in columns}


def _gear(file: Elements, after: Any, element: Element, number: int) -> Attributes:
    return {"gear": _row(np.trim_zeros(after.actuator_gear[number], "b"))}


def _lag(file: Elements, after: Any, element: Element, number: int) -> Attributes | str:
    if element.tag == "general":
        return LAG
    return {"timeconst": _row(after.actuator_dynprm[number, : 2 if element.tag == "muscle" else 1])}


def _limit(file: Elements, after: Any, element: Element, number: int) -> Attributes:
    return {"forcelimited": "true", "forcerange": _row(after.actuator_forcerange[number])}


def _delay(file: Elements, after: Any, element: Element, number: int) -> Attributes:
    delay = after.actuator_delay[number]
    return {"delay": _row(delay), "nsample": str(int(np.ceil(delay / after.opt.timestep)) + FIXED.extra_samples)}


def _inertial(file: Elements, after: Any, body: Element, number: int) -> Attributes | str:
    """Mass, and what differs besides; all of them where the body has no inertial element."""
    said: Attributes = {"mass": _row(after.body_mass[number])}
    old, own = file.model, file.weighed(body)
    if file.from_geoms:
        one, other = (a.body_inertia[number] * b.body_mass[number] for a, b in ((old, after), (after, old)))
        same = np.allclose(one, other, rtol=1e-9, atol=0) and not _differ(old, after, number, "ipos", "iquat")
        return said | {"density": None} if same and own is not None else FROM_GEOMS
    if own is None or _differ(old, after, number, "ipos"):
        said["pos"] = _row(after.body_ipos[number])
    if own is None or _differ(old, after, number, "inertia", "iquat"):
        said |= dict.fromkeys((*TURNS, "fullinertia"))
        said |= {"quat": _row(after.body_iquat[number]), "diaginertia": _row(after.body_inertia[number])}
    return said


def _differ(one: Any, other: Any, body: int, *names: str) -> bool:
    return any((getattr(one, f"body_{n}")[body] != getattr(other, f"body_{n}")[body]).any() for n in names)


WRITTEN: dict[str, tuple[str, str | Said]] = {
    **{f"dof_{name}": ("joint", name) for name in ("damping", "frictionloss", "armature")},
    "dof_solimp": ("joint", "solimpfriction"),
    "jnt_stiffness": ("joint", "stiffness"),
    "jnt_range": ("joint", _angle("range", "jnt_range")),
    "qpos_spring": ("joint", _angle("springref", "qpos_spring")),
    "qpos0": ("joint", _angle("ref", "qpos0")),
    **{f"tendon_{name}": ("tendon", name) for name in ("stiffness", "damping", "frictionloss")},
    "tendon_lengthspring": ("tendon", "springlength"),
    **{f"{kind}_{name}": (kind, name) for kind in ("geom", "pair") for name in ("friction", "solref", "solimp")},
    "geom_size": ("geom", _size),
    "geom_pos": ("geom", _placed("pos")),
    "geom_quat": ("geom", _placed("quat")),
    "eq_data": ("equality", _equality),
    "actuator_gear": ("actuator", _gear),
    "actuator_gainprm": ("actuator", _servo),
    "actuator_biasprm": ("actuator", _servo),
    "actuator_dynprm": ("actuator", _lag),
    "actuator_forcerange": ("actuator", _limit),
    "actuator_delay": ("actuator", _delay),
    **{f"body_{name}": ("body", _inertial) for name in ("mass", "inertia", "ipos", "iquat")},
}
"""Arrays of a model: the kind of element that a row is of, and its attribute."""


def joint_of_row(model: Any, array: str, row: int) -> int:
    """The joint that a row of an array is of."""
    if array.startswith("dof"):
        return int(model.dof_jntid[row])
    return int(np.searchsorted(model.jnt_qposadr, row, "right")) - 1 if array.startswith("qpos") else row


def rows_differing(before: Any, after: Any, array: str) -> list[int]:
    """Rows of an array in which two models differ; none of one that this version of MuJoCo lacks."""
    one, other = (getattr(each, array, ()) for each in (before, after))
    return [row for row in range(len(one)) if not np.array_equal(one[row], other[row])]


def _row(values: Any) -> str:
    return " ".join(f"{0.0 if abs(x) < 1e-12 else x:.7g}" for x in np.atleast_1d(values))

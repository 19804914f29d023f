"""What a cause on MuJoCo's engine changes, written into a copy of the MJCF file, and the copy tried on the log.

Elements are found by their names, or by their order where the file includes no other. Of shapes that touch, the rows of
the changed model are written, so that what MuJoCo reads of the copy is what was diagnosed:

    joint       damping, frictionloss, armature, stiffness, springref
    tendon      stiffness, springlength, damping, frictionloss
    contact     friction, solref, solimp, size, pos, quat of its geoms
    equality    polycoef
    actuator    gear of a motor, kp and kv of a servo, force of a muscle, timeconst
    link        mass of its inertial element, or of its only shape
"""

from dataclasses import replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import torch

from invdyn.diagnosis.assessment.result import Cause, Diagnosis, Finding, Written
from invdyn.diagnosis.engine.cubature_filter import cubature_filter
from invdyn.diagnosis.engine.effects import EFFECTS, SEVERAL, Candidate, contacts, pair_name
from invdyn.diagnosis.engine.model_numbers import HINGE, Place, changed
from invdyn.diagnosis.engine.problem import EngineLog, engine_log, looked_at
from invdyn.diagnosis.rules import FIXED, Rules
from invdyn.diagnosis.write_back.changes import FileChange
from invdyn.diagnosis.write_back.mjcf import INCLUDED
from invdyn.diagnosis.write_back.write_back import best
from invdyn.diagnosis.write_back.xml_text import Element, XmlText
from invdyn.models import Scene
from invdyn.models.bodies.body_xml import MOST_BYTES
from invdyn.models.bodies.whole_file import read_whole
from invdyn.models.divergence import Diverged
from invdyn.recordings import Recording, atomic_path

SHAPES = {
    "friction": "geom_friction",
    "solref": "geom_solref",
    "solimp": "geom_solimp",
    "size": "geom_size",
    "pos": "geom_pos",
    "quat": "geom_quat",
}
SPHERE = 2
TURNS = ("euler", "axisangle", "xyaxes", "zaxis")
NO_WORD = "the file has no word for it"
FROM_SHAPE = "its inertia follows from its shape: write an inertial element beside it"
ENDS = "the shape is placed by its ends: write it there"
GAIN = "its actuator says its force otherwise than by gear, kp, kv or force: multiply gain and bias by that factor"
LIMITED = "its force is limited before the gear: multiply gear and forcerange as the motor has it"
ELSEWHERE = "it is placed by a frame, or by a mesh's centre: move it there"
LAG = "its actuator says its lag otherwise than by timeconst: multiply it there"


def write_back(
    diagnosis: Diagnosis, source: str | Path, scene: Scene, out: str | Path, recording: Recording, passive: bool = False
) -> Diagnosis:
    """The diagnosis with what was written: a corrected copy of ``source``, the file of ``scene``, as ``out``.

    Without a gap, or a cause, nothing is written, and that is said. Raises OSError where the file cannot be written.
    """
    cause = best(diagnosis)
    if cause is None:
        why = "there is no gap that a file should change for" if not diagnosis.gap.detected else "no cause was found"
        return replace(diagnosis, written=Written(str(out), (), {}, why))
    new, written, unsaid = rewritten(read_whole(source, MOST_BYTES), scene, cause)
    with atomic_path(out) as temporary:
        temporary.write_bytes(new)
        there = Scene.of(Path(temporary), dimensions=scene.dimensions, where=str(out))
        tried = _tried(scene, there, recording, passive, diagnosis.rules)
    changes = tuple(each.to_json() for each in written)
    return replace(diagnosis, written=Written(str(out), changes, unsaid, rollout=tried))


def rewritten(content: bytes, scene: Scene, cause: Cause) -> tuple[bytes, list[FileChange], dict[str, str]]:
    """The content with a cause's numbers; what was written, and what was not: words → why."""
    text = XmlText(content)
    model, writer = scene.model, _Writer(text, scene.model)
    written: list[FileChange] = []
    unsaid: dict[str, str] = {}
    for finding in cause.effects:
        candidate = candidate_of(model, finding)
        numbers = candidate.effect.numbers
        values = [finding.parameters[number.name].mean for number in numbers]
        after = changed(model, [(n.write, candidate.place, v) for n, v in zip(numbers, values, strict=True)])
        why: dict[str, str | None] = {}
        for number, value in zip(numbers, values, strict=True):
            e, before = finding.parameters[number.name], number.read(model, candidate.place)
            change = FileChange(candidate.place.name, number.name, before, value, e.interval_90, e.unit, finding.key)
            if number.attribute not in why:  # several numbers may be one attribute
                why[number.attribute] = writer.write(candidate.place, number.attribute, value, change.comment, after)
            reason = why[number.attribute]
            if reason is None:
                written.append(change)
            else:
                unsaid[change.words] = reason
    return text.changed(), written, unsaid


def candidate_of(model: Any, finding: Finding) -> Candidate:
    """The effect and place that a finding names."""
    effect = next(each for each in EFFECTS if each.name == finding.effect)
    (name,) = finding.where.values()
    if effect.places is contacts:
        names = {pair_name(model, pair): pair for pair in permutations(range(model.ngeom), 2)}
        pairs = tuple(names[each] for each in name.split(SEVERAL))
        return Candidate(effect, Place("contact", name, pairs[0][0], pairs))
    every = tuple(permutations(range(model.ngeom), 2))
    return Candidate(effect, next(each for each in effect.places(model, every) if each.name == name))


class _Writer:
    """Changes of elements of a text, whose compiled model is ``model``."""

    def __init__(self, text: XmlText, model: Any):
        self.text, self.model = text, model
        self.whole = not text.found("include")
        self.degrees = not any(c.attributes.get("angle") == "radian" for c in text.found("compiler"))
        outside = [e for e in text.elements if not e.inside("default")]

        def children(section: str) -> list[Element]:
            return [e for e in outside if e.parent is not None and e.parent.tag == section]

        bodies = [e for e in outside if e.tag == "body" and e.inside("worldbody")]

        def of_bodies(*tags: str) -> list[Element]:
            """In MuJoCo's order: body by body, and within one as the text has them."""
            own = [e for e in outside if e.tag in tags and e.inside("worldbody")]
            return sorted(own, key=lambda e: bodies.index(body) if (body := _body(e)) is not None else -1)

        self.kinds = {
            "joint": (of_bodies("joint", "freejoint"), model.njnt),
            "tendon": (children("tendon"), model.ntendon),
            "geom": (of_bodies("geom"), model.ngeom),
            "equality": (children("equality"), model.neq),
            "actuator": (children("actuator"), model.nu),
            "link": (bodies, model.nbody - 1),
        }

    def element(self, kind: str, number: int) -> Element | None:
        """Of that number in the compiled model."""
        elements, count = self.kinds[kind]
        lookup = {"link": "body"}.get(kind, kind)
        name = getattr(self.model, lookup)(number).name
        named = [e for e in elements if name and e.attributes.get("name") == name]
        if len(named) == 1:
            return named[0]
        index = number - (kind == "link")
        return elements[index] if self.whole and len(elements) == count else None

    def write(self, place: Place, attribute: str, value: float, comment: str, after: Any) -> str | None:
        """Why a number could not be written; None where it was."""
        if not attribute:
            return NO_WORD
        if place.kind == "contact":
            return self._shapes(attribute, comment, after)
        if (element := self.element(place.kind, place.number)) is None:
            return INCLUDED
        if place.kind == "actuator":
            return self._actuator(element, place.number, attribute, value, comment)
        if place.kind == "link":
            return self._mass(element, place.number, value, comment)
        said = _said(value)
        if attribute == "springref" and self.degrees and self.model.jnt_type[place.number] == HINGE:
            said = _said(float(np.degrees(value)))
        if attribute == "polycoef":
            said = _row(after.eq_data[place.number, :5])
        if attribute == "springlength":
            said = _row(np.unique(after.tendon_lengthspring[place.number]))
        self.text.change(element, comment, **{attribute: said})
        return None

    def _shapes(self, attribute: str, comment: str, after: Any) -> str | None:
        """Rows of all geoms that differ in the changed model."""
        field = SHAPES[attribute]
        before, new = getattr(self.model, field), getattr(after, field)
        found = []
        for geom in np.flatnonzero((before != new).any(1)).tolist():
            element = self.element("geom", geom)
            if element is None:
                return INCLUDED
            if attribute in ("pos", "quat") and "fromto" in element.attributes:
                return ENDS
            if attribute in ("pos", "quat") and (element.inside("frame") or _is_mesh(self.model, geom)):
                return ELSEWHERE
            body = int(self.model.geom_bodyid[geom])
            if attribute == "size" and body and self._inertial(body) is None:
                return FROM_SHAPE
            count = _sizes(self.model, geom, element) if attribute == "size" else None
            found.append((element, _row(new[geom][:count])))
        if not found:
            return "the pair stands in <contact>: write it there"
        for element, row in found:
            away = dict.fromkeys(TURNS) if attribute == "quat" else {}
            self.text.change(element, comment, **{attribute: row, **away})
        return None

    def _inertial(self, body: int) -> Element | None:
        element = self.element("link", body)
        own = [e for e in self.text.found("inertial") if e.parent is element]
        return own[0] if own else None

    def _mass(self, element: Element, body: int, value: float, comment: str) -> str | None:
        factor = value / float(self.model.body_mass[body])
        inertial = self._inertial(body)
        if inertial is not None:
            inertias = {
                name: _row(factor * np.array(inertial.attributes[name].split(), float))
                for name in ("diaginertia", "fullinertia")
                if name in inertial.attributes
            }
            self.text.change(inertial, comment, mass=_said(value), **inertias)
            return None
        shapes = [e for e in self.kinds["geom"][0] if e.parent is element]
        heavy = [e for e in shapes if float(e.attributes.get("mass", 1.0)) > 0]
        if len(heavy) != 1:
            return "its shapes share its mass: write an inertial element"
        self.text.change(heavy[0], comment, mass=_said(value), density=None)
        return None

    def _actuator(self, element: Element, number: int, attribute: str, value: float, comment: str) -> str | None:
        model, own = self.model, element.attributes
        if attribute == "gear":
            if element.tag == "motor":
                if model.actuator_forcelimited[number]:
                    return LIMITED
                gear = np.trim_zeros(model.actuator_gear[number], "b") * value
                self.text.change(element, comment, gear=_row(gear))
                return None
            keys = {"position": ("kp", "kv"), "velocity": ("kv",)}.get(element.tag)
            if keys is None or "dampratio" in own:
                return GAIN
            gains = {"kp": model.actuator_gainprm[number, 0], "kv": -model.actuator_biasprm[number, 2]}
            self.text.change(element, comment, **{key: _said(float(gains[key]) * value) for key in keys})
            return None
        if attribute == "force":
            if element.tag != "muscle":
                return GAIN
            peak, scale = model.actuator_gainprm[number, 2:4]
            said = {"force": _said(float(peak) * value)} if peak >= 0 else {"scale": _said(float(scale) * value)}
            self.text.change(element, comment, **said)
            return None
        if element.tag == "general":
            return LAG
        constants = model.actuator_dynprm[number, : 2 if element.tag == "muscle" else 1] * value
        self.text.change(element, comment, timeconst=_row(constants))
        return None


def _tried(before: Scene, after: Scene, recording: Recording, passive: bool, rules: Rules) -> dict | None:
    """How far replays with the file and with the copy are off the encoders; None without any."""
    import mujoco

    if recording.angles is None:
        return None
    recording = looked_at(recording, rules)
    try:
        off = [replay_errors(engine_log(recording, scene, passive=passive, rules=rules)) for scene in (before, after)]
    except Diverged:
        return None
    total = [float(np.sqrt(np.mean(np.square(list(each.values()))))) for each in off]
    return {
        "engine": f"MuJoCo {mujoco.__version__}",
        "recording": recording.name,
        "held_out": False,
        "window_s": FIXED.replay_window,
        "angle_rms_rad": {name: {"before": off[0][name], "after": off[1][name]} for name in off[0]},
        "total_rms_rad": {"before": total[0], "after": total[1]},
    }


def replay_errors(log: EngineLog) -> dict[str, float]:
    """Errors of angles, root mean square by joint, of replays that begin at a filtered state a window; {} without."""
    size = np.array([FIXED.engine_start_size])
    mean = cubature_filter(log.with_residual(1.0), log.observations.numpy(), size).mean[0]
    mean[:, : log.model.torque_size] = 0.0
    rows = len(mean)
    length = max(2, round(FIXED.replay_window / float(np.median(np.diff(log.model.time.numpy())))))
    starts = np.arange(0, rows - 1, length)
    state, off = torch.as_tensor(mean[starts]), []
    seen = log.recording.angles
    if seen is None:
        return {}
    columns = [log.model.scene.joint_names.index(name) for name in log.recording.joint_names]
    for step in range(1, length):
        there = starts + step < rows
        starts, state = starts[there], state[torch.as_tensor(there)]
        if not len(starts):
            break
        state = log.model.moved(state, torch.as_tensor(starts + step))
        _, tangent, _, _ = log.model.split(state)
        angles = log.model.reference_angles + tangent.numpy()
        off.append(angles[:, columns] - seen[starts + step])
    errors = np.sqrt(np.nanmean(np.concatenate(off) ** 2, 0))
    return dict(zip(log.recording.joint_names, errors.tolist(), strict=True))


def _body(element: Element) -> Element | None:
    """The body that an element stands in; None in the world."""
    parent = element.parent
    while parent is not None and parent.tag not in ("body", "worldbody"):
        parent = parent.parent
    return parent if parent is not None and parent.tag == "body" else None


def _is_mesh(model: Any, geom: int) -> bool:
    """Whether a geom is a mesh, which MuJoCo places by its centre."""
    return bool(model.geom_dataid[geom] >= 0)


def _sizes(model: Any, geom: int, element: Element) -> int:
    """How many numbers the size of a round shape has in the file: a sphere's radius, and half a length besides."""
    return 1 if model.geom_type[geom] == SPHERE or "fromto" in element.attributes else 2


def _said(value: float) -> str:
    return f"{value:.6g}"


def _row(values: np.ndarray) -> str:
    return " ".join(_said(float(value)) for value in values)

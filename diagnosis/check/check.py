"""`invdyn check`: whether a log is what it says it is, what its motion excites, and which effects it could show.

Each step needs the one before. First come units, by their size (:mod:`invdyn.recordings.plausible`). Then come signs,
zeros, columns, gears and offsets, by torques against motion (:mod:`..problem.mistakes`); each is put right before the
next is looked for. Base parameters (:mod:`.excitation`) and effects (:mod:`.visible`) come last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from invdyn.diagnosis.check.excitation import BaseParameter, excited
from invdyn.diagnosis.check.visible import Visible, visible
from invdyn.diagnosis.problem.angles import recorded_angles
from invdyn.diagnosis.problem.mistakes import Found, Mistake, find, fixed, units
from invdyn.diagnosis.problem.torque_regression import Explained, Motion, as_large, explain, smoothings
from invdyn.models import ArticulatedBody, Body
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import InputError, Recording, check_plausible
from invdyn.recordings.plausible import check_magnitudes
from invdyn.recordings.units import Units


@dataclass(frozen=True)
class Wrong:
    """A mistake in the words of the user: its kind, the joints' names, what, the remedy, and what else it might be.

    `before` and `after` are the shares of the torque that the motion does not ask for, NaN where no torque tells.
    """

    kind: str
    joints: tuple[str, ...]
    words: str
    remedy: str
    value: float
    before: float = float("nan")
    after: float = float("nan")
    others: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """One line."""
        where = f"at joint {' and '.join(map(repr, self.joints))} " if self.joints else ""
        told = ""
        if np.isfinite(self.before):
            told = f" (the torques miss {100 * self.before:.0f} % of their size, {100 * self.after:.0f} % then)"
        or_else = "".join(f"; or {other}" for other in self.others)
        return f"{where}{self.words}{told}: {self.remedy}{or_else}"


@dataclass(frozen=True)
class Check:
    """What is wrong with a log, what is left of its torques, and what it can show.

    Attributes:
        mistakes: what is wrong, in the order in which it was found.
        unexplained: share of the torque, 0 to 1, that the body and its friction leave; None without torques.
        by_joint: the same of each joint.
        excited: base parameters, best known first.
        visible: effects; None where the log must be put right first, or nobody asked.
    """

    recording: str
    mistakes: tuple[Wrong, ...]
    unexplained: float | None
    by_joint: dict[str, float]
    excited: tuple[BaseParameter, ...]
    visible: Visible | None

    def to_json(self) -> dict:
        """As a JSON file has it."""
        return {
            "recording": self.recording,
            "mistakes": [
                {
                    "kind": wrong.kind,
                    "joints": list(wrong.joints),
                    "what": wrong.words,
                    "remedy": wrong.remedy,
                    "value": wrong.value,
                    "torque_missed": None if np.isnan(wrong.before) else [wrong.before, wrong.after],
                    "or": list(wrong.others),
                }
                for wrong in self.mistakes
            ],
            "torque_unexplained": self.unexplained,
            "torque_unexplained_by_joint": self.by_joint,
            "base_parameters": [
                {"what": each.words, "value": each.value, "sd": each.sd, "unit": each.unit} for each in self.excited
            ],
            "effects": None if self.visible is None else self.visible.dprime,
            "record": None if self.visible is None else {what: list(of) for what, of in self.visible.record.items()},
        }


def check(recording: Recording, body: ArticulatedBody, *, passive: bool = False, effects: bool = True) -> Check:
    """Check a log against a body; ``effects`` False leaves out which ones it could show, which takes seconds.

    Raises InputError where log and body have nothing to do with each other: other joints, or nothing observed.
    """
    wrong, recording = _unit_mistakes(recording, body)
    mistakes: list[Wrong] = list(wrong)
    left: Explained | None = None
    base: list[BaseParameter] = []
    encoders = recording.angles is not None
    dynamics = dynamics_for(body)
    motion = None if passive else _motion(recording, body, wrong)
    if motion is not None:
        for each in find(dynamics, body, motion, encoders=encoders):
            mistakes.append(_in_words(each, body.joint_names))
            motion = each.mistake.right(motion)
        left = explain(dynamics, body, motion)
        base = excited(dynamics, body, motion, left.by_joint)
    shown = None
    if not mistakes:
        try:
            shown = visible(recording, body, passive) if effects else None
        except InputError as error:
            mistakes.append(Wrong("refused", (), str(error), "see there", float("nan")))
    return Check(
        recording.name,
        tuple(mistakes),
        None if left is None else left.misfit,
        {} if left is None else dict(zip(body.joint_names, left.by_joint.tolist(), strict=True)),
        tuple(base),
        shown,
    )


def _unit_mistakes(recording: Recording, body: ArticulatedBody) -> tuple[list[Wrong], Recording]:
    """What the size of numbers says of their units, and the recording in the right ones."""
    if (told := _implausible(recording, body)) is None:
        return [], recording
    singles: list[tuple[Mistake, ...]] = [(mistake,) for mistake in units()]
    several = [pair for pair in combinations(units(), 2) if pair[0].kind != pair[1].kind]
    for tried in (*singles, *several):
        righted = recording
        for mistake in tried:
            righted = _with_units(righted, mistake)
        if _implausible(righted, body) is None:
            return [Wrong(m.kind, (), m.words, m.remedy, m.value) for m in tried], righted
    return [Wrong("refused", (), told, "see there", float("nan"))], recording


def _with_units(recording: Recording, mistake: Mistake) -> Recording:
    if mistake.kind == "time":
        return replace(recording, time=recording.time * mistake.value)
    return replace(recording, angles=None if recording.angles is None else recording.angles * mistake.value)


def _implausible(recording: Recording, body: ArticulatedBody) -> str | None:
    """What :mod:`invdyn.recordings.plausible` says against it; None for nothing."""
    try:
        check_magnitudes(recording, Units())
        if isinstance(body, Body):
            check_plausible(recording, [link.nominal("length") for link in body.links], body.base)
    except InputError as error:
        return str(error)
    return None


def _motion(recording: Recording, body: ArticulatedBody, wrong: Sequence[Wrong]) -> Motion | None:
    """Motion and torques under the window in which they explain most, whatever is wrong with them; None of neither."""
    if recording.torques is None or not np.isfinite(recording.torques).all() or not recording.torques.any():
        return None
    order = [recording.joint_names.index(name) for name in body.joint_names if name in recording.joint_names]
    if len(order) < body.num_joints:
        missing = next(name for name in body.joint_names if name not in recording.joint_names)
        raise InputError(
            f"{recording.name}: expected torques of every joint of the body, {', '.join(body.joint_names)}, "
            f"got none of {missing!r}: rename the columns, or map them (--map)"
        )
    encoders = recording.angles is not None
    angle = recording.angles[:, order] if recording.angles is not None else recorded_angles(recording, body)
    motions = smoothings(body, recording.time, angle, recording.torques[:, order])
    if not motions:
        return None
    dynamics = dynamics_for(body)
    known = [*fixed(body.num_joints, encoders), *(units() if encoders else ())]

    def best(motion: Motion) -> float:
        tried = (motion, as_large(dynamics, body, motion), *(mistake.right(motion) for mistake in known))
        return min(explain(dynamics, body, each).misfit for each in tried)

    return min(motions, key=best)


def _in_words(found: Found, joints: Sequence[str]) -> Wrong:
    mistake = found.mistake

    def told(other: Mistake) -> str:
        return f"at {' and '.join(joints[k] for k in other.joints)} {other.words}" if other.joints else other.words

    names = tuple(joints[k] for k in mistake.joints)
    others = tuple(dict.fromkeys(told(other) for other in found.others))[:2]
    return Wrong(mistake.kind, names, mistake.words, mistake.remedy, mistake.value, found.before, found.after, others)

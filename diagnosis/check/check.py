"""`invdyn check`: whether a log is what it says it is, what its motion excites, and which effects it could show.

Each step needs the one before. First come rows that are no readings (:mod:`.rows`), then units, by their size
(:mod:`.units`). Then come signs, zeros, columns, gears and offsets, by torques against motion
(:mod:`.mistakes`), and where none of these is wrong, the times of commands (:mod:`.command_times`). Each is
put right before the next is looked for. Base parameters (:mod:`.excitation`) and effects (:mod:`.visible`) come last.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import TYPE_CHECKING

import numpy as np

from invdyn.diagnosis.check.command_times import between, late_commands
from invdyn.diagnosis.check.excitation import BaseParameter, excited
from invdyn.diagnosis.check.mistakes import Found, Mistake, find, known, left_by
from invdyn.diagnosis.check.rows import wrong_rows
from invdyn.diagnosis.check.torque_fit import Explained, TorqueFit
from invdyn.diagnosis.check.torque_regression import Motion, as_large
from invdyn.diagnosis.check.units import doubted_degrees, idle, motions, wrong_units
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import InputError, Recording
from invdyn.recordings.reading import Reading

if TYPE_CHECKING:
    from invdyn.diagnosis.check.visible import Visible

BY_TORQUES = "signs, zeros, exchanged columns and gears of joints"
"""What torques along a motion show."""


@dataclass(frozen=True)
class Wrong:
    """A mistake in the words of the user: its kind, the joints' names, what, the remedy, and what else it might be.

    `before` and `after` are the shares of the torque that the motion does not need, NaN without torques. `misfit` is
    that of all torques as they were, with the body's numbers that fit them best.
    """

    kind: str
    joints: tuple[str, ...]
    words: str
    remedy: str
    value: float
    before: float = float("nan")
    after: float = float("nan")
    others: tuple[str, ...] = ()
    misfit: float = float("nan")

    @property
    def by_size(self) -> bool:
        """Whether the size of the numbers tells it, and no torque."""
        return bool(np.isnan(self.before))

    @property
    def sentence(self) -> str:
        """One line."""
        where = f"at joint {' and '.join(map(repr, self.joints))} " if self.joints else ""
        missed = ""
        if np.isfinite(self.before):
            missed = f" (the torques miss {100 * self.before:.0f} % of their size, {100 * self.after:.0f} % then)"
        or_else = "".join(f"; or {other}" for other in self.others)
        return f"{where}{self.words}{missed}: {self.remedy}{or_else}"


@dataclass(frozen=True)
class Check:
    """What is wrong with a log, what is left of its torques, and what it can show.

    Attributes:
        mistakes: what is wrong, in the order in which it was found.
        unexplained: share of the torque, 0 to 1, that the body and its friction leave; None without torques.
        by_joint: the same of each joint.
        excited: base parameters, best known first.
        visible: effects; None where the log must be put right first, or where they are not wanted.
        not_looked_at: what only torques along a motion show, and why this log does not; None where it was tested.
        doubt: what may be wrong, and cannot be told; None of nothing.
        nearest: what explains most, and yet leaves more of a joint's torques than a right log does; None of nothing.
    """

    recording: str
    mistakes: tuple[Wrong, ...]
    unexplained: float | None
    by_joint: dict[str, float]
    excited: tuple[BaseParameter, ...]
    visible: "Visible | None"
    not_looked_at: str | None = None
    nearest: Wrong | None = None
    doubt: str | None = None
    rules: Rules = DEFAULT

    @property
    def unclear(self) -> bool:
        """Whether the torques miss more than those of a log that is right, and no mistake explains it."""
        if self.mistakes or self.unexplained is None:
            return False
        limits = self.rules.check
        return self.unexplained > limits.max_right_misfit or (
            self.nearest is not None and self.unexplained > limits.min_misfit
        )

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
                    "value": None if np.isnan(wrong.value) else wrong.value,
                    "torque_missed": None if np.isnan(wrong.before) else [wrong.before, wrong.after],
                    "or": list(wrong.others),
                }
                for wrong in self.mistakes
            ],
            "nearest": None if self.nearest is None or not self.unclear else self.nearest.sentence,
            "doubt": self.doubt,
            "not_looked_at": self.not_looked_at,
            "torque_unexplained": self.unexplained,
            "torque_unexplained_by_joint": self.by_joint,
            "base_parameters": [
                {"what": each.words, "value": each.value, "sd": each.sd, "unit": each.unit} for each in self.excited
            ],
            "effects": None if self.visible is None else self.visible.dprime,
            "record": None if self.visible is None else {what: list(of) for what, of in self.visible.record.items()},
        }


def check(
    recording: Recording | Reading,
    body: ArticulatedBody,
    *,
    passive: bool = False,
    effects: bool = True,
    rules: Rules = DEFAULT,
) -> Check:
    """Check a log against a body; ``effects`` False leaves out which ones it could show, which takes seconds.

    A `Reading` says where the log's units stand, so that a mistake of them is put right there. Raises InputError where
    log and body have nothing to do with each other: other joints, or nothing observed.
    """
    reading = Reading(recording) if isinstance(recording, Recording) else recording
    mistakes, reading = rows_of(reading, rules)
    implausible, units_wrong, reading = wrong_units(reading, body, rules)
    recording = reading.recording
    mistakes += [_in_words(each, body.joint_names) for each in units_wrong]
    if implausible is not None and not units_wrong:
        mistakes.append(Wrong("refused", (), implausible, "see there", float("nan")))
    left: Explained | None = None
    nearest: Wrong | None = None
    base: list[BaseParameter] = []
    encoders = recording.angles is not None
    fit = TorqueFit(dynamics_for(body), body)
    unclear = any(each.kind == "percent" for each in units_wrong)  # no angle is known, as no range is
    every = [] if passive or unclear else motions(reading, body, rules)
    motion = _motion(every, reading, fit, rules) if every else None
    if motion is not None:
        looked_for = partial(find, fit, encoders=encoders, said=reading.recording.units)
        found, dropped = looked_for(motion)
        if not found and fit.explain(motion).misfit > rules.check.max_right_misfit:  # under another window, then
            other = min(every, key=lambda each: fit.explain(each).misfit)
            again, gone = looked_for(other)
            found, dropped, motion = (again, gone, other) if again else (found, dropped, motion)
        late = late_commands(fit, motion, every, *_commands(recording, body), rules)
        if late is not None and found:  # a delay has a number: it must leave less than a sign or an exchange
            righted = reduce(lambda own, each: each.mistake.right(own) or own, found, motion)
            least = fit.explain(righted).misfit / rules.check.equal_misfit
            late = late if left_by(late.mistake, fit, motion) < least else None
        if late is not None:
            again, dropped = looked_for(late.mistake.right(motion) or motion)
            found = [late, *again]
        for each in found:
            mistakes.append(_in_words(each.mistake, body.joint_names, each))
            motion = each.mistake.right(motion) or motion
        if dropped is not None:
            nearest = _in_words(dropped.mistake, body.joint_names, dropped)
        left = fit.explain(motion)
        base = excited(fit.dynamics, body, motion, left.by_joint)
    shown = None
    if effects and not mistakes:
        from invdyn.diagnosis.check.visible import visible  # the diagnosis, which takes seconds to import

        try:
            shown = visible(recording, body, passive, rules)
        except InputError as error:
            mistakes.append(Wrong("refused", (), str(error), "see there", float("nan")))
    return Check(
        recording.name,
        tuple(mistakes),
        None if left is None else left.misfit,
        {} if left is None else dict(zip(body.joint_names, left.by_joint.tolist(), strict=True)),
        tuple(base),
        shown,
        f"{BY_TORQUES}: {_unmoved(recording, body, passive, unclear)}" if motion is None else None,
        nearest,
        None if left is None or mistakes else doubted_degrees(reading, body, left.misfit, rules),
        rules,
    )


def rows_of(reading: Reading, rules: Rules) -> tuple[list[Wrong], Reading]:
    """Rows that are no readings, in words, and the reading without them."""
    names, (found, righted) = reading.recording.joint_names, wrong_rows(reading, rules)
    return [_in_words(each, names) for each in found], righted


def _unmoved(recording: Recording, body: ArticulatedBody, passive: bool, unclear: bool = False) -> str:
    """Why a log has no motion with torques; ``unclear`` is the unit of its angles."""
    if passive:
        return "no torque acts"
    if unclear:
        return "the unit of the angles is not known"
    if recording.torques is None:
        return "the log has no torques"
    if not np.isfinite(recording.torques).all():
        return "torques are missing at some joint or row"
    return "all torques are zero" if idle(recording, body) else "the log has too few rows"


def _commands(recording: Recording, body: ArticulatedBody) -> tuple[np.ndarray, np.ndarray]:
    """Times (T,) and commands (T, K) in the order of the body's joints."""
    assert recording.torques is not None  # as there is a motion
    return recording.time, recording.torques[:, [recording.joint_names.index(name) for name in body.joint_names]]


def _motion(every: Sequence[Motion], reading: Reading, fit: TorqueFit, rules: Rules) -> Motion:
    """Motion and torques under that window, of ``every`` one, in which they explain most, right or wrong."""
    body = fit.body
    encoders = reading.recording.angles is not None
    few = [each.thinned(rules.check.scan_rows) for each in every]
    plain = [fit.explain(each).misfit for each in few]
    if min(plain) <= rules.check.min_misfit:  # nothing is wrong
        return every[int(np.argmin(plain))]
    # angles or commands alone are exchanged more rarely, and no window tells these from whole columns
    mistakes = [
        m for m in known(every[0], encoders, reading.recording.units) if m.kind != "exchanged" or "columns" in m.words
    ]
    rare = between(*_commands(reading.recording, body))

    def best(motion: Motion, whole: Motion) -> float:
        tried = [motion, as_large(fit.dynamics, body, motion)]
        tried += [] if rare is None else [whole.recommanded(rare[1]).thinned(rules.check.scan_rows)]
        return min(*(fit.explain(each).misfit for each in tried), *(left_by(each, fit, motion) for each in mistakes))

    return every[int(np.argmin([best(*each) for each in zip(few, every, strict=True)]))]


def _in_words(mistake: Mistake, joints: Sequence[str], found: Found | None = None) -> Wrong:
    """A mistake with its joints' names; where torques tell, what they miss before and after, and what else it is."""

    def words(other: Mistake) -> str:
        return f"at {' and '.join(joints[k] for k in other.joints)} {other.words}" if other.joints else other.words

    wrong = Wrong(mistake.kind, tuple(joints[k] for k in mistake.joints), mistake.words, mistake.remedy, mistake.value)
    if found is None:
        return wrong
    others = tuple(dict.fromkeys(words(other) for other in found.others))[:2]
    return replace(wrong, before=found.before, after=found.after, others=others, misfit=found.misfit)

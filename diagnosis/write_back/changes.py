"""What the best cause changes of a simulation's file, in the body's own terms; and what no file can say.

An effect adds to what the file has: from b to b + Δb. Of the whole cause, means are written, with 90 % intervals.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import torch

from invdyn.diagnosis.assessment.result import Cause, Estimate, Finding, Learned
from invdyn.models import ArticulatedBody
from invdyn.models.bodies.joint_parts import PARTS, JointParts
from invdyn.models.bodies.protocol import AXES
from invdyn.models.effects.base import rotated
from invdyn.models.effects.disturbances import turned
from invdyn.models.effects.inertias import inertia_of

SEEN = "how the motion is seen is no part of a simulation's file"
OF_LINK = ("mass", "com", "inertia")
"""What names of a link's numbers begin with: "mass", "com" or "com_x", "inertia" or "inertia_xx"."""
IMPEDANCE = "friction impedance"
"""d of MuJoCo's dry friction, from 0 to 1: a joint at rest creeps the less, the nearer it is to 1."""
SERVO_DAMPING = "servo damping"
ZERO = "encoder zero"
"""What an encoder shows where the body's angle is 0, rad."""
ZERO_ELSEWHERE = "subtract it from the log's angles, or from the joint's zero in the map"
Z_90 = 1.645  # sd, half of a normal 90 % interval
PLACED = "it was learned because the file calls it uncertain; where links begin and end stays as the file has it"
NOT_SAID = "a simulation's file has no word for it"


@dataclass(frozen=True)
class FileChange:
    """One number of a file: of a joint, a link or the whole ("gravity_x"), by name; what it is, from and to, in `unit`.

    `interval_90` is of `after`; `effect` the finding's key, or "learned" of a number that was uncertain.
    """

    place: str
    quantity: str
    before: float
    after: float
    interval_90: tuple[float, float]
    unit: str
    effect: str

    @property
    def words(self) -> str:
        """What it is, as it is named where it cannot be written."""
        return f"{self.quantity} of {self.place}" if self.place else self.quantity

    def to_json(self) -> dict[str, Any]:
        """What a diagnosis.json has of it."""
        return {
            "place": self.place,
            "quantity": self.quantity,
            "from": self.before,
            "to": self.after,
            "interval_90": list(self.interval_90),
            "unit": self.unit,
            "effect": self.effect,
        }

    @property
    def comment(self) -> str:
        """Its comment in a file."""
        return comment_of([self])


def comment_of(changes: Sequence[FileChange]) -> str:
    """The comment of changes that are written together."""
    said = [
        f"{each.quantity} of {each.place or 'the whole'} from {each.before:.4g} to {each.after:.4g} {each.unit}, "
        f"90 % interval {each.interval_90[0]:.4g} to {each.interval_90[1]:.4g}"
        for each in changes
    ]
    return f"invdyn: {'; '.join(said)}"


@dataclass(frozen=True)
class Correction:
    """What to change, and what cannot be: words → why."""

    changes: tuple[FileChange, ...]
    unsaid: dict[str, str]


class Refined(Protocol):
    """Numbers of a file that an output-error fit found, with those of an ensemble's members."""

    @property
    def changes(self) -> tuple[FileChange, ...]:
        """At the fit."""

    def member(self, place: int) -> tuple[FileChange, ...]:
        """At one of the draws."""

    def to_json(self) -> dict[str, Any]:
        """What a diagnosis.json has of it."""


def correction(cause: Cause, body: ArticulatedBody) -> Correction:
    """The changes that a cause asks for."""
    changes: list[FileChange] = []
    unsaid: dict[str, str] = {}
    for finding in cause.effects:
        if (entry := finding.entry) and entry.file_change:
            changes += SAID[entry.file_change](finding, body)
            if entry.said_in_part:
                unsaid[finding.key] = entry.said_in_part
        else:
            unsaid[finding.key] = NOT_SAID if finding.side == "dynamics" else SEEN
    said = {(change.place, change.quantity): place for place, change in enumerate(changes)}
    for number in cause.learned:
        before, to = number.change.before, number.change.after
        also = said.get((number.place, number.quantity))
        if not in_files(number):
            unsaid[f"{number.quantity} of {number.place}"] = PLACED
        elif also is None:
            change = FileChange(number.place, number.quantity, before, to.mean, to.interval_90, to.unit, "learned")
            changes.append(change)
        elif number.quantity not in PARTS:  # a joint's part has both already (:mod:`..assessment.findings`)
            changes[also] = _later(changes[also], to.mean - before, to.sd)
    return Correction(tuple(changes), unsaid)


def in_files(number: Learned) -> bool:
    """Whether what was learned of a number is written: of joints' parts and links' inertias."""
    return number.quantity in PARTS or number.quantity.startswith(OF_LINK)


def _later(change: FileChange, shift: float, sd: float) -> FileChange:
    """A change from what was learned: by its ``shift``, whose ``sd`` widens the interval as if it were independent."""
    after, (low, high) = change.after + shift, change.interval_90
    below, above = (math.hypot(end - change.after, Z_90 * sd) for end in (low, high))
    return replace(change, after=after, interval_90=(after - below, after + above))


def _joint(body: ArticulatedBody, name: str) -> JointParts:
    return body.joint_parts[body.joint_names.index(name)]


def _raised(finding: Finding, place: str, quantity: str, name: str, before: float) -> FileChange:
    """A number by so much more."""
    if name in finding.changes:
        after = finding.changes[name].after
        return FileChange(place, quantity, before, after.mean, after.interval_90, after.unit, finding.key)
    e = finding.parameters[name]
    return FileChange(place, quantity, before, before + e.mean, _moved(e, before), e.unit, finding.key)


def _moved(e: Estimate, before: float, factor: float = 1.0) -> tuple[float, float]:
    low, high = sorted(before + factor * x for x in e.interval_90)
    return low, high


def _part(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    """Parts of a joint, to which parameters add."""
    joint, fields = finding.where["joint"], finding.entry.body_file_fields if finding.entry else {}
    own = _joint(body, joint)
    raised = [_raised(finding, joint, part, name, getattr(own, part)) for name, part in fields.items()]
    return [each for change in raised for each in _with_the_servo(change, own)]


def _with_the_servo(change: FileChange, own: JointParts) -> list[FileChange]:
    """A joint whose servo damps it too may have less damping than none: the servo then has less."""
    drag, (low, high) = own.servo_damping, change.interval_90
    if change.quantity != "damping" or change.after >= 0 or not drag:
        return [change]
    servo = replace(
        change,
        quantity=SERVO_DAMPING,
        before=drag,
        after=max(0.0, drag + change.after),
        interval_90=(min(max(0.0, drag + low), drag), min(max(0.0, drag + high), drag)),
    )
    return [replace(change, after=0.0, interval_90=(0.0, max(0.0, high))), servo]


def _friction(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    """Friction that a joint has in motion."""
    joint = finding.where["joint"]
    return [_raised(finding, joint, "friction", "coulomb", _joint(body, joint).friction)]


def _spring(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    """Two springs are one: k = k₀ + Δk, at rest where their torques balance."""
    joint = finding.where["joint"]
    own, k, rest = _joint(body, joint), finding.parameters["stiffness"], finding.parameters["rest_angle"]
    total = own.stiffness + k.mean
    whole = (own.stiffness * own.rest + k.mean * rest.mean) / total if total > 0 else own.rest
    stiffer = _raised(finding, joint, "stiffness", "stiffness", own.stiffness)
    shift = whole - rest.mean
    rest_change = FileChange(joint, "rest", own.rest, whole, _moved(rest, shift), "rad", finding.key)
    return [stiffer, rest_change]


def _gain(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    e = finding.parameters["gain"]
    joints = [finding.where["joint"]] if "joint" in finding.where else list(body.joint_names)
    named = [(j, "motor gain" if _joint(body, j).servo is None else "servo gain") for j in joints]
    return [FileChange(j, name, 1.0, 1 + e.mean, _moved(e, 1.0), "1", finding.key) for j, name in named]


def _limit(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    joint, e = finding.where["joint"], finding.parameters["limit"]
    motor = _joint(body, joint).motor
    before = float("inf") if motor is None else motor.high
    return [FileChange(joint, "motor limit", before, e.mean, e.interval_90, e.unit, finding.key)]


def _payload(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    e = finding.parameters["mass"]
    assert body.hand is not None  # as a payload was found there
    return [FileChange(body.link_names[body.hand[0]], "payload", 0.0, e.mean, e.interval_90, e.unit, finding.key)]


def _inertial(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    name = finding.where["link"]
    own = inertia_of(body.parameters(), body.link_names.index(name))
    before = torch.cat([own.mass, own.com, own.mean]).tolist()
    return [_raised(finding, name, key, key, value) for key, value in zip(finding.parameters, before, strict=True)]


def _delay(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    e = finding.parameters["delay"]
    joints = [finding.where["joint"]] if "joint" in finding.where else list(body.joint_names)
    return [FileChange(j, "motor delay", 0.0, e.mean, e.interval_90, e.unit, finding.key) for j in joints]


def _zero(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    e = finding.parameters["offset"]
    return [FileChange(finding.where["joint"], ZERO, 0.0, e.mean, e.interval_90, e.unit, finding.key)]


def _gravity(finding: Finding, body: ArticulatedBody) -> list[FileChange]:
    """Rotated gravity in the body's frame; each angle moves its coordinates by themselves, to first order."""
    given, own = finding.parameters, torch.tensor(body.gravity, dtype=torch.float64)

    def at(**other: float) -> torch.Tensor:
        angles = {name: torch.tensor([other.get(name, e.mean)], dtype=own.dtype) for name, e in given.items()}
        if "angle" in angles:
            return rotated(own, angles["angle"])
        return turned(own, torch.cat([angles.get(f"about_{axis}", own.new_zeros(1)) for axis in AXES]))

    after = at()
    ends = [torch.stack([at(**{name: end}) - after for end in e.interval_90]) for name, e in given.items()]
    below, above = (torch.stack(side).square().sum(0).sqrt() for side in zip(*map(_sides, ends), strict=True))
    every = zip(AXES, own.tolist(), after.tolist(), (after - below).tolist(), (after + above).tolist(), strict=False)
    return [
        FileChange("", f"gravity_{axis}", before, to, (low, high), "m/s²", finding.key)
        for axis, before, to, low, high in every
        if abs(to - before) > 1e-12 * float(own.norm())
    ]


def _sides(ends: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """How far coordinates (2, n) at two ends of an interval go below and above, (n,) each."""
    return ends.amin(0).clamp_max(0), ends.amax(0).clamp_min(0)


SAID: dict[str, Callable[[Finding, ArticulatedBody], list[FileChange]]] = {
    "joint part": _part,
    "friction in motion": _friction,
    "spring": _spring,
    "motor gain": _gain,
    "motor limit": _limit,
    "motor delay": _delay,
    "payload": _payload,
    "inertia": _inertial,
    "gravity": _gravity,
    "encoder zero": _zero,
}
"""What a file can say, by :attr:`.CatalogueEntry.file_change`."""

"""Units of a log that are wrong: by the size of its numbers, and by its torques where the unit was declared.

A unit that was not declared is wrong where its numbers cannot be the body's, and can in another one
(:mod:`.mistakes`). One that was declared is wrong where, besides that, the torques are far from what the
motion asks for, and near it in the other unit. One mistake comes before two; of several that will do, that one is taken
with which the torques fit best.

Numbers of a mapping within ±100 may be degrees, or say how far each joint is in its range (LeRobot's usual unit). Only
torques tell these two apart. Numbers that end at ±100, or at 0 and 100, are no degrees.
"""

import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from invdyn.diagnosis.check.mistakes import Mistake, units
from invdyn.diagnosis.check.robot_terms import RobotTerms
from invdyn.diagnosis.check.torque_fit import TorqueFit
from invdyn.diagnosis.check.torque_regression import Motion, smoothings
from invdyn.diagnosis.problem.angles import recorded_angles
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.inference.plausible_for_body import check_fits, slides
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.effects.scale import NEGLIGIBLE, typical_torque
from invdyn.recordings import InputError, Recording
from invdyn.recordings.logs.mapping import ENDS
from invdyn.recordings.plausible import check_magnitudes, check_shifts
from invdyn.recordings.reading import Reading
from invdyn.recordings.units import Units


def wrong_units(
    reading: Reading, body: ArticulatedBody, rules: Rules = DEFAULT
) -> tuple[str | None, tuple[Mistake, ...], Reading]:
    """What speaks against the units, the mistakes that explain it, and the reading without them.

    None, no mistakes and the reading as it is where nothing does; no mistakes where no other unit will do.
    """
    recording, limits = reading.recording, rules.check
    if _rows(recording) < rules.recording.min_rows:  # too few to tell a pace by
        return None, (), reading
    implausible = _implausible(recording, body)
    if implausible is None and _implausible(replace(recording, units=Units()), body) is None:
        return None, (), reading
    if _refused(partial(check_shifts, recording, slides(body))) is not None:  # of one joint, and read from its own line
        return implausible, (), reading
    found: list[tuple[float, tuple[Mistake, ...], Reading]] = []
    for tried in _combined(reading):
        if found and len(tried) > len(found[0][1]):
            break  # one mistake is more probable than two
        scales: dict[str, float] = {}
        for mistake in tried:
            scales |= mistake.scales
        try:
            righted = reading.rescaled(**scales)
        except InputError:  # no times of any recording
            continue
        if _implausible(replace(righted.recording, units=Units()), body) is None:
            found.append((least_misfit(righted, body, rules), tried, righted))
    if not found:
        return implausible, (), reading
    # the first one where no torque tells
    missed, mistakes, righted = min(found, key=lambda each: each[0])
    own = least_misfit(reading, body, rules)
    if implausible is None and not missed < min(limits.max_remaining * own, limits.max_right_misfit):
        return None, (), reading
    if 0 < own < min(missed, limits.max_right_misfit):  # an arm that whirls: its torques say so, and outweigh its size
        return None, (), reading
    degrees = any(mistake.kind == "degrees" for mistake in mistakes)
    if degrees and (shares := _shares(reading, body, 0 < missed < limits.degrees_misfit, rules)) is not None:
        return implausible, (shares,), reading
    return implausible, mistakes, righted


def _rows(recording: Recording) -> int:
    """Rows with an observation."""
    seen = np.isfinite(recording.keypoints).any((1, 2))
    return int((seen if recording.angles is None else seen | np.isfinite(recording.angles).any(1)).sum())


def _shares(reading: Reading, body: ArticulatedBody, all_confirmed: bool, rules: Rules) -> Mistake | None:
    """That a mapping's numbers are, or may be, shares of each joint's range; None where they are degrees.

    ``all_confirmed``: whether the torques say that they are degrees.
    """
    within = _within(reading, body, rules)
    if within is None or (all_confirmed and within == "inside"):
        return None
    turn = _range_for(reading)
    if within == "ends":
        words = "numbers end at ±100: they say how far each joint is in its range, as LeRobot's do"
        return Mistake("percent", (), words, turn, math.nan)
    words = "the angles are no radians: LeRobot's −100 to 100 of each joint's range, or degrees"
    turn += ', or, if they are degrees, unit = "deg"'
    return Mistake("percent", (), words, turn, math.nan)


def doubted_degrees(reading: Reading, body: ArticulatedBody, misfit: float, rules: Rules = DEFAULT) -> str | None:
    """That a servo log's numbers, which a mapping calls degrees, may be shares of ranges; None where torques say not.

    Degrees and shares are alike in size. So a right log of degrees may be doubted, whose simulation misses as much.
    """
    units = {own.angle.unit for own in reading.maps or () if own.angle is not None}
    if units != {"deg"} or not reading.targets or misfit < rules.check.degrees_misfit:
        return None
    if _within(reading, body, rules) is None:
        return None
    return (
        f"the numbers called degrees stay within ±100, and the torques miss {100 * misfit:.0f} %: they may be "
        f"LeRobot's −100 to 100 of each joint's range (without use_degrees); then {_range_for(reading)}, and no unit"
    )


def _within(reading: Reading, body: ArticulatedBody, rules: Rules) -> str | None:
    """Whether a mapping's numbers of angles stay "inside" ±100, or end there ("ends"); None of others."""
    recording = reading.recording
    if reading.maps is None or recording.angles is None:
        return None
    order = [recording.joint_names.index(name) for name in body.joint_names if name in recording.joint_names]
    angles = recording.angles[:, order]
    if angles.shape[1] != body.num_joints:
        return None
    raw = RobotTerms.of(body, np.zeros_like(angles), reading.maps).angle.raw(angles)
    low, high = np.nanmin(raw, axis=0, initial=np.inf), np.nanmax(raw, axis=0, initial=-np.inf)
    if (np.maximum(-low, high) > ENDS[1] + rules.check.range_tolerance).any():
        return None
    ends = (np.abs(np.stack([-low, high]) - ENDS[1]) <= rules.check.range_tolerance).any()
    return "ends" if ends else "inside"


def _range_for(reading: Reading) -> str:
    """What to write for shares of a range."""
    lines = " and ".join(f'"{track} = …"' for track in (("angle", "target") if reading.targets else ("angle",)))
    mapping = reading.recording.units.mapping
    return f"write range = [low, high], rad at −100 and at 100, in each line {lines} of {mapping}"


def motions(reading: Reading, body: ArticulatedBody, rules: Rules = DEFAULT) -> list[Motion]:
    """Motion and torques under each window; none where no torque is known, or none acts to speak of.

    Raises InputError where a joint of the body has no torques.
    """
    recording = reading.recording
    if recording.torques is None or not np.isfinite(recording.torques).all() or idle(recording, body):
        return []
    order = [recording.joint_names.index(name) for name in body.joint_names if name in recording.joint_names]
    if len(order) < body.num_joints:
        missing = next(name for name in body.joint_names if name not in recording.joint_names)
        raise InputError(
            f"{recording.name}: expected torques of every joint of the body, {', '.join(body.joint_names)}, "
            f"got none of {missing!r}: rename the columns, or map them (--map)"
        )
    angle = recording.angles[:, order] if recording.angles is not None else recorded_angles(recording, body)
    return smoothings(body, recording.time, angle, recording.torques[:, order], reading.maps, rules)


def idle(recording: Recording, body: ArticulatedBody) -> bool:
    """Whether all torques are zero, or so small that they move nothing."""
    if recording.torques is None:
        return True
    typical = typical_torque(dynamics_for(body), body.parameters()).max().item()
    return not bool((np.abs(recording.torques) > NEGLIGIBLE * typical).any())


def least_misfit(reading: Reading, body: ArticulatedBody, rules: Rules) -> float:
    """The misfit of the torques under the window that it is least under; 0 where none are known."""
    fit = TorqueFit(dynamics_for(body), body)
    return min((fit.explain(each).misfit for each in motions(reading, body, rules)), default=0.0)


def _combined(reading: Reading) -> Iterator[tuple[Mistake, ...]]:
    """One mistake, or one of angles and one of times."""
    stated = None
    if reading.maps is not None:
        stated = {
            track: {own.unit for own in (getattr(each, track) for each in reading.maps) if own is not None} or {None}
            for track in ("angle", "target")
        }
    every = list(units(reading.recording.units, reading.targets, stated))
    yield from ((mistake,) for mistake in every)
    yield from (pair for pair in combinations(every, 2) if len({each.kind == "time" for each in pair}) == 2)


def _implausible(recording: Recording, body: ArticulatedBody) -> str | None:
    """What speaks against the size of the numbers; None for nothing."""
    return wrong_size(recording, slides(body), partial(check_fits, recording, body))


def wrong_size(recording: Recording, shifting: Collection[str], fits: Callable[[], None]) -> str | None:
    """The same of joints of which some are ``shifting``, and by what ``fits`` raises."""
    turning = [name not in shifting for name in recording.joint_names]
    angles = None if recording.angles is None else np.where(turning, 1.0, 0.0) * recording.angles
    turns = replace(recording, angles=angles)
    return _refused(partial(check_shifts, recording, shifting), partial(check_magnitudes, turns), fits)


def _refused(*checks: Callable[[], None]) -> str | None:
    """What the first check that refuses the recording says; None where none does."""
    try:
        for each in checks:
            each()
    except InputError as error:
        return str(error)
    return None

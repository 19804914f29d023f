"""Units of a log that are wrong: by the size of its numbers, and by its torques where somebody said the unit.

A unit that nobody declared is wrong where its numbers cannot be the body's, and can in another one
(:mod:`..problem.mistakes`). One that was declared is wrong where, beside that, the torques are far from what the motion
asks for, and near it in the other unit. One mistake comes before two; of several that will do, that one is taken with
which the torques fit best.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from invdyn.diagnosis.problem.angles import recorded_angles
from invdyn.diagnosis.problem.mistakes import BETTER, NEAR, Mistake, units
from invdyn.diagnosis.problem.torque_regression import Motion, explain, smoothings
from invdyn.inference.plausible_for_body import check_fits, slides
from invdyn.models import ArticulatedBody
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.recordings import InputError, Recording
from invdyn.recordings.plausible import check_magnitudes, check_shifts
from invdyn.recordings.reading import Reading
from invdyn.recordings.units import Units


def wrong_units(reading: Reading, body: ArticulatedBody) -> tuple[str | None, tuple[Mistake, ...], Reading]:
    """What speaks against the units, the mistakes that explain it, and the reading without them.

    None, no mistakes and the reading as it is where nothing does; no mistakes where no other unit will do.
    """
    recording = reading.recording
    told = _implausible(recording, body, reading.units)
    if told is None and _implausible(recording, body, Units()) is None:
        return None, (), reading
    if _shifted(recording, body, reading.units) is not None:  # of one joint, and told by its own line
        return told, (), reading
    found: list[tuple[float, tuple[Mistake, ...], Reading]] = []
    for tried in _combined(reading):
        if found and len(tried) > len(found[0][1]):
            break  # one mistake is likelier than two, whatever the torques say
        scales: dict[str, float] = {}
        for mistake in tried:
            scales |= mistake.scales
        try:
            righted = reading.rescaled(**scales)
        except InputError:  # no times of any recording
            continue
        if _implausible(righted.recording, body, Units()) is None:
            found.append((_missed(righted, body), tried, righted))
    if not found:
        return told, (), reading
    # the first one where no torque tells
    missed, mistakes, righted = min(found, key=lambda each: each[0])
    if told is None and not missed < min(BETTER * _missed(reading, body), NEAR):
        return None, (), reading
    return told, mistakes, righted


def motions(reading: Reading, body: ArticulatedBody) -> list[Motion]:
    """Motion and torques under each window; none where no torque is known.

    Raises InputError where a joint of the body has no torques.
    """
    recording = reading.recording
    if recording.torques is None or not np.isfinite(recording.torques).all() or not recording.torques.any():
        return []
    order = [recording.joint_names.index(name) for name in body.joint_names if name in recording.joint_names]
    if len(order) < body.num_joints:
        missing = next(name for name in body.joint_names if name not in recording.joint_names)
        raise InputError(
            f"{recording.name}: expected torques of every joint of the body, {', '.join(body.joint_names)}, "
            f"got none of {missing!r}: rename the columns, or map them (--map)"
        )
    angle = recording.angles[:, order] if recording.angles is not None else recorded_angles(recording, body)
    return smoothings(body, recording.time, angle, recording.torques[:, order], reading.maps)


def _missed(reading: Reading, body: ArticulatedBody) -> float:
    """The misfit of the torques under the window that it is least under; 0 where none are known."""
    dynamics = dynamics_for(body)
    return min((explain(dynamics, body, each).misfit for each in motions(reading, body)), default=0.0)


def _combined(reading: Reading) -> Iterator[tuple[Mistake, ...]]:
    """One mistake, or one of angles and one of times."""
    every = list(units(reading.units, reading.targets))
    yield from ((mistake,) for mistake in every)
    yield from (pair for pair in combinations(every, 2) if len({each.kind == "time" for each in pair}) == 2)


def _implausible(recording: Recording, body: ArticulatedBody, units: Units) -> str | None:
    """What speaks against the size of the numbers; None for nothing."""
    if (told := _shifted(recording, body, units)) is not None:
        return told
    turning = [name not in slides(body) for name in recording.joint_names]
    try:
        angles = None if recording.angles is None else np.where(turning, recording.angles, np.nan)
        check_magnitudes(replace(recording, angles=angles), units)
        check_fits(recording, body, units)
    except InputError as error:
        return str(error)
    return None


def _shifted(recording: Recording, body: ArticulatedBody, units: Units) -> str | None:
    """What speaks against the size of the numbers of joints that shift."""
    try:
        check_shifts(recording, slides(body), units)
    except InputError as error:
        return str(error)
    return None

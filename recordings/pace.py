"""Plausibility of a recording's times and speeds for a body of given size; and gaps in the times.

The period of a pendulum as long as the body, T = 2π √(L/g), is a natural unit of time. It distinguishes seconds from
frame numbers, and radians from degrees:

    rows      come at least four times a period (a quarter of it is the fall from level to hanging), else motion is
              not resolved; and no faster than `PLAUSIBLE.interval`
    speeds    have Froude numbers v²/(g L), the tip's centripetal over gravity's acceleration (Alexander, Physiol. Rev.
              69, 1989), of the order of 1: the robots and passive pendulums that come with this package lie between 0
              and 4.3; minutes taken for seconds raise it 3,600-fold, degrees taken for radians 3,283-fold

v is the mean speed over `PLAUSIBLE.speed_baseline`, over which noise is averaged. It must be exceeded in a quarter of
the rows, so that neither rest nor a few outliers count. g = 9.81 m/s², for all gravities in the body's own plane.
"""

import warnings
from dataclasses import replace
from typing import Any

import numpy as np

from .errors import InputError
from .limits import PLAUSIBLE
from .recording import Recording
from .units import TIMES

GRAVITY = 9.81  # m/s²


def swing(length: float) -> float:
    """Period of a pendulum of that length (m), s."""
    return 2 * np.pi * float(np.sqrt(length / GRAVITY))


def check_interval(recording: Recording, length: float) -> None:
    """Raise InputError when rows with an observation are too far apart, or too near, for seconds.

    Args:
        recording: its times in seconds, if that is what they are.
        length: of the body, m; of pixels and body lengths, whose size in m is unknown, about 1.
    """
    time = recording.time[_observed(recording)]
    if len(time) < 2:
        return
    interval = float(np.median(np.diff(time)))
    slowest = swing(length) / 4
    if np.spacing(np.abs(time).max()) > 0.01 * interval:
        raise InputError(
            f"times near {time[0]:.9g} s have too few digits for rows {interval:.3g} s apart: count from the first row"
        )
    if PLAUSIBLE.interval <= interval <= slowest:
        return
    units = recording.units
    whole = bool((time == np.round(time)).all()) and interval == 1.0
    fitting = [unit for unit, size in TIMES.items() if 10 * PLAUSIBLE.interval <= interval * size <= slowest]
    likely = min(
        fitting, key=lambda unit: abs(np.log(interval * TIMES[unit] / PLAUSIBLE.typical_interval)), default=None
    )
    if whole and units.mapping is None:
        hint = "these look like frame numbers: pass --units frames --fps with the frame rate"
    elif likely is not None:
        hint = f"these look like {likely}: {units.put(likely)}"
    else:
        hint = "give times in seconds, and the right --fps"
    limit = f"swings once in {4 * slowest:.2g} s" if interval > slowest else "is filmed and read less often"
    size = f"of {length:.2g} m" if recording.length_unit == "m" else "of usual length"
    raise InputError(
        f"rows are {interval:.3g} s apart (median), but an arm {size} {limit}; {hint} "
        f"({units.accepts('s')} if seconds they are)"
    )


def froude(places: np.ndarray, time: np.ndarray, length: float) -> float:
    """v²/(g L) of places (T, D), m, at times (T,), s; NaN rows are skipped; 0 for fewer than two rows."""
    seen = np.isfinite(places).all(axis=-1)
    places, time = places[seen], time[seen]
    if len(time) < 2:
        return 0.0
    rows = round(PLAUSIBLE.speed_baseline * np.sqrt(length / GRAVITY) / np.median(np.diff(time)))
    rows = min(max(rows, 1), len(time) - 1)
    speed = np.linalg.norm(places[rows:] - places[:-rows], axis=-1) / (time[rows:] - time[:-rows])
    return float(np.quantile(speed, 0.75) ** 2 / (GRAVITY * length))


def bridged(recording: Recording, length: float, first: int = 0) -> Recording:
    """Rows without an observation, a frame interval apart, across each step longer than a quarter of a swing.

    So long a step is too large for an integrator with a constant torque; empty rows let the bands widen instead.
    Commands stay constant. A warning says so.

    Args:
        recording: any.
        length: of the body, m.
        first: number, from 0, that its first row has in the file.

    Raises InputError when this would take more rows than were recorded: the parts before and after such a gap are
    independent.
    """
    time, interval = recording.time, recording.frame_interval
    step = np.diff(time)
    more = np.where(step > swing(length) / 4, np.ceil(step / interval - 1e-6) - 1, 0)
    if not more.any():
        return recording
    worst = int(step.argmax())
    row = first + worst + 1
    where = f"rows {row} and {row + 1} are {step[worst]:.3g} s apart ({time[worst]:g} s, then {time[worst + 1]:g} s)"
    if more.sum() > len(time):
        raise InputError(
            f"{where}: no torque can be inferred across so long a gap. Use the rows before it (--frames :{row}) or "
            f"after it (--frames {row}:)"
        )
    more = more.astype(int)
    source = np.repeat(np.arange(len(time)), np.append(more + 1, 1))
    part = np.arange(len(source)) - np.flatnonzero(np.diff(source, prepend=-1))[source]
    share = part / (np.append(more, 0)[source] + 1)
    filled = time[source] + share * np.append(step, 0.0)[source]

    def rows(values: Any, constant: bool = False) -> Any:
        if values is None:
            return None
        values = values[source]
        if not constant:
            values[part > 0] = np.nan
        return values

    warnings.warn(
        f"{where}: gaps longer than {swing(length) / 4:.2g} s are bridged by {more.sum()} rows without an observation",
        stacklevel=2,
    )
    return replace(
        recording,
        time=filled,
        keypoints=rows(recording.keypoints),
        confidence=rows(recording.confidence),
        angles=rows(recording.angles),
        torques=rows(recording.torques, constant=True),
    )


def _observed(recording: Recording) -> np.ndarray:
    """(T,) whether a row has a place or an angle; a row may carry a command alone."""
    seen = np.isfinite(recording.keypoints).any(axis=(1, 2))
    return seen if recording.angles is None else seen | np.isfinite(recording.angles).any(axis=1)

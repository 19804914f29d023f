"""Rows of a log that are no readings, by their numbers alone: outliers, wrapped angles, held values.

    stray     a value c comes back exactly, ten usual steps or more from the rows around: another publisher's
    wrapped   steps of nearly the whole range of a joint, with small ones around them: q is known modulo M
    held      new numbers come in every p-th row alone, and are more than one count of the sensor

Numbers are compared with those of the same column, so that no unit matters. The modulus is stated in the numbers of the
log, where it is one that encoders have (2π, 360, 4096, …).

Shapes: T rows, K joints.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn.diagnosis.check.mistakes import Mistake
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.recordings import Recording
from invdyn.recordings.reading import Reading

MODULI = (math.tau, math.pi, 1.0, 2.0, 100.0, 200.0, 360.0, 180.0, 1024.0, 2048.0, 4096.0, 8192.0, 16384.0, 65536.0)
"""In which encoders count, in their own numbers."""


def wrong_rows(reading: Reading, rules: Rules = DEFAULT) -> tuple[list[Mistake], Reading]:
    """What is wrong with the rows of a reading, and the reading without it: outliers and repeats missing, unwrapped.

    The number of a mistake is the constant, the modulus or the period.
    """
    if reading.recording.angles is None:
        return [], reading
    found, righted = _righted(reading.recording, _factors(reading), rules)
    if not found:
        return [], reading
    again = reading.again

    def read(**scales: float) -> Recording:
        assert again is not None  # a reading that is multiplied has none
        return _righted(again(**scales), _factors(reading), rules)[1]

    return found, replace(reading, recording=righted, again=None if again is None else read)


def _factors(reading: Reading) -> list[float]:
    """SI units of a number of the log, by joint; 1 without a mapping."""
    maps = reading.maps or ()
    sources = [own.angle for own in maps]
    count = 0 if reading.recording.angles is None else reading.recording.angles.shape[1]
    return [abs(s.factor) if s is not None and s.factor else 1.0 for s in sources] or [1.0] * count


def _righted(recording: Recording, factors: Sequence[float], rules: Rules) -> tuple[list[Mistake], Recording]:
    angles = np.array(recording.angles)
    torques = None if recording.torques is None else np.array(recording.torques)
    found = []
    for values, what in ((angles, "angles"), (torques, "commands")):
        outliers = {} if values is None else {k: own for k, v in enumerate(values.T) if (own := _outliers(v, rules))}
        for constant in dict.fromkeys(c for c, _ in outliers.values()):
            joints = tuple(k for k, (c, _) in outliers.items() if c == constant)
            count = max(int(outliers[k][1].sum()) for k in joints)
            words = f"{count} of {len(angles)} rows have the {what} {constant:.6g}, far from the rows around them"
            turn = "leave these rows out: another publisher's, or no reading"
            found.append(Mistake("stray", joints, words, turn, constant))
        for k, (_, rows) in outliers.items():
            assert values is not None
            values[rows, k] = np.nan if what == "angles" else values[_before(rows), k][rows]
    wraps = {k: modulus for k, v in enumerate(angles.T) if (modulus := _modulus(v, factors[k], rules))}
    for modulus in dict.fromkeys(wraps.values()):
        joints = tuple(k for k, own in wraps.items() if own == modulus)
        words = f"the angles jump by {modulus:.6g}: they are wrapped"
        turn = f"write wrap = {modulus:.6g} in the line of each angle of the map, or unwrap the column"
        found.append(Mistake("wrapped", joints, words, turn, modulus))
    for k, modulus in wraps.items():
        seen = np.isfinite(angles[:, k])
        angles[seen, k] = np.unwrap(angles[seen, k], period=modulus * factors[k])
    periods = {k: p for k, v in enumerate(angles.T) if (p := _period(v, rules)) > 1}
    for period in dict.fromkeys(periods.values()):
        joints = tuple(k for k, p in periods.items() if p == period)
        which = {2: "second", 3: "third"}.get(period, f"{period}th")
        words = f"the angles are new in every {which} row alone, and repeated between"
        found.append(Mistake("held", joints, words, "leave the repeats empty", float(period)))
    for k in periods:
        seen = np.flatnonzero(np.isfinite(angles[:, k]))
        repeats = seen[1:][np.diff(angles[seen, k]) == 0]
        angles[repeats, k] = np.nan
    return found, replace(recording, angles=angles, torques=torques) if found else recording


def _before(rows: np.ndarray) -> np.ndarray:
    """For each row the last one before it that is none of ``rows`` (T,); of the first ones the next such one."""
    good = np.flatnonzero(~rows)
    return good[np.maximum(np.searchsorted(good, np.arange(len(rows)), side="right") - 1, 0)]


def _outliers(values: np.ndarray, rules: Rules) -> tuple[float, np.ndarray] | None:
    """The constant that rows (T,) of a column have which are none of it, and which rows; None of a clean one."""
    seen = np.flatnonzero(np.isfinite(values))
    own = values[seen]
    if len(own) < rules.check.min_column_rows:
        return None
    each, counts = np.unique(own, return_counts=True)
    for place in np.argsort(-counts)[:3]:
        count = int(counts[place])
        if count < max(rules.check.min_outliers, rules.check.min_outlier_share * len(own)) or count > len(own) // 2:
            continue
        rows = own == each[place]
        rest = own[~rows]
        steps = np.abs(np.diff(rest))
        usual = max(float(np.median(steps)), float(np.quantile(steps, 0.9)) / 3)
        # numbers that come in a few levels, as a relay's, repeat anyway
        if usual == 0 or len(np.unique(rest)) < 0.1 * len(rest):
            continue
        edges = np.flatnonzero(np.diff(rows.astype(int)))
        if count > rules.check.max_outlier_run * (len(edges) / 2 + 1):  # a pause, not another publisher's rows
            continue
        far = np.abs(own[edges + 1] - own[edges]) > rules.check.min_outlier_step * usual
        if len(edges) >= 2 * rules.check.min_outliers - 1 and far.mean() > 0.8:
            where = np.zeros(len(values), dtype=bool)
            where[seen[rows]] = True
            return float(each[place]), where
    return None


def _modulus(values: np.ndarray, factor: float, rules: Rules) -> float | None:
    """The modulus of a column (T,), in the log's own numbers; None of one that never jumps."""
    own = values[np.isfinite(values)]
    if len(own) < rules.check.min_column_rows or not (spread := float(np.ptp(own))) > 0:
        return None
    steps = np.diff(own)
    jumps = np.abs(steps) > rules.check.min_jump * spread
    small = np.abs(steps[~jumps])
    if not jumps.any() or jumps.mean() > 0.2 or not len(small) or small.max() > (1 - rules.check.min_jump) * spread:
        return None
    # what wraps stays at both ends of its range; what comes back at once is a glitch
    quarter = 0.25 * spread
    ends = (own > own.max() - quarter).sum(), (own < own.min() + quarter).sum()
    if min(ends) <= 2 * jumps.sum():
        return None
    # a jump is the modulus less what the joint moved meanwhile
    around = np.array([_usual(steps, jumps, at) for at in np.flatnonzero(jumps).tolist()])
    modulus = float(np.median(np.abs(steps[jumps] - around))) / factor
    if np.abs(np.abs(steps[jumps] - around) / factor - modulus).max() > 0.1 * modulus:
        return None
    nearest = min(MODULI, key=lambda known: abs(known - modulus))
    return nearest if abs(nearest - modulus) < rules.check.modulus_tolerance * nearest else modulus


def _usual(steps: np.ndarray, jumps: np.ndarray, at: int) -> float:
    """The step around a jump: the mean of its neighbours that are none."""
    near = [steps[k] for k in (at - 1, at + 1) if 0 <= k < len(steps) and not jumps[k]]
    return float(np.mean(near)) if near else 0.0


def _period(values: np.ndarray, rules: Rules) -> int:
    """In every how many rows a column (T,) has a new number, 1 in each."""
    own = values[np.isfinite(values)]
    if len(own) < rules.check.min_column_rows:
        return 1
    steps = np.abs(np.diff(own))
    changes = np.flatnonzero(steps)
    if len(changes) < rules.check.min_column_rows // 2:
        return 1
    apart = np.diff(changes)
    period = int(np.median(apart))
    regular = np.abs(apart - period) <= (period > 3)
    counted = np.median(steps[changes]) > 2.5 * steps[changes].min()  # more than the sensor's last digit
    return period if period > 1 and regular.mean() > rules.check.min_regular and counted else 1

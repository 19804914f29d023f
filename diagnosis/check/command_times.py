"""Whether the commands of a log are as of its angles' clock: by torques under commands at other times.

    u(t − d)                       d < 0, or longer than a motor takes: two clocks, or a stamp of arrival
    u(t − d₀ − r (t − t₀))         r ≠ 0: clocks that drift
    u linear between its changes   a target that was logged more rarely than the servo got it

Angles stay as they are, and delays are compared in rows that have commands under all of them, so that each is one
solution of the equations that :mod:`.torque_fit` keeps. Rows whose command is not in the log are then left out.
A delay that a motor may have is an effect, and left to the diagnosis. Log and remedy are compared in the same rows,
by what they would miss in others: long windows leave few values, which a drift and friction fit whatever they are.

Shapes: T rows, R rows of a motion, K joints.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.optimize import minimize

from invdyn.diagnosis.check.mistakes import Found, Mistake
from invdyn.diagnosis.check.torque_fit import TorqueFit, share
from invdyn.diagnosis.check.torque_regression import Motion
from invdyn.diagnosis.rules import FIXED, Rules

NUMBERS = {"delay": 1, "drift": 2, "rare": 0}
"""How many numbers a remedy of each kind fits."""


def late_commands(
    fit: TorqueFit, motion: Motion, every: Sequence[Motion], time: np.ndarray, commands: np.ndarray, rules: Rules
) -> Found | None:
    """What the torques of a ``motion`` say of the times of its ``commands`` (T, K); None of nothing wrong.

    Its kind is "delay", "drift" or "rare", and its number the delay, s, the rate, or the rows between two targets. Put
    right is the motion under the commands as they should be, in the rows that have them.
    ``every`` has it under each window: that under which wrong commands fit best is seldom the one for right ones.
    """
    limits, own = rules.check, fit.explain(motion)
    if not own.misfit > limits.min_misfit:
        return None
    step, joints = float(np.median(np.diff(time))), motion.q.shape[1]

    def tried(delay: float, group: tuple[int, ...], of: Motion = motion, ends: float = limits.max_shift) -> float:
        made = _inner(of.recommanded(_held(shifted(time, commands, delay, group))), ends)
        return fit.explain(made.thinned(limits.scan_rows)).misfit

    # a servo's torque is sharp in time: all rows are tried of all joints, few of one
    few = _both_ways(limits.delay_growth, step, time, limits.max_shift)
    sharp = any(motion.terms.by_target)
    delays = _both_ways(1.0, step, time, limits.max_shift) if sharp else few
    missing = [(k,) for k in range(joints) if joints > 1 and own.by_joint[k] > limits.max_joint_misfit]
    groups: list[tuple[int, ...]] = [(), *missing]
    best: tuple[float, tuple[int, ...], float] = (math.inf, (), 0.0)
    for group in groups:
        for delay in few if group else delays:
            left = tried(delay, group)
            if left < best[0] / (limits.equal_misfit if group else 1.0):
                best = left, group, float(delay)
    found = []
    if best[2] > limits.max_delay or best[2] < -limits.max_lead * step:
        width, delay = max(1, round(0.25 * abs(best[2]) / step)), best[2]
        ends = (abs(delay) + width * step) / (time[-1] - time[0])  # no more, so that most rows tell its size
        window = min(every, key=lambda each: tried(delay, best[1], each, ends))
        for rows in (width, max(1, width // 4), max(1, width // 16)):
            near = delay + step * np.unique(np.linspace(-rows, rows, 9).round())
            delay = min(near.tolist(), key=lambda d: tried(d, best[1], window, ends))
        words = (
            f"the commands come {abs(delay):.3g} s too {'early' if delay > 0 else 'late'} for the angles: two clocks"
        )
        turn = f"{'add' if delay > 0 else 'subtract'} {abs(delay):.3g} s {'to' if delay > 0 else 'from'} its times"
        found.append((Mistake("delay", best[1], words, turn, delay), shifted(time, commands, delay, best[1])))
    if (drift := _drift(fit, motion, time, commands, step, rules)) is not None:
        rate, given = drift
        words = f"the commands' clock runs {abs(rate):.2%} {'slow' if rate > 0 else 'fast'} against the angles'"
        found.append((Mistake("drift", (), words, "put both on one clock", rate), given))
    rare = between(time, commands)
    if rare is not None:
        words = f"targets or torques are logged in every {rare[0]}th row alone, and were sent more often"
        found.append((Mistake("rare", (), words, "log them at the rate of the controller", float(rare[0])), rare[1]))
    worth: list[Found] = []
    for mistake, given in found:
        numbers = NUMBERS[mistake.kind]
        group, logged = mistake.joints, np.where(np.isnan(given), np.nan, commands)
        motions = [(each.recommanded(logged), each.recommanded(given)) for each in every]  # in the same rows
        if not (motions := [pair for pair in motions if len(pair[1].q)]):  # a window may be longer than what is left
            continue
        righted, wrong, right = min(
            ((fit.explain(new), old, new) for old, new in motions),
            key=lambda each: each[0].missed_elsewhere(group, numbers),
        )
        if righted.misfit > min(limits.max_remaining * fit.explain(wrong).misfit, limits.max_right_misfit):
            continue
        if (after := righted.missed_elsewhere(group, numbers)) > limits.max_joint_misfit:
            continue
        before = share(fit.left_by_values(wrong, righted.values), righted.required, group)
        worth.append(Found(replace(mistake, right=partial(lambda right, motion: right, right)), before, after))
    # in what is required of the joints: a weak one, whose torque no remedy explains, has its own unit in the misfit
    most = limits.equal_misfit * min((late.after for late in worth), default=0.0)
    # a delay has one number, and a drift two
    return next((late for late in worth if late.after <= most), None)


def _both_ways(growth: float, step: float, time: np.ndarray, share: float) -> np.ndarray:
    """Delays, s, within a ``share`` of the log, later and earlier, each so many times the one before, or a row more."""
    rows, most = [1], share * (time[-1] - time[0]) / step
    while (further := max(rows[-1] + 1, round(growth * rows[-1]))) < most:
        rows.append(further)
    return np.concatenate([rows, [-each for each in rows]]) * step


def _inner(motion: Motion, share: float) -> Motion:
    """A motion without that share of its rows at each end."""
    ends = int(share * len(motion.q))
    return motion.at(slice(ends, len(motion.q) - ends))


def _held(commands: np.ndarray) -> np.ndarray:
    """Commands (T, K) with the first and last known ones before and after these."""
    known = np.flatnonzero(np.isfinite(commands).all(1))
    return commands[np.arange(len(commands)).clip(known[0], known[-1])] if len(known) else np.zeros_like(commands)


def shifted(
    time: np.ndarray, commands: np.ndarray, delay: float | np.ndarray, joints: tuple[int, ...] = ()
) -> np.ndarray:
    """Commands (T, K), each constant until the next, a ``delay`` s later, one or (T,); of some joints, all if none.

    NaN where the log has none.
    """
    slack = FIXED.time_slack * (time[-1] - time[0]) / (len(time) - 1)
    at = np.searchsorted(time, time - delay + slack, side="right") - 1
    there = (at >= 0) & (time - delay <= time[-1] + slack)
    moved = np.where(there[:, None], commands[at.clip(0, len(time) - 1)], np.nan)
    if not joints:
        return moved
    made = np.array(commands)
    made[:, list(joints)] = moved[:, list(joints)]
    return made


def between(time: np.ndarray, commands: np.ndarray) -> tuple[int, np.ndarray] | None:
    """Rows from one change to the next, and commands linear between changes; None where they change in each row."""
    changes = np.flatnonzero((np.diff(commands, axis=0) != 0).any(1)) + 1
    if len(changes) < 5 or (period := int(np.median(np.diff(changes)))) < 2:
        return None
    at = np.concatenate([[0], changes])
    return period, np.stack([np.interp(time, time[at], each[at]) for each in commands.T], -1)


def _drift(
    fit: TorqueFit, motion: Motion, time: np.ndarray, commands: np.ndarray, step: float, rules: Rules
) -> tuple[float, np.ndarray] | None:
    """The rate by which commands come late, and commands put right, from the delays of thirds of the log."""
    limits = rules.check
    grid = np.append(_both_ways(limits.delay_growth, step, time, limits.max_shift), 0.0)
    delays, middles = [], []
    for third in range(3):
        lefts = []
        for delay in grid.tolist():
            made = motion.recommanded(_held(shifted(time, commands, delay)))
            rows = slice(third * len(made.q) // 3, (third + 1) * len(made.q) // 3)
            lefts.append((fit.explain(made.at(rows).thinned(limits.scan_rows)).misfit, delay))
        delays.append(min(lefts)[1])
        middles.append(time[0] + (third + 0.5) / 3 * (time[-1] - time[0]))
    rate, offset = np.polyfit(middles, delays, 1)
    if abs(delays[2] - delays[0]) < 3 * step or not min(delays[0], delays[2]) <= delays[1] <= max(delays[0], delays[2]):
        return None

    def left(at: np.ndarray) -> float:
        late = at[0] * step + at[1] * step * (time - middles[1]) / (middles[2] - middles[0])
        made = motion.recommanded(_held(shifted(time, commands, late)))
        return fit.explain(made.thinned(limits.scan_rows)).misfit

    begin = np.array([offset + rate * middles[1], rate * (middles[2] - middles[0])]) / step
    simplex = begin + 2 * np.eye(3, 2, -1)
    best = minimize(left, begin, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 60}).x * step
    rate = float(best[1] / (middles[2] - middles[0]))
    return rate, shifted(time, commands, best[0] + rate * (time - middles[1]))

"""Whether the commands of a log are as of its angles' clock: by torques under commands at other times.

    u(t − d)                       d < 0, or longer than a motor takes: two clocks, or a stamp of arrival
    u(t − d₀ − r (t − t₀))         r ≠ 0: clocks that drift
    u linear between its changes   a target that was logged more rarely than the servo got it

Angles stay as they are, so that each is one solution of the equations that :mod:`.torque_fit` keeps. A delay
that a motor may have is an effect, and left to the diagnosis.

Shapes: T rows, R rows of a motion, K joints.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from invdyn.diagnosis.check.torque_fit import TorqueFit, share
from invdyn.diagnosis.check.torque_regression import Motion
from invdyn.diagnosis.rules import Rules


@dataclass(frozen=True)
class LateCommands:
    """What is wrong with the commands' times: `kind` "delay", "drift" or "rare"; the joints, none for all; a number.

    `value` is the delay, s; the rate, 1; or the rows between two targets. `before` and `after` are what the joints'
    torques miss of what the motion asks of them. `commands` (T, K) are as they should be.
    """

    kind: str
    joints: tuple[int, ...]
    words: str
    remedy: str
    value: float
    before: float
    after: float
    commands: np.ndarray


def late_commands(
    fit: TorqueFit, motion: Motion, time: np.ndarray, commands: np.ndarray, rules: Rules
) -> LateCommands | None:
    """What the torques of a ``motion`` say of the times of its ``commands`` (T, K); None of nothing wrong."""
    limits, own = rules.check, fit.explain(motion)
    if not own.misfit > limits.min_misfit:
        return None
    step, joints = float(np.median(np.diff(time))), motion.q.shape[1]

    def tried(delay: float, group: tuple[int, ...]) -> float:
        return fit.explain(motion.recommanded(shifted(time, commands, delay, group)).thinned(limits.scan_rows)).misfit

    # a servo's torque is sharp in time: all rows are tried of all joints, few of one
    few = _both_ways(limits.delay_grid, step, time)
    sharp = motion.terms is not None and any(motion.terms.by_target)
    every = _both_ways(range(1, limits.delay_grid[-1] + 1), step, time) if sharp else few
    missing = [(k,) for k in range(joints) if joints > 1 and own.by_joint[k] > limits.max_joint_misfit]
    groups: list[tuple[int, ...]] = [(), *missing]
    best: tuple[float, tuple[int, ...], float] = (math.inf, (), 0.0)
    for group in groups:
        for delay in few if group else every:
            left = tried(delay, group)
            if left < best[0] / (limits.equal_misfit if group else 1.0):
                best = left, group, float(delay)
    found = []
    if best[2] > limits.max_delay or best[2] < -limits.max_lead * step:
        width = max(1, round(0.25 * abs(best[2]) / step))
        delay = best[2]
        for rows in (width, max(1, width // 4)):
            near = delay + step * np.unique(np.linspace(-rows, rows, 9).round())
            delay = min(near.tolist(), key=lambda d: tried(d, best[1]))
        words = (
            f"the commands come {abs(delay):.3g} s too {'early' if delay > 0 else 'late'} for the angles: two clocks"
        )
        turn = f"{'add' if delay > 0 else 'subtract'} {abs(delay):.3g} s {'to' if delay > 0 else 'from'} its times"
        found.append(("delay", best[1], words, turn, delay, shifted(time, commands, delay, best[1])))
    if (drift := _drift(fit, motion, time, commands, step, rules)) is not None:
        rate, given = drift
        words = f"the commands' clock runs {abs(rate):.2%} {'slow' if rate > 0 else 'fast'} against the angles'"
        found.append(("drift", (), words, "put both on one clock", rate, given))
    rare = between(time, commands)
    if rare is not None:
        words = f"targets or torques are logged in every {rare[0]}th row alone, and were sent more often"
        found.append(("rare", (), words, "log them at the rate of the controller", float(rare[0]), rare[1]))
    worth = []
    for kind, group, words, turn, value, given in found:
        righted = fit.explain(motion.recommanded(given))
        if righted.misfit > min(limits.max_remaining * own.misfit, limits.max_right_misfit):
            continue
        if (after := righted.missed(group)) > limits.max_joint_misfit:
            continue
        # a servo's target that leads more asks for more damping, whatever the reason
        taken = fit.by_damping(motion, righted.values)
        if share(taken, righted.required, group) > limits.max_damping_share:
            continue
        before = share(fit.left_by_values(motion, righted.values), righted.required, group)
        worth.append(LateCommands(kind, group, words, turn, value, before, after, given))
    # in what is required of the joints: a weak one, whose torque no remedy explains, has its own unit in the misfit
    most = limits.equal_misfit * min((late.after for late in worth), default=0.0)
    # a delay has one number, and a drift two
    return next((late for late in worth if late.after <= most), None)


def _both_ways(rows: Sequence[int], step: float, time: np.ndarray) -> np.ndarray:
    """Delays, s, of so many rows and less than none, within a fifth of the log."""
    grid = np.array([way * each for way in (1, -1) for each in rows]) * step
    return grid[np.abs(grid) < 0.2 * (time[-1] - time[0])]


def shifted(
    time: np.ndarray, commands: np.ndarray, delay: float | np.ndarray, joints: tuple[int, ...] = ()
) -> np.ndarray:
    """Commands (T, K), each constant until the next, a ``delay`` s later, one or (T,); of some joints, all if none."""
    at = np.searchsorted(time, time - delay + 1e-9, side="right") - 1
    moved = commands[at.clip(0, len(time) - 1)]
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
    grid = np.append(_both_ways(limits.delay_grid, step, time), 0.0)
    delays, middles = [], []
    for third in range(3):
        lefts = []
        for delay in grid.tolist():
            made = motion.recommanded(shifted(time, commands, delay))
            rows = slice(third * len(made.q) // 3, (third + 1) * len(made.q) // 3)
            lefts.append((fit.explain(made.at(rows).thinned(limits.scan_rows)).misfit, delay))
        delays.append(min(lefts)[1])
        middles.append(time[0] + (third + 0.5) / 3 * (time[-1] - time[0]))
    rate, offset = np.polyfit(middles, delays, 1)
    if abs(delays[2] - delays[0]) < 3 * step or not min(delays[0], delays[2]) <= delays[1] <= max(delays[0], delays[2]):
        return None

    def left(at: np.ndarray) -> float:
        late = at[0] * step + at[1] * step * (time - middles[1]) / (middles[2] - middles[0])
        return fit.explain(motion.recommanded(shifted(time, commands, late)).thinned(limits.scan_rows)).misfit

    begin = np.array([offset + rate * middles[1], rate * (middles[2] - middles[0])]) / step
    simplex = begin + 2 * np.eye(3, 2, -1)
    best = minimize(left, begin, method="Nelder-Mead", options={"initial_simplex": simplex, "maxfev": 60}).x * step
    rate = float(best[1] / (middles[2] - middles[0]))
    return rate, shifted(time, commands, best[0] + rate * (time - middles[1]))

"""What a world without an effect does not follow from any state: misfits of the best ones to start from.

The world replays the same commands and is set back once in a pendulum's period. The angles and velocities then are what
Gauss–Newton makes the best of, each window damped by itself (Levenberg, Q. Appl. Math. 1944; Marquardt, J. SIAM 1963).
Windows of an eighth of the period come first, then twice as long ones from the states that were found. That is multiple
shooting's way to a long horizon (Bock, 1983). On a motion that is unstable, straight lines over a whole period mislead
from anywhere but next to the best state.

Shapes: T frames, K joints, O points or other things seen, W windows. SI units, radians.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from invdyn.blindcheck.motion import replay
from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.stretched import pendulum_frequency
from invdyn.blindcheck.world import Trajectory
from invdyn.models import Body

REPLAY_LEAD = 0.1
"""s before the first frame from which the world is replayed: longer than any delay; no earlier motion was recorded."""
DIFFERENCE_ANGLE = 1e-4
"""rad, of the differences by which the effect of another starting state is measured."""
MAX_GAUSS_NEWTON_STEPS = 10
"""Gauss–Newton steps at most, for windows of one length, unless said otherwise."""
MAX_WINDOW_DOUBLINGS = 3
"""How often the windows' length doubles, up to a period, unless said otherwise."""


def unlike_any_start(
    true: Trajectory,
    body: Body,
    world: Callable[[], World],
    film: Callable[[Trajectory], np.ndarray],
    seen: np.ndarray,
    frames: np.ndarray,
    noise: float,
    steps_at_most: int | None = None,
    doubled: int | None = None,
) -> np.ndarray:
    """Tips ``seen`` (T, O, d) at ``frames`` (T,), less what ``world`` makes of the best states to start from.

    In units of the ``noise``, m; NaN where it whirls away. States are looked for from the ``true`` ones on,
    in so many steps (`MAX_GAUSS_NEWTON_STEPS`), with windows ``doubled`` so often (`MAX_WINDOW_DOUBLINGS`).
    """
    most = MAX_GAUSS_NEWTON_STEPS if steps_at_most is None else steps_at_most
    lengths = MAX_WINDOW_DOUBLINGS if doubled is None else doubled
    true = _from(true, frames[0] - REPLAY_LEAD)
    hz = pendulum_frequency(body)
    interval = np.diff(true.command_time).mean()
    units = [(DIFFERENCE_ANGLE * unit, np.zeros_like(unit)) for unit in np.eye(body.num_joints)]
    units += [(np.zeros_like(unit), 2 * np.pi * hz * DIFFERENCE_ANGLE * unit) for unit in np.eye(body.num_joints)]

    def windows(steps: int, time: np.ndarray) -> np.ndarray:
        early = 1e-3 * interval  # a restart belongs to the window that it opens
        return ((time - true.command_time[0] + early) // (interval * steps)).astype(int)

    def misfit(steps: int, shift: np.ndarray) -> np.ndarray:
        each = shift[windows(steps, true.time)]
        q, qd = (sum(each[:, i, None] * unit[part] for i, unit in enumerate(units)) for part in (0, 1))
        points = film(replay(world(), true._replace(q=true.q + q, qd=true.qd + qd), interval * steps))
        return (seen - points) / noise

    def started(steps: int) -> np.ndarray:
        return np.zeros((windows(steps, true.time).max() + 1, len(units)))

    # restarts fall on rows of the command, and those of long windows on those of short ones
    steps = max(1, round(min(2.0, 1 / hz) / interval / 2**lengths))
    while not np.isfinite(misfit(steps, started(steps))).any() and steps > 1:  # whirls at once without the effect
        steps //= 2
    shift = started(steps)
    best = misfit(steps, shift)
    for longer in range(lengths + 1):
        rest = misfit(steps, shift) if longer else best
        if longer and not np.isfinite(rest).any():
            break
        best, shift = _fitted(partial(misfit, steps), shift, rest, windows(steps, frames), most)
        steps, shift = 2 * steps, shift[::2]
    return best


def _fitted(
    misfit: Callable[[np.ndarray], np.ndarray], shift: np.ndarray, rest: np.ndarray, window: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """The smallest misfits (T, O, d) and their shifts (W, units), from a shift and its misfits ``rest``.

    ``window`` (T,) is that of each frame.
    """
    units = shift.shape[1]
    damping, slopes = np.zeros(len(shift)), None
    going = set(np.unique(window).tolist())
    rest, shift = rest.copy(), shift.copy()
    for _ in range(most):
        if slopes is None:
            slopes = np.stack([rest - misfit(shift + unit) for unit in np.eye(units)], axis=-1)
        tried, hoped, misled = shift.copy(), {}, False
        for number in going:
            rows = (window == number) & np.isfinite(rest).all((1, 2)) & np.isfinite(slopes).all((1, 2, 3))
            if rows.sum() > units:
                design, left = slopes[rows].reshape(-1, units), rest[rows].ravel()
                square = design.T @ design
                square += damping[number] * np.diag(square.diagonal())
                step = np.linalg.lstsq(square, design.T @ left, rcond=None)[0]
                tried[number] += step
                hoped[number] = float(((left - design @ step) ** 2).sum())
        new = misfit(tried)
        for number in sorted(going):
            rows = window == number
            diverged = np.isfinite(rest[rows]) & ~np.isfinite(new[rows])  # it whirls away where it did not before
            before, after = (float(np.nansum(each[rows] ** 2)) for each in (rest, new))
            after = np.inf if diverged.any() else after
            if number not in hoped or before - hoped[number] < max(0.01 * before, 0.1):
                going.discard(number)  # nothing more to be had
                continue
            misled |= before - after < 0.75 * (before - hoped[number])
            if after < before:
                rest[rows], shift[number] = new[rows], tried[number]
                damping[number] /= 10
            else:
                damping[number] = max(10 * damping[number], 0.01)
        if misled:
            slopes = None
        if not going:
            break
    return rest, shift


def _from(trajectory: Trajectory, moment: float) -> Trajectory:
    """A trajectory without what was before its last row of the command by that ``moment``, s."""
    row = max(int(np.searchsorted(trajectory.command_time, moment, side="right")) - 1, 0)
    first = int(np.argmin(np.abs(trajectory.time - trajectory.command_time[row])))
    rows = {name: getattr(trajectory, name)[row:] for name in ("command_time", "command")}
    return Trajectory(*(values[first:] for values in trajectory[:5]), **rows)

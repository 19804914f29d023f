"""How visible an effect is, from what was made and without any diagnosis.

Noise-free tips with and without the effect, in units of the noise: d′ = √Σ (Δp/σ)² over frames and coordinates. For
an effect of the dynamics the world without it replays the same commands, and is set back once in a pendulum's period,
to the state from which it follows best: Δp is what no other angles and velocities at that moment make up for, as nobody
sees the state itself, nor a gear's play or a link's bend. With unknown torque only what no posture of the body could
show counts. Where the effect is in the noise alone, d′ = √2Σ KL between the noise with and without it.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from invdyn.models import Body

from .camera import OBSERVATIONS, film
from .motion import frame_times, pendulum_frequency, replay
from .present import Present, pace, seen_by_camera, world_with
from .reality import Trajectory, World
from .sizes import Scene

EARLY = 0.1
"""s before the first frame from which the world is replayed: longer than any delay, and nobody saw what was before."""
NUDGE = 1e-4
"""rad, of the differences by which the effect of another starting state is measured."""
STEPS = 10
"""Gauss–Newton steps at most, in each window damped by itself (Levenberg–Marquardt)."""


def visibility(
    each: Present,
    present: Sequence[Present],
    s: Scene,
    real: Trajectory,
    regime: str,
    noise: float,
    seed: Sequence[int],
) -> tuple[float, float]:
    """(d′, rms of the change in units of the noise) of one of the effects that are present in `real`."""
    rest, stated = [e for e in present if e is not each], frame_times(s.plan)

    def tips(trajectory: Trajectory, effects: Sequence[Present], sd: float = 0.0) -> np.ndarray:
        return film(trajectory, stated / pace(effects), seen_by_camera(effects), sd, seed)[:, 1:]

    if each.name == "varying_noise":
        quiet, loud = (tips(real, effects, noise) - tips(real, effects) for effects in (rest, present))
        ratio = (loud / quiet) ** 2
        change = np.sqrt(ratio - 1 - np.log(ratio))
    elif regime == "unknown_torque" and each.name not in OBSERVATIONS:
        change = np.zeros(1)
    elif regime == "unknown_torque" and each.name != "timestamp_jitter":  # no torque makes one frame alone jump
        change = _misfit(tips(real, present), s.body, noise)
    elif each.name in OBSERVATIONS and each.name != "clock_rate":
        change = (tips(real, present) - tips(real, rest)) / noise
    else:
        world = partial(world_with, s.body, rest, s)
        change = _unlike_any_start(
            _told(each, real), s, world, lambda run: tips(run, rest), tips(real, present), stated
        )
        change = change / noise
    known = change[np.isfinite(change)]
    return float(np.sqrt((known**2).sum())), float(np.sqrt((known**2).mean())) if known.size else 0.0


def _told(each: Present, real: Trajectory) -> Trajectory:
    """The trajectory as it is seen: angles between links, whatever plays or bends in them, and by the told clock."""
    angle = np.diff(real.heading, axis=1, prepend=0.0)
    real = real._replace(q=angle, qd=np.gradient(angle, real.time, axis=0))
    if each.name != "clock_rate":
        return real
    rate = each.parameters["rate"]  # the same commands at the stated times, from the states that were stated
    return real._replace(time=real.time * rate, qd=real.qd / rate, command_time=real.command_time * rate)


def _unlike_any_start(
    true: Trajectory,
    s: Scene,
    world: Callable[[], World],
    film: Callable[[Trajectory], np.ndarray],
    seen: np.ndarray,
    frames: np.ndarray,
) -> np.ndarray:
    """Tips ``seen`` (T, K, 2) at ``frames`` (T,), less what ``world`` makes of the best states to start from.

    Gauss–Newton on angles and velocities at the start of every window, with new slopes where straight lines misled.
    """
    true = _from(true, frames[0] - EARLY)
    hz = pendulum_frequency(s.body)
    interval = np.diff(true.command_time).mean()
    steps = max(1, round(min(2.0, 1 / hz) / interval))  # restarts then fall on rows of the command
    units = [(NUDGE * unit, np.zeros_like(unit)) for unit in np.eye(s.body.num_joints)]
    units += [(np.zeros_like(unit), 2 * np.pi * hz * NUDGE * unit) for unit in np.eye(s.body.num_joints)]

    def followed(q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        return film(replay(world(), true._replace(q=true.q + q, qd=true.qd + qd), interval * steps))

    rest = seen - followed(0.0, 0.0)
    while not np.isfinite(rest).any() and steps > 1:  # whirls at once without the effect
        steps //= 2
        rest = seen - followed(0.0, 0.0)
    period = interval * steps
    origin = true.command_time[0]
    early = 1e-3 * interval  # a restart belongs to the window that it opens
    window, of_time = (((time - origin + early) // period).astype(int) for time in (frames, true.time))
    count = max(window.max(), of_time.max()) + 1
    shift, damping, slopes = np.zeros((count, len(units))), np.zeros(count), None
    going = set(np.unique(window).tolist())

    def started(shift: np.ndarray) -> np.ndarray:
        each = shift[of_time]
        return followed(*(sum(each[:, i, None] * unit[part] for i, unit in enumerate(units)) for part in (0, 1)))

    for _ in range(STEPS):
        if slopes is None:
            here = seen - rest
            slopes = np.stack([started(shift + unit) - here for unit in np.eye(len(units))], axis=-1)
        tried, hoped, misled = shift.copy(), {}, False
        for number in going:
            rows = (window == number) & np.isfinite(rest).all((1, 2)) & np.isfinite(slopes).all((1, 2, 3))
            if rows.sum() > len(units):
                design, misfit = slopes[rows].reshape(-1, len(units)), rest[rows].ravel()
                square = design.T @ design
                square += damping[number] * np.diag(square.diagonal())
                step = np.linalg.lstsq(square, design.T @ misfit, rcond=None)[0]
                tried[number] += step
                hoped[number] = float(((misfit - design @ step) ** 2).sum())
        left = seen - started(tried)
        for number in sorted(going):
            rows = window == number
            lost = np.isfinite(rest[rows]) & ~np.isfinite(left[rows])  # it whirls away where it did not before
            before, after = (float(np.nansum(each[rows] ** 2)) for each in (rest, left))
            after = np.inf if lost.any() else after
            if number not in hoped or before - hoped[number] < 0.01 * before:
                going.discard(number)  # nothing more to be had
                continue
            misled |= before - after < 0.75 * (before - hoped[number])
            if after < before:
                rest[rows], shift[number] = left[rows], tried[number]
                damping[number] /= 10
            else:
                damping[number] = max(10 * damping[number], 0.01)
        if misled:
            slopes = None
        if not going:
            break
    return rest


def _from(trajectory: Trajectory, moment: float) -> Trajectory:
    """A trajectory without what was before its last row of the command by that ``moment``, s."""
    row = max(int(np.searchsorted(trajectory.command_time, moment, side="right")) - 1, 0)
    first = int(np.argmin(np.abs(trajectory.time - trajectory.command_time[row])))
    rows = {name: getattr(trajectory, name)[row:] for name in ("command_time", "command")}
    return Trajectory(*(values[first:] for values in trajectory[:5]), **rows)


def _misfit(points: np.ndarray, body: Body, noise: float) -> np.ndarray:
    """How far points (T, K, 2) are from any posture of the body: errors of the links' lengths over their noise."""
    chain = np.concatenate([np.broadcast_to(body.base, (len(points), 1, 2)), points], axis=1)
    lengths = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    sd = noise * np.sqrt(np.where(np.arange(body.num_joints) == 0, 1.0, 2.0))
    return (lengths - np.array([link.nominal("length") for link in body.links])) / sd

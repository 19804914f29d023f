"""How visible an effect is, from what was made and without any diagnosis.

Noise-free tips with and without the effect, in units of the noise: d′ = √Σ (Δp/σ)² over frames and coordinates. For
an effect of the dynamics the world without it replays the same commands, and is set back to the true state once in
half a pendulum's period. With unknown torque only what no posture of the body could show counts. Where the effect is
in the noise alone, d′ = √2Σ KL between the noise with and without it.
"""

from collections.abc import Sequence

import numpy as np

from invdyn.models import Body

from .camera import OBSERVATIONS, film
from .motion import frame_times, pendulum_frequency, replay
from .present import Present, pace, seen_by_camera, world_with
from .reality import Trajectory
from .sizes import Scene


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
    else:
        of_camera = each.name in OBSERVATIONS and each.name != "clock_rate"
        without = real if of_camera else _without(each, rest, s, real)
        change = (tips(real, present) - tips(without, rest)) / noise
    return float(np.sqrt(np.nansum(change**2))), float(np.sqrt(np.nanmean(change**2)))


def _without(each: Present, rest: Sequence[Present], s: Scene, real: Trajectory) -> Trajectory:
    if each.name == "clock_rate":  # the same commands at the stated times, from the states that were stated
        rate = each.parameters["rate"]
        real = real._replace(time=real.time * rate, qd=real.qd / rate, command_time=real.command_time * rate)
    return replay(world_with(s.body, rest, s), real, min(1.0, 0.5 / pendulum_frequency(s.body)))


def _misfit(points: np.ndarray, body: Body, noise: float) -> np.ndarray:
    """How far points (T, K, 2) are from any posture of the body: errors of the links' lengths over their noise."""
    chain = np.concatenate([np.broadcast_to(body.base, (len(points), 1, 2)), points], axis=1)
    lengths = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    sd = noise * np.sqrt(np.where(np.arange(body.num_joints) == 0, 1.0, 2.0))
    return (lengths - np.array([link.nominal("length") for link in body.links])) / sd

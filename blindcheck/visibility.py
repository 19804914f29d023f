"""How visible an effect is, from what was made and without any diagnosis.

Noise-free tips with and without the effect, in units of the noise: d′ = √Σ (Δp/σ)² over frames and coordinates. For
an effect of the dynamics, the world without it replays the same commands. Once in a pendulum's period it is set back to
the state from which it follows best (`starts`). So Δp is what no other angles and velocities at that moment make up
for: the state itself is not seen, nor the position within backlash or a link's bend. With unknown torque only what no
posture of the body could show counts; in space all that an effect of the observation changes. Encoders count where a
setting says so, and where one of them is off. A robot's log begins each period from the true state. Where the effect is
in the noise alone, d′ = √2Σ KL between the noise with and without it.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np

from invdyn.blindcheck.camera import readings
from invdyn.blindcheck.effects import OBSERVATIONS
from invdyn.blindcheck.engine import MUJOCO, Engine
from invdyn.blindcheck.initial_state_fit import unlike_any_start
from invdyn.blindcheck.injected_effects import Present, pace, shown_by_sensors, world_with
from invdyn.blindcheck.motion import frame_times
from invdyn.blindcheck.scene import Scene
from invdyn.blindcheck.setting import Style
from invdyn.blindcheck.world import Trajectory
from invdyn.models import Body


def visibility(
    each: Present,
    present: Sequence[Present],
    s: Scene,
    real: Trajectory,
    regime: str,
    noise: float,
    seed: Sequence[int],
    engine: Engine = MUJOCO,
    style: Style | None = None,
) -> dict[str, float]:
    """d′, and rms of the change in units of the noise, of one of the effects that are present in `real`."""
    rest, stated = [e for e in present if e is not each], frame_times(s.plan)

    def tips(trajectory: Trajectory, effects: Sequence[Present], sd: float = 0.0) -> np.ndarray:
        return engine.film(trajectory, stated / pace(effects), shown_by_sensors(effects), sd, seed)[:, 1:]

    def shown(trajectory: Trajectory, effects: Sequence[Present]) -> np.ndarray:
        points = tips(trajectory, effects)
        if style is None or style.encoder is None or not (style.counted or each.name == "encoder_offset"):
            return points
        # angles as so many metres as they are as well known
        read = readings(trajectory, stated / pace(effects), shown_by_sensors(effects))
        angles = read * (noise / style.encoder)
        flat = points.reshape(len(stated), -1) if style.filmed else points[:, :0, 0]
        return np.concatenate([flat, angles], -1)[..., None]

    if each.name == "varying_noise":
        without, with_effect = (tips(real, effects, noise) - tips(real, effects) for effects in (rest, present))
        ratio = (with_effect / without) ** 2
        change = np.sqrt(ratio - 1 - np.log(ratio))
    elif regime == "unknown_torque" and each.name not in OBSERVATIONS:
        change = np.zeros(1)
    elif regime == "unknown_torque" and each.name != "timestamp_jitter" and s.body.is_chain:
        # no torque makes one frame alone jump
        change = _misfit(tips(real, present), s.body, noise)
    elif each.name in OBSERVATIONS and each.name not in ("clock_rate", "encoder_offset"):
        change = (tips(real, present) - tips(real, rest)) / noise
    else:
        world, camera = partial(world_with, s.body, rest, s, engine), partial(shown, effects=rest)
        thorough = engine.setting.thorough if style is None else style.thorough or engine.setting.thorough
        change = unlike_any_start(
            _as_seen(each, real), s.body, world, camera, shown(real, present), stated, noise, *thorough
        )
    known = change[np.isfinite(change)]
    rms = float(np.sqrt((known**2).mean())) if known.size else 0.0
    return {"dprime": float(np.sqrt((known**2).sum())), "visibility_rms": rms}


def _as_seen(each: Present, real: Trajectory) -> Trajectory:
    """The trajectory as it is seen: angles between links with all their bending, by the recorded clock."""
    angle = np.diff(real.heading, axis=1, prepend=0.0)
    real = real._replace(q=angle, qd=np.gradient(angle, real.time, axis=0))
    if each.name != "clock_rate":
        return real
    rate = each.parameters["rate"]  # the same commands at the stated times, from the states that were stated
    return real._replace(time=real.time * rate, qd=real.qd / rate, command_time=real.command_time * rate)


def _misfit(points: np.ndarray, body: Body, noise: float) -> np.ndarray:
    """How far points (T, K, 2) are from any posture of the body: errors of the links' lengths over their noise."""
    chain = np.concatenate([np.broadcast_to(body.base, (len(points), 1, 2)), points], axis=1)
    lengths = np.linalg.norm(np.diff(chain, axis=1), axis=-1)
    sd = noise * np.sqrt(np.where(np.arange(body.num_joints) == 0, 1.0, 2.0))
    return (lengths - np.array([link.nominal("length") for link in body.links])) / sd

"""How large the effects are that sensors show (`camera` and `encoders` simulate them): names, units and draws."""

import numpy as np

from invdyn.blindcheck.effects.effect import sensor_effect
from invdyn.blindcheck.motion import between
from invdyn.blindcheck.scene import NONIDEAL_FRACTION, Scene, natural_hz, sign


def _centre(rng: np.random.Generator, s: Scene) -> dict:
    """Where the camera looks, if not at the origin: of an arm with one link, that would make another twin of it."""
    if s.body.num_joints == 1 or rng.random() > NONIDEAL_FRACTION:
        return {}
    return {f"centre_{axis}": rng.uniform(-0.4, 0.4) * s.reach for axis in "xy"}


@sensor_effect(site="joint", units={"offset": "rad"}, needs=("clock", "encoders"))
def _encoder_offset(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    return {"offset": a * sign(rng) * np.deg2rad(rng.uniform(1.0, 4.0))}


@sensor_effect(site="keypoint", units={"along": "m", "across": "m"})
def _keypoint_offset(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    angle, size = rng.uniform(0, 2 * np.pi), a * rng.uniform(0.03, 0.1) * s.body.links[k].nominal("length")
    return {"along": size * np.cos(angle), "across": size * np.sin(angle)}


@sensor_effect(site="keypoint", units={"kappa": "s²", "damping_ratio": "1"})
def _soft_tissue(rng: np.random.Generator, s: Scene, k: int, a: float) -> dict:
    second = np.gradient(np.gradient(s.motion.points[:, k + 1], s.motion.time, axis=0), s.motion.time, axis=0)
    rms = np.sqrt((second**2).sum(-1).mean())
    kappa = a * rng.uniform(0.02, 0.05) * s.body.links[k].nominal("length") / rms
    return {"kappa": kappa} | ({"damping_ratio": rng.uniform(0.1, 0.6)} if rng.random() < NONIDEAL_FRACTION else {})


@sensor_effect(units={"scale": "1"})
def _camera_scale(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"scale": 1 + a * sign(rng) * rng.uniform(0.02, 0.08)}


@sensor_effect(units={"angle": "rad"}, needs=("gravity",))
def _camera_roll(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"angle": a * sign(rng) * np.deg2rad(rng.uniform(1.0, 3.0))}


@sensor_effect(units={"angle": "rad", "distance": "m", "centre_x": "m", "centre_y": "m"})
def _camera_yaw(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    view = {"angle": a * sign(rng) * np.deg2rad(rng.uniform(4, 12)), "distance": rng.uniform(2.0, 5.0) * s.reach}
    return view | _centre(rng, s)


@sensor_effect(units={"k1": "m⁻²", "centre_x": "m", "centre_y": "m"})
def _lens_distortion(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"k1": a * sign(rng) * rng.uniform(0.02, 0.08) / s.reach**2} | _centre(rng, s)


@sensor_effect(units={"rate": "1"}, needs=("clock",))
def _clock_rate(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"rate": np.exp(a * sign(rng) * rng.uniform(0.05, 0.22))}


@sensor_effect(units={"latency": "s"}, needs=("command", "clock"))
def _camera_latency(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"latency": a * np.clip(rng.uniform(0.01, 0.06) / natural_hz(s), 0.005, 0.06)}


@sensor_effect(units={"readout": "s/m"})
def _rolling_shutter(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"readout": a * sign(rng) * np.clip(rng.uniform(0.01, 0.03) / natural_hz(s), 0.003, 0.03) / s.reach}


@sensor_effect(units={"rate": "1", "sd": "s"})
def _timestamp_jitter(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {
        "rate": rng.uniform(0.3, 1.0),
        "sd": a * rng.uniform(0.5, 1.0) * max(1 / s.plan.frame_rate, 0.01 / natural_hz(s)),
    }


@sensor_effect(units={"rate": "1", "scale": "m"})
def _outliers(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {
        "rate": a * between(rng, 0.01, 0.1),
        "scale": rng.uniform(0.1, 0.4) * s.reach,
    }


@sensor_effect(site="keypoint", units={"rate": "1"}, needs=("two joints",))
def _label_swap(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {"rate": a * between(rng, 0.01, 0.05)}


@sensor_effect(units={"slope": "s/m"})
def _varying_noise(rng: np.random.Generator, s: Scene, place: int, a: float) -> dict:
    return {
        "slope": a
        * rng.uniform(2.0, 6.0)
        / np.sqrt((np.gradient(s.motion.points[:, -1], s.motion.time, axis=0) ** 2).sum(-1).mean())
    }

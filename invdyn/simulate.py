"""Recordings with known truth: an arm driven by random torques, filmed with noise."""

import math
from typing import Any

import numpy as np
import torch
from scipy.optimize import minimize

from invdyn.models import (
    ArmModel,
    Body,
    Encoders,
    Keypoints,
    Link,
    Observation,
    OrnsteinUhlenbeck,
    Sensor,
    dynamics_for,
    planar_body,
)
from invdyn.models.divergence import check_finite
from invdyn.recordings import InputError, Recording, Truth
from invdyn.recordings.units import Units

STEP = 0.004  # s, the longest step of the Runge–Kutta integrator: its own error lies far below any camera's
MAX_FRAMES = 1_000_000  # nine hours of film
GENTLE = 0.15  # share of the torque that holds the body level: it swings; with twice that it whirls

PAPER: dict[str, Any] = {  # options of `infer` for the paper's planar arm: explicit Euler, torque noise as printed
    "torque": OrnsteinUhlenbeck("printed", decay=6.0),
    "integrator": "euler",
    "settings": {
        "torque.scale": 20.0,
        "torque.decay": 6.0,
        "noise.angle": 0.01,
        "noise.velocity": 0.01,
        "emission.keypoint_scale": math.sqrt(0.05),
    },
}

PAPER_IN_SPACE: dict[str, Any] = {  # the same of its arm in space, as its code has them (test/run-3d-arm.ipynb)
    "torque": OrnsteinUhlenbeck("printed", decay=2.0),
    "integrator": "euler",
    "settings": {
        "torque.scale": 2.0,
        "torque.decay": 2.0,
        "noise.angle": 4e-5,
        "noise.velocity": 4e-5,
        "initial.angle": 0.0,
        "initial.angle_scale": math.sqrt(0.001),
        "initial.velocity": 0.0,
        "initial.velocity_scale": math.sqrt(0.001),
        "emission.keypoint_scale": math.sqrt(0.01),
    },
}


def person_arm() -> Body:
    """The arm of a woman of 1.75 m and 70 kg, as if all of its numbers were known: those of `models.person`."""
    upper = Link("upper_arm", "shoulder", "elbow", length=0.277, mass=1.785, com=0.160, inertia=0.0093)
    forearm = Link("forearm", "elbow", "wrist", length=0.267, mass=1.358, com=0.180, inertia=0.0166)
    return planar_body("arm of a person", [upper, forearm], gravity=(0.0, -9.81))


def record(model: ArmModel, seed: int = 0, name: str = "simulated") -> tuple[Recording, Truth]:
    """Draw one recording of `model`'s keypoints and encoders, and the states behind it; same seed, same recording.

    Raises Diverged where it runs away.
    """
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        states, observations = model.simulate()
    check_finite(states)
    body, time = model.body, model.time.numpy()
    _, angle, velocity = (part.numpy() for part in model.split(states))
    command = None if model.command is None else model.command.numpy()
    observation, encoders = model.observation, model.observation.encoders
    recording = Recording(
        time=time,
        keypoints=observation.points(observations).numpy(),
        keypoint_names=observation.keypoints.names if observation.keypoints else (),
        angles=observation.of(encoders, observations).numpy() if encoders else None,
        torques=command,
        joint_names=body.joint_names if encoders or command is not None else (),
        name=name,
        units=Units(length="m", angle="rad", time="s"),
    )
    torque = model.net_torque(states).numpy()
    return recording, Truth(time, angle, velocity, torque, body.joint_names)


def random_arm(
    body: Body,
    *,
    duration: float = 6.0,
    fps: float = 30.0,
    noise: float = 0.005,
    encoder_noise: float | None = None,
    torque_scale: float | None = None,
    commanded: bool = False,
    seed: int = 0,
) -> ArmModel:
    """Model of an arm that hangs, nearly at rest, until Ornstein–Uhlenbeck torques move it as physics says.

    Args:
        body: its priors stand at their nominal values.
        duration: s.
        fps: frames a second.
        noise: standard deviation of each keypoint coordinate, m.
        encoder_noise: standard deviation of encoders, rad (m of a slide), which are then recorded, too.
        torque_scale: standard deviation of each joint's torque, N·m; by default a fraction of what holds the
            body level (without gravity: of what turns it briskly).
        commanded: the torques are a command, known and constant from frame to frame, instead of unknown.
        seed: of the command.

    Raises:
        InputError: values that are no positive numbers or beyond what is real, or a duration that holds fewer than
            two frames or more than a million.
    """
    for name, (value, largest) in {
        "duration": (duration, 1e6),
        "fps": (fps, 1e6),
        "noise": (noise, 1e3),
        "encoders": (encoder_noise, 1e3),
        "torque_scale": (torque_scale, 1e6),
    }.items():
        if value is not None and not 0 <= value <= largest:
            raise InputError(f"{name} must be a number from 0 to {largest:g}, got {value:g}")
    if duration * fps > MAX_FRAMES:
        raise InputError(
            f"{duration:g} s at {fps:g} frames a second are {duration * fps:.3g} frames; at most {MAX_FRAMES} are made"
        )
    num_frames = round(duration * fps)
    if num_frames < 2:
        raise InputError(f"{duration:g} s at {fps:g} frames a second are {num_frames} frames; at least 2 are needed")
    torque = OrnsteinUhlenbeck()

    sensors: list[Sensor] = [Keypoints(body.keypoint_names)] if body.keypoint_names else []
    own = {"emission.keypoint_scale": noise} if sensors else {}
    if encoder_noise is not None or not sensors:
        sensors.append(Encoders())
        own["emission.angle_scale"] = 1e-4 if encoder_noise is None else encoder_noise
    rest = resting(body)

    def model(command: np.ndarray | None = None) -> ArmModel:
        return ArmModel(
            body,
            np.arange(num_frames) / fps,
            Observation(*sensors),
            torque=torque,
            command=command,
            substeps=math.ceil(1 / (fps * STEP)),
            parameters={
                **own,
                "noise.angle": 0.0,
                "noise.velocity": 0.0,
                "initial.angle": rest,
                "initial.angle_scale": 0.3,
                "initial.velocity_scale": 0.1,
            },
        )

    free = model()
    if torque_scale is None:
        scale = GENTLE * free.parameters["torque.scale"]
    else:
        scale = torch.full((body.num_joints,), torque_scale * math.sqrt(2 * torque.decay), dtype=free.dtype)
    free = free.replace(**{"torque.scale": scale})
    if not commanded:
        return free
    _, plan = record(free, seed)
    return model(plan.torque).replace(**{"torque.scale": torch.zeros_like(scale)})


def resting(body: Body) -> list[float]:
    """Coordinates in which a body hangs: of a tree the least potential energy near 0, its shifts being 0, (K,)."""
    if body.is_chain:
        return body.hanging
    dynamics, numbers = dynamics_for(body), body.parameters()
    turning = [motion.turns for _, motion in body.motions()]
    places = torch.tensor([place for place, turns in enumerate(turning) if turns])

    def energy(angles: np.ndarray) -> tuple[float, np.ndarray]:
        q = torch.zeros(body.num_joints, dtype=torch.float64)
        q[places] = torch.as_tensor(angles)
        return dynamics.potential_energy(q, numbers).item(), dynamics.gravity_load(q, numbers)[places].numpy()

    found = torch.zeros(body.num_joints, dtype=torch.float64)
    if len(places) and any(body.gravity):
        # a little off, as upright is a rest, too, but none that lasts
        found[places] = torch.as_tensor(minimize(energy, np.full(len(places), 0.1), jac=True, method="L-BFGS-B").x)
    return found.tolist()


def paper_arm(body: Body, num_frames: int = 200) -> ArmModel:
    """The arm that Biderman et al. (2020) simulate, in the plane at `PAPER`'s settings or in space at the others."""
    paper, step = (PAPER, 0.03) if body.dimensions == 2 else (PAPER_IN_SPACE, 0.01)
    return ArmModel(
        body,
        step * np.arange(num_frames),
        Observation(Keypoints(body.keypoint_names)),
        torque=paper["torque"],
        integrator=paper["integrator"],
        parameters=paper["settings"],
    )

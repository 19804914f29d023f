"""Where linearising begins: paths through smoothed inverse kinematics (:mod:`invdyn.models.kinematics`).

From angles θ (T, K): velocities and accelerations by differences, torques by inverse dynamics, on the CPU in float64.
Of a base that moves its own track tells the path (:mod:`.base_track`), which is taken from the keypoints first. A model
here is an :class:`.ArmModel`, or what has as much of its body, sensors and parameters.
"""

from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.models.articulated.base_track import smoothed
from invdyn.models.kinematics import joint_angle_candidates
from invdyn.models.observation.keypoints import first_joint
from invdyn.models.observation.observation import Observation


def kinematic_paths(model: Any, observations: Tensor) -> Tensor | None:
    """Paths (C, T, D) of a model through observations (T, O); None where these tell too little."""
    numbers, time = _plain_numbers(model), model.time.cpu()
    base = base_path(model, observations)
    if base is not None:
        observations = on_base_at_rest(model.observation, observations, base[:, : model.body.dimensions])
    sd = joint_angle_sd(model, numbers)
    candidates = joint_angle_candidates(model.body, time.numpy(), observations, model.observation, numbers, sd)
    if candidates is None:
        return None
    return torch.stack([_path_through(model, torch.as_tensor(angles), time, numbers, base) for angles in candidates])


def path_through(model: Any, angles: Tensor, like: Tensor | None = None) -> Tensor:
    """The path (T, D) of a model through joint angles (T, K), rad; its base moves as in a path ``like`` (T, D)."""
    base = None
    if model.base is not None and like is not None:
        base = like[:, model.layout.torque - model.base.size : model.layout.torque].detach().cpu().double()
    return _path_through(model, angles.detach().cpu().double(), model.time.cpu(), _plain_numbers(model), base)


def base_path(model: Any, observations: Tensor) -> Tensor | None:
    """States (T, 4 d) of a base that moves, by its own track in rows (T, O); None where there is none."""
    sensor = model.observation.base_point
    if model.base is None or sensor is None:
        return None
    numbers = _plain_numbers(model)
    track = model.observation.of(sensor, observations.detach().cpu().double()) - first_joint(numbers)
    noise = float(model.parameters["emission.base_scale"].max())
    return torch.as_tensor(smoothed(model.base, model.parameters, model.time.cpu().numpy(), track.numpy(), noise))


def on_base_at_rest(observation: Observation, rows: Tensor, place: Tensor) -> Tensor:
    """Rows (T, O) as of a base at rest: keypoints less its displacement ``place`` (T, d)."""
    return observation.with_points(rows, observation.points(rows) - place.to(rows).unsqueeze(-2))


def _plain_numbers(model: Any) -> Any:
    numbers = model.body_parameters()
    return type(numbers)(*(value.detach().cpu().double() for value in numbers))


def joint_angle_sd(model: Any, numbers: Any) -> np.ndarray:
    """Standard deviation (K,) with which one row tells each joint's, in the plane each link's, angle, rad."""
    if model.observation.encoders:
        sd = model.parameters["emission.angle_scale"]
    elif model.observation.keypoints:
        sd = 1.5 * model.parameters["emission.keypoint_scale"].max() / model.dynamics.levers(numbers)
    elif pixels := model.observation.pixels:
        noise = model.parameters["emission.pixel_scale"].median().detach().cpu()
        sd = 1.5 * pixels.resolution * noise / model.dynamics.levers(numbers)
    else:
        sd = torch.ones(model.body.num_joints)
    return sd.detach().cpu().double().clamp(max=1.0).numpy()


def _path_through(model: Any, q: Tensor, time: Tensor, numbers: Any, base: Tensor | None) -> Tensor:
    step = time.diff().unsqueeze(-1)
    # Forward differences: under explicit Euler they satisfy the transition exactly.
    qd = q.diff(dim=0) / step
    qd = torch.cat([qd, qd[-1:]])
    qdd = torch.cat([qd.diff(dim=0) / step, torch.zeros_like(q[:1])])
    torque = model.dynamics.inverse(q, qd, qdd, numbers)
    if model.command is not None:
        torque = torque - model.command.cpu()
    z = model.torque.path(torque, time)
    if model.base is not None:
        state = q.new_zeros(len(q), model.base.size) if base is None else base
        carried = model.dynamics.uniform_load(q, model.base.parted(state)[2], numbers)
        z = torch.cat([model.torque.path(torque - carried, time), state], -1)
    path = torch.cat([z, z.new_zeros(len(z), model.layout.hidden + model.layout.memory), q, qd], -1)
    return path.to(dtype=model.dtype, device=model.device)

"""Where linearising begins: paths through smoothed inverse kinematics (:mod:`invdyn.models.kinematics`).

From angles θ (T, K): velocities and accelerations by differences, torques by inverse dynamics, on the CPU in float64.
"""

from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from invdyn.models.articulated.state import StateLayout
from invdyn.models.bodies.protocol import ArticulatedBody
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.kinematics import joint_angle_candidates
from invdyn.models.observation.observation import Observation
from invdyn.models.torques import TorqueProcess


class Watched(Protocol):
    """A body before its sensors."""

    body: ArticulatedBody
    dynamics: Dynamics
    observation: Observation
    parameters: dict[str, Tensor]


class Articulated(Watched, Protocol):
    """What a model has to give here; :class:`.arm.ArmModel` is one."""

    torque: TorqueProcess

    @property
    def layout(self) -> StateLayout:
        """Of its states."""

    @property
    def time(self) -> Tensor:
        """(T,) s."""

    @property
    def command(self) -> Tensor | None:
        """(T, K) N·m."""

    @property
    def dtype(self) -> torch.dtype:
        """Of its parameters."""

    @property
    def device(self) -> torch.device:
        """Of its parameters."""

    def body_parameters(self) -> Any:
        """The body's numbers."""


def kinematic_paths(model: Articulated, observations: Tensor) -> Tensor | None:
    """Paths (C, T, D) of a model through observations (T, O); None where these tell too little."""
    numbers, time = _plain_numbers(model), model.time.cpu()
    sd = joint_angle_sd(model, numbers)
    candidates = joint_angle_candidates(model.body, time.numpy(), observations, model.observation, numbers, sd)
    if candidates is None:
        return None
    return torch.stack([_path_through(model, torch.as_tensor(angles), time, numbers) for angles in candidates])


def path_through(model: Articulated, angles: Tensor) -> Tensor:
    """The path (T, D) of a model through joint angles (T, K), rad."""
    return _path_through(model, angles.detach().cpu().double(), model.time.cpu(), _plain_numbers(model))


def _plain_numbers(model: Articulated) -> Any:
    numbers = model.body_parameters()
    return type(numbers)(*(value.detach().cpu().double() for value in numbers))


def joint_angle_sd(model: Watched, numbers: Any) -> np.ndarray:
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


def _path_through(model: Articulated, q: Tensor, time: Tensor, numbers: Any) -> Tensor:
    step = time.diff().unsqueeze(-1)
    # Forward differences: under explicit Euler they satisfy the transition exactly.
    qd = q.diff(dim=0) / step
    qd = torch.cat([qd, qd[-1:]])
    qdd = torch.cat([qd.diff(dim=0) / step, torch.zeros_like(q[:1])])
    torque = model.dynamics.inverse(q, qd, qdd, numbers)
    if model.command is not None:
        torque = torque - model.command.cpu()
    z = model.torque.path(torque, time)
    path = torch.cat([z, z.new_zeros(len(z), model.layout.hidden + model.layout.memory), q, qd], -1)
    return path.to(dtype=model.dtype, device=model.device)

"""Where linearising an arm begins: paths through smoothed inverse kinematics (:mod:`.kinematics`).

From angles θ (T, K): velocities and accelerations by differences, torques by inverse dynamics, on the CPU in float64.
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.models.bodies.body import BodyParameters
from invdyn.models.kinematics import joint_angle_candidates


def kinematic_paths(arm, observations: Tensor) -> Tensor | None:
    """Paths (C, T, D) of an :class:`.arm.ArmModel` through observations (T, O); None where these tell too little."""
    body = BodyParameters(*(value.detach().cpu().double() for value in arm.body_parameters()))
    time = arm.time.cpu()
    candidates = joint_angle_candidates(time.numpy(), observations, arm.emission_model, body, link_angle_sd(arm, body))
    if candidates is None:
        return None
    return torch.stack([_path_through(arm, torch.as_tensor(angles), time, body) for angles in candidates])


def link_angle_sd(arm, body: BodyParameters) -> np.ndarray:
    """Standard deviation (K,) with which one row tells each link's angle, rad."""
    if arm.emission_model.num_encoders:
        sd = arm.parameters["emission.angle_scale"]
    else:
        sd = 1.5 * arm.parameters["emission.keypoint_scale"].max() / body.length
    return sd.detach().cpu().double().clamp(max=1.0).numpy()


def _path_through(arm, q: Tensor, time: Tensor, body: BodyParameters) -> Tensor:
    step = time.diff().unsqueeze(-1)
    # Forward differences: under explicit Euler they satisfy the transition exactly.
    qd = q.diff(dim=0) / step
    qd = torch.cat([qd, qd[-1:]])
    qdd = torch.cat([qd.diff(dim=0) / step, torch.zeros_like(q[:1])])
    torque = arm.dynamics.inverse(q, qd, qdd, body)
    if arm.command is not None:
        torque = torque - arm.command.cpu()
    z = arm.torque.path(torque, time)
    hidden = z.new_zeros(len(z), arm.state_dim - z.shape[-1] - 2 * q.shape[-1])
    path = torch.cat([z, hidden, q, qd], -1)
    return path.to(dtype=arm.dtype, device=arm.device)

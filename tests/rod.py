"""A rod on a hinge, and what a model makes of a motion when nothing is random."""

from dataclasses import replace

import numpy as np
import torch

from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body
from invdyn.models.articulated.drive import RowDrive

F64 = torch.float64
INERTIA = 1.5 * 0.3**2 / 3  # of the rod below about its joint


def rod(rows=101, step=0.005, gravity=(0.0, 0.0), command=None, **kwargs):
    body = planar_body("rod", [Link("link", "hinge", "tip", length=0.3, mass=1.5)], gravity=gravity)
    return ArmModel(body, step * np.arange(rows), Observation(Keypoints([0])), command=command, **kwargs)


def rolled(model, q, qd, rows=None):
    """Angles and velocities (T, K) without any noise."""
    K = len(q)
    x = torch.cat([torch.zeros(model.state_dim - 2 * K), *(torch.tensor(value, dtype=F64) for value in (q, qd))])
    path = [x]
    for t in range(1, rows or model.num_steps):
        path.append(model.transition_mean(path[-1], t))
    path = torch.stack(path).numpy()
    return path[:, -2 * K : -K], path[:, -K:]


def driven(model, motor, t=3, step=None):
    """What drives a model at row ``t`` under a steady ``motor`` torque (..., K), in sub-steps of ``step`` s."""
    step = model.dt[t].reshape(1) if step is None else torch.tensor(step)
    return RowDrive(motor, 0.0, model.body_parameters(), model.timeline.clock(t, model.dtype), step, step, 1)


def torque_of(model, ideal, x, t=3):
    """The extra generalised force of the effects on the K joints, N·m, (..., K), from accelerations; no own inertia."""
    _, q, qd = ideal.split(x)
    body = ideal.body_parameters()
    drive = replace(driven(model, torch.zeros_like(q), t), body=body)
    return model.mechanics.with_friction(*model.mechanics.smooth(drive, q, qd, 0.0))[0]

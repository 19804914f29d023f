"""Integrator sub-steps from the integrator's own error, which would otherwise be taken for physics.

The error e_t of row t is the difference to twice as many sub-steps, over that one row, along the smoothed inverse
kinematics. A few rows of wild inverse kinematics must not decide: the hundredth part with the largest errors is not
asked. Two limits:

    seen    |e_t| in an angle stays under a tenth of "noise.angle" plus a tenth of the observations' noise
    nats    ½ Σ_t |Q^{−1/2} e_t|², which log evidence loses at most (all of it where observations show every state; Q of
            angles and velocities), stays under so many nats: errors that no row shows add up over a recording, and
            whatever takes shorter sub-steps for reasons of its own gains that much over what does not
"""

from copy import copy

import torch
from torch import Tensor

from invdyn.models import ArmModel
from invdyn.models.arm_start import link_angle_sd

SUBSTEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
SHARE = 0.1
"""Of what can be noticed in an angle, for the first limit."""
ASKED = 0.99
"""Part of the rows that is."""


def sufficient_substeps(model: ArmModel, observations: Tensor, nats: float | None = None) -> int:
    """Smallest of ``SUBSTEPS`` whose error stays under the first limit, and the second where ``nats`` are given.

    The last one, if none does. "euler" keeps one step, as printed: its error is part of that model.
    """
    if model.integrator == "euler":
        return 1
    paths = model.initial_paths(observations)
    path = paths[len(paths) // 2]
    rows, joints = torch.arange(1, model.num_steps), model.body.num_joints
    noticed = model.parameters["noise.angle"] + 0.1 * torch.as_tensor(link_angle_sd(model, model.body_parameters()))
    noise = torch.cat([model.parameters["noise.angle"], model.parameters["noise.velocity"]])
    tried, ends = copy(model), {}

    def motion(count: int) -> Tensor:
        """Angles and velocities (T - 1, 2K) at the ends of all rows, in so many sub-steps."""
        if count not in ends:
            tried.substeps = count
            ends[count] = tried.transition_mean(path[:-1], rows)[:, -2 * joints :]
        return ends[count]

    with torch.no_grad():
        for substeps in SUBSTEPS:
            error = motion(substeps) - motion(2 * substeps)
            unseen = (torch.quantile(error[:, :joints].abs(), ASKED, dim=0) <= SHARE * noticed).all()
            lost = 0.5 * (error / noise).square().sum(-1)
            cheap = nats is None or lost[lost <= torch.quantile(lost, ASKED)].sum() <= nats
            if bool(unseen) and bool(cheap):
                break
    return substeps

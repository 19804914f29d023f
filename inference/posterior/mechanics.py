"""Everything mechanical that follows from a posterior, frame by frame and draw by draw.

With D(θ), c(θ), h(θ, θ̇) of the body's equation of motion D θ̈ + h + c = τ (:mod:`invdyn.models`):

    inertia_matrix    D       [chain, draw, time, joint, joint_2]  kg·m²
    gravity_load      c       [chain, draw, time, joint]           N·m
    coriolis          h       [chain, draw, time, joint]           N·m
    acceleration      θ̈       [chain, draw, time, joint]           rad/s²
    kinetic_energy    ½θ̇ᵀDθ̇   [chain, draw, time]                  J
    potential_energy  V       [chain, draw, time]                  J
    power             τ θ̇     [chain, draw, time, joint]           W
"""

from typing import Any

import arviz as az
import numpy as np
import torch
import xarray as xr

from invdyn.models import BodyParameters, dynamics_for

PARTS = ("length", "mass", "com", "inertia", "gravity", "base")


def mechanics(idata: az.InferenceData) -> xr.Dataset:
    """Compute the table above from ``idata`` (posterior angles, velocities and torques, and the body's constants)."""
    posterior, constants = idata["posterior"], idata["constant_data"]

    def tensor(variable: xr.DataArray) -> torch.Tensor:
        return torch.as_tensor(variable.values, dtype=torch.float64)

    frame, joint = ["chain", "draw", "time"], ["chain", "draw", "time", "joint"]

    def constant(part: str) -> torch.Tensor:
        if part in posterior:  # an uncertain body: its scalars differ between draws
            return tensor(posterior[part].transpose("chain", "draw", "link")).unsqueeze(-2)
        return tensor(constants[part])

    body = BodyParameters(**{part: constant(part) for part in PARTS})
    q, qd, tau = (tensor(posterior[name]) for name in ("angle", "velocity", "torque"))
    dynamics = dynamics_for(q.shape[-1])
    unit = idata.attrs.get("length_unit", "m")
    si = unit == "m"
    torque, energy = ("N·m", "J") if si else (f"kg·({unit})²/s²",) * 2
    values = {
        "inertia_matrix": (
            [*joint, "joint_2"],
            dynamics.inertia_matrix(q, body),
            "kg·m²" if si else f"kg·({unit})²",
        ),
        "gravity_load": (joint, dynamics.gravity_load(q, body), torque),
        "coriolis": (joint, dynamics.coriolis(q, qd, body), torque),
        "acceleration": (joint, dynamics.forward(q, qd, tau, body), "rad/s²"),
        "kinetic_energy": (frame, dynamics.kinetic_energy(q, qd, body), energy),
        "potential_energy": (frame, dynamics.potential_energy(q, body), energy),
        "power": (joint, dynamics.power(qd, tau), "W" if si else f"kg·({unit})²/s³"),
    }
    coords: dict[str, Any] = {name: posterior[name] for name in joint}
    coords["joint_2"] = posterior["joint"].values
    return xr.Dataset(
        {name: (dims, np.asarray(v), {"units": u}) for name, (dims, v, u) in values.items()}, coords=coords
    )

"""Everything mechanical that follows from a posterior, frame by frame and draw by draw.

With D(θ), c(θ), h(θ, θ̇) of the body's equation of motion D θ̈ + h + c = τ (:mod:`invdyn.models`), and of θ̈ with the
friction, springs and rotors that its file gives the joints:

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

from invdyn.inference.posterior.body_doubt import OF_JOINTS, joint_losses
from invdyn.models import ArticulatedBody, BodyParameters, dynamics_for, planar_dynamics
from invdyn.models.bodies.joint_parts import NOTHING
from invdyn.models.bodies.protocol import kept_as


def mechanics(idata: az.InferenceData, body: ArticulatedBody | None = None) -> xr.Dataset:
    """Compute the table above from ``idata`` (posterior angles, velocities and torques, and the body's constants).

    ``body`` is whose posterior it is; where it is not given, a chain in the plane.
    """
    posterior, constants = idata["posterior"], idata["constant_data"]

    def tensor(variable: xr.DataArray) -> torch.Tensor:
        return torch.as_tensor(variable.values, dtype=torch.float64)

    frame, joint = ["chain", "draw", "time"], ["chain", "draw", "time", "joint"]

    def constant(part: str) -> torch.Tensor:
        if part in posterior and "time" not in posterior[part].dims:  # an uncertain body, which draws differ in
            return tensor(posterior[part].transpose("chain", "draw", ...)).unsqueeze(2)
        return tensor(constants[part])

    q, qd, tau = (tensor(posterior[name]) for name in ("angle", "velocity", "torque"))
    parts = [NOTHING] * q.shape[-1] if body is None else body.joint_parts
    stiffness, rest, *filed = (
        tau.new_tensor([getattr(each, name) for each in parts])
        for name in ("stiffness", "rest", "friction", "damping", "armature")
    )
    joints = dict(zip(OF_JOINTS, (torch.zeros(q.shape[-1]).to(q), *filed), strict=True))
    if "dry_friction" in posterior:  # what joints take besides
        for name, value in joints.items():
            joints[name] = value + tensor(posterior[name].transpose("chain", "draw", "joint")).unsqueeze(2)
    joints = {name: value.expand_as(q) for name, value in joints.items()}
    acting = tau - joint_losses(joints, qd) - stiffness * (q - rest)  # the others do not move the body
    numbers = BodyParameters if body is None else type(body.parameters())
    dynamics = planar_dynamics(q.shape[-1]) if body is None else dynamics_for(body)
    own = numbers(*(constant(kept_as(part)) for part in numbers._fields))
    unit = idata.attrs.get("length_unit", "m")
    si = unit == "m"
    torque, energy = ("N·m", "J") if si else (f"kg·({unit})²/s²",) * 2
    values = {
        "inertia_matrix": (
            [*joint, "joint_2"],
            dynamics.inertia_matrix(q, own),
            "kg·m²" if si else f"kg·({unit})²",
        ),
        "gravity_load": (joint, dynamics.gravity_load(q, own), torque),
        "coriolis": (joint, dynamics.coriolis(q, qd, own), torque),
        "acceleration": (joint, dynamics.forward(q, qd, acting, own, joints["rotor_inertia"]), "rad/s²"),
        "kinetic_energy": (frame, dynamics.kinetic_energy(q, qd, own), energy),
        "potential_energy": (frame, dynamics.potential_energy(q, own), energy),
        "power": (joint, dynamics.power(qd, tau), "W" if si else f"kg·({unit})²/s³"),
    }
    coords: dict[str, Any] = {name: posterior[name] for name in joint}
    coords["joint_2"] = posterior["joint"].values
    return xr.Dataset(
        {name: (dims, np.asarray(v), {"units": u}) for name, (dims, v, u) in values.items()}, coords=coords
    )

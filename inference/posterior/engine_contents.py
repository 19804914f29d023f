"""What the posterior of a MuJoCo model holds: the arm's variables, and what contacts and actuators do.

posterior             torque [chain, draw, time, joint] N·m (N of slides), the generalised force of the drive at each
                      degree of freedom; angle rad and velocity rad/s of them; position [.., keypoint, space];
                      drive [.., input] in each input's unit (controls, excitations, wrenches); activation
                      [.., activation_of] and actuator_force [.., actuator] N where the file's actuators are the drive;
                      contact_force N and centre_of_pressure m [.., contact, axis] of pairs of shapes that touch;
                      reaction_force N and reaction_moment N·m [.., link, axis] on each body with a joint, and the
                      joint_centre m about which the moment is
posterior_predictive  position, angle, sensor with observation noise
observed_data         the same, as recorded
constant_data         the model's parameters; skeleton; ground [contact], 1 for contacts with what does not move
attributes            "engine": why MuJoCo's; "hidden": what the motion does not tell, a line each

Shapes: paths (M, R, T, D).
"""

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import arviz as az
import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.posterior.arm_contents import sensed, true_values
from invdyn.inference.posterior.problem import DRAWS, Contents, Variables
from invdyn.models.bodies.body_mjcf import engine
from invdyn.models.bodies.protocol import AXES
from invdyn.models.engine.contacts import contact_forces
from invdyn.models.engine.drives import turning_dofs
from invdyn.models.engine.model import EngineModel
from invdyn.models.engine.reactions import evaluated, joint_reactions
from invdyn.models.engine.scene import Scene
from invdyn.recordings import Recording, Truth

UNTOLD = 0.6
"""Posterior sd, as a share of the prior's, from which on the motion says next to nothing of a number."""
ACTS = 1.0
"""N, median force of a contact from which on it acts in a row."""
PRIOR_DRAWS = 4000


def engine_contents(
    model: EngineModel,
    observations: Tensor,
    recording: Recording,
    truth: Truth | None,
    reasons: Sequence[str],
    paths: Tensor,
    rows: Tensor,
) -> Contents:
    """Return what the posterior holds; arguments are those of :func:`.arm_contents.arm_contents`.

    ``reasons`` say why MuJoCo's engine was taken.
    """
    scene, joints = model.scene, [*DRAWS, "time", "joint"]
    z, tangent, velocity, _ = model.split(paths)
    flat = paths.reshape(-1, *paths.shape[-2:]).numpy()
    force, actuator_force = generalised_forces(model, flat)
    lead = paths.shape[:2]
    points = torch.as_tensor(model.sensed(paths).numpy()[..., scene.points[:, list(scene.plane)]])
    posterior: Variables = {
        "torque": (joints, force.reshape(*lead, *force.shape[1:])),
        "angle": (joints, tangent + torch.as_tensor(model.reference_angles)),
        "velocity": (joints, velocity),
        "position": ([*DRAWS, "time", "keypoint", "space"], points),
        "drive": ([*DRAWS, "time", "input"], model.inputs.values(z[..., : model.inputs.size].numpy())),
    }
    if model.inputs.controls_actuators:
        shape = (*lead, *actuator_force.shape[1:])
        posterior["actuator_force"] = ([*DRAWS, "time", "actuator"], actuator_force.reshape(shape))
    if model.na:
        activation = model.physics(flat.reshape(-1, model.state_dim))[:, -model.na :]  # within its limits
        posterior["activation"] = ([*DRAWS, "time", "activation_of"], activation.reshape(*lead, -1, model.na))
    contacts = contact_forces(model, flat)
    if contacts.pairs:
        sizes = [*DRAWS, "time", "contact", "axis"]
        posterior["contact_force"] = (sizes, contacts.force.reshape(*lead, *contacts.force.shape[1:]))
        posterior["centre_of_pressure"] = (sizes, contacts.centre.reshape(*lead, *contacts.centre.shape[1:]))

    links, wrench = joint_reactions(model, flat)
    for name, part in zip(("reaction_force", "reaction_moment", "joint_centre"), np.split(wrench, 3, -1), strict=True):
        posterior[name] = ([*DRAWS, "time", "link", "axis"], part.reshape(*lead, *part.shape[1:]))

    predictive, observed, of_sensors, seen = sensed(model.observation, rows, observations, "m")
    attributes: dict[str, Any] = {
        "recording": recording.name,
        "body": scene.name,
        "length_unit": "m",
        "model": "dynamic",
        "engine": f"dynamics by MuJoCo: {'; '.join(reasons)}" if reasons else "dynamics by MuJoCo",
    }
    constants: Variables = {
        name: ([f"{name}_{axis}" for axis in range(value.ndim)], value.detach())
        for name, value in model.parameters.items()
    }
    if skeleton := _skeleton(scene):
        constants["skeleton"] = (["edge", "end"], np.array(skeleton))
    constants["turns"] = (["joint"], turning_dofs(scene.model).astype(np.int8))
    constants |= true_values(truth, scene.joint_names)
    if contacts.pairs:
        constants["ground"] = (["contact"], contacts.ground.astype(np.int8))
    coords: dict[str, Any] = {
        "time": recording.time,
        "joint": list(scene.joint_names),
        "space": [AXES[axis] for axis in scene.plane],
        "axis": list(AXES),
        "keypoint": list(scene.keypoint_names),
        "input": list(model.inputs.names),
        "actuator": list(scene.actuator_names),
        "activation_of": activation_names(model),
        "contact": list(contacts.names),
        "link": list(links),
    }
    return Contents(posterior, predictive, observed, constants, coords, _units(model) | of_sensors, attributes, seen)


def generalised_forces(model: EngineModel, paths: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of the drive in states (N, T, D): at degrees of freedom (N, T, nv), and of actuators (N, T, nu)."""
    mujoco, scene = engine(model.scene.name), model.scene
    flat, compiled = paths.reshape(-1, paths.shape[-1]), model.compiled()
    compiled.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    out, own = np.full((len(flat), model.nv), np.nan), np.full((len(flat), compiled.nu), np.nan)
    for k, data in evaluated(model, compiled, flat):
        out[k] = data.qfrc_smooth - data.qfrc_passive + data.qfrc_bias
        own[k] = data.actuator_force
    shape = paths.shape[:-1]
    assert scene.num_joints == model.nv
    return out.reshape(*shape, -1), own.reshape(*shape, -1)


def hidden(model: EngineModel, idata: az.InferenceData) -> list[str]:
    """Lines on contacts, and on what the motion does not tell, from equally weighted draws."""
    posterior = idata["posterior"].stack(sample=DRAWS, create_index=False)
    lines = untold(model, posterior["drive"].transpose("sample", "time", "input").values)
    if "contact_force" in posterior:
        force = posterior["contact_force"].transpose("sample", "time", "contact", "axis").values
        names = [str(name) for name in posterior["contact"].values]
        lines += contact_lines(force, names, idata["constant_data"]["ground"].values > 0)
    return lines


def untold(model: EngineModel, drive: np.ndarray) -> list[str]:
    """A line for each driven number of which the motion says next to nothing, from draws (N, T, K)."""
    with seeded(0):
        z = model.initial().expand(torch.Size([PRIOR_DRAWS])).sample()
    prior = model.inputs.values(z[:, : model.inputs.size].double().numpy()).std(0)
    share = np.median(drive.std(0), 0) / prior
    return [
        f"the motion hardly tells {name}: its band is {100 * part:.0f} % as wide as before anything was seen"
        for name, part in zip(model.inputs.names, share, strict=True)
        if part > UNTOLD
    ]


def contact_lines(force: np.ndarray, names: Sequence[str], ground: np.ndarray) -> list[str]:
    """What is known of each contact (N, T, P, 3), and whether the split between those with the ground is unknown."""
    lines = []
    size = np.linalg.norm(force, axis=-1)  # (N, T, P)
    for k, name in enumerate(names):
        acting = np.median(size[..., k], 0) > ACTS
        if acting.any():
            mean, width = size[:, acting, k].mean(), np.ptp(np.quantile(size[:, acting, k], [0.05, 0.95], 0), 0).mean()
            lines.append(
                f"contact {name}: {mean:.3g} N ± {width / 2:.2g} (90 %) in {100 * acting.mean():.0f} % of rows"
            )
    for i, j in combinations(np.flatnonzero(ground).tolist(), 2):
        one, other = (force[..., k, 2] for k in (i, j))
        stands = (np.median(one, 0) > ACTS) & (np.median(other, 0) > ACTS)
        if not stands.any():
            continue
        # Means over the rows: momentum knows a sum's, and of single rows' forces next to nothing. Its sd is √2 of a
        # single one's where they are independent, and below it where more than half of each makes up for the other.
        one, other = one[:, stands].mean(1), other[:, stands].mean(1)
        single, together = float(min(one.std(), other.std())), float((one + other).std())
        if single > together:
            lines.append(
                f"while both touch, the motion does not tell how {names[i]} and {names[j]} share the load: each ± "
                f"{1.645 * single:.2g} N (90 %) on average, their sum ± {1.645 * together:.2g} N"
            )
    return lines


def activation_names(model: EngineModel) -> list[str]:
    """Of the na activations: their actuators'."""
    compiled, names = model.scene.model, [""] * model.na
    for a, own in enumerate(model.scene.actuator_names):
        first, count = int(compiled.actuator_actadr[a]), int(compiled.actuator_actnum[a])
        for k in range(count if first >= 0 else 0):
            names[first + k] = own if count == 1 else f"{own}_{k}"
    return names


def _units(model: EngineModel) -> dict[str, str]:
    units = {"torque": "N·m", "angle": "rad", "velocity": "rad/s", "position": "m"}  # of joints that turn
    units |= {"truth_torque": units["torque"], "truth_angle": "rad", "truth_velocity": "rad/s"}
    units |= {"drive": " and ".join(dict.fromkeys(model.inputs.units)), "actuator_force": "N"}
    units |= {"contact_force": "N", "centre_of_pressure": "m"}
    return units | {"reaction_force": "N", "reaction_moment": "N·m", "joint_centre": "m"}


def _skeleton(scene: Scene) -> list[tuple[int, int]]:
    """Pairs of sites to draw a line between: along a body, and to the nearest one inwards that has a site."""
    model = scene.model
    first: dict[int, int] = {}
    edges = []
    for site, body in enumerate(model.site_bodyid.tolist()):
        if body in first:
            edges.append((first[body], site))
            continue
        first[body] = site
        above = int(model.body_parentid[body])
        while above and above not in first:
            above = int(model.body_parentid[above])
        if above in first and above != body:
            edges.append((first[above], site))
    return edges

"""What the posterior of an arm holds: torques, angles, velocities, keypoints, with names and units.

posterior             torque [chain, draw, time, joint] N·m (not of a kinematic model), angle rad, velocity rad/s,
                      position [chain, draw, time, keypoint, space] of the tips;
                      residual_torque if commanded; of a base that moves base_position, base_velocity and
                      base_acceleration [chain, draw, time, space]
posterior_predictive  position and angle with observation noise
observed_data         position [time, keypoint, space], angle [time, joint]
constant_data         the model's parameters, command, truth; in space smallest_singular_value [time] of the
                      tracked sites' Jacobian and unseen [time, joint], 1 where no keypoint shows a
                      coordinate (:mod:`.visibility`), which the attribute "unseen" says in words; "charts" says
                      which joints' frames were rotated, and which pass a pole all the same (:mod:`.charts`)
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from torch import Tensor

from invdyn.inference.posterior.problem import DRAWS, Contents, Variables
from invdyn.inference.posterior.visibility import unseen_lines, visibility
from invdyn.models import ArmModel
from invdyn.models.bodies.protocol import axes
from invdyn.models.observation.keypoints import first_joint
from invdyn.models.observation.observation import Observation
from invdyn.recordings import Recording, Truth


def arm_contents(
    model: ArmModel,
    observations: Tensor,
    recording: Recording,
    truth: Truth | None,
    notes: Sequence[str],
    paths: Tensor,
    rows: Tensor,
) -> Contents:
    """Return what the posterior of an arm holds.

    Args:
        model: of the arm, in float64; a kinematic model has no torques.
        observations: (T, O), NaN where missing.
        recording, truth: where the rows come from, and what is known of the torques.
        notes: lines that a reader must know.
        paths: (M, R, T, D) draws of the states.
        rows: (M, R, T, O) draws of the observations given them.
    """
    body = model.body
    units = _units(recording.length_unit)
    joints = [*DRAWS, "time", "joint"]

    _, angle, velocity = model.split(paths)
    dynamic = isinstance(model, ArmModel)
    moved = model.base_motion(paths) if dynamic else None
    tips = model.sites(paths) if dynamic else model.dynamics.keypoints(angle, model.body_parameters())
    posterior: Variables = {"torque": (joints, model.net_torque(paths))} if dynamic else {}
    posterior |= {
        "angle": (joints, angle),
        "velocity": (joints, velocity),
        "position": ([*DRAWS, "time", "keypoint", "space"], tips),
    }
    if moved is not None:
        place = first_joint(model.body_parameters())
        carried = {"base_position": place + moved[0], "base_velocity": moved[1], "base_acceleration": moved[2]}
        posterior |= {name: ([*DRAWS, "time", "space"], value) for name, value in carried.items()}
    if dynamic and model.command is not None:
        posterior["residual_torque"] = (joints, paths[..., : body.num_joints])

    predictive, observed, of_sensors, seen = sensed(model.observation, rows, observations, recording.length_unit)
    coords: dict[str, Any] = {
        "time": recording.time,
        "joint": list(body.joint_names),
        "space": axes(body),
        "link": list(body.link_names),
        "keypoint": list(body.keypoint_names),
    }
    attributes: dict[str, Any] = {
        "recording": recording.name,
        "body": body.name,
        "length_unit": recording.length_unit,
        "model": "dynamic" if dynamic else "kinematic",
    }
    if notes:
        attributes["charts"] = "\n".join(notes)
    constants = _constants(model, truth)
    if body.dimensions == 3:
        smallest, unseen = visibility(model, observations, angle.mean((0, 1)))
        constants["smallest_singular_value"] = (["time"], smallest)
        constants["unseen"] = (["time", "joint"], unseen.astype(np.int8))
        if lines := unseen_lines(unseen, body.joint_names):
            attributes["unseen"] = "\n".join(lines)

    return Contents(posterior, predictive, observed, constants, coords, units | of_sensors, attributes, seen)


def sensed(
    observation: Observation, rows: Tensor, observations: Tensor, length_unit: str
) -> tuple[Variables, Variables, dict[str, str], dict[str, Any]]:
    """What sensors show in drawn ``rows`` and showed, the units, and names of what they see."""
    predictive: Variables = {}
    observed: Variables = {}
    units: dict[str, str] = {}
    names: dict[str, Any] = {}
    for sensor in observation.sensors:
        dims = list(sensor.coords)
        predictive[sensor.name] = ([*DRAWS, "time", *dims], observation.of(sensor, rows))
        observed[sensor.name] = (["time", *dims], observation.of(sensor, observations))
        units |= {sensor.name: length_unit if sensor.unit == "length" else sensor.unit}
        names |= {dim: list(each) for dim, each in sensor.coords.items()}
    return predictive, observed, units, names


def true_values(truth: Truth | None, joint_names: Sequence[str]) -> Variables:
    """Of the joints that a truth names; others are not known."""
    if truth is None:
        return {}
    found: Variables = {}
    for name in ("torque", "angle", "velocity"):
        values = np.full((len(truth.time), len(joint_names)), np.nan)
        for k, joint in enumerate(joint_names):
            if joint in truth.joint_names:
                values[:, k] = getattr(truth, name)[:, truth.joint_names.index(joint)]
        found[f"truth_{name}"] = (["time", "joint"], values)
    return found


def _units(length: str) -> dict[str, str]:
    torque = "N·m" if length == "m" else f"kg·({length})²/s²"
    units = {"angle": "rad", "velocity": "rad/s", "position": length, "length": length, "mass": "kg"}
    units |= dict.fromkeys(("torque", "residual_torque", "command", "truth_torque"), torque)
    units |= {"truth_angle": "rad", "truth_velocity": "rad/s", "com": length}
    units |= dict.fromkeys(("base", "origin", "sites", "base_position"), length)
    units |= {"base_velocity": f"{length}/s", "base_acceleration": f"{length}/s²"}
    units |= {"gravity": f"{length}/s²", "smallest_singular_value": f"{length}/rad"}
    return units | {"inertia": f"kg·({length})²" if length != "m" else "kg·m²"}


def _constants(model: ArmModel, truth: Truth | None) -> Variables:
    constants: Variables = dict(model.body.described(model.body_parameters()))
    if isinstance(model, ArmModel) and model.command is not None:
        constants["command"] = (["time", "joint"], model.command)
    return constants | true_values(truth, model.body.joint_names)

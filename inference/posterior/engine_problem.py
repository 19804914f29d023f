"""From a recording and a MuJoCo model to an :class:`.EngineModel` with sensible starting values.

* the keypoints' noise from what a smooth motion cannot explain (:mod:`.jitter`);
* the first row's configuration and velocities by inverse kinematics (:mod:`invdyn.models.engine.inverse_kinematics`);
* the drive: the file's actuators where it has muscles, else torques at all hinges and slides, but those that stand for
  a moving base: slides of bodies on the world, and the hinges next to them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.posterior.engine_contents import engine_contents
from invdyn.inference.posterior.initialise import sensor_jitter
from invdyn.inference.posterior.problem import Contents, StateSpaceProblem
from invdyn.models import EngineModel, Observation, TorqueProcess
from invdyn.models.articulated.defaults import Value, WrongValue
from invdyn.models.bodies.body_mjcf import engine
from invdyn.models.bodies.joint_parts_mjcf import actuators_of
from invdyn.models.bodies.scalars import BodyError
from invdyn.models.engine.drives import Controls, Drive, JointTorques, Wrench, is_muscle
from invdyn.models.engine.scene import Scene
from invdyn.models.observation.encoders import Encoders
from invdyn.models.observation.keypoints import Keypoints
from invdyn.models.observation.sensor import Sensor
from invdyn.models.state_space import UnknownParameter
from invdyn.recordings import InputError, Recording, Truth

DRIVES = ("auto", "joints", "actuators", "wrench:BODY")
INITIAL_ANGLE, MIN_VELOCITY = 0.2, 0.5
"""rad or m, rad/s or m/s: how far the first row may be from its inverse kinematics, standard deviations."""


@dataclass(frozen=True)
class EngineProblem(StateSpaceProblem):
    """A MuJoCo model and its recording.

    Attributes:
        model, observations: as :class:`.StateSpaceProblem` has them.
        recording: where the rows come from.
        truth: torques to compare with, at the recording's times, or None.
        reasons: why MuJoCo's engine was taken.
    """

    model: EngineModel
    recording: Recording
    truth: Truth | None = None
    reasons: tuple[str, ...] = ()

    def monitored(self, paths: Tensor) -> np.ndarray:
        """Return the drive (M, R, T, K), whose mixing is stated."""
        return paths[..., : self.model.inputs.size].double().numpy()

    def contents(self, paths: Tensor, rows: Tensor) -> Contents:
        """Return torques, angles, keypoints, drive and contact forces, by name."""
        model = self.model.to(dtype=torch.float64)
        own = (self.recording, self.truth, self.reasons)
        return engine_contents(model, self.observations, *own, paths.double(), rows.double())


def engine_problem(
    recording: Recording,
    scene: Scene,
    *,
    drive: str | Drive | Sequence[Drive] = "auto",
    torque: TorqueProcess | None = None,
    family: str = "gaussian",
    parameters: Mapping[str, Value] | None = None,
    truth: Truth | None = None,
    reasons: Sequence[str] = (),
) -> EngineProblem:
    """Bind a MuJoCo model to a recording.

    Args:
        recording: keypoints among the scene's sites, encoder angles of its joints, or both, in m and rad.
        scene: of as many dimensions as the keypoints have.
        drive: what is not known, one of ``DRIVES``, or drives themselves.
        torque: its process; Ornstein–Uhlenbeck by default.
        family: of the observation noise.
        parameters: values by dotted name that replace the defaults.
        truth: to compare with.
        reasons: why MuJoCo's engine was taken, for the summary.

    Raises InputError where the recording does not fit, BodyError for a drive that the scene does not have.
    """
    names, sites = recording.keypoint_names, scene.keypoint_names
    if names and recording.keypoints.shape[-1] != scene.dimensions:
        raise InputError(
            f"{recording.name}: keypoints have {recording.keypoints.shape[-1]} coordinates, the scene is seen in "
            f"{scene.dimensions}: read it with dimensions={recording.keypoints.shape[-1]}"
        )
    if strange := [name for name in names if name not in sites]:
        raise InputError(
            f"{recording.name}: keypoint {strange[0]!r} is no site of {scene.name}, which has "
            f"{', '.join(sites) or 'none'}: add a site of that name to the file, or leave the keypoint out"
        )
    sensors: list[Sensor] = [Keypoints([sites.index(name) for name in names], recording.confidence)] if names else []
    columns = [recording.keypoints.reshape(recording.num_frames, -1)] if names else []
    if recording.angles is not None and np.isfinite(recording.angles).any():
        angles = np.full((recording.num_frames, scene.num_joints), np.nan)
        if unknown := [name for name in recording.joint_names if name not in scene.joint_names]:
            raise InputError(
                f"{recording.name}: joint {unknown[0]!r} is not of {scene.name}, which has "
                f"{', '.join(scene.joint_names)}: rename the column"
            )
        angles[:, [scene.joint_names.index(name) for name in recording.joint_names]] = recording.angles
        sensors.append(Encoders())
        columns.append(angles)
    if not sensors:
        raise InputError(f"{recording.name}: expected keypoints among {', '.join(sites)}, or angles, got neither")
    observation = Observation(*sensors, family=family).bound(scene)
    rows = np.concatenate(columns, 1)
    given: dict[str, Any] = {}
    for sensor in sensors:
        given |= _noise(observation, sensor, rows, scene)
    time = recording.time - recording.time[0]
    drives = chosen_drive(scene, drive) if isinstance(drive, str) else drive
    try:
        model = EngineModel(scene, time, observation, drive=drives, torque=torque, parameters=given)
        observations = torch.as_tensor(rows)
        first = model.initial_paths(observations)[0]
        _, tangent, velocity, _ = model.split(first)
        speed = np.quantile(np.abs(velocity.numpy()), 0.95, axis=0)
        given |= {
            "initial.angle": tangent[0],
            "initial.angle_scale": INITIAL_ANGLE,
            "initial.velocity_scale": np.maximum(2 * speed, MIN_VELOCITY),
            **(parameters or {}),
        }
        model = EngineModel(scene, time, observation, drive=drives, torque=torque, parameters=given)
    except (UnknownParameter, WrongValue) as error:
        raise InputError(f"settings: {error.args[0]}") from None
    known = None if truth is None else truth.at(recording.time)
    return EngineProblem(model, observations, recording, known, tuple(reasons), name=recording.name)


def _noise(observation: Observation, sensor: Sensor, rows: np.ndarray, scene: Scene) -> dict[str, np.ndarray]:
    """Of a sensor, from its columns' jitter; columns that no row shows have that of the others."""
    bound = next(each for each in observation.sensors if each.name == sensor.name)
    jitter = sensor_jitter(observation, bound, rows)
    known = jitter[np.isfinite(jitter) & (jitter > 0)]
    usual = float(np.median(known)) if len(known) else 1e-3
    return bound.started(np.where(np.isfinite(jitter) & (jitter > 0), jitter, usual), scene.reach)


def chosen_drive(scene: Scene, word: str) -> Drive:
    """The drive that a word of ``DRIVES`` means. Raises InputError for another word."""
    kind, _, body = word.partition(":")
    if kind == "auto":
        kind = "actuators" if is_muscle(scene.model).any() else "joints"
    if kind == "actuators":
        return Controls()
    if kind == "wrench" and body:
        return Wrench(body)
    if kind != "joints":
        raise InputError(f"expected a drive among {', '.join(DRIVES)}, got {word!r}")
    joints = driven_joints(scene)
    if not joints:
        raise BodyError(f"{scene.name}: expected a hinge or slide that is driven, got none: use wrench:BODY")
    return JointTorques(joints)


def driven_joints(scene: Scene) -> tuple[str, ...]:
    """Hinges and slides but those of a moving base.

    A base is a body on the world with a slide or a free joint while other bodies hang on it: a trunk on a rail, or one
    that slides and turns in a plane. Nothing but contacts moves it, unless the file has an actuator at one of its
    joints. Balls are driven, too.
    """
    mujoco, model = engine(scene.name), scene.model
    names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]
    kinds = model.jnt_type
    found = []
    for j, name in enumerate(names):
        body = int(model.jnt_bodyid[j])
        mates = kinds[model.jnt_bodyid == body]
        on_world = model.body_weldid[model.body_parentid[body]] == 0
        carries = bool((model.body_parentid[body + 1 :] == body).any())
        motors = [actuators_of(mujoco, model, int(k)) for k in np.flatnonzero(model.jnt_bodyid == body)]
        if kinds[j] == 0 or (on_world and carries and (mates == 2).any() and not any(motors)):
            continue
        found.append(name)
    return tuple(found)

"""From a recording and a body to a model with sensible starting values, as in Biderman et al. (2020).

* first-frame angles at maximum likelihood (inverse kinematics), with a weak Gaussian around them;
* link lengths from the median distance between joints, when they are to be learned (:mod:`.lengths`);
* whether the base moves, and how, from its own track (:mod:`.base_motion`);
* the keypoints' noise from what a smooth motion cannot explain (:mod:`.jitter`);
* integrator sub-steps from the integrator's own error. An error that is not far below the noise would be taken for
  physics.

All of it is a start: :mod:`.marginal_likelihood` then maximises the marginal likelihood.
"""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.posterior.arm_contents import arm_contents
from invdyn.inference.posterior.base_motion import Base, hold_base
from invdyn.inference.posterior.body_doubt import is_doubted, with_doubted_body
from invdyn.inference.posterior.cameras import LEARNED, pixels_of, started
from invdyn.inference.posterior.charts import chosen, poles
from invdyn.inference.posterior.lengths import with_observed_lengths
from invdyn.inference.posterior.problem import Contents, StateSpaceProblem
from invdyn.models import (
    ArmModel,
    ArticulatedBody,
    Body,
    Encoders,
    Keypoints,
    Observation,
    Sensor,
    TorqueProcess,
    dynamics_for,
)
from invdyn.models.articulated.applied_force import AppliedForce
from invdyn.models.articulated.defaults import WrongValue
from invdyn.models.articulated.moving_base import MovingBase
from invdyn.models.articulated.start import joint_angle_sd, on_base_at_rest
from invdyn.models.kinematics import joint_angle_candidates
from invdyn.models.observation.keypoints import BasePoint
from invdyn.models.observation.pixels import DEFAULT_BIAS, Pixels
from invdyn.models.state_space import UnknownParameter
from invdyn.recordings import InputError, Recording, SiteForce, Truth
from invdyn.recordings.cameras import Filmed
from invdyn.recordings.jitter import jitter, point_jitter, robust_sd, seen_vectors

SUBSTEPS = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64)
OUTLIER_RATIO = 20.0
"""Times as far off as a sure keypoint that a doubtful one is an outlier."""


@dataclass(frozen=True)
class Problem(StateSpaceProblem):
    """An arm and its recording: what an inference method is given.

    Attributes:
        model: bound to the recording's commands and times, the latter from ``origin`` on.
        observations: (T, O) rows of the model's emission, NaN where missing.
        recording: where they come from.
        truth: torques to compare with, or None.
        notes: what was decided on the way that a reader of the result must know.
        base: what was decided of the base, in a line; empty where nothing was looked at.
        origin: the recording's time, s, at which the model's is 0. Single precision tells no two rows apart in
            seconds since 1970.
        doubted: whether torques are those of bodies that may differ from the file (:mod:`.body_doubt`).
    """

    model: ArmModel
    recording: Recording
    truth: Truth | None = None
    notes: tuple[str, ...] = ()
    origin: float = 0.0
    doubted: bool = False
    base: str = ""

    @property
    def uncertain(self) -> tuple[str, ...]:
        """What of the body has a prior."""
        return ("body",) if self.model.body.has_priors else ()

    def monitored(self, paths: Tensor) -> np.ndarray:
        """Return the torques (M, R, T, K), whose mixing is stated."""
        return self.model.to(dtype=torch.float64).net_torque(paths.double()).numpy()

    def contents(self, paths: Tensor, rows: Tensor) -> Contents:
        """Return torques, angles, velocities and keypoints, by name."""
        model = self.model.to(dtype=torch.float64)
        found = arm_contents(model, self.observations, self.recording, self.truth, self.notes, paths, rows)
        found.attributes.update({"base": self.base} if self.base else {})
        return with_doubted_body(found, model, paths) if self.doubted and "torque" in found.posterior else found


def arm_problem(
    recording: Recording,
    body: ArticulatedBody,
    *,
    torque: TorqueProcess | None = None,
    integrator: str = "rk4",
    substeps: int | None = None,
    family: str = "gaussian",
    parameters: Mapping[str, object] | None = None,
    learn_lengths: bool = False,
    hide_torque: bool = False,
    passive: bool = False,
    truth: Truth | None = None,
    learn_cameras: Sequence[str] = (),
    forces: Sequence[SiteForce] = (),
    origin: float | None = None,
    moving_base: bool = False,
) -> Problem:
    """Bind a body to a recording.

    Args:
        recording: keypoints among the body's sites, encoder angles, or both; of a film its pixels are observed.
        body: lengths in the recording's length unit.
        torque: torque process; Ornstein–Uhlenbeck by default.
        integrator, substeps: of the dynamics; sub-steps are chosen from the error when not given.
        family: of the observation noise, one of :data:`invdyn.models.FAMILIES`.
        parameters: values by dotted name that replace the defaults.
        learn_lengths: start link lengths at the median distances.
        hide_torque: ignore the recording's commanded torques.
        passive: the commanded torque is zero.
        truth: to compare with.
        learn_cameras: what of a film's cameras is not known: "offset" and "pose" of all but the first, or, instead of
            poses, "turn", how each is rotated about its place.
        forces: known ones on keypoints of the body, with the recording's clock.
        origin: see :class:`Problem`; by default the time of the first row.
        moving_base: let the base move as its track says, where the recording has one that moves; else it is at rest.

    Raises InputError when the recording does not fit the body.
    """
    if unknown := [each for each in learn_cameras if each not in LEARNED]:
        raise InputError(f"of cameras {', '.join(LEARNED)} may be learned, got {unknown[0]!r}")
    if {"pose", "turn"} <= set(learn_cameras):
        raise InputError("expected pose or turn to be learned of cameras, got both: a pose has the turn in it")
    if learn_cameras and not isinstance(recording, Filmed):
        raise InputError(f"{recording.name} is no film of several cameras, of which something could be learned")
    origin = float(recording.time[0]) if origin is None else origin
    time = recording.time - origin
    held = hold_base(recording, body) if moving_base else Base(recording)
    recording, motion = held.recording, held.motion
    sites = [(p, site) for p, site in _sites(recording, body) if recording.keypoint_names[p] != held.apart]
    joints = body.num_joints
    angles = _in_order(recording, body, recording.angles, "angles")
    command = None if hide_torque else _in_order(recording, body, recording.torques, "commanded torques")
    if passive:
        command = np.zeros((recording.num_frames, joints))
    if command is not None and not np.isfinite(command).all():
        raise InputError(
            f"{recording.name}: the commanded torque is missing at frame "
            f"{int(np.argwhere(~np.isfinite(command))[0][0])}: "
            "fill it in, or pass --set hide_torque=yes to treat torques as unknown"
        )
    if isinstance(recording, Filmed) and recording.views is not None:
        columns = [recording.views.pixels[:, c, p] for c in range(len(recording.views.calibration)) for p, _ in sites]
    else:
        columns = [recording.keypoints[:, p] for p, _ in sites]
    rows = [np.concatenate(columns, axis=1)] if columns else []
    if held.apart is not None:
        rows.append(recording.keypoint(held.apart))
    if angles is not None:
        rows.append(angles)
    if not rows:
        raise InputError(
            f"{recording.name} has neither a keypoint nor an angle of body '{body.name}': "
            f"expected keypoints among {', '.join(body.keypoint_names)}, "
            f"got {', '.join(recording.keypoint_names) or 'none'}"
        )
    observations = torch.as_tensor(np.concatenate(rows, axis=1))
    confidence = None if recording.confidence is None else recording.confidence[:, [p for p, _ in sites]]
    if confidence is not None and not (
        np.isfinite(confidence).any() and np.ptp(confidence[np.isfinite(confidence)]) > 0
    ):
        confidence = None  # a constant confidence says nothing
    sensors: list[Sensor] = [Keypoints([site for _, site in sites], confidence)] if sites else []
    if isinstance(recording, Filmed) and sites:
        sensors = [pixels_of(recording, sites, tuple(learn_cameras))]
    sensors += [] if motion is None else [BasePoint()]
    sensors += [] if angles is None else [Encoders()]
    observation = Observation(*sensors, family=family).bound(body)
    if learn_lengths:
        body = with_observed_lengths(held.at_rest, body)
    at_rest = observations if motion is None else on_base_at_rest(observation, observations, motion.displacements)
    notes: tuple[str, ...] = ()
    if isinstance(body, Body) and not body.is_chain:
        # Where others use its coordinates they stay as they are.
        spoken = angles is not None or command is not None or truth is not None
        spoken |= any(name.startswith("initial.") for name in parameters or {})
        body, notes = _charted(body, time, at_rest, observation, turning=not spoken)
    values = {**_start_values(body, time, at_rest, observation), **held.values, **(parameters or {})}
    options: dict[str, Any] = {"torque": torque, "command": command, "integrator": integrator, "parameters": values}
    options["base"] = None if motion is None else MovingBase(body.dimensions)
    try:
        model = ArmModel(body, time, observation, substeps=substeps or 1, **options)
    except (UnknownParameter, WrongValue) as error:
        raise InputError(f"settings: {error.args[0]}") from None
    for each in forces:
        each.check(body.keypoint_names, recording.time, body.dimensions)
    if forces:
        given = ((each.keypoint, torch.as_tensor(each.time - origin), torch.as_tensor(each.force)) for each in forces)
        model = model.with_effects(*(AppliedForce(*each) for each in given))
    if substeps is None:
        model = model.in_substeps(sufficient_substeps(model, observations))
    known = None if truth is None else truth.at(recording.time)
    return Problem(model, observations, recording, known, notes, origin, is_doubted(model), held.line)


def _sites(recording: Recording, body: ArticulatedBody) -> list[tuple[int, int]]:
    """Pairs (keypoint in the recording, site of the body)."""
    if recording.keypoints.shape[-1] != body.dimensions and recording.keypoint_names:
        where = {2: "moves in a plane", 3: "moves in space"}.get(body.dimensions, f"has {body.dimensions} dimensions")
        raise InputError(
            f"{recording.name}: keypoints have {recording.keypoints.shape[-1]} coordinates, but body "
            f"'{body.name}' {where}"
        )
    names = body.keypoint_names
    known = names if body.base_keypoint is None else (body.base_keypoint, *names)
    strange = [name for name in recording.keypoint_names if name not in known]
    if strange:
        raise InputError(
            f"{recording.name}: keypoint {strange[0]!r} is not of body '{body.name}', "
            f"which has {', '.join(known)}: rename the body's tips or leave the keypoint out"
        )
    return [(p, names.index(name)) for p, name in enumerate(recording.keypoint_names) if name in names]


def _in_order(recording: Recording, body: ArticulatedBody, values: np.ndarray | None, what: str) -> np.ndarray | None:
    """Columns (T, K) in the body's order of joints; None when there are none."""
    if values is None or not np.isfinite(values).any():
        return None
    if set(recording.joint_names) != set(body.joint_names):
        raise InputError(
            f"{recording.name}: {what} are of joints {', '.join(recording.joint_names)}, "
            f"but body '{body.name}' has {', '.join(body.joint_names)}"
        )
    return values[:, [recording.joint_names.index(name) for name in body.joint_names]]


def _charted(
    tree: Body, time: np.ndarray, observations: Tensor, observation: Observation, turning: bool
) -> tuple[Body, tuple[str, ...]]:
    """The tree in charts that suit the recording, if they may be chosen, and what to say of them."""
    if all(len(link.joint.chart) < 2 for link in tree.links):
        return tree, ()

    def path(tree: Body) -> np.ndarray | None:
        numbers, sd = tree.parameters(), _angle_sd(tree, observations, observation)
        candidates = joint_angle_candidates(tree, time, observations, observation, numbers, sd)
        return None if candidates is None else candidates[len(candidates) // 2]

    tree, said = chosen(tree, path) if turning else (tree, [])
    steep = [] if (own := path(tree)) is None else poles(tree, own)
    for line in steep:
        warnings.warn(line, stacklevel=3)
    return tree, (*said, *steep)


def _angle_sd(body: ArticulatedBody, observations: Tensor, observation: Observation) -> np.ndarray:
    """What one row tells of each angle, sd (K,) in rad, by the jitter of the columns."""
    rows = observations.numpy()
    if observation.encoders:
        return np.maximum(jitter(rows[:, observation.part(observation.encoders)]), 1e-6)
    if (pixels := observation.pixels) is not None:
        # What lasts of a tracker's errors is no jitter, and several pixels as a rule.
        noise = pixels.resolution * np.maximum(sensor_jitter(observation, pixels, rows), DEFAULT_BIAS)
    elif observation.keypoints is not None:
        noise = sensor_jitter(observation, observation.keypoints, rows)
    else:
        return np.ones(body.num_joints)
    return np.clip(1.5 * noise.max() / dynamics_for(body).levers(body.parameters()).numpy(), 1e-6, 1.0)


def sensor_jitter(observation: Observation, sensor: Sensor, rows: np.ndarray) -> np.ndarray:
    """Noise sd (n,) of a sensor's columns in rows (T, O); all axes of a point have the same, that of the point."""
    columns = rows[:, observation.part(sensor)]
    if not isinstance(sensor, Keypoints | Pixels):
        return jitter(columns)
    axes = sensor.shape[-1]
    return point_jitter(columns.reshape(len(columns), -1, axes)).repeat(axes)


def _start_values(
    body: ArticulatedBody, time: np.ndarray, observations: Tensor, observation: Observation
) -> dict[str, object]:
    """Observation noise and the first frame's angles and velocities."""
    numbers, dynamics = body.parameters(), dynamics_for(body)
    reach = dynamics.reach(numbers).item()
    rows = observations.numpy()
    values: dict[str, Any] = {}
    for sensor in observation.sensors:
        values |= sensor.started(sensor_jitter(observation, sensor, rows), reach)
    sd = values["emission.angle_scale"] if observation.encoders else _angle_sd(body, observations, observation)
    # Slack in the kinematics, well under what can be seen of it.
    values["noise.angle"] = float(np.clip(0.1 * np.min(sd), 1e-6, 1e-3))
    values["noise.velocity"] = 1e-3  # rad/s, slack as well
    candidates = joint_angle_candidates(body, time, observations, observation, numbers, sd)
    if candidates is not None:
        middle = candidates[len(candidates) // 2]
        last = max(1, int(np.flatnonzero(np.isfinite(rows).any(1))[-1]))
        known = slice(last + 1)  # rows after the last one seen only predict
        speed = np.abs(np.diff(middle[known], axis=0) / np.diff(time[known])[:, None])
        values["initial.angle"] = middle[0]
        values["initial.angle_scale"] = 0.5
        values["initial.velocity_scale"] = np.maximum(2 * np.quantile(speed, 0.95, axis=0), 0.5)
        if (pixels := observation.pixels) is not None:
            seen = dynamics.keypoints(torch.as_tensor(middle), numbers)[:, list(pixels.sites)]
            values |= started(pixels, rows[:, observation.part(pixels)], seen.numpy())
        if (keypoints := observation.keypoints) is not None:
            # What rigid links cannot explain is observation noise to begin with.
            sites = keypoints.tracked(dynamics.keypoints(torch.as_tensor(middle), numbers)).numpy()
            off = observation.points(rows) - sites
            misfit = np.array([robust_sd(seen_vectors(each)) for each in off.swapaxes(0, 1)])
            least = point_jitter(observation.points(rows))
            usual = keypoints.defaults(reach)["emission.keypoint_scale"].numpy()  # of those that no row shows
            values["emission.keypoint_scale"] = np.where(misfit > 0, np.clip(misfit, least, 0.3 * reach), usual)
            if keypoints.confidence is not None:
                values["emission.confidence_drop"] = confidence_drop(off, keypoints.confidence.drop.numpy())
    return values


def confidence_drop(off: np.ndarray, drop: np.ndarray) -> np.ndarray:
    """Start of δ of each keypoint, (P,), from misfits (T, P, d) and the drops of their confidence (T, P).

    Where doubtful rows are ``OUTLIER_RATIO`` times as far off as sure ones they start as outliers, δ = log(ratio) per
    drop: as good ones the mode would run through them, and the search for parameters end there. What is noisier by less
    starts at 0, for it may be an effect that a diagnosis names.
    """
    start = np.zeros(drop.shape[1])
    for p, (size, d) in enumerate(zip(np.linalg.norm(off, axis=-1).T, drop.T, strict=True)):
        low = np.isfinite(size) & (d > 0.5)
        high = np.isfinite(size) & (d <= 0.5)
        if low.any() and high.any() and np.median(size[low]) > OUTLIER_RATIO * np.median(size[high]) > 0:
            ratio = np.median(size[low]) / np.median(size[high])
            start[p] = np.log(ratio) / (np.median(d[low]) - np.median(d[high]))
    return start


def sufficient_substeps(model: ArmModel, observations: Tensor, share: float = 0.1) -> int:
    """Smallest of ``SUBSTEPS`` whose error stays under ``share`` of what can be noticed; the last one, if none does.

    The error is the difference to twice as many sub-steps, over one row, along the smoothed
    inverse kinematics. What can be noticed: an angle of "noise.angle" plus a tenth of the observation
    noise. "euler" keeps one step, as printed: its error is part of that model.
    """
    if model.integrator == "euler":
        return 1
    paths = model.initial_paths(observations)
    path = paths[len(paths) // 2]
    rows = torch.arange(1, model.num_steps)
    limit = model.parameters["noise.angle"] + 0.1 * torch.as_tensor(joint_angle_sd(model, model.body_parameters()))
    ends: dict[int, Tensor] = {}

    def angles(count: int) -> Tensor:
        """At the ends of all rows, in so many sub-steps."""
        if count not in ends:
            _, ends[count], _ = model.split(model.in_substeps(count).transition_mean(path[:-1], rows))
        return ends[count]

    with torch.no_grad():
        for substeps in SUBSTEPS:
            error = (angles(substeps) - angles(2 * substeps)).abs()
            # A few frames of wild inverse kinematics must not decide.
            if bool((torch.quantile(error, 0.99, dim=0) <= share * limit).all()):
                break
    return substeps

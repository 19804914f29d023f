"""Whether a fitted model explains its recording, and with torques that such a body can have; if not, from which row on.

Residuals are compared with the sensor's own noise. With r_p(t) the distance of what was observed of keypoint p from
what the mode predicts, σ_p the larger of its track's jitter (:mod:`invdyn.recordings.jitter`) and of a stated noise,
and L the body's reach, a row is not explained where

    r_p(t) > max(`TIMES` σ_p, `SHARE` L)        an encoder, with r in rad: max(`TIMES` σ, `ANGLE`)

A fitted noise would explain anything; jitter knows nothing of the model. Reported are keypoints of which `ROWS` of the
rows, or a `RUN` of them, are not explained: the body has other lengths, leaves the plane, or is another one.

A joint's torque is bounded by its motor's limits, where the body's file states them. For others the bound is that of a
strong person, scaled to animals: of a limb of length L whose parts of mass m_i lie r_i from its base,

    τ_max = `STRONGEST` · max(1, .6 m / L) · g Σ m_i r_i

Muscles' forces grow with their cross-section, L², their torques with L³, and the weight's with L⁴. An arm of 3.5 kg and
.6 m, which needs 10 N·m to be stretched out, gets 150 N·m. Maximal isometric moments of the shoulder were 40 to 115
N·m (Holzbaur, Delp, Gold & Murray 2007, J. Biomech. 40, 2442–2449).

Shapes: T rows, P keypoints, K joints.
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.posterior.initialise import Problem, sensor_jitter
from invdyn.models import ArmModel, Body, Encoders, Keypoints

TIMES, SHARE, ANGLE = 5.0, 0.08, 0.1
ROWS, RUN = 0.05, 5
STRONGEST, LIMB, GRAVITY = 15.0, 0.6, 9.81
FRICTION = 0.2
"""Of a joint's weight that friction may have, where no torque is stated to act."""
PAST_MOTOR = 1.25
"""Times its limit that a motor's joint, whose torque has friction in it, may have."""


def unexplained(problem: Problem, path: Tensor) -> list[str]:
    """Lines on what the mode ``path`` (T, D) of the problem's model does not explain, the worst first; else none."""
    model = problem.model
    _, angle, _ = model.split(path)
    sites = model.observation_model.view(path, torch.arange(len(path))).points.detach()
    rows = problem.observations.numpy()
    lines: list[tuple[float, str]] = []
    for sensor in model.observation.sensors:
        noise = sensor_jitter(model.observation, sensor, rows)
        if isinstance(sensor, Keypoints):
            points = model.observation.points(rows)
            off = np.linalg.norm(points - sensor.tracked(sites).numpy(), axis=-1)
            noise = noise.reshape(points.shape[1:])[:, 0]
            reach = model.dynamics.reach(model.body_parameters()).item()
            names, unit, least = sensor.coords["keypoint"], problem.recording.length_unit, SHARE * reach
        elif isinstance(sensor, Encoders):
            off = np.abs(rows[:, model.observation.part(sensor)] - angle.detach().numpy())
            names, unit, least = model.body.joint_names, "rad", ANGLE
        else:
            continue
        for name, own, sd in zip(names, off.T, noise, strict=True):
            limit = max(TIMES * sd, least)
            if (begin := _begins(own > limit, np.isfinite(own))) is not None:
                bad = own > limit
                large = float(np.median(own[bad]))
                half = (int(bad.sum()) + 1) // 2
                counted = "1 row" if half == 1 else f"{half} rows"
                times = f", {large / sd:.2g} times its own jitter" if sd > 0 else ""
                words = (
                    f"from {_row(problem, begin)} on {name} is off what this body can do, by {large:.2g} {unit} or "
                    f"more in {counted}{times}: it was lost, leaves the plane, changes its "
                    "lengths, or is another one"
                )
                lines.append((large / least, words))
    torque = model.net_torque(path).detach().numpy()
    lines += _too_strong(problem, torque)
    if _stated_zero(model):
        lines += _not_zero(problem, torque, angle)
    return [f"not explained: {line}" for _, line in sorted(lines, reverse=True)]


def _too_strong(problem: Problem, torque: np.ndarray) -> list[tuple[float, str]]:
    """Lines on joints whose torque (T, K) is beyond what their motor, or any limb, can give; with how far beyond."""
    body = problem.model.body
    if not isinstance(body, Body):
        return []
    strength = _strength(problem.model) if problem.recording.length_unit == "m" else np.inf
    lines = []
    for name, parts, own in zip(body.joint_names, body.joint_parts, torque.T, strict=True):
        if (motor := parts.motor) is not None and motor.limited:
            over = np.maximum(own / motor.high if motor.high > 0 else 0.0, own / motor.low if motor.low < 0 else 0.0)
            limit, whose = PAST_MOTOR, f"its motor gives {motor.low:.3g} to {motor.high:.3g} N·m"
        elif np.isfinite(strength):
            over, limit = np.abs(own) / strength, 1.0
            whose = f"no limb of this size is known to exceed {strength:.2g} N·m"
        else:
            continue
        if over.max() > limit:
            begin = int((over > limit).argmax())
            largest = f"{np.abs(own).max():.3g} N·m"
            words = f"from {_row(problem, begin)} on the torque of {name} reaches {largest}, and {whose}"
            lines.append((float(over.max() / limit), words))
    return lines


def _stated_zero(model: ArmModel) -> bool:
    """Whether all torques are stated, and stated to be zero."""
    return model.command is not None and not bool(model.command.any())


def _not_zero(problem: Problem, torque: np.ndarray, angle: Tensor) -> list[tuple[float, str]]:
    """Lines on joints whose torque (T, K) was stated to be zero, and is a large share of what their weight exerts."""
    model = problem.model
    load = model.dynamics.gravity_load(angle, model.body_parameters()).detach().numpy()
    lines = []
    for name, own, weight in zip(model.body.joint_names, torque.T, load.T, strict=True):
        size, limit = np.sqrt((own**2).mean()), FRICTION * np.sqrt((weight**2).mean())
        if 0 < limit < size:
            begin = int((np.abs(own) > limit).argmax())
            words = (
                f"from {_row(problem, begin)} on {name} has a torque of {size:.2g} N·m rms, where none is stated, and "
                f"its weight exerts {limit / FRICTION:.2g}: something holds or moves it, or the body is another one"
            )
            lines.append((float(size / limit), words))
    return lines


def _strength(model: ArmModel) -> float:
    """τ_max, N·m, of a body that is not said to be a robot; see the top."""
    numbers = model.body_parameters()
    ways = torch.eye(numbers.gravity.shape[-1], dtype=numbers.gravity.dtype)
    straight = numbers.gravity.new_zeros(model.body.num_joints)
    loads = [model.dynamics.gravity_load(straight, numbers._replace(gravity=GRAVITY * way)) for way in ways]
    hold = torch.stack(loads).norm(dim=0).max().item()
    return STRONGEST * max(1.0, LIMB / model.dynamics.reach(numbers).item()) * hold


def _begins(bad: np.ndarray, seen: np.ndarray) -> int | None:
    """The first row of those that are ``bad`` (T,), of rows that are ``seen``, where they are too many; else None."""
    rows = np.flatnonzero(seen)
    own = bad[rows]
    runs = np.convolve(own, np.ones(RUN), "valid") if len(own) >= RUN else np.zeros(1)
    if own.sum() <= ROWS * len(own) and runs.max() < RUN:
        return None
    return int(rows[own.argmax()])


def _row(problem: Problem, row: int) -> str:
    return f"row {row + 1} ({problem.recording.time[row]:.6g} s)"

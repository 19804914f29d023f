"""Filter-and-differentiate: the classical inverse dynamics of biomechanics, to compare with.

    angles → zero-phase Butterworth → θ, θ̇, θ̈ by central differences → τ = D(θ) θ̈ + h(θ, θ̇) + c(θ)

Winter (2009), "Biomechanics and motor control of human movement", 4th ed., §3.4. The filter is of second
order and run forwards and backwards. Without a given cut-off it comes from Winter's residual analysis.
R(f) is the rms of what a filter of cut-off f takes away. It falls on a straight line where the filter takes away noise
alone. The line's value at f = 0 estimates the rms of all the noise, and the cut-off is where R equals it.

Gaps are bridged by straight lines for the filter's sake only: where one is longer than half a period of
the cut-off, and at the ends, the result is NaN. One path, no uncertainty, no evidence.

Shapes: T frames, K joints; time (T,) s, angles (T, K) rad.
"""

import math
from dataclasses import replace

import arviz as az
import numpy as np
import torch
from torch import Tensor

from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.posterior import to_inference_data
from invdyn.models import ArmModel, Body, BodyParameters, Observation
from invdyn.models.articulated.start import base_path, joint_angle_sd, on_base_at_rest
from invdyn.models.dynamics.interface import Dynamics
from invdyn.models.inverse_kinematics import row_poses
from invdyn.models.kinematics import joint_angle_candidates, link_angles, within_half_a_turn
from invdyn.recordings import InputError

MIN_FRAMES = 10
"""Frames that the filter needs to reflect at its ends."""


def joint_angles(
    time: np.ndarray, observations: Tensor, observation: Observation, body: BodyParameters
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles (T, K), rad, unwrapped, gaps bridged by straight lines; and the gaps' lengths (T, K), s.

    A length is 0 where the angle was seen, and inf in a gap that is open at an end of the recording.
    Raises InputError when a link is never seen.
    """
    links, wrapped = link_angles(observations, observation, body)
    absolute, gap = np.empty_like(links), np.empty_like(links)
    for k in range(links.shape[1]):
        seen = np.flatnonzero(np.isfinite(links[:, k]))
        if not len(seen):
            raise InputError(
                f"link {k + 1} of the body is never seen: filter-and-differentiate needs both ends of every link, "
                "or encoders; use another method"
            )
        angle = links[seen, k]
        # Whole turns, where the sensor cannot count them.
        for i in np.flatnonzero(wrapped[seen, k])[1 if wrapped[seen[0], k] else 0 :]:
            angle[i] += 2 * np.pi * np.round((angle[i - 1] - angle[i]) / (2 * np.pi))
        absolute[:, k] = np.interp(time, time[seen], angle)
        gap[:, k] = _gaps(time, np.isfinite(links[:, k]))
    # A joint's angle is the difference of two links', and has the gaps of both.
    gap[:, 1:] = np.maximum(gap[:, 1:], gap[:, :-1])
    return within_half_a_turn(np.diff(absolute, axis=1, prepend=0.0), wrapped), gap


def tree_angles(model: ArmModel, body: Body, observations: Tensor) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates (T, K) of a tree by inverse kinematics row by row, and gaps (T, K), s, as `joint_angles` has them.

    A row that is not wholly seen is a gap of all joints. Raises InputError where none is.
    """
    time, numbers = model.time.numpy(), model.body_parameters()
    sd = joint_angle_sd(model, numbers)
    near = joint_angle_candidates(body, time, observations, model.observation, numbers, sd)
    if near is None:
        raise InputError("neither a keypoint nor an encoder is ever seen: filter-and-differentiate needs them")
    poses, whole = row_poses(body, observations, model.observation, numbers, sd, near[len(near) // 2])
    seen = np.flatnonzero(whole)
    if not len(seen):
        raise InputError("no row is wholly seen, as filter-and-differentiate needs it: use another method")
    poses = np.stack([np.interp(time, time[seen], column[seen]) for column in poses.T], -1)
    return poses, np.broadcast_to(_gaps(time, whole)[:, None], poses.shape)


def _gaps(time: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Lengths (T,) of the gaps that rows lie in, s: 0 where they were ``seen`` (T,), inf at an open end."""
    edges = np.concatenate([[-np.inf], time[seen], [np.inf]])
    place = np.searchsorted(time[seen], time, side="right")
    return np.where(seen, 0.0, edges[np.minimum(place + 1, len(edges) - 1)] - edges[place])


def derivatives(
    time: np.ndarray, angle: np.ndarray, cutoff: float | np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Filtered angles, velocities and accelerations, each (T, K); ``cutoff`` in Hz, one or (K,).

    Raises InputError for too few frames, or a cut-off that is not between 0 and half the frame rate.
    """
    grid, interval = _regular(time)
    cutoffs = np.broadcast_to(np.asarray(cutoff, dtype=float), angle.shape[1:])
    if len(grid) < MIN_FRAMES:
        raise InputError(f"filter-and-differentiate needs at least {MIN_FRAMES} frames, got {len(grid)}")
    if not ((cutoffs > 0) & (cutoffs < 0.5 / interval)).all():
        raise InputError(f"expected a cut-off between 0 and {0.5 / interval:g} Hz, half the frame rate, got {cutoff}")
    q = np.stack([_low_passed(_onto(grid, time, a), f, interval) for a, f in zip(angle.T, cutoffs, strict=True)], -1)
    qd = np.gradient(q, interval, axis=0)
    qdd = np.gradient(qd, interval, axis=0)
    q, qd, qdd = (np.stack([_onto(time, grid, column) for column in x.T], -1) for x in (q, qd, qdd))
    return q, qd, qdd


def winter_cutoff(time: np.ndarray, angle: np.ndarray, count: int = 60) -> np.ndarray:
    """Cut-offs (K,), Hz, by Winter's residual analysis of angles (T, K)."""
    grid, interval = _regular(time)
    if len(grid) < MIN_FRAMES:
        raise InputError(f"filter-and-differentiate needs at least {MIN_FRAMES} frames, got {len(grid)}")
    half = 0.5 / interval
    frequencies = np.linspace(0.01, 0.9, count) * half
    straight = frequencies > half / 2
    cutoffs = []
    for column in angle.T:
        column = _onto(grid, time, column)
        residual = np.array([np.sqrt(np.mean((column - _low_passed(column, f, interval)) ** 2)) for f in frequencies])
        noise = np.polynomial.Polynomial.fit(frequencies[straight], residual[straight], 1)(0.0)
        below = residual <= noise
        cutoffs.append(frequencies[below.argmax() if below.any() else -1])
    return np.array(cutoffs)


def _low_passed(column: np.ndarray, cutoff: float, interval: float) -> np.ndarray:
    from scipy.signal import butter, filtfilt  # it takes half a second to import, and no other method needs it

    return filtfilt(*butter(2, cutoff, fs=1 / interval), column)


def _regular(time: np.ndarray) -> tuple[np.ndarray, float]:
    """A grid of the median step, which is ``time`` itself if that is regular to a hundredth; and the step, s."""
    interval = float(np.median(np.diff(time)))
    if np.abs(np.diff(time) - interval).max() < 0.01 * interval:
        return time, interval
    return np.linspace(time[0], time[-1], round((time[-1] - time[0]) / interval) + 1), interval


def _onto(grid: np.ndarray, time: np.ndarray, column: np.ndarray) -> np.ndarray:
    return column if grid is time else np.interp(grid, time, column)


def inverse_dynamics(
    dynamics: Dynamics, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, body: BodyParameters
) -> np.ndarray:
    """Net joint torques (T, K), N·m."""
    angles, velocities, accelerations = (torch.as_tensor(x.copy()) for x in (q, qd, qdd))
    return dynamics.inverse(angles, velocities, accelerations, body).numpy()


@torch.no_grad()
def differentiate(
    problem: Problem,
    *,
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    cutoff: float | None = None,
) -> az.InferenceData:
    """Torques by filter-and-differentiate: one chain, one draw, no evidence (NaN).

    Args are those of :func:`.smc.smc`, of which options and start are not used, and:
        problem: of the model only the body and the commands are used.
        cutoff: Hz; by residual analysis, joint by joint, when not given.

    Raises InputError for fewer than ten frames, a link that is never seen, an impossible cut-off, or a body
    that is neither a chain in the plane nor a tree in space.
    """
    model, time = problem.model.to(dtype=torch.float64), problem.recording.time
    body, rows, base = model.body_parameters(), problem.observations, base_path(model, problem.observations)
    if base is not None:
        rows = on_base_at_rest(model.observation, rows, base[:, : model.body.dimensions])
    if model.body.is_chain:
        angle, gap = joint_angles(time, rows, model.observation, body)
    elif isinstance(model.body, Body):
        angle, gap = tree_angles(model, model.body, rows)
    else:
        raise InputError(
            f"filter-and-differentiate reads angles of a chain in the plane or a tree in space, got body "
            f"'{model.body.name}': use another method"
        )
    cutoffs = winter_cutoff(time, angle) if cutoff is None else np.full(angle.shape[1], cutoff)
    q, qd, qdd = derivatives(time, angle, cutoffs)
    for x in (q, qd, qdd):
        x[gap > 0.5 / cutoffs] = math.nan
    torque = torch.as_tensor(inverse_dynamics(model.dynamics, q, qd, qdd, body))
    if model.command is not None:
        torque = torque - model.command
    z = [model.torque.path(torque, model.time)]
    if model.base is not None and base is not None:
        load = model.dynamics.uniform_load(torch.as_tensor(q), model.base.parted(base)[2], body)
        z = [model.torque.path(torque - load, model.time), base]
    path = torch.cat([*z, torch.as_tensor(q), torch.as_tensor(qd)], -1)
    if progress is not None:
        progress(1, 1, "differentiate")
    with seeded(seed):
        return to_inference_data(
            replace(problem, doubted=False),  # one path says nothing of bodies that may differ
            path[None, None],
            method="differentiate",
            seed=seed,
            settings={**(settings or {}), "cutoff": cutoffs.tolist()},
        )

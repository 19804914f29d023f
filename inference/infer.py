"""The main job: from a recording and a body to the posterior of the torques."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import arviz as az

from invdyn.inference.initialise import Problem, arm_problem
from invdyn.inference.marginal_likelihood import Free, fit
from invdyn.inference.marginalise import over_bodies
from invdyn.inference.smc import Progress, SMCOptions, smc
from invdyn.models import Body, Learned, TorqueProcess
from invdyn.recordings import InputError, Recording, Truth

METHODS: dict[str, Callable[..., az.InferenceData]] = {
    "smc": partial(smc, guide="controlled"),
    "bootstrap": partial(smc, guide="bootstrap"),
}


def free_parameters(problem: Problem, given: Sequence[str] = (), learn_lengths: bool = False) -> list[Free]:
    """Parameters to fit when not ``given``: σ_y, the torque process, and what of the body is to be learned.

    Not the dynamics' own noise ε: white noise on a velocity is a white torque by another name, and where it is
    free it takes torque away from τ (on the DFKI arm the evidence likes that, and the error doubles).
    """
    wanted = [
        Free("torque.scale"),
        Free("torque.decay", sd=1.0),
        Free("torque.lengthscale", sd=1.0),
        # One σ_y as in the paper; its ratio between keypoints is that of their misfits at the start.
        Free("emission.keypoint_scale", tied=True),
        Free("emission.confidence_slope", tied=True),
        Free("emission.angle_scale", tied=True),
        Free("emission.df", sd=1.0),
    ]
    body = problem.model.body
    for quantity in ("length", "mass", "com", "inertia"):
        entries = tuple(k for k, link in enumerate(body.links) if isinstance(getattr(link, quantity), Learned))
        if learn_lengths and quantity == "length":
            entries = tuple(range(body.num_joints))
        if entries:
            wanted.append(Free(f"body.{quantity}", sd=0.3, entries=entries))
    return [f for f in wanted if f.name in problem.model.parameters and f.name not in given]


def infer(
    recording: Recording,
    body: Body,
    *,
    method: str = "smc",
    num_filters: int = 64,
    num_particles: int = 100,
    num_draws: int = 4,
    seed: int = 0,
    settings: Mapping[str, object] | None = None,
    torque: TorqueProcess | None = None,
    integrator: str = "rk4",
    substeps: int | None = None,
    family: str = "gaussian",
    learn_lengths: bool = False,
    truth: Truth | None = None,
    passive: bool = False,
    hide_torque: bool = False,
    progress: Progress | None = None,
) -> az.InferenceData:
    """Infer the torques that moved a recorded body.

    Args:
        recording: planar keypoints, encoders, or both.
        body: in the recording's length unit; its priors and uncertainties are integrated out, its
            learned scalars learned.
        method: a key of ``METHODS``.
        num_filters, num_particles, num_draws: M, N, and smoothed trajectories per filter.
        seed: same seed, same result.
        settings: parameters by dotted name that are known, such as {"torque.scale": 20.0}; the noise
            scales, λ, σ_τ and σ_y that are not given are fitted by marginal likelihood.
        torque, integrator, substeps, family: see :func:`arm_problem`.
        learn_lengths: learn the links' lengths, from the median distances on.
        truth: torques to compare with.
        passive: no torque acts (what is inferred is what acts all the same: friction, drive).
        hide_torque: ignore the recording's commands.
        progress: called with (done, total, what).

    Returns:
        InferenceData as :mod:`.posterior` lays it out.

    Raises:
        InputError: the recording does not fit the body, or an unknown method or parameter.
    """
    if method not in METHODS:
        raise InputError(f"expected a method among {', '.join(METHODS)}, got {method!r}")
    body = body.with_uncertainty()
    problem = arm_problem(
        recording,
        body,
        torque=torque,
        integrator=integrator,
        substeps=substeps,
        family=family,
        parameters=settings,
        learn_lengths=learn_lengths,
        hide_torque=hide_torque,
        passive=passive,
        truth=truth,
    )
    free = free_parameters(problem, tuple(settings or ()), learn_lengths)
    report = None if progress is None else lambda done, total: progress(done, total, "fit")
    fitted = fit(problem.model, problem.observations, free, progress=report)
    problem = Problem(fitted.model, problem.observations, recording, problem.truth)
    record = {
        "fitted": {f.name: fitted.model.parameters[f.name].tolist() for f in free},
        "fit_converged": fitted.converged,
        "integrator": problem.model.integrator,
        "substeps": problem.model.substeps,
        "family": family,
        "torque_process": type(problem.model.torque).__name__,
    }
    options = SMCOptions(num_filters, num_particles, num_draws)
    run = METHODS[method]
    if body.has_priors:
        run = partial(over_bodies, run)
    return run(problem, options=options, start=fitted.path, seed=seed, settings=record, progress=progress)

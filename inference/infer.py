"""The main job: from a recording and a body to the posterior of the torques."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path

import arviz as az

from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.memory import check_memory
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.renamed_methods import present_name
from invdyn.inference.task import prepare
from invdyn.models import ArticulatedBody, TorqueProcess
from invdyn.recordings import InputError, Recording, SiteForce, Truth


def infer(
    recording: Recording,
    body: ArticulatedBody,
    *,
    method: str = "smc",
    num_filters: int = 64,
    num_particles: int = 100,
    num_draws: int = 4,
    seed: int = 0,
    settings: Mapping[str, object] | None = None,
    torque: TorqueProcess | Sequence[TorqueProcess] | None = None,
    integrator: str = "rk4",
    substeps: int | None = None,
    family: str = "gaussian",
    learn_lengths: bool = False,
    truth: Truth | None = None,
    passive: bool = False,
    hide_torque: bool = False,
    progress: Progress | None = None,
    device: str = "cpu",
    filters_per_task: int | None = None,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    learn_cameras: Sequence[str] = (),
    forces: Sequence[SiteForce] = (),
) -> az.InferenceData:
    """Infer the torques that moved a recorded body.

    Args:
        recording: keypoints, encoders, or both; of several cameras (:class:`.cameras.Filmed`) their pixels.
        body: in the recording's length unit; its priors and uncertainties are integrated out, its
            learned scalars learned. "differentiate" takes nominal values, "particle-gibbs" the most probable ones.
        method: a key of ``METHODS``.
        num_filters, num_particles, num_draws: M, N, and smoothed trajectories per filter.
        seed: same seed, same result.
        settings: parameters by dotted name that are known, such as {"torque.scale": 20.0}. The other noise scales, λ
            and σ_τ are fitted by marginal likelihood. "vsmc" learns their posterior and that of learned lengths and
            masses, and integrates them out.
        torque: process of the torque, at its fitted parameters; or several, which are then the prior in equal parts,
            with parameters that are uncertain: draws of each are in proportion to its evidence (of methods without
            evidence, "vsmc" and variational ones all are of the most probable process). By default those of
            :func:`invdyn.models.default_torques`.
        integrator, substeps, family: see :func:`arm_problem`.
        learn_lengths: learn the links' lengths, from the median distances on.
        truth: torques to compare with.
        passive: no torque acts. The inferred torque is then that of friction and other effects; where it is a fifth
            of what the weight exerts, or more, a warning says so.
        hide_torque: ignore the recording's commands.
        progress: called with (done, total, what).
        device: of the particle filters, "cpu" or "cuda".
        filters_per_task: see :class:`SMCOptions`.
        executor: any ``concurrent.futures`` executor, whose workers share the filters or, where the body is
            uncertain, its draws; the result is the same to the bit. None: this process.
        checkpoint: folder of this run, made when missing: the fit, the guide and the filters that are done are kept
            there, so that the same call continues where it was interrupted.
        learn_cameras: what is not known of a film's cameras, see :func:`arm_problem`.
        forces: known ones on keypoints, which add to the torques; :func:`invdyn.recordings.read_forces`.

    Returns:
        InferenceData as :mod:`.posterior` lays it out.

    Raises:
        InputError: the recording does not fit the body, an unknown method or parameter, a device that is not there,
            more filters than memory holds, or a checkpoint of another run.
        LostWork: workers died and could not be replaced; the message names the filters that are missing.
    """
    method = present_name(method)
    if method not in METHODS:
        raise InputError(f"expected a method among {', '.join(METHODS)}, got {method!r}")
    options = SMCOptions(num_filters, num_particles, num_draws, device=device, filters_per_task=filters_per_task)
    check_memory(recording.num_frames, body.num_joints, options, (method,))
    task = prepare(
        recording,
        body,
        options=options,
        seed=seed,
        settings=settings,
        truth=truth,
        learn_lengths=learn_lengths,
        report=stage(progress, "fit"),
        torque=torque,
        integrator=integrator,
        substeps=substeps,
        family=family,
        hide_torque=hide_torque,
        passive=passive,
        checkpoint=checkpoint,
        learn_cameras=learn_cameras,
        forces=forces,
    )
    return task.run(method, progress, executor, learn=True)

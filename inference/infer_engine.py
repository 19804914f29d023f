"""Torques, excitations and contact forces of anything that MuJoCo loads, from a recording."""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from typing import Any

import arviz as az
import numpy as np

from invdyn.inference.execution.progress import Progress, stage
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.memory import check_memory
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.scales_on_linearisation import fit_scales
from invdyn.inference.methods.registry import DISTRIBUTED, METHODS
from invdyn.inference.posterior.engine_contents import hidden
from invdyn.inference.posterior.engine_problem import EngineProblem, engine_problem
from invdyn.inference.renamed_methods import present_name
from invdyn.inference.smoothing.linearised import gaussian_smoother
from invdyn.models import Scene, TorqueProcess
from invdyn.models.engine.drives import Drive
from invdyn.models.torques import OrnsteinUhlenbeck
from invdyn.recordings import InputError, Recording, Truth

ENGINE_METHODS = ("smc", "bootstrap", "laplace", "particle-gibbs")
"""Methods that need no slopes of the dynamics."""
FILTERS, PARTICLES, DRAWS = 16, 200, 8
"""Default sizes: a step of MuJoCo takes a hundred times as long as one of the compiled arms."""


def infer_engine(
    recording: Recording,
    scene: Scene,
    *,
    method: str = "smc",
    num_filters: int = FILTERS,
    num_particles: int = PARTICLES,
    num_draws: int = DRAWS,
    seed: int = 0,
    settings: Mapping[str, Any] | None = None,
    drive: str | Drive | Sequence[Drive] = "auto",
    torque: TorqueProcess | None = None,
    family: str = "gaussian",
    truth: Truth | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    reasons: Sequence[str] = (),
) -> az.InferenceData:
    """Infer what moved a recorded MuJoCo model: torques or excitations, and the forces of its contacts.

    Args:
        recording: keypoints, encoders, or both, in m and rad.
        scene: the model, :meth:`.Scene.of` a file.
        method: one of ``ENGINE_METHODS``; where the filters of "smc" cannot follow, the answer is that of "laplace", if
            this settled, and it says so.
        num_filters, num_particles, num_draws: M, N, and smoothed trajectories per filter.
        seed: same seed, same result, for any number of threads or workers.
        settings: parameters by dotted name that are known. Otherwise the scale of the drive and that of each sensor's
            noise are fitted by marginal likelihood.
        drive: what is not known: "joints" (torques at hinges and slides), "actuators" (the file's own), "wrench:BODY",
            or drives; "auto" takes the actuators of a file with muscles, and else joints.
        torque: process of the drive; Ornstein–Uhlenbeck by default.
        family: of the observation noise.
        truth: torques to compare with.
        progress: called with (done, total, what).
        executor: any ``concurrent.futures`` executor, whose workers share the filters.
        reasons: why MuJoCo's engine was taken, for the summary.

    Returns InferenceData as :mod:`.engine_contents` lays it out.

    Raises InputError where the recording does not fit, for an unknown method or parameter; BodyError for a drive that
    the model does not have; Diverged for one whose simulation runs away along the recording.
    """
    method = present_name(method)
    if method not in ENGINE_METHODS:
        raise InputError(f"expected a method among {', '.join(ENGINE_METHODS)} for MuJoCo's engine, got {method!r}")
    options = SMCOptions(num_filters, num_particles, num_draws)
    check_memory(recording.num_frames, scene.num_joints, options, (method,))
    given = dict(settings or {})
    problem = engine_problem(
        recording,
        scene,
        drive=drive,
        torque=torque,
        family=family,
        parameters=given,
        truth=truth,
        reasons=reasons,
    )
    report = stage(progress, "fit")
    smoother = gaussian_smoother(problem.model, problem.observations)
    free = free_scales(problem, tuple(given))
    model, smoother, settled = fit_scales(problem.model, problem.observations, free, smoother, report)
    record: dict[str, Any] = {
        "fitted": {each.name: model.parameters[each.name].tolist() for each in free},
        "fit_converged": settled,
        "integrator": "MuJoCo",
        "torque_process": type(torque or OrnsteinUhlenbeck()).__name__,
        "family": family,
    }
    if doubt := misfit(problem, smoother.path.numpy(), model):
        record["in_doubt"] = [doubt]
    places: dict[str, Any] = {"executor": executor} if method in DISTRIBUTED else {}
    places |= {"or_linearised": True} if method == "smc" else {}
    fitted = EngineProblem(model, problem.observations, recording, problem.truth, problem.reasons, name=problem.name)
    idata = METHODS[method](
        fitted, options=options, start=smoother.path, seed=seed, settings=record, progress=progress, **places
    )
    if lines := hidden(model, idata):
        idata.attrs["hidden"] = "\n".join(lines)
    return idata


def free_scales(problem: EngineProblem, given: Sequence[str]) -> list[Free]:
    """What is fitted when not ``given``: the drive's scale, a factor of all numbers, and each kind of sensor's noise.

    A drive that is squashed into limits has a scale by itself, as its prior is even over them.
    """
    names = [name for name in problem.model.parameters if name.startswith("emission.") and name.endswith("_scale")]
    drives = problem.model.inputs.drives
    unlimited = not any(np.isfinite(getattr(each, "width", ())).any() for each in drives)
    names += ["torque.scale"] if unlimited else []
    return [Free(name, tied=True) for name in names if name not in given]


def misfit(problem: EngineProblem, path: np.ndarray, model: Any) -> str:
    """A line where the fitted noise is far above the columns' own jitter: the model does not explain the rows."""
    for name in ("emission.keypoint_scale", "emission.angle_scale"):
        if name not in model.parameters:
            continue
        before, after = problem.model.parameters[name], model.parameters[name]
        if bool((after > 4 * before).any()):
            return (
                f"the fit needs {name} {float((after / before).max()):.1f} times the rows' own jitter: the model does "
                "not explain this recording; look at its masses, lengths and sites"
            )
    return ""

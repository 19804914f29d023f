"""A recording bound to a body, its unknown parameters fitted: what any method then runs on."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint, digest
from invdyn.inference.execution.distribute import inside
from invdyn.inference.execution.progress import Progress, Report
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.fitting.marginal_likelihood import Free
from invdyn.inference.marginalise import over_bodies
from invdyn.inference.methods.registry import DISTRIBUTED, METHODS, RESUMED, WITHOUT_EVIDENCE, timed
from invdyn.inference.plausible_for_body import put_right
from invdyn.inference.posterior.explained import unexplained
from invdyn.inference.posterior.gap_branches import fit_over_gaps
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.models import ArmModel, ArticulatedBody, TorqueProcess
from invdyn.models.articulated.applied_force import AppliedForce
from invdyn.recordings import InputError, Recording, Truth

CLOCK, POSE = 0.05, {"turn": 0.05, "shift": 0.1}
"""s, rad and m: how far off the clocks and poses of cameras may be that are to be learned, standard deviations."""
DROP, MIN_DROP = "emission.confidence_drop", 0.02
"""The noise's growth between the surest and the least sure rows, and the least that its fit starts from."""


def free_parameters(problem: Problem, given: Sequence[str] = (), learn_lengths: bool = False) -> list[Free]:
    """Parameters to fit when not ``given``: σ_y, the torque process, and what of the body is to be learned.

    The dynamics' own noise ε is not among them. White noise on a velocity is a white torque by another name, and takes
    torque away from τ. On the DFKI arm the evidence likes that, and the torque's error doubles. A moving base's process
    is that of its own track (:mod:`.base_motion`): a person's torques make up for what the base does to the arm, and
    the evidence of both would take that for a base that the arm does not feel.
    """
    body, observed = problem.model.body, [name for name in problem.model.parameters if name.startswith("emission.")]
    wanted = [
        Free("torque.scale"),
        Free("torque.decay", sd=1.0),
        Free("torque.lengthscale", sd=1.0),
        # Small, so that one joint hardly tells it: one share of the joints' torques, and one rate, for all.
        Free("torque.rough_scale", tied=True),
        Free("torque.rough_decay", tied=True, sd=1.0),
        # One σ_y as in the paper; its ratio between keypoints is that of their misfits at the start.
        *(Free(name, sd=1.0) if name == "emission.df" else Free(name, tied=True) for name in observed),
    ]
    learned = dict(body.learned)
    if learn_lengths and body.is_chain:  # a tree says itself which of its lengths are learned
        learned = {"length": tuple(range(body.num_joints)), **{k: v for k, v in learned.items() if k != "length"}}
    wanted += [Free(f"body.{quantity}", sd=0.3, entries=entries) for quantity, entries in learned.items()]
    if (pixels := problem.model.observation.pixels) is not None:
        # The first camera is where it is, and its clock is right: all others' are relative to it.
        clocks, poses = (tuple(range(n, n * len(pixels.camera_names))) for n in (1, 3))
        wanted += [Free("camera.offset", sd=1.0, entries=clocks, unit=CLOCK)]
        wanted += [Free(f"camera.{way}", sd=1.0, entries=poses, unit=unit) for way, unit in POSE.items()]
        # Three numbers a camera say little of their size.
        wanted += [Free("camera.turn_scale", tied=True, sd=0.5)]
    return [f for f in wanted if f.name in problem.model.parameters and f.name not in given]


@dataclass(frozen=True)
class Task:
    """A fitted problem, and all that a method needs to run on it.

    Attributes:
        problem: with the fitted parameters.
        path: (T, D) mode, a warm start.
        options: sizes.
        seed: of every random number.
        record: fitted values and choices, kept with the result.
        checkpoint: of this run, or None.
        unfitted: the problem with the parameters that the fit began at, the centre of their prior.
        free: parameters that were fitted.
    """

    problem: Problem
    path: Tensor
    options: SMCOptions
    seed: int
    record: dict
    checkpoint: Checkpoint | None = None
    unfitted: Problem | None = None
    free: tuple[Free, ...] = ()

    def run(
        self,
        method: str,
        progress: Progress | None = None,
        executor: Executor | None = None,
        *,
        learn: bool = False,
    ) -> az.InferenceData:
        """Posterior by ``method``, a key of ``METHODS``; over draws of the body where it is uncertain.

        Parameters are the fitted ones. With ``learn`` "vsmc" has them uncertain, on a body that is not: their prior
        is that of the fit, around where it began, for around what was fitted it would count the data twice.

        With an ``executor`` its workers share the work (:mod:`.distribute`). Raises InputError when the method
        cannot do with an uncertain body, LostWork when workers that died could not be replaced.
        """
        run: Callable[..., az.InferenceData] = METHODS[method]
        places: dict[str, Any] = {"executor": executor} if method in DISTRIBUTED else {}
        places |= {"checkpoint": self.checkpoint} if method in RESUMED else {}
        problem = self.problem
        if self.problem.model.body.has_priors:
            if method == "nuts":
                raise InputError(
                    "nuts takes the body as known, and this one is uncertain: drop its priors and [uncertainty], "
                    "or use smc"
                )
            if method not in WITHOUT_EVIDENCE:
                run = timed(partial(over_bodies, partial(_by_name, method)))
                places = {"executor": executor, "checkpoint": inside(self.checkpoint, f"{method}-bodies")}
        elif method == "vsmc" and learn and self.free and self.unfitted is not None:
            problem, places = self.unfitted, {**places, "free": self.free}
        return run(
            problem,
            options=self.options,
            start=self.path,
            seed=self.seed,
            settings=self.record,
            progress=progress,
            **places,
        )


def _by_name(method: str, problem: Problem, **options: Any) -> az.InferenceData:
    """A method as workers can be sent it."""
    return METHODS[method](problem, **options)


def prepare(
    recording: Recording,
    body: ArticulatedBody,
    *,
    options: SMCOptions,
    seed: int,
    settings: Mapping[str, object] | None = None,
    truth: Truth | None = None,
    learn_lengths: bool = False,
    report: Callable[[int, int], None] | None = None,
    checkpoint: str | Path | None = None,
    torque: TorqueProcess | Sequence[TorqueProcess] | None = None,
    **binding: Any,
) -> Task:
    """Bind ``recording`` to ``body`` and fit what is not in ``settings``; of several torque processes one is chosen.

    ``binding`` are further options of :func:`.initialise.arm_problem`; ``report`` is called with (done, total) of
    the fit; ``checkpoint`` is a folder that keeps it, and what methods have done. Raises InputError when the recording
    does not fit the body, for an unknown parameter, a device that is not there, or a checkpoint of another run.
    """
    options.check()
    recording = put_right(recording, body)
    problems = [
        arm_problem(
            recording,
            body.with_uncertainty(),
            parameters=settings,
            truth=truth,
            learn_lengths=learn_lengths,
            torque=process,
            **{"moving_base": True, **binding},
        )
        for process in (torque if isinstance(torque, Sequence) else (torque,))
    ]
    frees = [free_parameters(each, tuple(settings or ()), learn_lengths) for each in problems]
    kept = None if checkpoint is None else Checkpoint(checkpoint, _fingerprint(problems, options, seed, frees))
    chosen, model, path, converged, evidence, doubts = _fitted(problems, frees, report, kept)
    problem, free = problems[chosen], frees[chosen]
    fitted = replace(problem, model=model)
    doubts = [*unexplained(fitted, path), *doubts]
    for doubt in doubts:
        warnings.warn(doubt, stacklevel=3)
    record = {
        "fitted": {f.name: model.parameters[f.name].tolist() for f in free},
        "fit_converged": converged,
        "integrator": problem.model.integrator,
        "substeps": problem.model.substeps,
        "family": problem.model.observation.family,
        "torque_process": type(problem.model.torque).__name__,
    }
    if forces := [str(effect.where[0]) for effect in model.effects if isinstance(effect, AppliedForce)]:
        record["forces"] = forces
    if doubts:
        record["in_doubt"] = doubts
    if len(problems) > 1:
        names = [type(each.model.torque).__name__ for each in problems]
        record["torque_evidence"] = dict(zip(names, evidence, strict=True))
    return Task(fitted, path, options, seed, record, kept, problem, tuple(free))


def _fitted(
    problems: Sequence[Problem], frees: Sequence[list[Free]], report: Report | None, checkpoint: Checkpoint | None
) -> tuple[int, ArmModel, Tensor, bool, list[float], list[str]]:
    """Number of the most probable problem, its model, mode, whether it converged, evidence of each, nats, and doubts.

    They come from the checkpoint, or are fitted and kept there.
    """
    if checkpoint is not None and (kept := checkpoint.load()) is not None:
        tensors, state = kept
        path, chosen = tensors.pop("path"), state["chosen"]
        model = problems[chosen].model.replace(**tensors)
        return chosen, model, path, state["converged"], state["evidence"], state["doubts"]
    fits = []
    for number, (problem, free) in enumerate(zip(problems, frees, strict=True)):
        model = problem.model
        if DROP in {f.name for f in free}:  # a logarithm is fitted, and 0 has none
            model = model.replace(**{DROP: model.parameters[DROP].clamp(min=MIN_DROP)})
        part = _share(report, number, len(problems))
        fits.append(fit_over_gaps(model, problem.observations, free, part, problem.origin))
    evidence = [float(each.log_marginal) for each, _ in fits]
    chosen = int(np.argmax(evidence))
    best, doubts = fits[chosen]
    if checkpoint is not None:
        tensors = {**best.model.parameters, "path": best.path}
        checkpoint.save(tensors, converged=best.converged, chosen=chosen, evidence=evidence, doubts=doubts)
    return chosen, best.model, best.path, best.converged, evidence, doubts


def _share(report: Report | None, number: int, count: int) -> Report | None:
    """What reports the progress of one fit of several as that of all."""
    return None if report is None else lambda done, total: report(number * total + done, count * total)


def _fingerprint(
    problems: Sequence[Problem], options: SMCOptions, seed: int, frees: Sequence[list[Free]]
) -> dict[str, Any]:
    """All that the numbers of a run depend on, but for the method: each has a folder of its own."""
    model = problems[0].model  # others differ from it in their torque process alone
    observation, torques = model.observation, [each.model.torque for each in problems]
    data = [problems[0].observations, model.time]
    data += [tensor for tensor in (model.command, *observation.data()) if tensor is not None]
    return {
        "version": version("invdyn"),
        "recording": digest(*data),
        "body": repr(model.body),
        "start": digest(*(model.parameters[name] for name in sorted(model.parameters))),
        "free": [repr(f) for free in frees for f in free],
        "torques": ", ".join(f"{type(torque).__name__} {vars(torque)}" for torque in torques),
        "integrator": f"{model.integrator}, {model.substeps} sub-steps",
        "family": observation.family,
        "forces": [repr(effect) for effect in model.effects],
        "seed": seed,
        **{name: str(value) for name, value in asdict(options).items()},
    }

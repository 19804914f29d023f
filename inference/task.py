"""A recording bound to a body, its unknown parameters fitted: what any method then runs on."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import inside
from invdyn.inference.execution.progress import Progress
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.best_guide import guides_agree
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.memory import give_back
from invdyn.inference.filters.moment_matching import exact_closed_form
from invdyn.inference.filters.second_opinion import evidence
from invdyn.inference.fit_processes import fingerprint, fit_processes, fitted_on_the_middle
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.parameter_draws import (
    Candidate,
    ParameterSet,
    given_the_rest,
    parameter_draws,
    sets_needed,
)
from invdyn.inference.free_parameters import at_start, free_parameters, of_priors, with_entries
from invdyn.inference.methods.over_sets import BATCHED, over_sets
from invdyn.inference.methods.registry import DISTRIBUTED, METHODS, OF_ARMS, RESUMED, WITHOUT_EVIDENCE, timed
from invdyn.inference.plausible_for_body import put_right
from invdyn.inference.posterior.explained import unexplained
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.models import ArticulatedBody, TorqueProcess, default_torques
from invdyn.models.articulated.applied_force import AppliedForce
from invdyn.models.divergence import Diverged
from invdyn.recordings import InputError, Recording, Truth

MIXED = frozenset({"bootstrap", *BATCHED})
"""Methods that have draws of several torque processes and their parameters; others have the most probable ones."""
NUM_SETS = 16
"""Sets at most, as each takes a guide of its own. The 5 % and 95 % quantiles of 16 torques hold .79 of the next one: of
bodies that differ a Gaussian smoother, which needs no guide, has as many as chains.
"""
SETS = 5_505_505
"""Place of the random numbers of process and parameters (:func:`.seeds.derived`)."""


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
        candidates: torque processes with their fits.
        mixed: whether the prior is the candidates' mixture.
    """

    problem: Problem
    path: Tensor
    options: SMCOptions
    seed: int
    record: dict
    checkpoint: Checkpoint | None = None
    unfitted: Problem | None = None
    free: tuple[Free, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    mixed: bool = False

    def run(
        self,
        method: str,
        progress: Progress | None = None,
        executor: Executor | None = None,
        *,
        learn: bool = False,
    ) -> az.InferenceData:
        """Posterior by ``method``, a key of ``METHODS``; over draws of the body where it is uncertain.

        Parameters are the fitted ones. With ``learn`` they are uncertain: of several torque processes a method of
        :data:`MIXED` has draws of each in proportion to its evidence, with parameters drawn (:mod:`.parameter_draws`),
        and "vsmc" learns those of the most probable one, on a body that is known: their prior is that of the fit,
        around where it began, for around what was fitted it would count the data twice.

        With an ``executor`` its workers share the work (:mod:`.distribute`). Raises InputError when the method
        cannot do with an uncertain body, LostWork when workers that died could not be replaced.
        """
        give_back()
        run: Callable[..., az.InferenceData] = METHODS[method]
        places: dict[str, Any] = {"executor": executor} if method in DISTRIBUTED else {}
        places |= {"checkpoint": self.checkpoint} if method in RESUMED else {}
        problem, record = self.problem, self.record
        if method in OF_ARMS and self.unfitted is not None:  # what is filtered and differentiated is a nominal body's
            nominal = self.unfitted.model.parameters
            means = {
                name: {entry: nominal[f"body.{name}"].flatten()[entry] for entry in own}
                for name, own in problem.model.body.priors.items()
            }
            problem = replace(problem, model=with_entries(problem.model, means))
        mixed, of_body = learn and self.mixed and method in MIXED, of_priors(problem.model.body)
        uncertain = any(map(of_body, self.free))
        if method == "nuts" and uncertain:
            raise InputError(
                "nuts takes the body as known, and this one is uncertain: drop its priors and [uncertainty], or use smc"
            )
        uncertain = uncertain and method not in WITHOUT_EVIDENCE
        if mixed or uncertain:
            chosen = max(self.candidates, key=lambda each: each.fit.log_marginal)
            run, sets = self._over_sets(method, self.candidates if mixed else [given_the_rest(chosen, of_body)])
            places = {"executor": executor, "checkpoint": inside(self.checkpoint, f"{method}-sets")}
        if mixed:
            names = [type(each.model.torque).__name__ for each in sets]
            record = {**record, "torque_sets": {name: names.count(name) for name in dict.fromkeys(names)}}
        elif method == "vsmc" and learn and not uncertain and self.free and self.unfitted is not None:
            problem, places = self.unfitted, {**places, "free": self.free}
        return run(
            problem,
            options=self.options,
            start=self.path,
            seed=self.seed,
            settings=record,
            progress=progress,
            **places,
        )

    def _over_sets(
        self, method: str, candidates: Sequence[Candidate]
    ) -> tuple[Callable[..., az.InferenceData], list[ParameterSet]]:
        """The method over sets of process and parameters, and these sets."""
        joints, options = self.problem.model.body.num_joints, self.options
        # Torques come first, angles and velocities last.
        shown = [*range(joints), *range(-2 * joints, 0)]
        count = min(NUM_SETS, sets_needed(candidates, shown, options.num_filters * options.num_draws))
        if any(map(of_priors(self.problem.model.body), self.free)):  # whose numbers are shown as draws, too
            count = options.num_filters if method == "laplace" else NUM_SETS
        count = min(count, options.num_filters)
        with seeded(derived(self.seed, SETS)):
            sets = parameter_draws(candidates, self.problem.observations, count)
        one_by_one, model = partial(over_sets, method, sets=sets, together=False), self.problem.model
        if method not in BATCHED or model.nonsmooth:
            return timed(one_by_one), sets
        if method == "laplace":
            return timed(partial(over_sets, method, sets=sets)), sets
        if not exact_closed_form(model.to(dtype=torch.float64), self.path):
            return timed(one_by_one), sets

        def in_a_batch(problem: Problem, checkpoint: Checkpoint | None, **options: Any) -> az.InferenceData:
            with suppress(SMCFailed, Diverged):
                found = over_sets(method, problem, sets, checkpoint=checkpoint, **options)
                evidences = torch.as_tensor(found["sample_stats"]["log_evidence"].to_numpy())
                if self._confirms(candidates, evidences):
                    return found
            return one_by_one(problem, checkpoint=inside(checkpoint, "alone"), **options)

        return timed(in_a_batch), sets

    def _confirms(self, candidates: Sequence[Candidate], log_evidence: Tensor) -> bool:
        """Whether filters over sets, with log-evidences (M,) of the mixture, agree, and a bootstrap pilot is no higher.

        The pilot is of the fit: the mixture's evidence is less, by what its parameters and processes cost.
        """
        marginal = torch.tensor([float(each.fit.log_marginal) for each in candidates]).double()
        best = candidates[int(marginal.argmax())].fit.log_evidence
        cost = best - float(marginal.logsumexp(0)) + math.log(len(marginal))
        ahead = evidence(log_evidence + cost, "controlled")
        return guides_agree(self.problem.model, self.problem.observations, self.options, self.seed, ahead)


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
    """Bind ``recording`` to ``body`` and fit what is not in ``settings``; of several torque processes each.

    Several are a mixture, as is one in a list, and None (:func:`invdyn.models.default_torques`): see :class:`Task`.

    ``binding`` are further options of :func:`.initialise.arm_problem`; ``report`` is called with (done, total) of
    the fit; ``checkpoint`` is a folder that keeps it, and what methods have done. Raises InputError when the recording
    does not fit the body, for an unknown parameter, a device that is not there, or a checkpoint of another run.
    """
    options.check()
    torque = default_torques(settings or ()) if torque is None else torque
    recording = put_right(recording, body)

    def bound(part: Recording, process: TorqueProcess | None, truth: Truth | None = None) -> Problem:
        return arm_problem(
            part,
            body.with_uncertainty(),
            parameters=settings,
            truth=truth,
            learn_lengths=learn_lengths,
            torque=process,
            **{"moving_base": True, **binding},
        )

    processes = torque if isinstance(torque, Sequence) else (torque,)
    problems = [bound(recording, process, truth) for process in processes]
    frees = [free_parameters(each, tuple(settings or ()), learn_lengths) for each in problems]
    kept = None if checkpoint is None else Checkpoint(checkpoint, fingerprint(problems, options, seed, frees))

    def begin(number: int, known: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return fitted_on_the_middle(recording, partial(bound, process=processes[number]), frees[number], known)

    fits, doubts_of = fit_processes(problems, frees, begin, report, kept)
    chosen = int(np.argmax([each.log_marginal for each in fits]))
    problem, free, best = problems[chosen], frees[chosen], fits[chosen]
    fitted = replace(problem, model=best.model)
    doubts = [*unexplained(fitted, best.path), *doubts_of[chosen]]
    for doubt in doubts:
        warnings.warn(doubt, stacklevel=3)
    record = {
        "fitted": {f.name: best.model.parameters[f.name].tolist() for f in free},
        "fit_converged": best.converged,
        "integrator": problem.model.integrator,
        "substeps": problem.model.substeps,
        "family": problem.model.observation.family,
        "torque_process": type(problem.model.torque).__name__,
    }
    if forces := [str(effect.where[0]) for effect in best.model.effects if isinstance(effect, AppliedForce)]:
        record["forces"] = forces
    if doubts:
        record["in_doubt"] = doubts
    if len(problems) > 1:
        names = [type(each.model.torque).__name__ for each in problems]
        marginal = [float(each.log_marginal) for each in fits]
        record["torque_evidence"] = dict(zip(names, marginal, strict=True))
    candidates = [
        Candidate(at_start(each, own), own, found) for each, own, found in zip(problems, frees, fits, strict=True)
    ]
    mixed = isinstance(torque, Sequence)
    return Task(fitted, best.path, options, seed, record, kept, problem, tuple(free), tuple(candidates), mixed)

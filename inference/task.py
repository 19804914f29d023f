"""A recording bound to a body, its unknown parameters fitted: what any method then runs on."""

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import torch
from pyro.distributions import LogNormal, Normal
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint, digest, part_of
from invdyn.inference.execution.distribute import inside
from invdyn.inference.execution.progress import Progress, Report
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.best_guide import guides_agree
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.moment_matching import exact_closed_form
from invdyn.inference.filters.second_opinion import evidence
from invdyn.inference.fitting.log_parameters import Free
from invdyn.inference.fitting.marginal_likelihood import Fit, fit
from invdyn.inference.fitting.parameter_draws import (
    Candidate,
    ParameterSet,
    given_the_rest,
    parameter_draws,
    sets_needed,
)
from invdyn.inference.methods.over_sets import BATCHED, over_sets
from invdyn.inference.methods.registry import DISTRIBUTED, METHODS, OF_ARMS, RESUMED, WITHOUT_EVIDENCE, timed
from invdyn.inference.plausible_for_body import put_right
from invdyn.inference.posterior.explained import unexplained
from invdyn.inference.posterior.gap_branches import fit_over_gaps
from invdyn.inference.posterior.initialise import Problem, arm_problem
from invdyn.models import ArmModel, ArticulatedBody, TorqueProcess, default_torques
from invdyn.models.articulated.applied_force import AppliedForce
from invdyn.models.bodies.scalars import in_normal_units
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
CLOCK, POSE = 0.05, {"turn": 0.05, "shift": 0.1}
"""s, rad and m: how far off the clocks and poses of cameras may be that are to be learned, standard deviations."""
PILOT_ROWS, PILOT_FROM = 1000, 4000
"""Rows in the middle of a long recording on which its parameters are fitted first, and from how many rows on."""
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
        Free("torque.rough_scale", tied=True, sd=1.0),
        Free("torque.rough_decay", tied=True, sd=1.0),
        # One σ_y as in the paper; its ratio between keypoints is that of their misfits at the start.
        *(Free(name, sd=1.0) if name == "emission.df" else Free(name, tied=True) for name in observed),
    ]
    learned = dict(body.learned)
    if learn_lengths and body.is_chain:  # a tree says itself which of its lengths are learned
        learned = {"length": tuple(range(body.num_joints)), **{k: v for k, v in learned.items() if k != "length"}}
    wanted += [
        Free(f"body.{quantity}", sd=sd, entries=entries, unit=unit)
        for quantity, sd, unit, entries in _known_in_part(body)
    ]
    wanted += [Free(f"body.{quantity}", sd=0.3, entries=entries) for quantity, entries in learned.items()]
    if (pixels := problem.model.observation.pixels) is not None:
        # The first camera is where it is, and its clock is right: all others' are relative to it.
        clocks, poses = (tuple(range(n, n * len(pixels.camera_names))) for n in (1, 3))
        wanted += [Free("camera.offset", sd=1.0, entries=clocks, unit=CLOCK)]
        wanted += [Free(f"camera.{way}", sd=1.0, entries=poses, unit=unit) for way, unit in POSE.items()]
        # Three numbers a camera say little of their size.
        wanted += [Free("camera.turn_scale", tied=True, sd=0.5)]
    return [f for f in wanted if f.name in problem.model.parameters and f.name not in given]


def _of_priors(body: ArticulatedBody) -> Callable[[Free], bool]:
    """Whether a parameter is one of the body's numbers that have priors."""
    own = {(f"body.{quantity}", entry) for quantity, entries in body.priors.items() for entry in entries}
    return lambda free: bool(free.entries) and {(free.name, entry) for entry in free.entries or ()} <= own


def _known_in_part(body: ArticulatedBody) -> list[tuple[str, float, float | None, tuple[int, ...]]]:
    """The body's numbers that have priors: quantity, sd and unit as of :class:`Free`, and entries that these are of."""
    alike: dict[tuple[str, float, float | None], list[int]] = {}
    for quantity, own in body.priors.items():
        for entry, each in own.items():
            if not isinstance(each, Normal | LogNormal):
                warnings.warn(
                    f"body.{quantity}[{entry}]: the prior {type(each).__name__} is replaced by a (log-)normal of "
                    "its mean and sd, whose draws may be beyond its bounds; give a LogNormal to say so yourself",
                    stacklevel=2,
                )
            alike.setdefault((quantity, *in_normal_units(each)[1:]), []).append(entry)
    return [(*which, tuple(entries)) for which, entries in alike.items()]


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
            problem = replace(problem, model=_with_entries(problem.model, means))
        mixed, of_body = learn and self.mixed and method in MIXED, _of_priors(problem.model.body)
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
        if any(map(_of_priors(self.problem.model.body), self.free)):  # whose numbers are shown as draws, too
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
    kept = None if checkpoint is None else Checkpoint(checkpoint, _fingerprint(problems, options, seed, frees))

    def begin(number: int, known: Mapping[str, Tensor]) -> Mapping[str, Tensor]:
        return _of_middle(recording, partial(bound, process=processes[number]), frees[number], known)

    fits, doubts_of = _fitted(problems, frees, begin, report, kept)
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


def _fitted(
    problems: Sequence[Problem],
    frees: Sequence[list[Free]],
    begin: Callable[[int, Mapping[str, Tensor]], Mapping[str, Tensor]],
    report: Report | None,
    checkpoint: Checkpoint | None,
) -> tuple[list[Fit[ArmModel]], list[list[str]]]:
    """Fit of each problem, and what is in doubt of each: from the checkpoint, or fitted and kept there."""
    if checkpoint is not None and (kept := checkpoint.load()) is not None:
        tensors, state = kept
        parts = [part_of(tensors, f"{number}.") for number in range(len(problems))]
        there = zip(problems, parts, state["fits"], strict=True)
        return [_kept_fit(each, own, numbers) for each, own, numbers in there], state["doubts"]
    fits: list[Fit[ArmModel]] = []
    doubts: list[list[str]] = []
    for number, (problem, free) in enumerate(zip(problems, frees, strict=True)):
        part = _share(report, number, len(problems))
        model, rows = at_start(problem, free), problem.observations
        like = _like(model, problems[0].model, fits[0]) if number else {"begin": {}}
        like["begin"] |= begin(number, like["begin"])
        found, doubt = fit_over_gaps(model, rows, free, part, problem.origin, **like)
        fits.append(found)
        doubts.append(doubt)
    if checkpoint is not None:
        tensors = {
            f"{number}.{name}": value for number, each in enumerate(fits) for name, value in _tensors_of(each).items()
        }
        numbers = [
            {name: float(getattr(each, name)) for name in NUMBERS} | {"converged": each.converged} for each in fits
        ]
        checkpoint.save(tensors, fits=numbers, doubts=doubts)
    return fits, doubts


def _of_middle(
    recording: Recording, bound: Callable[[Recording], Problem], free: Sequence[Free], known: Mapping[str, Tensor]
) -> Mapping[str, Tensor]:
    """Parameters fitted on the middle of a long recording, at which to begin with all of it: {} where there are none.

    Their own fit begins at those that are ``known`` of another process.

    They save most of the search, and change what it finds by no more than its tolerance.
    """
    if recording.num_frames < PILOT_FROM or type(recording) is not Recording:
        return {}
    first = (recording.num_frames - PILOT_ROWS) // 2
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the whole recording's fit says what is to be said
            problem = bound(recording.select(first, first + PILOT_ROWS))
            model = fit(at_start(problem, free), problem.observations, free, begin=known).model
    except (InputError, Diverged, KeyError):
        return {}  # the arm is not seen there, say
    return {each.name: model.parameters[each.name] for each in free}


def _like(model: ArmModel, first: ArmModel, fit: Fit[ArmModel]) -> dict[str, Any]:
    """What the fit of a model starts from, given that of the ``first``, which differs in its torque process alone."""
    joints = model.body.num_joints
    z, rest = fit.path[:, : first.torque.size(joints)], fit.path[:, first.torque.size(joints) :]
    begin = {name: value for name, value in fit.model.parameters.items() if name in model.parameters}
    return {"start": torch.cat([model.torque.path(z[:, :joints], model.time), rest], -1), "begin": begin}


def at_start(problem: Problem, free: Sequence[Free]) -> ArmModel:
    """The model at the parameters that a fit begins at."""
    model = problem.model
    names = {f.name for f in free}
    if DROP in names:  # a logarithm is fitted, and 0 has none
        model = model.replace(**{DROP: model.parameters[DROP].clamp(min=MIN_DROP)})
    priors = {quantity: own for quantity, own in model.body.priors.items() if f"body.{quantity}" in names}
    middles = {
        quantity: {entry: in_normal_units(each)[0] for entry, each in own.items()} for quantity, own in priors.items()
    }
    return _with_entries(model, middles)


def _with_entries(model: ArmModel, values: Mapping[str, Mapping[int, float | Tensor]]) -> ArmModel:
    """The model with other ``values`` of some of its body's numbers, by the number's name and flat index."""
    found = {f"body.{quantity}": model.parameters[f"body.{quantity}"].clone() for quantity in values}
    for quantity, own in values.items():
        for entry, value in own.items():
            found[f"body.{quantity}"].view(-1)[entry] = value
    return model.replace(**found)


PARAMETER = "parameter "
"""Before a parameter's name in a checkpoint: it may be any."""
NUMBERS = ("log_evidence", "log_marginal")
ARRAYS = ("phi", "covariance", "scatter")
"""Of a fit, that a checkpoint keeps."""


def _tensors_of(fit: Fit[ArmModel]) -> dict[str, Tensor]:
    """What of a fit is a tensor."""
    own = {"path": fit.path} | {name: torch.as_tensor(getattr(fit, name)) for name in ARRAYS}
    own |= {f"log_sd {name}": torch.as_tensor(value) for name, value in fit.log_sd.items()}
    return own | {f"{PARAMETER}{name}": value for name, value in fit.model.parameters.items()}


def _kept_fit(problem: Problem, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> Fit[ArmModel]:
    """The fit whose tensors :func:`_tensors_of` gave."""
    model = problem.model.replace(**part_of(tensors, PARAMETER))
    log_sd = {name: value.numpy() for name, value in part_of(tensors, "log_sd ").items()}
    of = {name: numbers[name] for name in ("converged", *NUMBERS)} | {name: tensors[name].numpy() for name in ARRAYS}
    return Fit(model=model, path=tensors["path"], log_sd=log_sd, **of)


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
        "kept": [*NUMBERS, *ARRAYS, "sets by number"],
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

"""Parameter sets of one model, of its body's numbers too: each filter, or Gaussian smoother, has a set of its own.

The sets (:mod:`.fitting.parameter_draws`) differ in their parameters alone, and so do their Gaussian smoothers and the
guides made of these (:class:`.affine.Corrected`, without a correction). A batch of filters with a set each takes hardly
longer than one with the same for all: what a row costs is its number of operations. By "laplace" draws of a set are of
its smoother; by "smc" they are ancestral lines, which meet seldom under a guide that looks ahead.

Each of S sets θ_s gets M/S of the filters. The outer weights

    W_m ∝ Ẑ_m(θ_{s(m)}),

with the set's offset in Ẑ_m, are importance weights of the pair (θ_s, trajectory), so that pooled draws integrate the
parameters out, and the mean of the Ẑ_m is the evidence with θ integrated out. All of them are a batch, or a method runs
on one at a time: any method, models with kinks, and sets whose smoother has no finite evidence.

Shapes: S sets, M filters in all, R draws of each, observations (T, O), paths (M, R, T, D).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from typing import Any

import arviz as az
import torch
from torch import Tensor

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.distribute import distribute
from invdyn.inference.execution.progress import Progress, Report, stage
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.filters.backward_simulation import genealogy
from invdyn.inference.filters.filtering import SMCOptions, filters_of, in_type, sufficient_dtype
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.resampling import resample
from invdyn.inference.filters.second_opinion import evidence
from invdyn.inference.fitting.parameter_draws import ParameterSet
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.posterior.files import packed, unpacked
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.posterior.posterior import combine, stored_dtype, to_inference_data
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.smoothing.posterior_linearisation import posterior_linearisation
from invdyn.inference.variational.affine import Corrected
from invdyn.models import ArmModel

BATCHED = frozenset({"laplace", "smc"})
"""Methods that take sets in a batch."""
ROWS_AT_ONCE = 20_000
"""Rows × parameter sets that are linearised in one batch: memory."""


@dataclass(frozen=True)
class SetBatch:
    """What one worker does: posteriors of S ``problems`` by a ``method``.

    Attributes:
        starts: (S, T, D) paths that the smoothers begin at.
        counts: filters of each problem.
        offsets: nats that each problem's evidences have in them.
    """

    method: str
    problems: Sequence[Problem]
    starts: Tensor
    counts: Sequence[int]
    offsets: Sequence[float]
    options: SMCOptions
    seed: int
    settings: dict | None = None


def over_sets(
    method: str,
    problem: Problem,
    sets: Sequence[ParameterSet],
    *,
    options: SMCOptions,
    seed: int = 0,
    start: Tensor | None = None,
    settings: dict | None = None,
    progress: Progress | None = None,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    together: bool = True,
) -> az.InferenceData:
    """The posterior over ``sets`` of one or more models, at most one a filter, by a ``method``.

    ``together`` it is one of :data:`BATCHED`, and a task has sets of one model, with as many filters as a task may
    have; else a task is a set. Other arguments are those of :func:`.smc.smc`, of which ``start`` does not count. The
    result's posterior also holds each draw's length, mass, com and inertia, where they differ.
    """
    counts = [len(part) for part in torch.arange(options.num_filters).tensor_split(len(sets))]
    most = max(1, min(options.at_once // max(counts), ROWS_AT_ONCE // len(problem.observations))) if together else 1
    run = run_sets if together else run_set
    tasks = []
    for _, own in groupby(range(len(sets)), key=lambda k: sets[k].candidate):
        numbers = list(own)
        tasks += [numbers[first : first + most] for first in range(0, len(numbers), most)]
    found = distribute(
        run if checkpoint is None else partial(in_bytes, run),
        [
            (
                SetBatch(
                    method,
                    [replace(problem, model=sets[k].model) for k in numbers],
                    torch.stack([sets[k].path for k in numbers]),
                    [counts[k] for k in numbers],
                    [sets[k].offset for k in numbers],
                    options,
                    derived(seed, numbers[0]),
                    settings,
                ),
            )
            for numbers in tasks
        ],
        [f"parameter sets {numbers[0] + 1} to {numbers[-1] + 1} of {len(sets)}" for numbers in tasks],
        executor=executor,
        checkpoint=checkpoint,
        progress=stage(progress, "parameter sets"),
    )
    parts = [each if isinstance(each, az.InferenceData) else unpacked(each) for own in found for each in own]
    return combine(parts, seed=seed)


def run_sets(task: SetBatch, progress: Report | None = None) -> Any:
    """Posterior of a task's problems, all at once: one InferenceData where their bodies are one, else one each."""
    problems, options, seed = task.problems, task.options, task.seed
    rows = problems[0].observations.detach().cpu().double()
    many = stacked([each.model.to(dtype=torch.float64, device="cpu") for each in problems])
    smoothers = posterior_linearisation(many, rows, gauss_newton(many, rows, start=task.starts), 1)
    owners = [k for k, count in enumerate(task.counts) for _ in range(count)]
    with seeded(seed, options.device):
        more = torch.tensor(task.offsets).double()[owners]
        numbers = sets = torch.tensor(owners)
        together = _of_one_body(problems)
        if task.method == "laplace":
            evidences, result = smoothers.log_evidence[owners] + more, None
            if together:  # draws of a part weigh the same: each set has as many as it weighs
                sets = numbers[resample(evidences[None])[0].sort().values]
            paths = _gaussian(smoothers, sets.tolist(), options)
        else:
            paths, result = _filtered(problems, smoothers, owners, options)
            evidences = result.log_evidence + more
        whole = [numbers >= 0] if together else [numbers == k for k in range(len(problems))]
        found = []
        for own in whole:
            model = stacked([problems[k].model for k in sets[own]], axes=2)
            one = replace(problems[int(numbers[own][0])], model=model)
            part = None if result is None else result.of_filters(own, evidences)
            drawn = paths if own.all() else paths[own]  # all of them are not copied
            found.append(_contents(task, one, drawn, evidences[own], part))
    if progress is not None:
        progress(1, 1)
    return found


def run_set(task: SetBatch, progress: Report | None = None) -> Any:
    """The same of one problem by any method."""
    few = replace(task.options, num_filters=task.counts[0], refits=min(task.options.refits, 1))
    run = METHODS[task.method]
    found = run(task.problems[0], options=few, start=task.starts[0], seed=task.seed, settings=task.settings)
    found["sample_stats"]["log_evidence"] = found["sample_stats"]["log_evidence"] + task.offsets[0]
    if progress is not None:
        progress(1, 1)
    return [found]


def in_bytes(run: Callable[..., Any], task: SetBatch, progress: Report | None = None) -> list[dict[str, Tensor]]:
    """The same for a checkpoint: a netCDF file in bytes takes longer to write than to compute."""
    return [packed(each) for each in run(task, progress)]


def stacked(models: Sequence[ArmModel], axes: int = 1) -> ArmModel:
    """One model with the parameters of all: those that differ have shape (S, 1, own shape), or more ``axes`` of 1."""
    values = {name: [each.parameters[name] for each in models] for name in models[0].parameters}
    differing = {name: own for name, own in values.items() if any(not torch.equal(own[0], each) for each in own)}
    # One parameter has to say how many there are.
    differing = differing or {"noise.angle": values["noise.angle"]}
    shape = (len(models), *[1] * axes)
    return models[0].replace(
        **{name: torch.stack(own).reshape(*shape, *own[0].shape) for name, own in differing.items()}
    )


def _of_one_body(problems: Sequence[Problem]) -> bool:
    """Whether all have the same body, whose numbers are constants of a posterior."""
    first, *others = (
        {name: value for name, value in each.model.parameters.items() if name.startswith("body.")} for each in problems
    )
    return all(torch.equal(value, each[name]) for each in others for name, value in first.items())


def _gaussian(smoothers: GaussianSmoother, owners: Sequence[int], options: SMCOptions) -> Tensor:
    """Draws of the smoothers of the sets ``owners`` (M,), in order."""
    shape = (len(owners), options.num_draws, *smoothers.path.shape[-2:])
    paths = torch.empty(shape, dtype=stored_dtype(*shape))
    sizes = [owners.count(k) for k in range(len(smoothers.log_evidence))]
    for k, own in enumerate(paths.split(sizes)):
        if len(own):
            own.copy_(GaussianChain.of(smoothers.of_set(k)).sample(own.shape[:2], dtype=own.dtype))
    return paths


def _filtered(
    problems: Sequence[Problem], smoothers: GaussianSmoother, owners: Sequence[int], options: SMCOptions
) -> tuple[Tensor, FilterResult]:
    """Ancestral lines of filters, each with the set and the guide of its own."""
    observations = problems[0].observations
    dtype = options.dtype or sufficient_dtype(smoothers)
    # Sets differ in numbers alone: what one of them is checked for holds of all.
    first = in_type(problems[0].model, observations, options, dtype)
    models: list[Any] = [each.model.to(dtype=first.dtype, device=first.device) for each in problems]
    rows = observations.to(dtype=models[0].dtype, device=options.device)
    guides = [Corrected(model, rows, smoothers.of_set(k)) for k, model in enumerate(models)]
    model = stacked([models[k] for k in owners])
    guide = Corrected.stacked([guides[k] for k in owners], model)
    filters = filters_of(model, guide, replace(options, num_filters=len(owners)))
    result = filters.run(rows, windows=True).cpu()
    return genealogy(result, options.num_draws), result


def _contents(
    task: SetBatch, problem: Problem, paths: Tensor, evidences: Tensor, result: FilterResult | None
) -> az.InferenceData:
    """InferenceData of paths (M, R, T, D) of filters or smoothers with ``evidences`` (M,)."""
    method, seed, options, settings = task.method, task.seed, task.options, task.settings or {}
    if result is None:
        whole = float(evidences.mean())
        found = to_inference_data(problem, paths, method=method, seed=seed, settings=settings, log_evidence=whole)
        found["sample_stats"]["log_evidence"].values[:] = evidences
        return found
    judged = evidence(evidences, "controlled")
    diagnostics: dict[str, float | str] = {"usable": int(judged.usable), "doubt": judged.reason}
    diagnostics |= {"contradicted": "", "guide": "controlled", "guide_reason": ""}
    settings = {**settings, "num_filters": options.num_filters, "num_particles": options.num_particles}
    settings |= {"filters_per_task": len(paths), "resampling": options.resampling}
    return to_inference_data(
        problem, paths, result, method=method, seed=seed, diagnostics=diagnostics, settings=settings
    )

"""Methods side by side, on one recording and one body: which to trust, and at what cost.

Parameters that are not known are fitted once (:mod:`.marginal_likelihood`), so all methods answer the same question;
"vsmc" too, which by itself (:func:`.infer.infer`) would learn their posterior, and here trains its guide alone. For a
``log_score`` parameters are fitted and methods run once more, on the first rows alone. The table's columns stand in
:mod:`.comparison`; any state-space model is compared by :func:`.compare_methods.compare_methods`.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import torch

from invdyn.inference.comparison import Comparison, checked_methods, in_own_process, kept, measured, named, run_methods
from invdyn.inference.execution.progress import Progress, Report, stage
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.filters.memory import check_memory
from invdyn.inference.held_out import log_score
from invdyn.inference.methods.registry import METHODS
from invdyn.inference.posterior.initialise import Problem
from invdyn.inference.task import Task, prepare
from invdyn.models import ArticulatedBody
from invdyn.models.state_space import UnknownParameter
from invdyn.recordings import InputError, Recording, Truth
from invdyn.recordings.errors import first_line

MIN_ROWS = 10
"""Rows that a head must have for its parameters to be fitted."""


def compare(
    recording: Recording,
    body: ArticulatedBody,
    methods: Sequence[str],
    *,
    truth: Truth | None = None,
    seed: int = 0,
    settings: Mapping[str, object] | None = None,
    num_filters: int = 64,
    num_particles: int = 100,
    num_draws: int = 4,
    held_out: float = 0.2,
    replicates: int = 1,
    isolate: bool = False,
    progress: Progress | None = None,
    device: str = "cpu",
    filters_per_task: int | None = None,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    **binding: Any,
) -> Comparison:
    """Run several methods on one recording.

    Args:
        recording, body: as :func:`.infer.infer` takes them.
        methods: keys of ``METHODS``; one that fails leaves a row with its reason and does not stop the others.
        truth: torques to score against.
        seed: same seed, same result (but for seconds and memory).
        settings: parameters by dotted name that are known; the others are fitted.
        num_filters, num_particles, num_draws: M, N, and smoothed trajectories per filter.
        held_out: share of the rows, the last ones, that ``log_score`` is over; 0 for none.
        replicates: runs of each method with seeds of their own, of which the sd of log-evidence is stated.
        isolate: run each method in a process of its own.
        progress: called with (done, total, what).
        device, filters_per_task, executor: as :func:`.infer.infer` takes them.
        checkpoint: folder of this comparison, made when missing: fits, what methods keep of their work, and each
            method's result with its seconds and memory are kept there, so that the same call continues from there.
        binding: further options of :func:`.initialise.arm_problem`: torque, integrator, family, learn_lengths …

    Raises:
        InputError: no or an unknown method, a ``held_out`` that is no share, both ``isolate`` and an ``executor``,
            more filters than memory holds, a recording that does not fit the body, or a checkpoint of another run.
    """
    methods = checked_methods(methods, tuple(METHODS), replicates, isolate, executor)
    if not 0 <= held_out < 1:
        raise InputError(f"expected a share of rows to hold out from 0 up to 1, got {held_out}")
    options = SMCOptions(num_filters, num_particles, num_draws, device=device, filters_per_task=filters_per_task)
    check_memory(recording.num_frames, body.num_joints, options, methods)
    bind: Callable[..., Task] = partial(prepare, body=body, options=options, seed=seed, settings=settings, **binding)
    folder = None if checkpoint is None else Path(checkpoint)
    whole = bind(recording, truth=truth, report=stage(progress, "fit"), checkpoint=folder and folder / "whole")
    bind = partial(bind, torque=whole.problem.model.torque)
    head, future, missing = _split(whole, recording, bind, held_out, stage(progress, "fit without the tail"), folder)
    found = run_methods(
        whole,
        methods,
        "torque",
        _true_torque,
        recording.name,
        replicates=replicates,
        isolate=isolate,
        progress=progress,
        executor=executor,
    )
    if head is not None and future is not None:
        launch = partial(kept, in_own_process if isolate else partial(measured, executor=executor))
        for method in found.posteriors:
            try:
                scored, *_ = launch(head, method, progress=named(progress, f"{method} without the tail"))
                found.table.loc[method, "log_score"] = log_score(future, scored, whole.path, seed)
            except Exception as error:  # the others are still scored
                found.note(method, f"no log score: {first_line(error)}")
    if missing:
        found.notes["all"] = f"no log score: {missing}"
    return found if head is None else replace(found, held_out=_seen(whole, head))


def _split(
    whole: Task,
    recording: Recording,
    bind: Callable[..., Task],
    share: float,
    report: Report | None,
    folder: Path | None,
) -> tuple[Task | None, Problem | None, str]:
    """Task of the first rows, the whole problem with their parameters, and why there is none."""
    rows = recording.num_frames
    first = rows - round(share * rows)
    if first == rows:
        return None, None, "" if share == 0 else "the tail is empty"
    if first < MIN_ROWS:
        return None, None, f"{first} rows are too few to fit parameters to"
    if whole.problem.model.body.has_priors:
        return None, None, "the body is uncertain, and each filter has another"
    if not bool((~torch.isnan(whole.problem.observations[first:])).any()):
        return None, None, "nothing is observed in the tail"
    try:
        place = folder and folder / f"first-{first}-rows"
        head = bind(recording.select(0, first), report=report, checkpoint=place)
        future = replace(whole.problem, model=whole.problem.model.replace(**head.problem.model.parameters))
    except (InputError, UnknownParameter) as error:
        return None, None, first_line(error)
    return head, future, ""


def _seen(whole: Task, head: Task) -> int:
    """Rows with an observation after the head's."""
    tail = whole.problem.observations[len(head.problem.observations) :]
    return int((~torch.isnan(tail)).any(-1).sum())


def _true_torque(idata: az.InferenceData) -> np.ndarray | None:
    """(T, K), where it is known."""
    known = idata["constant_data"].get("truth_torque")
    return None if known is None else known.transpose("time", "joint").values

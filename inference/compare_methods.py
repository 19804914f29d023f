"""Methods side by side, on one model of one's own and its rows: which to trust, and at what cost.

The table's columns stand in :mod:`.comparison`.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np
import torch

from invdyn.inference.comparison import Comparison, checked_methods, run_methods
from invdyn.inference.contract import ModelError
from invdyn.inference.execution.progress import Progress
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.infer_states import generic_methods, given_sizes, parameter_sizes, state_space_task
from invdyn.models.state_space import StateSpaceModel


def compare_methods(
    model: StateSpaceModel,
    rows: torch.Tensor | np.ndarray,
    methods: Sequence[str],
    *,
    truth: torch.Tensor | np.ndarray | None = None,
    seed: int = 0,
    num_filters: int | None = None,
    num_particles: int | None = None,
    num_draws: int | None = None,
    replicates: int = 1,
    isolate: bool = False,
    progress: Progress | None = None,
    device: str = "cpu",
    filters_per_task: int | None = None,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    name: str = "rows",
    arguments: Mapping[str, Mapping[str, Any]] | None = None,
) -> Comparison:
    """Run several methods on one model.

    Args:
        model: any state-space model.
        rows: (T, O) observations, NaN where missing.
        methods: keys of ``METHODS`` that need no body, or of ``PARAMETER_METHODS``; one that fails leaves a row with
            its reason.
        truth: (T, D) states to score against, NaN where unknown.
        seed: same seed, same result (but for seconds and memory).
        num_filters, num_particles, num_draws: as :func:`.infer_states.infer_states` takes them.
        replicates: runs of each method with seeds of their own, of which the sd of log-evidence is stated.
        isolate: run each method in a process of its own.
        progress: called with (done, total, what).
        device, filters_per_task, executor: as :func:`.infer_states.infer_states` takes them.
        checkpoint: folder of this comparison, made when missing: what methods keep of their work, and each method's
            result with its seconds and memory are kept there, so that the same call continues from there.
        name: of the data.
        arguments: further ones of a method, by its name.

    Raises InputError for no or an unknown method, or a checkpoint of another run; ModelError, an InputError, for a
    truth of another shape, or a model that does not fit its rows.
    """
    methods = checked_methods(methods, generic_methods(), replicates, isolate, executor)
    sizes, given = given_sizes(num_filters, num_particles, num_draws), arguments or {}
    options = SMCOptions(**sizes, device=device, filters_per_task=filters_per_task)
    own = {method: parameter_sizes(method, sizes) | dict(given.get(method, {})) for method in methods}
    own = {method: each for method, each in own.items() if each}
    task = state_space_task(model, rows, options, seed, checkpoint, name, own)
    if task.checkpoint is not None and task.checkpoint.load() is None:
        task.checkpoint.save({})  # of this run: another one is refused here, not method by method
    known = None if truth is None else np.asarray(truth, dtype=float)
    shape = (len(task.problem.observations), model.state_dim)
    if known is not None and known.shape != shape:
        raise ModelError(f"expected true states of shape {shape}, got {known.shape}")

    return run_methods(
        task,
        methods,
        "state",
        lambda idata: known,
        name,
        replicates=replicates,
        isolate=isolate,
        progress=progress,
        executor=executor,
    )

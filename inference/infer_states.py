"""The posterior of the states of any model, by any method.

    states = infer_states(model, rows, method="smc", seed=0)

A model gives three distributions (:class:`.StateSpaceModel`); a method takes the model and its rows, and gives
InferenceData. Parameters are those of the model; ones with a prior need a method that learns them.
"""

from concurrent.futures import Executor
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import torch
from pyro.distributions import Distribution

from invdyn.inference.contract import ModelError, check_model
from invdyn.inference.execution.checkpoint import Checkpoint, digest
from invdyn.inference.execution.progress import Progress
from invdyn.inference.filters.filtering import SMCOptions
from invdyn.inference.methods.registry import DISTRIBUTED, METHODS, OF_ARMS, PARAMETER_METHODS, RESUMED
from invdyn.inference.posterior.problem import StateSpaceProblem
from invdyn.inference.renamed_methods import present_name
from invdyn.models.state_space import StateSpaceModel


@dataclass(frozen=True)
class StateSpaceTask:
    """A model with its rows, and how a method runs on them.

    Attributes:
        problem: model and rows.
        options: sizes.
        seed: of every random number.
        checkpoint: of this run, or None.
        arguments: further ones of a method, by its name.
    """

    problem: StateSpaceProblem
    options: SMCOptions
    seed: int = 0
    checkpoint: Checkpoint | None = None
    arguments: dict[str, dict[str, Any]] = field(default_factory=dict)

    def run(self, method: str, progress: Progress | None = None, executor: Executor | None = None) -> az.InferenceData:
        """Posterior by ``method``. Raises ModelError where it cannot serve the model."""
        if method in OF_ARMS:
            raise ModelError(f"{method} needs a body, and a state-space model has none: use another method")
        if method not in generic_methods():
            raise ModelError(f"expected a method among {', '.join(generic_methods())}, got {method!r}")
        learned = method in PARAMETER_METHODS
        if self.problem.uncertain and not learned:
            raise ModelError(
                f"{method} takes parameters as they are, and {', '.join(self.problem.uncertain)} has a prior: use "
                f"{' or '.join(PARAMETER_METHODS)}, or a model without priors"
            )
        if learned and not self.problem.uncertain:
            raise ModelError(f"{method} learns parameters, and none has a prior: give some by model.with_priors(…)")
        places: dict[str, Any] = {"executor": executor} if method in DISTRIBUTED else {}
        places |= {"checkpoint": self.checkpoint} if method in RESUMED else {}
        return (PARAMETER_METHODS if learned else METHODS)[method](
            self.problem,
            options=self.options,
            seed=self.seed,
            settings={},
            progress=progress,
            **places,
            **self.arguments.get(method, {}),
        )


def generic_methods() -> tuple[str, ...]:
    """Names of the methods that take any state-space model."""
    return (*(name for name in METHODS if name not in OF_ARMS), *PARAMETER_METHODS)


def infer_states(
    model: StateSpaceModel,
    rows: torch.Tensor | np.ndarray,
    *,
    method: str = "smc",
    num_filters: int | None = None,
    num_particles: int | None = None,
    num_draws: int | None = None,
    smoothing: str = "backward",
    seed: int = 0,
    progress: Progress | None = None,
    device: str = "cpu",
    filters_per_task: int | None = None,
    executor: Executor | None = None,
    checkpoint: str | Path | None = None,
    name: str = "rows",
    **arguments: Any,
) -> az.InferenceData:
    """Infer the states of a model from its rows.

    Args:
        model: any state-space model.
        rows: (T, O) observations, NaN where missing.
        method: a key of ``METHODS`` that needs no body, or of ``PARAMETER_METHODS``.
        num_filters, num_particles, num_draws: M, N, and smoothed trajectories per filter; by default 64, 100 and 4.
            "pmmh" and "smc2" have chains and runs for filters, and parameters for draws, and defaults of their own.
        smoothing: of particle filters, "backward", which needs a transition density, or "genealogy", which also takes a
            state without noise.
        seed: same seed, same result.
        progress: called with (done, total, what).
        device: of the particle filters, "cpu" or "cuda".
        filters_per_task: see :class:`.SMCOptions`.
        executor: any ``concurrent.futures`` executor, whose workers share the filters; the same bits without one.
        checkpoint: folder of this run, made when missing, from which the same call continues.
        name: of the data, for the result.
        arguments: further ones of the method.

    Returns:
        InferenceData as :mod:`.posterior` lays it out, its states in posterior/state.

    Raises ModelError, a ValueError of one line, for a model that contradicts itself or its rows, or a method that
    cannot serve it; InputError for sizes that no machine has; SMCFailed where all particles have weight zero.
    """
    method = present_name(method)
    sizes = given_sizes(num_filters, num_particles, num_draws)
    options = SMCOptions(**sizes, smoothing=smoothing, device=device, filters_per_task=filters_per_task)
    own = {method: parameter_sizes(method, sizes) | arguments}
    return state_space_task(model, rows, options, seed, checkpoint, name, own).run(method, progress, executor)


def given_sizes(num_filters: int | None, num_particles: int | None, num_draws: int | None) -> dict[str, Any]:
    """Those of the sizes that are given, as :class:`.SMCOptions` takes them."""
    sizes = {"num_filters": num_filters, "num_particles": num_particles, "num_draws": num_draws}
    return {size: value for size, value in sizes.items() if value is not None}


def parameter_sizes(method: str, sizes: dict[str, Any]) -> dict[str, Any]:
    """Sizes as arguments of a method that learns parameters; {} of the others, which take them in their options."""
    if method not in PARAMETER_METHODS:
        return {}
    chains = {"pmmh": "num_chains", "smc2": "num_runs"}
    return {chains[method] if size == "num_filters" else size: value for size, value in sizes.items()}


def state_space_task(
    model: StateSpaceModel,
    rows: torch.Tensor | np.ndarray,
    options: SMCOptions,
    seed: int,
    checkpoint: str | Path | None = None,
    name: str = "rows",
    arguments: dict[str, dict[str, Any]] | None = None,
) -> StateSpaceTask:
    """Check a model against its rows, and bind them."""
    options.check()
    problem = StateSpaceProblem(model, check_model(model, rows), name=name)
    arguments = arguments or {}
    kept = None if checkpoint is None else Checkpoint(checkpoint, _fingerprint(problem, options, seed, arguments))
    return StateSpaceTask(problem, options, seed, kept, arguments)


def _fingerprint(
    problem: StateSpaceProblem, options: SMCOptions, seed: int, arguments: dict[str, dict[str, Any]]
) -> dict[str, Any]:
    """All that the numbers of a run depend on."""
    model = problem.model
    return {
        "version": version("invdyn"),
        "model": type(model).__qualname__,
        "priors": {name: _described(prior) for name, prior in model.priors.items()},
        "arguments": repr(arguments),
        "parameters": digest(*(model.parameters[name] for name in sorted(model.parameters))),
        "rows": digest(problem.observations),
        "options": repr(options),
        "seed": seed,
    }


def _described(prior: Distribution) -> str:
    """The family of a prior, and its numbers."""
    base = getattr(prior, "base_dist", prior)
    numbers = {name: getattr(base, name).tolist() for name in sorted(base.arg_constraints) if hasattr(base, name)}
    return f"{type(base).__name__} {numbers} {tuple(prior.batch_shape)} {tuple(prior.event_shape)}"

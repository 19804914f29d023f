"""Fitted hypotheses as numbers and names: what a diagnosis keeps of its refinements (:mod:`..kept_units`).

Effects and models are no numbers. They follow from the problem, the effects that were refined and the means of their
parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
import torch

from invdyn.diagnosis.kept_units import Numbers, kept
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.inference.execution.distribute import Tensors
from invdyn.models.effects.base import Effect

ARRAYS = ("mean", "covariance", "by_size", "about", "learned")
SCALARS = ("log_evidence", "kappa", "memory", "of_memory", "far")
BY_NAME = ("noise", "noise_sd", "noise_log")


def kept_hypothesis(
    problem: DiagnosisProblem,
    name: str,
    effects: Sequence[Effect],
    inputs: Sequence[Any],
    compute: Callable[[], FittedHypothesis | None],
) -> FittedHypothesis | None:
    """What ``compute`` makes of ``effects`` and further ``inputs``, kept with the problem's units.

    ``effects`` are all that the result has, in any order. Arrays are laid out row by row, as they come back: sums, and
    so the last bit, depend on that.
    """

    def laid_out() -> FittedHypothesis | None:
        found = compute()
        if found is None:
            return None
        arrays = {each: getattr(found, each) for each in ARRAYS}
        arrays = {each: None if value is None else np.ascontiguousarray(value) for each, value in arrays.items()}
        return replace(found, path=found.path.contiguous(), **arrays)

    def unpack(tensors: Tensors, state: dict[str, Any]) -> FittedHypothesis | None:
        return None if state["effects"] is None else _from_numbers(problem, effects, tensors, state)

    every = [problem.content, effects, *inputs]
    return kept(problem.checkpoint, problem.budget, name, every, laid_out, _as_numbers, unpack)


def content_of(cause: FittedHypothesis) -> list:
    """All of a hypothesis that later units may depend on."""
    tensors, state = _as_numbers(cause)
    return [cause.effects, tensors, state, dict(cause.model.parameters)]


def _as_numbers(cause: FittedHypothesis | None) -> Numbers:
    if cause is None:
        return {}, {"effects": None}
    arrays = {each: getattr(cause, each) for each in ARRAYS}
    tensors = {each: torch.from_numpy(value) for each, value in arrays.items() if value is not None}
    state: dict[str, Any] = {each: float(getattr(cause, each)) for each in SCALARS}
    state |= {each: {key: float(value) for key, value in getattr(cause, each).items()} for each in BY_NAME}
    state |= {"effects": [effect.key for effect in cause.effects], "plausible": bool(cause.plausible)}
    return {**tensors, "path": cause.path}, state


def _from_numbers(
    problem: DiagnosisProblem, effects: Sequence[Effect], tensors: Tensors, state: dict[str, Any]
) -> FittedHypothesis:
    by_key = {effect.key: effect for effect in effects}
    model = problem.model.with_effects(*(by_key[key] for key in state["effects"]))
    among, mean = unknowns(problem, tuple(model.effects)), tensors["mean"].numpy()
    noise = cast(dict[str, float], state["noise"])
    model = model.replace(**{f"effect.{n}": torch.tensor([v], dtype=torch.float64) for n, v in noise.items()})
    return FittedHypothesis(
        effects=tuple(model.effects),
        names=among.names,
        path=tensors["path"],
        model=among.set_in(model, mean),
        plausible=state["plausible"],
        **{each: tensors[each].numpy() if each in tensors else None for each in ARRAYS},  # type: ignore[arg-type]
        **{each: state[each] for each in (*SCALARS, *BY_NAME)},
    )

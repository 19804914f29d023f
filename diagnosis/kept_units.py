"""Units of a diagnosis, kept in a folder, so that the same call continues where an earlier one was killed.

A diagnosis is a deterministic function of its inputs, made of units: a screen, a refinement, the search of an effect's
parameters, a run of filters. Each is kept under a digest of all that it depends on as soon as it is done, and looked up
before it is computed (memoisation: Michie 1968, "Memo functions and machine learning", Nature 218). A call that was
killed loses the units at work, one for each process; its result is the same to the bit.

A unit also leaves what it did to the budget, and the failure that is its answer. Units are numbers and names, as all
checkpoints (:mod:`invdyn.inference.execution.checkpoint`): to read them runs no code. Effects and models are no
numbers. They follow from the problem, the effects that the unit was given, and the parameters.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.execution import records
from invdyn.inference.execution.distribute import Tensors, inside
from invdyn.inference.execution.records import Plain, Restored
from invdyn.models import ArmModel
from invdyn.models.divergence import Diverged, Singular, diverging
from invdyn.models.effects.base import Effect
from invdyn.models.effects.composition import NotTogether

P = ParamSpec("P")
T = TypeVar("T")

FAILURES = {each.__name__: each for each in (Diverged, Singular, NotTogether)}
"""What says that a candidate is none; see :func:`.budget.attempt`."""


def kept_unit(
    name: str, *kinds: type
) -> Callable[[Callable[Concatenate[Any, P], T]], Callable[Concatenate[Any, P], T]]:
    """Keep what a function returns, or raises, in its problem's checkpoint; where that has none, it is only computed.

    The problem is the function's first argument. Its content and all other arguments are what the result depends on.
    The problem's budget is brought to where the unit left it. Results hold ``kinds``, the classes of dataclasses in
    them, besides what :class:`_Plain` takes. Arrays are laid out row by row, as they come back: sums, and so
    the last bit, depend on that.
    """

    def decorated(compute: Callable[Concatenate[Any, P], T]) -> Callable[Concatenate[Any, P], T]:
        @wraps(compute)
        def unit(problem: Any, /, *given: P.args, **options: P.kwargs) -> T:
            if problem.checkpoint is None:
                return _laid_out(compute(problem, *given, **options))
            budget = problem.budget
            before, missed = budget.done, budget.missed
            known = _Plain()
            inputs = records.content_digest([problem.content, given, options, before], known)
            store = inside(problem.checkpoint, f"{name}-{inputs}")
            assert store is not None
            if (found := store.load()) is not None:
                tensors, state = found
                budget.done, budget.missed = state["done"], missed | set(state["missed"])
                if "failure" in state:
                    raise FAILURES[state["failure"]](state["words"])
                return _Restored(tensors, kinds, problem.model, known.effects).of(state["result"])

            def spent() -> dict[str, Any]:
                return {"done": budget.done, "missed": sorted(budget.missed - missed)}

            try:
                with diverging():
                    result = _laid_out(compute(problem, *given, **options))
            except tuple(FAILURES.values()) as error:
                store.save({}, failure=type(error).__name__, words=str(error), **spent())
                raise
            kept = _Plain()
            plain = kept.of(result)
            store.save(kept.tensors, result=plain, **spent())
            return result

        return unit

    return decorated


def _laid_out(value: Any) -> Any:
    """A result with its arrays and tensors row by row."""
    if isinstance(value, Tensor):
        return value.contiguous()
    if isinstance(value, np.ndarray):
        return np.ascontiguousarray(value).reshape(value.shape)
    if isinstance(value, list | tuple):
        return type(value)(map(_laid_out, value))
    if is_dataclass(value) and not isinstance(value, type):
        return replace(value, **{each.name: _laid_out(getattr(value, each.name)) for each in fields(value)})
    return value


class _Plain(Plain):
    """Of a diagnosis, with effects and models in addition; the effects that it met are in ``effects``."""

    def __init__(self) -> None:
        super().__init__()
        self.effects: dict[tuple[str, int], Effect] = {}

    def of(self, value: Any) -> Any:
        """A value as JSON holds it."""
        if isinstance(value, Effect):
            self.effects[value.key, value.variant] = value
            return {"effect": [value.key, value.variant], "class": type(value).__name__}
        if isinstance(value, ArmModel):
            parameters = self.of(dict(value.parameters))
            return {"effects": self.of(list(value.effects)), "parameters": parameters, "substeps": value.substeps}
        if isinstance(value, Distribution):  # a prior's numbers stand next to it
            return type(value).__name__
        return super().of(value)


class _Restored(Restored):
    """The same from a checkpoint; ``model`` is the problem's, ``effects`` are by key and variant."""

    def __init__(self, tensors: Tensors, kinds: tuple[type, ...], model: ArmModel, effects: Mapping[Any, Effect]):
        super().__init__(tensors, kinds)
        self.model, self.effects = model, effects

    def of(self, state: Any) -> Any:
        """The value."""
        match state:
            case {"effect": [key, variant]}:
                return self.effects[key, variant].bound(self.model.body)
            case {"effects": own, "parameters": parameters}:
                return self.model.with_effects(*self.of(own)).replace(**self.of(parameters))
        return super().of(state)


def content_digest(value: Any) -> str:
    """As of :mod:`.records`, of effects and models, too."""
    return records.content_digest(value, _Plain())

"""Units of a diagnosis, kept in a folder, so that the same call continues where an earlier one was killed.

A diagnosis is a deterministic function of its inputs, made of units: a screen, a refinement, the search of an effect's
parameters, a run of filters. Each is kept under a digest of all that it depends on as soon as it is done, and looked up
before it is computed (memoisation: Michie 1968, "Memo functions and machine learning", Nature 218). A call that was
killed loses the units at work, one for each process; its result is the same to the bit.

A unit also leaves what it did to the budget, and the failure that is its answer. Units are numbers and names, as all
checkpoints (:mod:`invdyn.inference.execution.checkpoint`): to read them runs no code.
"""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar

import numpy as np
from torch import Tensor

from invdyn.diagnosis.budget import Budget
from invdyn.inference.execution.checkpoint import Checkpoint, digest
from invdyn.inference.execution.distribute import Tensors, inside
from invdyn.models.divergence import Diverged, Singular, diverging
from invdyn.models.effects.base import Effect
from invdyn.models.effects.composition import NotTogether

T = TypeVar("T")

Numbers = tuple[Tensors, dict[str, Any]]
"""Tensors by name, and values that JSON can hold."""

FAILURES = {each.__name__: each for each in (Diverged, Singular, NotTogether)}
"""What says that a candidate is none; see :func:`.budget.attempt`."""


def kept(
    folder: Checkpoint | None,
    budget: Budget,
    name: str,
    inputs: Sequence[Any],
    compute: Callable[[], T],
    pack: Callable[[T], Numbers],
    unpack: Callable[[Tensors, dict[str, Any]], T],
) -> T:
    """The result of ``compute``, or the one that is kept in the ``folder``; raises what it raised.

    Args:
        folder: of the whole diagnosis; None where nothing is kept.
        budget: of the diagnosis, which is brought to where the unit left it.
        name: of the kind of unit.
        inputs: all that the result depends on, but for the budget's work so far.
        compute: the unit.
        pack, unpack: from its result to numbers, and back.
    """
    if folder is None:
        return compute()
    before, missed = budget.done, budget.missed
    store = inside(folder, f"{name}-{content_digest([*inputs, before])}")
    assert store is not None
    if (found := store.load()) is not None:
        tensors, state = found
        budget.done, budget.missed = state["done"], missed | set(state["missed"])
        if "failure" in state:
            raise FAILURES[state["failure"]](state["words"])
        return unpack(tensors, state)
    try:
        with diverging():
            result = compute()
    except tuple(FAILURES.values()) as error:
        store.save({}, failure=type(error).__name__, words=str(error), **_spent(budget, missed))
        raise
    tensors, values = pack(result)
    store.save(tensors, **values, **_spent(budget, missed))
    return result


def _spent(budget: Budget, missed: frozenset[str]) -> dict[str, Any]:
    return {"done": budget.done, "missed": sorted(budget.missed - missed)}


def content_digest(value: Any) -> str:
    """A short hexadecimal name of a value's content: equal for equal numbers, whichever type holds them."""
    return hashlib.sha256(json.dumps(_plain(value)).encode()).hexdigest()[:24]


def _plain(value: Any) -> Any:
    """Numbers, arrays, names, effects and collections of them, as JSON has them without loss."""
    if isinstance(value, Tensor):
        return digest(value)
    if isinstance(value, np.ndarray):
        return ["array", str(value.dtype), list(value.shape), hashlib.sha256(value.tobytes()).hexdigest()]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, Effect):
        return [type(value).__name__, value.key, value.variant]
    if isinstance(value, Mapping):
        return [[key, _plain(value[key])] for key in sorted(value)]
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if is_dataclass(value) and not isinstance(value, type):
        return [[each.name, _plain(getattr(value, each.name))] for each in fields(value)]
    if isinstance(value, float):
        return value.hex()
    if value is None or isinstance(value, bool | int | str):
        return value
    raise TypeError(f"expected numbers, names and effects, got {type(value).__name__}")

"""A traced program as one loop over particles, compiled by numba: no gradients, a tenth of torch's time or less.

Arguments lie by column, (columns, B, N): B bodies with N particles each, or B = 1 where all have the same body; numbers
of the body are (count, B), or (count, B, N) where each particle has its own. Angles' cosines and sines come in ready:
torch computes them for many at a time. Divisions follow numpy's rules, and NaN and infinity are kept.
"""

import logging
import math
import time
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.models.spatial.programs import Program, function

FASTMATH = {"contract", "reassoc", "nsz", "arcp"}  # not nnan and ninf: a simulation that diverges must show it
DTYPES = {torch.float32: np.float32, torch.float64: np.float64}

_log = logging.getLogger(__name__)


def engine():
    """The numba package, or None, with one warning."""
    try:
        import numba
    except ImportError:
        warnings.warn(
            "fast dynamics need `pip install 'invdyn[fast]'`; torch does it in ten times the time", stacklevel=3
        )
        return None
    return numba


class Compiled:
    """Loops of programs, each compiled at its first use; `seconds` has what that took, by method and dtype."""

    def __init__(self, numba):
        self._numba = numba
        self._loops: dict[tuple, Any] = {}
        self._bodies: dict[str, tuple] = {}
        self.seconds: dict[str, float] = {}

    def __call__(
        self, method: str, traced: Program, joint: Mapping[str, Tensor], numbers: Sequence[Tensor], batch: Sequence[int]
    ) -> Tensor:
        """Outputs (*batch, O) of arguments (..., columns) by word, and of numbers (...), laid out by column."""
        dtype = joint["q"].dtype
        body, own = self._body(method, numbers, batch, dtype)
        _, B, N = shape = (-1, *body.shape[1:]) if own else (-1, body.shape[1], math.prod(batch) // body.shape[1])
        given = [_by_column(joint[word], batch, shape) for word in traced.words]
        out = torch.empty(len(traced.source.results), B, N, dtype=dtype)
        loop, literals = self._loop(method, traced, own, dtype)
        loop(*given, body, literals, out.numpy())
        return out.view(-1, *batch).movedim(0, -1)

    def _body(self, method: str, numbers: list[Tensor], batch: Sequence[int], dtype: torch.dtype) -> tuple:
        """Numbers as an array (count, B, 1), or (count, 1, N) where each particle has its own: True then.

        It is kept for as long as the same list of numbers comes.
        """
        known, of, found = self._bodies.get(method, (None, None, None))
        if known is not numbers or of != batch:
            split = _first_shared(numbers, len(batch))
            B, N = math.prod(batch[:split]), math.prod(batch[split:])
            own = N == 1 < B
            array = np.empty((len(numbers), B), DTYPES[dtype])
            shape = (*batch[:split], *(1 for _ in batch[split:]))
            for row, number in zip(array, numbers, strict=True):
                row[...] = number.detach().expand(shape).reshape(B).numpy()
            found = array[:, None, :] if own else array[:, :, None], own
            self._bodies[method] = numbers, batch, found
        return found

    def _loop(self, method: str, traced: Program, own: bool, dtype: torch.dtype):
        key = (id(traced), own, dtype)
        if key not in self._loops:
            began = time.perf_counter()
            scalar = self._numba.from_dtype(np.dtype(DTYPES[dtype]))
            array = scalar[:, :, ::1]
            types = (*(array for _ in traced.words), array, scalar[::1], array)
            compiling = self._numba.njit(self._numba.void(*types), fastmath=FASTMATH, error_model="numpy", nogil=True)
            # the program is kept with its loop: the id of one that is gone could become another's
            literals = np.array(list(traced.source.literals.values()), DTYPES[dtype])
            self._loops[key] = compiling(_loop_source(traced, own)), literals, traced
            took = time.perf_counter() - began
            self.seconds[f"{method} {str(dtype).removeprefix('torch.')}"] = took
            _log.info("numba compiled %s of %d operations in %.1f s", method, traced.operations, took)
        return self._loops[key][:2]


def _loop_source(traced: Program, own: bool):
    source, words = traced.source, traced.words
    loads = [
        f"{name} = {word}[{place}, b, i]" for name, (word, place) in zip(source.arguments, traced.moving, strict=True)
    ]
    numbers = [f"{name} = body[{place}, b, {'i' if own else 0}]" for place, name in enumerate(source.numbers)]
    stores = [f"out[{place}, b, i] = {name}" for place, name in enumerate(source.results)]
    inner = [*(numbers if own else ()), *loads, *source.lines, *stores]
    return function(
        f"loop({', '.join(words)}{', ' if words else ''}body, literals, out)",
        [
            *(f"{name} = literals[{place}]" for place, name in enumerate(source.literals)),
            "for b in range(out.shape[1]):",
            *(f"    {line}" for line in (() if own else numbers)),
            "    for i in range(out.shape[2]):",
            *(f"        {line}" for line in inner),
        ],
        {},
    )


def _first_shared(numbers: Sequence[Tensor], ndim: int) -> int:
    """The first dimension of the batch from which on all particles have the same body."""
    split = 0
    for number in numbers:
        for back, size in enumerate(reversed(number.shape), 1):
            if size != 1:
                split = max(split, ndim - back + 1)
                break
    return split


def _by_column(value: Tensor, batch: Sequence[int], shape: tuple[int, ...]) -> np.ndarray:
    array = value.numpy(force=True)  # without its gradient
    if array.shape[:-1] != batch:
        array = np.broadcast_to(array, (*batch, array.shape[-1]))
    return np.ascontiguousarray(array.transpose(array.ndim - 1, *range(array.ndim - 1)).reshape(shape))

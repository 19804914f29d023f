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
        self.seconds: dict[str, float] = {}

    def __call__(
        self, method: str, traced: Program, joint: Mapping[str, Tensor], numbers: Sequence[Tensor], batch: Sequence[int]
    ) -> Tensor:
        """Outputs (*batch, O) of arguments (..., columns) by word, and of numbers (...), laid out by column."""
        words = sorted({word for word, _ in traced.moving})
        like = next(iter(joint.values()))
        split = _first_shared(numbers, len(batch))
        B, N = math.prod(batch[:split]), math.prod(batch[split:])
        own = N == 1 < B
        if own:
            B, N = 1, B
        given = [_by_column(joint[word], batch, (B, N)) for word in words]
        shape = (*batch[:split], *(1 for _ in batch[split:]))
        body = np.empty((len(numbers), B, N if own else 1), DTYPES[like.dtype])
        for row, number in zip(body, numbers, strict=True):
            row[...] = number.expand(shape).reshape(row.shape).numpy()
        out = np.empty((len(traced.source.results), B, N), DTYPES[like.dtype])
        literals = np.array(list(traced.source.literals.values()), DTYPES[like.dtype])
        self._loop(method, traced, words, own, like.dtype)(*given, body, literals, out)
        return torch.from_numpy(out).reshape(-1, *batch).movedim(0, -1)

    def _loop(self, method: str, traced: Program, words: Sequence[str], own: bool, dtype: torch.dtype):
        key = (id(traced), own, dtype)
        if key not in self._loops:
            began = time.perf_counter()
            scalar = self._numba.from_dtype(np.dtype(DTYPES[dtype]))
            array = scalar[:, :, ::1]
            types = (*(array for _ in words), array, scalar[::1], array)
            compiling = self._numba.njit(
                self._numba.void(*types), fastmath=FASTMATH, error_model="numpy", nogil=True
            )
            # the program is kept with its loop: the id of one that is gone could become another's
            self._loops[key] = compiling(_loop_source(traced, words, own)), traced
            took = time.perf_counter() - began
            self.seconds[f"{method} {str(dtype).removeprefix('torch.')}"] = took
            _log.info("numba compiled %s of %d operations in %.1f s", method, traced.operations, took)
        return self._loops[key][0]


def _loop_source(traced: Program, words: Sequence[str], own: bool):
    source = traced.source
    loads = [f"{name} = {word}[{place}, b, i]" for name, (word, place) in zip(source.arguments, traced.moving, strict=True)]
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


def _by_column(value: Tensor, batch: Sequence[int], shape: tuple[int, int]) -> np.ndarray:
    columns = value.detach().movedim(-1, 0).expand(-1, *batch)
    return columns.reshape(-1, *shape).contiguous().numpy()

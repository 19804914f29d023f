"""A traced program as one loop over particles, compiled by numba: no gradients, a tenth of torch's time or less.

Arguments lie by column, (columns, B, N): B bodies with N particles each, or B = 1 where all have the same body; numbers
of the body are (count, B), or (count, B, N) where each particle has its own. Angles' cosines and sines come in ready:
torch computes them for many at a time. Divisions follow numpy's rules, and NaN and infinity are kept.

Compiled loops live as long as their dynamics. numba could keep them on disk, but as pickles, which run code when they
are read; the few seconds are not worth that.
"""

import logging
import math
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate
from typing import Any

import numpy as np
import torch
from torch import Tensor

from invdyn.models.dynamics.spatial.programs import Program, function

FASTMATH = {"contract", "reassoc", "nsz", "arcp"}  # not nnan and ninf: a simulation that diverges must show it
LANES = 16
"""Particles in a block: in float32 what one vector register of the widest kind holds."""
LONG = 2.0
"""Seconds of compiling from which on the user is told."""
DTYPES = {torch.float32: np.float32, torch.float64: np.float64}

_log = logging.getLogger(__name__)


def engine() -> Any:
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
    """Loops of programs, each compiled at its first use; `seconds` of CPU that this took, by method and dtype."""

    def __init__(self, numba: Any):
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
        B = 1 if own else body.shape[1]
        N = math.prod(batch) // B
        given = [_by_column(joint[word], batch, (B, N)) for word in traced.words]
        out = torch.empty(len(traced.source.results), B, max(N, LANES), dtype=dtype)
        loop, literals = self._loop(method, traced, [len(columns) for columns in given], own, dtype)
        loop(*given, body, literals, out.numpy())
        return out[..., :N].reshape(-1, *batch).movedim(0, -1)

    def _body(self, method: str, numbers: Sequence[Tensor], batch: Sequence[int], dtype: torch.dtype) -> tuple:
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
            found = _filled(array[:, None, :]) if own else array[:, :, None], own
            self._bodies[method] = numbers, batch, found
        return found

    def _loop(self, method: str, traced: Program, sizes: list[int], own: bool, dtype: torch.dtype) -> Any:
        key = (id(traced), own, dtype)
        if key not in self._loops:
            began = time.thread_time()
            scalar = self._numba.from_dtype(np.dtype(DTYPES[dtype]))
            array = scalar[:, :, ::1]
            types = (*(array for _ in traced.words), array, scalar[::1], array)
            compiling = self._numba.njit(self._numba.void(*types), fastmath=FASTMATH, error_model="numpy", nogil=True)
            # the program is kept with its loop: the id of one that is gone could become another's
            literals = np.array(list(traced.source.literals.values()), DTYPES[dtype])
            self._loops[key] = compiling(_loop_source(traced, sizes, own)), literals, traced
            took = time.thread_time() - began
            self.seconds[f"{method} {str(dtype).removeprefix('torch.')}"] = took
            said = "numba compiled %s of %d operations in %.1f s of CPU: once for as long as these dynamics live"
            _log.log(logging.WARNING if took > LONG else logging.INFO, said, method, traced.operations, took)
        return self._loops[key][:2]


def _loop_source(traced: Program, sizes: Sequence[int], own: bool) -> Callable:
    """The loop over bodies, blocks of particles, and the lanes of a block; `sizes` are the columns of each word.

    A block's columns are copied next to each other first: of columns that lie anywhere, the compiler cannot know that
    results do not overwrite arguments, and would take one particle at a time.
    """
    source, words = traced.source, traced.words
    given = [*zip(words, sizes, strict=True), *([("body", len(source.numbers))] if own else [])]
    first = dict(zip(dict(given), accumulate((size for _, size in given), initial=0), strict=False))
    results = sum(size for _, size in given)
    named = [(name, first[word] + place) for name, (word, place) in zip(source.arguments, traced.moving, strict=True)]
    numbers = list(enumerate(source.numbers))
    if own:
        named += [(name, first["body"] + place) for place, name in numbers]
    copies = [f"block[{first[word]} + k, lane] = {word}[k, b, start + lane]" for word, _ in given]
    return function(
        f"loop({', '.join([*words, 'body', 'literals', 'out'])})",
        [
            *(f"{name} = literals[{place}]" for place, name in enumerate(source.literals)),
            f"block = zeros(({results + len(source.results)}, {LANES}), out.dtype)",
            "for b in range(out.shape[1]):",
            *(f"    {name} = body[{place}, b, 0]" for place, name in numbers if not own),
            f"    for begin in range(0, out.shape[2], {LANES}):",
            f"        start = min(begin, out.shape[2] - {LANES})",  # the last block is a whole one, too
            *(
                line
                for (_, size), copy in zip(given, copies, strict=True)
                for line in (
                    f"        for k in range({size}):",
                    f"            for lane in range({LANES}):",
                    f"                {copy}",
                )
            ),
            f"        for lane in range({LANES}):",
            *(f"            {name} = block[{place}, lane]" for name, place in named),
            *(f"            {line}" for line in source.lines),
            *(f"            block[{results + place}, lane] = {name}" for place, name in enumerate(source.results)),
            f"        for k in range({len(source.results)}):",
            f"            for lane in range({LANES}):",
            f"                out[k, b, start + lane] = block[{results} + k, lane]",
        ],
        {"zeros": np.zeros},
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
    array = value.numpy(force=True)  # without its gradient
    if array.shape[:-1] != batch:
        array = np.broadcast_to(array, (*batch, array.shape[-1]))
    array = array.transpose(array.ndim - 1, *range(array.ndim - 1))
    return _filled(np.ascontiguousarray(array.reshape(-1, *shape)))


def _filled(array: np.ndarray) -> np.ndarray:
    """The same, with zeros up to one block where there are fewer particles."""
    if array.shape[-1] >= LANES:
        return array
    whole = np.zeros((*array.shape[:-1], LANES), array.dtype)
    whole[..., : array.shape[-1]] = array
    return whole

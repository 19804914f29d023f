"""A filter's row as one compiled graph, by ``torch.compile``'s own compiler, inductor.

The row runs once under a tracer that records its tensor operations, from any Python code (the model's
classes, cached files, Pyro's distributions). The record is rewritten column by column (:mod:`.column_layout`), and the
compiler gets that. No Python is left for ``torch.compile`` to read, or to guard in each row, which would take a tenth
of a row's time at a thousand particles. The number of the row comes in as a tensor: an int would be frozen into the
graph.

Random numbers are drawn by torch's own generator, in the order of the plain row: same seed, same particles, but
for the rounding of operations that were joined.
"""

import warnings
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.fx import GraphModule

from invdyn.inference.filters.column_layout import by_columns, recorded, stored_by_columns

Particles = dict[str, Tensor]
Advance = Callable[[Tensor, Tensor, Tensor | None, Particles, Tensor], tuple]
"""Row's number (1,), its y (O,), what of it was seen, particles and log-weights before → particles and further tensors.
"""

OPTIONS = {"fallback_random": True}
"""Inductor's: random numbers from torch's own generator, not from one that inductor would write into its kernels."""


class CompiledRows:
    """Rows of ``advance``, compiled at the first of each kind.

    Where there is no compiler, or it fails, there is one warning and the rows run as they are.
    """

    def __init__(self, advance: Advance):
        self._advance = advance
        self._known: dict[Any, tuple[Advance, tuple]] = {}
        self._failed = False

    def __call__(
        self,
        owners: tuple,
        t: Tensor,
        y: Tensor,
        seen: Tensor | None,
        particles: Particles,
        log_weights: Tensor,
    ) -> tuple:
        """``advance(t, y, seen, particles, log_weights)`` of a row in the middle, by the graph of rows like it.

        ``owners`` are the objects that ``advance`` finds by itself: for others, another graph. They must not change:
        a graph holds what it has met of them, such as parameters.
        """
        particles = {name: stored_by_columns(value) for name, value in particles.items()}
        shapes = tuple((name, value.shape, value.dtype, value.device) for name, value in particles.items())
        key = (seen is None, shapes, y.dtype, *map(id, owners))
        if key not in self._known:
            row = None if self._failed else self._compiled(t, y, seen, particles, log_weights)
            self._failed = row is None
            # Owners are kept: the id of one that is gone could become another's.
            self._known[key] = row or self._advance, owners
        row, _ = self._known[key]
        return row(t, y, seen, particles, log_weights)

    def _compiled(
        self, t: Tensor, y: Tensor, seen: Tensor | None, particles: Particles, log_weights: Tensor
    ) -> Advance | None:
        """The graph of rows like this one, called as ``advance`` is; None where it cannot be had."""
        names, left = list(particles), list[str]()

        def flat(t: Tensor, y: Tensor, log_weights: Tensor, *rest: Tensor) -> tuple:
            values = dict(zip(names, rest, strict=False))
            entries_seen = rest[len(names)] if len(rest) > len(names) else None
            after, *others = self._advance(t, y, entries_seen, values, log_weights)
            left[:] = after
            return *after.values(), *others

        arguments = (t, y, log_weights, *particles.values(), *(() if seen is None else (seen,)))
        graph = compiled(flat, arguments, log_weights.shape)
        if graph is None:
            return None
        keys, count = list(left), len(left)

        def row(t: Tensor, y: Tensor, seen: Tensor | None, particles: Particles, log_weights: Tensor) -> tuple:
            values = graph(t, y, log_weights, *particles.values(), *(() if seen is None else (seen,)))
            return dict(zip(keys, values[:count], strict=True)), *values[count:]

        return row


def compiled(function: Callable[..., tuple], example: tuple[Tensor, ...], batch: torch.Size) -> Callable | None:
    """``function`` of tensors as a graph, for tensors of the shapes, types and devices of ``example``.

    Warns and returns None where it cannot be had. Torch's random state is left as it was. ``batch`` as for
    :func:`.column_layout.by_columns`.
    """
    devices = {value.device for value in example if value.is_cuda}
    try:
        with torch.random.fork_rng(devices=list(devices)):
            record = recorded(function, example)
            record.graph.eliminate_dead_code()
            graph = compile_record(by_columns(record, example, batch), example)
            graph(*example)  # so that what it calls at first use fails here
    except Exception as error:  # compilers fail in many classes; none of them is a reason not to filter
        reason = next(iter(str(error).strip().splitlines()), "") or type(error).__name__
        warnings.warn(f"the filter runs uncompiled: {reason}", RuntimeWarning, stacklevel=2)
        return None
    return graph


def compile_record(record: GraphModule, example: tuple[Tensor, ...]) -> Callable:
    """Inductor's form of a record of tensor operations."""
    with warnings.catch_warnings():
        # torch imports what it deprecates itself; where warnings are errors that would be a failure to compile.
        warnings.simplefilter("ignore", DeprecationWarning)
        from torch._inductor import compile as by_inductor

        return by_inductor(record, list(example), options=OPTIONS)

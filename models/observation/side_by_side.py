"""Rows of sensors with a distribution each, independent given the state.

    p(y) = Π_i p_i(y_i)

Shapes: rows (..., O), O the sum of the parts'; batches broadcast.
"""

from collections.abc import Sequence
from functools import reduce
from typing import Any

import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.observation.missing import RowDistribution, explained, gaussian_rows, observed_log_prob
from invdyn.models.shapes import apply, common, join


class SideBySide(RowDistribution):
    """See the top of the file.

    Args:
        parts: distributions of event shape (n,) each.
    """

    def __init__(self, parts: Sequence[Distribution]):
        batch = torch.Size(common(*(part.batch_shape for part in parts)))
        self.parts = [part.expand(batch) for part in parts]
        self.sizes = [part.event_shape[-1] for part in parts]
        super().__init__(batch, torch.Size([sum(self.sizes)]), validate_args=False)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> Any:
        """See :class:`torch.distributions.Distribution`."""
        return SideBySide([part.expand(torch.Size(batch_shape)) for part in self.parts])

    @property
    def loc(self) -> Tensor:
        """The parts' middles, (..., O)."""
        return join(*(getattr(part, "base_dist", part).loc for part in self.parts))

    @property
    def mean(self) -> Tensor:
        """Mean row (..., O)."""
        return join(*(part.mean for part in self.parts))

    @property
    def variance(self) -> Tensor:
        """Of each entry, (..., O)."""
        return join(*(part.variance for part in self.parts))

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the entries that are not NaN."""
        pieces = value.split(self.sizes, -1)
        each = (_log_prob(part, piece) for part, piece in zip(self.parts, pieces, strict=True))
        return reduce(torch.add, each)

    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of the parts, W as a vector where all of them are, else block by block."""
        pieces = value.split(self.sizes, -1)
        found = [gaussian_rows(part, piece) for part, piece in zip(self.parts, pieces, strict=True)]
        target = join(*(explained(part, piece) for part, piece in zip(self.parts, pieces, strict=True)))
        whitening = [each for each, _ in found]
        constant = reduce(torch.add, [each for _, each in found])
        rank = max(len(self.batch_shape), value.ndim - 1) + 1
        flat = [each.ndim == rank for each in whitening]
        if all(flat):
            return join(*whitening), target, constant
        blocks = [torch.diag_embed(each) if plain else each for each, plain in zip(whitening, flat, strict=True)]
        batch = common(*(block.shape[:-2] for block in blocks))
        whole, start = target.new_zeros(*batch, self.event_shape[-1], self.event_shape[-1]), 0
        for block, size in zip(blocks, self.sizes, strict=True):
            whole[..., start : start + size, start : start + size] = block
            start += size
        return whole, target, constant

    @torch.no_grad()
    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draw rows (sample_shape, ..., O)."""
        return torch.cat([part.sample(torch.Size(sample_shape)) for part in self.parts], -1)


def _log_prob(part: Distribution, value: Tensor) -> Tensor:
    """Log-density (...) of one part over the entries seen, without synchronisation with the device."""
    if not isinstance(part, torch.distributions.MultivariateNormal):
        return observed_log_prob(part, value, ~torch.isnan(value))
    whitening, constant = gaussian_rows(part, value)
    off = torch.where(torch.isnan(value), 0.0, value - part.loc)
    return constant - 0.5 * apply(whitening, off).square().sum(-1)

"""Detections with heavy tails: each keypoint's error follows a multivariate Student's t.

    y_p ~ t_ν(h_p, diag σ_p²),     log p = log Γ((ν + d)/2) − log Γ(ν/2) − ½ d log νπ − Σ log σ − ½ (ν + d) log(1 + q/ν)

with q = Σ ((y_p − h_p)/σ_p)² over the d coordinates that were seen (Kotz & Nadarajah 2004, "Multivariate t
distributions", §1). It is a scale mixture of normals, with one scale for all coordinates of a detection.
Other entries of a row, encoders', are normal.

Shapes: rows (..., O) = P keypoints' d coordinates, then E other entries; ν (...), or a number for all rows.
"""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from invdyn.models.observation.missing import RowDistribution
from invdyn.models.shapes import common


class MultivariateT(RowDistribution):
    """Distribution of observation rows; see the top of the file.

    Args:
        loc, scale: (..., O) middle and widths σ of a row.
        shape: (P, d).
        degrees: ν (...) > 0.
    """

    def __init__(self, loc: Tensor, scale: Tensor, shape: tuple[int, int], degrees: Tensor):
        batch = common(loc.shape[:-1], scale.shape[:-1], degrees.shape)
        self.loc, self.scale = loc.expand(*batch, -1), scale.expand(*batch, -1)
        self.layout, self.degrees = shape, degrees.expand(batch)
        super().__init__(batch, loc.shape[-1:], validate_args=False)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> Any:
        """See :class:`torch.distributions.Distribution`."""
        size = self.loc.shape[-1]
        loc, scale = (value.expand(*batch_shape, size) for value in (self.loc, self.scale))
        return MultivariateT(loc, scale, self.layout, self.degrees.expand(torch.Size(batch_shape)))

    def _seen(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        """What was seen (..., O), standardised errors, and of each keypoint (..., P) how much, its q, and ν."""
        seen = ~torch.isnan(value)
        off = (torch.where(seen, value, self.loc) - self.loc) / self.scale
        count, square = (self._detections(each).sum(-1) for each in (seen.to(off), off.square()))
        return seen.expand(off.shape), off, count, square, self.degrees.unsqueeze(-1)

    def _detections(self, row: Tensor) -> Tensor:
        """Keypoints (..., P, d) of a row."""
        return row[..., : math.prod(self.layout)].unflatten(-1, self.layout)

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the entries that are not NaN."""
        seen, off, count, square, nu = self._seen(value)
        points = torch.lgamma((nu + count) / 2) - torch.lgamma(nu / 2) - 0.5 * count * torch.log(nu * math.pi)
        points = points - 0.5 * (nu + count) * torch.log1p(square / nu)
        others = (-0.5 * off.square() - 0.5 * math.log(2 * math.pi))[..., math.prod(self.layout) :]
        widths = (torch.log(self.scale) * seen).sum(-1)
        return points.sum(-1) + (others * seen[..., math.prod(self.layout) :]).sum(-1) - widths

    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W, ỹ (..., O) and c (...): those of reweighted least squares, w = (ν + d)/(ν + q)/σ², a bound from below."""
        seen, off, count, square, nu = self._seen(value)
        weight = ((nu + count) / (nu + square)).repeat_interleave(self.layout[1], -1)
        weight = torch.cat([weight, torch.ones_like(off[..., weight.shape[-1] :])], -1)
        whitening = seen * weight.sqrt() / self.scale
        target = torch.where(seen, value, 0.0)
        return whitening, target, self.log_prob(value) + 0.5 * (weight * off.square()).sum(-1)

    @property
    def mean(self) -> Tensor:
        """Middle of the row (..., O), which is its mean where ν > 1."""
        return self.loc

    @torch.no_grad()
    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draw rows (sample_shape, ..., O)."""
        off = torch.randn(self._extended_shape(torch.Size(sample_shape)), dtype=self.loc.dtype, device=self.loc.device)
        half = (self.degrees / 2).unsqueeze(-1).expand(*off.shape[:-1], self.layout[0])
        wider = torch.sqrt(half / torch._standard_gamma(half))
        points, others = self._detections(off) * wider.unsqueeze(-1), off[..., math.prod(self.layout) :]
        return self.loc + self.scale * torch.cat([points.flatten(-2), others], -1)

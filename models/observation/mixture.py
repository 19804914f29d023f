"""Keypoints of a tracker with occasional errors: a mixture over the errors that a row may contain.

An outlier has an additional error of sd s in each coordinate, with probability ρ for each keypoint; a swap exchanges
the detections of two keypoints, with probability ρ for the row; a shift moves all keypoints of a row together, with
one probability. With h_p, σ_p the mean and the deviations of keypoint p, and π_a the keypoint whose detection is at p
under the row's alternative a (none swapped, or one swap),

    p(y) = Σ_a w_a Π_p [ (1 − ρ) N(y_p; h_{π_a(p)}, σ²_{π_a(p)}) + ρ N(y_p; h_{π_a(p)}, σ²_{π_a(p)} + s²) ]

Several kinds of outliers are independent errors, whose variances add. A row that is shifted by ξ v, with ξ ~ N(0, 1)
for all of its keypoints, has correlated detections, for each choice of outliers:

    N(y; h, S + v vᵀ),    S = diag(σ² + s² of outliers + w²)

A missing coordinate, NaN, drops out.

Shapes: rows (..., O) = P keypoints' d coordinates, then E other entries, encoders', which have no such errors; ρ, s
(..., 1).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import product
from typing import Any

import torch
from torch import Tensor

from invdyn.models.observation.missing import RowDistribution
from invdyn.models.observation.view import Outlier, Shift, Swap
from invdyn.models.shapes import common


@dataclass(frozen=True)
class _Alternative:
    """One explanation of a row's keypoints.

    Attributes:
        log_density: (...) of the row's detections and this alternative.
        order: the keypoint whose detection is at each place.
        precision: (..., P, d) of each detection.
        pull: (..., P, d) u, if the detections are correlated, whose precision is then diag(precision) − u uᵀ.
    """

    log_density: Tensor
    order: list[int]
    precision: Tensor
    pull: Tensor | None = None


class MistakenRows(RowDistribution):
    """Distribution of observation rows; see the top of the file.

    Args:
        loc, scale: (..., O) mean and standard deviations of a row without mistakes.
        shape: (P, d).
        outliers, swaps, shift: the possible errors; keypoints of swaps by their place in the row.
    """

    def __init__(
        self,
        loc: Tensor,
        scale: Tensor,
        shape: tuple[int, int],
        outliers: Sequence[Outlier],
        swaps: Sequence[Swap],
        shift: Shift | None = None,
    ):
        shifts = [shift] if shift else []
        rates = [each.rate[..., 0] for errors in (outliers, swaps, shifts) for each in errors]
        batch = common(loc.shape[:-1], scale.shape[:-1], *(rate.shape for rate in rates))
        self.loc, self.scale = loc.expand(*batch, -1), scale.expand(*batch, -1)
        self.layout, self.outliers, self.swaps, self.shift = shape, tuple(outliers), tuple(swaps), shift
        super().__init__(batch, loc.shape[-1:], validate_args=False)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> Any:
        """See :class:`torch.distributions.Distribution`."""
        size = self.loc.shape[-1]
        loc, scale = (value.expand(*batch_shape, size) for value in (self.loc, self.scale))
        return MistakenRows(loc, scale, self.layout, self.outliers, self.swaps, self.shift)

    @property
    def points(self) -> int:
        """P."""
        return self.layout[0]

    # -- the alternatives ----------------------------------------------------------------------
    @property
    def orders(self) -> list[list[int]]:
        """π_a: the keypoint whose detection is at each place; the first has none swapped."""
        orders = [list(range(self.points)) for _ in range(1 + len(self.swaps))]
        for order, swap in zip(orders[1:], self.swaps, strict=True):
            order[swap.one], order[swap.other] = swap.other, swap.one
        return orders

    def _log_weights(self) -> list[Tensor]:
        """Log w_a (...), those of swaps kept finite."""
        rates = [swap.rate[..., 0] for swap in self.swaps]
        none = 1 - sum(rates[1:], start=rates[0]) if rates else torch.ones_like(self.loc[..., 0])
        return [_log(none), *map(_log, rates)]

    def _widths(self, scale: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Log-probability (..., 1) and deviations (..., P, d) of every combination of outliers."""
        widths = [(torch.zeros_like(scale[..., 0]), scale)]
        for outlier in self.outliers:
            hit = [(weight + _log(outlier.rate), torch.hypot(sd, outlier.scale.expand_as(sd))) for weight, sd in widths]
            widths = [(weight + _log(1 - outlier.rate), sd) for weight, sd in widths] + hit
        return widths

    def _split(self, row: Tensor) -> tuple[Tensor, Tensor]:
        """A row as keypoints (..., P, d) and angles (..., E)."""
        mistakable = math.prod(self.layout)
        return row[..., :mistakable].unflatten(-1, self.layout), row[..., mistakable:]

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the coordinates that are not NaN."""
        return self._total(value, self._explain(value))

    def _total(self, value: Tensor, found: "Sequence[_Alternative]") -> Tensor:
        _, angles = self._split(value)
        mean, sd = self._split(self.loc)[1], self._split(self.scale)[1]
        return torch.stack([each.log_density for each in found]).logsumexp(0) + _normal(angles, mean, sd).sum(-1)

    def _explain(self, value: Tensor) -> "list[_Alternative]":
        """The alternatives: for every order without shift, and with it."""
        y, loc, scale = (self._split(each)[0] for each in (value, self.loc, self.scale))
        unshifted = _log(1 - self.shift.rate[..., 0]) if self.shift else 0.0
        found = []
        for order, weight in zip(self.orders, self._log_weights(), strict=True):
            widths = self._widths(scale[..., order, :])
            options = [w + _normal(y, loc[..., order, :], width).sum(-1) for w, width in widths]
            stacked = torch.stack(options)
            share = stacked.softmax(0).unsqueeze(-1)
            precision = sum(r / width**2 for r, (_, width) in zip(share, widths, strict=True))
            found.append(_Alternative(weight + unshifted + stacked.logsumexp(0).sum(-1), order, precision))
            if (shift := self.shift) is None:
                continue
            for which in product(widths, repeat=self.points):
                width = torch.stack([width[..., p, :] for p, (_, width) in enumerate(which)], -2)
                chance = sum(w[..., p] for p, (w, _) in enumerate(which)) + _log(shift.rate[..., 0]) + weight
                width = torch.hypot(width, shift.independent[..., order, :])
                density, pull = _shifted(y, loc[..., order, :], width, shift.along[..., order, :])
                found.append(_Alternative(chance + density, order, width**-2, pull))
        return found

    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W (..., O), ỹ (..., O) and c (...) with log p(y) ≥ −½|W (ỹ − h)|² + c in h, and equal at ``loc``.

        The bound of expectation–maximisation: a detection counts for each keypoint that it may belong to, in the shares
        that the alternatives have given the row. ỹ is 0 where W is. Of rows that may be shifted W is a matrix
        (..., O, O), upper triangular, with rows and columns of zeros for what is missing.
        """
        found = self._explain(value)
        total, shares = self._total(value, found), torch.stack([each.log_density for each in found]).softmax(0)
        y, angles = self._split(value)
        seen = ~torch.isnan(y)
        filled = torch.where(seen, y, 0.0)
        weight, pulled = torch.zeros_like(self._split(self.loc)[0]), torch.zeros_like(self._split(self.loc)[0])
        joint: Any = 0.0
        for each, share in zip(found, shares, strict=True):
            back = sorted(range(self.points), key=each.order.__getitem__)
            own = share[..., None, None] * each.precision * seen
            weight, pulled = weight + own[..., back, :], pulled + (own * filled)[..., back, :]
            if each.pull is not None:
                moved = share.sqrt()[..., None, None] * each.pull
                pulled = pulled - (moved * (moved * filled).sum((-2, -1), keepdim=True))[..., back, :]
                moved = moved[..., back, :].flatten(-2)
                joint = joint + moved.unsqueeze(-1) * moved.unsqueeze(-2)
        sd = self._split(self.scale)[1]
        known = (~torch.isnan(angles)) / sd
        given = torch.where(torch.isnan(angles), 0.0, angles).expand_as(sd)
        parts = weight.flatten(-2), pulled.flatten(-2), known, given
        if self.shift is None:
            whitening, target = _whitened(*parts)
            off = whitening * (target - self.loc)
        else:
            whitening, target = _whitened_together(*parts, joint)
            off = (whitening @ (target - self.loc).unsqueeze(-1))[..., 0]
        return whitening, target, total + 0.5 * off.square().sum(-1)

    def outlier_probability(self, value: Tensor) -> Tensor:
        """Probability (..., P) of each keypoint that its detection is an outlier, in rows not swapped or shifted.

        NaN unseen.
        """
        y, loc, scale = (self._split(each)[0] for each in (value, self.loc, self.scale))
        options = [w + _normal(y, loc, width).sum(-1) for w, width in self._widths(scale)]
        none = torch.stack(options).softmax(0)[0]
        return torch.where(torch.isnan(y).all(-1), torch.nan, 1 - none)

    # -- drawing -------------------------------------------------------------------------------
    @property
    def mean(self) -> Tensor:
        """Mean row (..., O)."""
        loc, angles = self._split(self.loc)
        rows = [
            w.exp()[..., None, None] * loc[..., o, :] for o, w in zip(self.orders, self._log_weights(), strict=True)
        ]
        return torch.cat([reduce(torch.add, rows).flatten(-2), angles], -1)

    @torch.no_grad()
    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draw rows (sample_shape, ..., O)."""
        shape = self._extended_shape(torch.Size(sample_shape))
        row = self.loc + self.scale * torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device)
        points, angles = self._split(row)
        for outlier in self.outliers:
            hit = torch.rand_like(points[..., :1]) < outlier.rate.unsqueeze(-1)
            points = points + hit * outlier.scale * torch.randn_like(points)
        if self.shift is not None:
            hit = (torch.rand_like(points[..., :1, :1]) < self.shift.rate.unsqueeze(-1)).to(points)
            points = points + hit * self.shift.along * torch.randn_like(points[..., :1, :1])
            points = points + hit * self.shift.independent * torch.randn_like(points)
        chance = torch.rand_like(points[..., 0, 0])
        passed: Tensor | float = 0.0
        whole = points
        for order, swap in zip(self.orders[1:], self.swaps, strict=True):
            rate = swap.rate[..., 0]
            hit = (chance >= passed) & (chance < passed + rate)
            points = torch.where(hit[..., None, None], whole[..., order, :], points)
            passed = passed + rate
        return torch.cat([points.flatten(-2), angles], -1)


def _normal(y: Tensor, loc: Tensor, scale: Tensor) -> Tensor:
    """Log N(y; loc, scale²) entry by entry, 0 where y is missing."""
    seen = ~torch.isnan(y)
    standard = (torch.where(seen, y, loc) - loc) / scale
    return -(0.5 * standard**2 + torch.log(scale) + 0.5 * math.log(2 * math.pi)) * seen


def _shifted(y: Tensor, loc: Tensor, width: Tensor, along: Tensor) -> tuple[Tensor, Tensor]:
    """Log N(y; loc, diag(width²) + v vᵀ) (...) of (..., P, d) that are not missing, v = ``along``; u of its precision.

    By Sherman and Morrison, with S = diag(width²): (S + v vᵀ)⁻¹ = S⁻¹ − u uᵀ, u = S⁻¹ v / √(1 + vᵀ S⁻¹ v).
    """
    seen = ~torch.isnan(y)
    moved = along * seen / width**2
    more = 1 + (along * moved).sum((-2, -1))
    off = ((torch.where(seen, y, loc) - loc) * moved).sum((-2, -1))
    log_density = _normal(y, loc, width).sum((-2, -1)) - 0.5 * torch.log(more) + 0.5 * off**2 / more
    return log_density, moved / more.sqrt()[..., None, None]


def _whitened(weight: Tensor, pulled: Tensor, known: Tensor, given: Tensor) -> tuple[Tensor, Tensor]:
    """W and ỹ (..., O) from keypoints' precisions (..., P·d) and their pulls, and angles' 1/σ and values (..., E)."""
    aim = torch.where(weight > 0, pulled / weight.clamp_min(torch.finfo(weight.dtype).tiny), 0.0)
    return torch.cat([weight.sqrt(), known], -1), torch.cat([aim, given], -1)


def _whitened_together(
    weight: Tensor, pulled: Tensor, known: Tensor, given: Tensor, joint: Tensor
) -> tuple[Tensor, Tensor]:
    """W (..., O, O) and ỹ (..., O) where the keypoints' precision is diag(weight) − ``joint`` (..., P·d, P·d)."""
    there = weight > 0
    # Missing entries become independent, and their rows are then set to zero.
    tril = torch.linalg.cholesky(torch.diag_embed(torch.where(there, weight, 1.0)) - joint)
    aim = torch.cholesky_solve(pulled.unsqueeze(-1), tril)[..., 0]
    size, points = known.shape[-1] + weight.shape[-1], weight.shape[-1]
    whitening = weight.new_zeros(*weight.shape[:-1], size, size)
    whitening[..., :points, :points] = tril.mT * there.unsqueeze(-2)
    whitening.diagonal(dim1=-2, dim2=-1)[..., points:] = known
    return whitening, torch.cat([aim, given.expand(*aim.shape[:-1], -1)], -1)


def _log(probability: Tensor) -> Tensor:
    """Logarithm of a probability, kept finite, so that a probability of zero has a finite slope."""
    return probability.clamp_min(torch.finfo(probability.dtype).tiny).log()

"""Keypoints of a tracker that errs now and then: a mixture over what it may have got wrong in a row.

A stray detection is off by s more, in each coordinate, with probability ρ for each keypoint; a swap exchanges the
detections of two keypoints, with probability ρ for the row. With h_p, σ_p the mean and the deviations of keypoint p,
and π_a the keypoint whose detection stands at p under the row's alternative a (none swapped, or one swap),

    p(y) = Σ_a w_a Π_p [ (1 − ρ) N(y_p; h_{π_a(p)}, σ²_{π_a(p)}) + ρ N(y_p; h_{π_a(p)}, σ²_{π_a(p)} + s²) ]

Several effects that stray make one width: ρ and s of independent errors, in turn. A missing coordinate, NaN, drops out.

Shapes: rows (..., O) = P keypoints' (x, y), then E encoder angles, which are never mistaken; ρ, s (..., 1).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from pyro.distributions import TorchDistribution
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.shapes import common


@dataclass(frozen=True)
class Stray:
    """Detections from elsewhere: probability (..., 1) of each keypoint in each row, and width, m.

    The width is (..., 1, 1) for all alike, or (..., P, 2) for each coordinate.
    """

    rate: Tensor
    scale: Tensor


@dataclass(frozen=True)
class Swap:
    """Two keypoints, by number, exchanged with a probability (..., 1) in each row."""

    one: int
    other: int
    rate: Tensor


class MistakenRows(TorchDistribution):
    """Distribution of observation rows; see the top of the file.

    Args:
        loc, scale: (..., O) mean and standard deviations of a row without mistakes.
        points: P.
        strays, swaps: what may go wrong; the keypoints of swaps by their place in the row.
    """

    support = constraints.real_vector
    has_rsample = False
    arg_constraints: dict = {}  # noqa: RUF012

    def __init__(self, loc: Tensor, scale: Tensor, points: int, strays: Sequence[Stray], swaps: Sequence[Swap]):
        rates = [mistake.rate[..., 0] for mistake in (*strays, *swaps)]
        batch = common(loc.shape[:-1], scale.shape[:-1], *(rate.shape for rate in rates))
        self.loc, self.scale = loc.expand(*batch, -1), scale.expand(*batch, -1)
        self.points, self.strays, self.swaps = points, tuple(strays), tuple(swaps)
        super().__init__(batch, loc.shape[-1:], validate_args=False)

    def expand(self, batch_shape, _instance=None):
        """See :class:`torch.distributions.Distribution`."""
        size = self.loc.shape[-1]
        loc, scale = (value.expand(*batch_shape, size) for value in (self.loc, self.scale))
        return MistakenRows(loc, scale, self.points, self.strays, self.swaps)

    # -- the alternatives ----------------------------------------------------------------------
    @property
    def orders(self) -> list[list[int]]:
        """π_a: whose detection stands at each keypoint's place; the first is none swapped."""
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
        """Log-probability (..., 1) and deviations (..., P, 2) of every combination of strays."""
        widths = [(torch.zeros_like(scale[..., 0]), scale)]
        for stray in self.strays:
            hit = [(weight + _log(stray.rate), torch.hypot(sd, stray.scale.expand_as(sd))) for weight, sd in widths]
            widths = [(weight + _log(1 - stray.rate), sd) for weight, sd in widths] + hit
        return widths

    def _split(self, row: Tensor) -> tuple[Tensor, Tensor]:
        """A row as keypoints (..., P, 2) and angles (..., E)."""
        return row[..., : 2 * self.points].unflatten(-1, (self.points, 2)), row[..., 2 * self.points :]

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the coordinates that are not NaN."""
        return self._explain(value)[0]

    def _explain(self, value: Tensor) -> tuple[Tensor, list[Tensor], list[Tensor]]:
        """Log-density, each alternative's probability given the row (...), and precisions (..., P, 2) under it."""
        (y, angles), (loc, mean), (scale, sd) = map(self._split, (value, self.loc, self.scale))
        logs, precisions = [], []
        for order, weight in zip(self.orders, self._log_weights(), strict=True):
            options = [
                (w + _normal(y, loc[..., order, :], width).sum(-1), width)
                for w, width in self._widths(scale[..., order, :])
            ]
            stacked = torch.stack([log for log, _ in options])
            logs.append(weight + stacked.logsumexp(0).sum(-1))
            share = stacked.softmax(0).unsqueeze(-1)
            precisions.append(sum(r / width**2 for r, (_, width) in zip(share, options, strict=True)))
        stacked = torch.stack(logs)
        total = stacked.logsumexp(0) + _normal(angles, mean, sd).sum(-1)
        return total, list(stacked.softmax(0)), precisions

    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W (..., O), ỹ (..., O) and c (...) with log p(y) ≥ −½|W (ỹ − h)|² + c in h, and equal at ``loc``.

        The bound of expectation–maximisation: what a detection says goes, in the shares that the alternatives have
        given the row, to the keypoints that it may be of. ỹ is 0 where W is.
        """
        total, shares, precisions = self._explain(value)
        y, angles = self._split(value)
        seen = ~torch.isnan(y)
        filled = torch.where(seen, y, 0.0)
        weight, pulled = torch.zeros_like(self._split(self.loc)[0]), torch.zeros_like(self._split(self.loc)[0])
        for order, share, precision in zip(self.orders, shares, precisions, strict=True):
            back = sorted(range(self.points), key=order.__getitem__)
            own = share[..., None, None] * precision * seen
            weight, pulled = weight + own[..., back, :], pulled + (own * filled)[..., back, :]
        aim = torch.where(weight > 0, pulled / weight.clamp_min(torch.finfo(weight.dtype).tiny), 0.0)
        sd = self._split(self.scale)[1]
        whitening = torch.cat([weight.sqrt().flatten(-2), (~torch.isnan(angles)) / sd], -1)
        target = torch.cat([aim.flatten(-2), torch.where(torch.isnan(angles), 0.0, angles).expand_as(sd)], -1)
        return whitening, target, total + 0.5 * (whitening * (target - self.loc)).square().sum(-1)

    # -- drawing -------------------------------------------------------------------------------
    @property
    def mean(self) -> Tensor:
        """Mean row (..., O)."""
        loc, angles = self._split(self.loc)
        rows = [
            w.exp()[..., None, None] * loc[..., o, :] for o, w in zip(self.orders, self._log_weights(), strict=True)
        ]
        return torch.cat([sum(rows).flatten(-2), angles], -1)

    @torch.no_grad()
    def sample(self, sample_shape=()) -> Tensor:
        """Draw rows (sample_shape, ..., O)."""
        shape = self._extended_shape(torch.Size(sample_shape))
        row = self.loc + self.scale * torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device)
        points, angles = self._split(row)
        for stray in self.strays:
            hit = torch.rand_like(points[..., :1]) < stray.rate.unsqueeze(-1)
            points = points + hit * stray.scale * torch.randn_like(points)
        chance, passed = torch.rand_like(points[..., 0, 0]), 0.0
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


def _log(probability: Tensor) -> Tensor:
    """Logarithm of a probability, kept finite: what never happens has a finite slope."""
    return probability.clamp_min(torch.finfo(probability.dtype).tiny).log()

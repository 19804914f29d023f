"""Keypoints of a tracker that errs now and then: a mixture over what it may have got wrong in a row.

A stray detection is off by s more, in each coordinate, with probability ρ for each keypoint; a swap exchanges the
detections of two keypoints, with probability ρ for the row; a shift moves all of a row by one chance. With h_p, σ_p
the mean and the deviations of keypoint p, and π_a the keypoint whose detection stands at p under the row's
alternative a (none swapped, or one swap),

    p(y) = Σ_a w_a Π_p [ (1 − ρ) N(y_p; h_{π_a(p)}, σ²_{π_a(p)}) + ρ N(y_p; h_{π_a(p)}, σ²_{π_a(p)} + s²) ]

Several effects that stray make one width: ρ and s of independent errors, in turn. A row that is shifted by ξ v, with
ξ ~ N(0, 1) for all of its keypoints, is one of correlated detections, for each choice of which of them stray:

    N(y; h, S + v vᵀ),    S = diag(σ² + s² of those that stray + w²)

A missing coordinate, NaN, drops out.

Shapes: rows (..., O) = P keypoints' d coordinates, then E other entries, encoders', which are never mistaken; ρ, s
(..., 1).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import torch
from torch import Tensor

from invdyn.models.observation.row_distribution import RowDistribution
from invdyn.models.observation.tracker_errors import Shift, Stray, Swap
from invdyn.models.shapes import common


@dataclass(frozen=True)
class _Alternative:
    """One of the things that a row's keypoints may be.

    Attributes:
        log_density: (...) of the row's detections and this.
        order: whose detection stands at each place.
        precision: (..., P, d) of each detection, by its place.
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
        strays, swaps, shift: what may go wrong; the keypoints of swaps by their place in the row.
    """

    def __init__(
        self,
        loc: Tensor,
        scale: Tensor,
        shape: tuple[int, int],
        strays: Sequence[Stray],
        swaps: Sequence[Swap],
        shift: Shift | None = None,
    ):
        rates = [mistake.rate[..., 0] for mistake in (*strays, *swaps, *([shift] if shift else []))]
        batch = common(loc.shape[:-1], scale.shape[:-1], *(rate.shape for rate in rates))
        self.loc, self.scale = loc.expand(*batch, -1), scale.expand(*batch, -1)
        self.shape, self.strays, self.swaps, self.shift = shape, tuple(strays), tuple(swaps), shift
        super().__init__(batch, loc.shape[-1:], validate_args=False)

    def expand(self, batch_shape, _instance=None):
        """See :class:`torch.distributions.Distribution`."""
        size = self.loc.shape[-1]
        loc, scale = (value.expand(*batch_shape, size) for value in (self.loc, self.scale))
        return MistakenRows(loc, scale, self.shape, self.strays, self.swaps, self.shift)

    @property
    def points(self) -> int:
        """P."""
        return self.shape[0]

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
        """Log-probability (..., 1) and deviations (..., P, d) of every combination of strays."""
        widths = [(torch.zeros_like(scale[..., 0]), scale)]
        for stray in self.strays:
            hit = [(weight + _log(stray.rate), torch.hypot(sd, stray.scale.expand_as(sd))) for weight, sd in widths]
            widths = [(weight + _log(1 - stray.rate), sd) for weight, sd in widths] + hit
        return widths

    def _split(self, row: Tensor) -> tuple[Tensor, Tensor]:
        """A row as keypoints (..., P, d) and angles (..., E)."""
        mistakable = math.prod(self.shape)
        return row[..., :mistakable].unflatten(-1, self.shape), row[..., mistakable:]

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (...) over the coordinates that are not NaN."""
        return self._total(value, self._explain(value))

    def _total(self, value: Tensor, found: "Sequence[_Alternative]") -> Tensor:
        _, angles = self._split(value)
        mean, sd = self._split(self.loc)[1], self._split(self.scale)[1]
        return torch.stack([each.log_density for each in found]).logsumexp(0) + _normal(angles, mean, sd).sum(-1)

    def _explain(self, value: Tensor) -> "list[_Alternative]":
        """What the row's keypoints may be: of every order those that are not shifted, and those that are."""
        y, loc, scale = (self._split(each)[0] for each in (value, self.loc, self.scale))
        timely = _log(1 - self.shift.rate[..., 0]) if self.shift else 0.0
        found = []
        for order, weight in zip(self.orders, self._log_weights(), strict=True):
            widths = self._widths(scale[..., order, :])
            options = [w + _normal(y, loc[..., order, :], width).sum(-1) for w, width in widths]
            stacked = torch.stack(options)
            share = stacked.softmax(0).unsqueeze(-1)
            precision = sum(r / width**2 for r, (_, width) in zip(share, widths, strict=True))
            found.append(_Alternative(weight + timely + stacked.logsumexp(0).sum(-1), order, precision))
            for which in product(widths, repeat=self.points) if self.shift else ():
                width = torch.stack([width[..., p, :] for p, (_, width) in enumerate(which)], -2)
                chance = sum(w[..., p] for p, (w, _) in enumerate(which)) + _log(self.shift.rate[..., 0]) + weight
                width = torch.hypot(width, self.shift.beside[..., order, :])
                density, pull = _shifted(y, loc[..., order, :], width, self.shift.along[..., order, :])
                found.append(_Alternative(chance + density, order, width**-2, pull))
        return found

    def gaussian_rows(self, value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """W (..., O), ỹ (..., O) and c (...) with log p(y) ≥ −½|W (ỹ − h)|² + c in h, and equal at ``loc``.

        The bound of expectation–maximisation: what a detection says goes, in the shares that the alternatives have
        given the row, to the keypoints that it may be of. ỹ is 0 where W is. Of rows that may be shifted W is a matrix
        (..., O, O), upper triangular, with rows and columns of zeros for what is missing.
        """
        found = self._explain(value)
        total, shares = self._total(value, found), torch.stack([each.log_density for each in found]).softmax(0)
        y, angles = self._split(value)
        seen = ~torch.isnan(y)
        filled = torch.where(seen, y, 0.0)
        weight, pulled = torch.zeros_like(self._split(self.loc)[0]), torch.zeros_like(self._split(self.loc)[0])
        joint = 0.0
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

    def stray(self, value: Tensor) -> Tensor:
        """Probability (..., P) that each keypoint's detection strays, in rows not swapped or shifted; NaN unseen."""
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
        if self.shift is not None:
            hit = (torch.rand_like(points[..., :1, :1]) < self.shift.rate.unsqueeze(-1)).to(points)
            points = points + hit * self.shift.along * torch.randn_like(points[..., :1, :1])
            points = points + hit * self.shift.beside * torch.randn_like(points)
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
    # What is missing stands by itself, and is then struck out.
    tril = torch.linalg.cholesky(torch.diag_embed(torch.where(there, weight, 1.0)) - joint)
    aim = torch.cholesky_solve(pulled.unsqueeze(-1), tril)[..., 0]
    size, points = known.shape[-1] + weight.shape[-1], weight.shape[-1]
    whitening = weight.new_zeros(*weight.shape[:-1], size, size)
    whitening[..., :points, :points] = tril.mT * there.unsqueeze(-2)
    whitening.diagonal(dim1=-2, dim2=-1)[..., points:] = known
    return whitening, torch.cat([aim, given.expand(*aim.shape[:-1], -1)], -1)


def _log(probability: Tensor) -> Tensor:
    """Logarithm of a probability, kept finite: what never happens has a finite slope."""
    return probability.clamp_min(torch.finfo(probability.dtype).tiny).log()

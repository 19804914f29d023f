"""A commanded torque as the motors make it: within each row a straight line.

A command is constant from its row to the next. What a delay or a lag makes of it is no longer constant within a row. A
straight line with the same impulse ∫u dt and first moment ∫u t dt stands for it. The line's effect on the arm differs
only in the third order of the row's length.

    u(t_r + s δ_r) = mean_r + slope_r (s − ½),   0 ≤ s < 1

Shapes: times (T,), mean and slope (..., T, K); row r lasts from time r to the next, the last one as long as
the one before it. Before the first row the command was what it is there.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor

from invdyn.models.shapes import common

INSTANT = 1e-5
"""s, under which a stretch of time is as good as none."""
GAUSS = math.sqrt(0.15)
"""Of a row's length: how far from its middle the outer points of Gauss–Legendre quadrature are."""


@dataclass(frozen=True)
class Command:
    """See the top of the file; torques in N·m, times in s."""

    time: Tensor
    mean: Tensor
    slope: Tensor

    @classmethod
    def held(cls, time: Tensor, torque: Tensor) -> "Command":
        """A command (T, K) that is constant within each row."""
        return cls(time, torque, torch.zeros_like(torque))

    @property
    def length(self) -> Tensor:
        """Length of each row, (T, 1) s."""
        step = self.time.diff()
        return torch.cat([step, step[-1:]]).unsqueeze(-1)

    def to(self, device: torch.device | str) -> "Command":
        """The same on ``device``."""
        return Command(self.time.to(device), self.mean.to(device), self.slope.to(device))

    def row(self, t: int | Tensor) -> tuple[Tensor, Tensor]:
        """Mean and slope of the row before row ``t``, (..., K), of the shape of states (..., K)."""
        rows = [value.movedim(-1, 0)[..., t - 1].movedim(0, -1) for value in (self.mean, self.slope)]
        single = isinstance(t, int) or t.ndim == 0
        mean, slope = (row.unsqueeze(-2) if single and row.ndim > 1 else row for row in rows)
        return mean, slope

    def split(self, parts: int) -> "Command":
        """The same lines in rows a ``parts``-th as long."""
        inside = (torch.arange(parts, device=self.mean.device, dtype=self.mean.dtype) + 0.5) / parts
        time = self.time[:, None] + self.length * (inside - 0.5 / parts).to(self.time)
        mean = self.mean.unsqueeze(-2) + self.slope.unsqueeze(-2) * (inside - 0.5)[:, None]
        slope = (self.slope / parts).unsqueeze(-2).expand(mean.shape)
        return Command(time.flatten(), mean.flatten(-3, -2), slope.flatten(-3, -2))

    def changed(self, function: Callable[[Tensor], Tensor]) -> "Command":
        """``function(torque)`` for what acts at once, such as a gain; its line in a row by three points of Gauss."""
        before, middle, after = (function(self.mean + s * self.slope) for s in (-GAUSS, 0.0, GAUSS))
        return replace(self, mean=(5 * before + 8 * middle + 5 * after) / 18, slope=(after - before) / (2 * GAUSS))

    def delayed(self, delay: Tensor) -> "Command":
        """The command ``delay`` seconds later, (K,) or (..., 1, K)."""
        edges = self._edges
        return self._over(self.time, edges[:-1, None] - delay, edges[1:, None] - delay)

    def paced(self, rate: Tensor) -> "Command":
        """The command as rows have it whose clock is right at the first one and runs ``rate`` times too fast."""
        edges = self._edges.unsqueeze(-1)
        true = edges[:1] + (edges - edges[:1]) / rate
        return self._over(self.time, true[..., :-1, :], true[..., 1:, :])

    def onto(self, time: Tensor) -> "Command":
        """The command on other rows (R,), whose lines have the impulse and first moment that it has over each."""
        step = time.diff()
        edges = torch.cat([time, time[-1:] + step[-1:]])
        return self._over(time, edges[:-1, None], edges[1:, None])

    def ahead(self, start: Tensor, seconds: Tensor) -> Tensor:
        """What moves an arm within τ = ``seconds`` (..., R, 1) of ``start`` (R,) or (): 2/τ² ∫₀^τ (τ − s) u ds.

        Backwards where τ < 0. In float64, for a command of any type: it is a small difference of integrals.
        """
        exact, span = self._exact, torch.where(seconds.abs() < INSTANT, INSTANT, seconds).double()
        start = start.double().unsqueeze(-1)
        first, last = (at if at.ndim > 1 else at[None] for at in (start, start + span))  # one row by itself
        impulse, moment = exact._sums
        before, moment_before = exact._integrals(impulse, moment, first)
        _, moment_after = exact._integrals(impulse, moment, last)
        mean = (2 / span**2 * (moment_after - moment_before - span * before)).to(self.mean.dtype)
        return mean if seconds.ndim > 1 or start.ndim > 1 else mean[..., 0, :]

    def between(self, start: Tensor, first: Tensor, last: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and slope of the line from ``first`` to ``last`` seconds (..., R, 1) after ``start`` (R,) or ()."""
        start = start.double().unsqueeze(-1)
        begin, end = (start + each.double() for each in (first, torch.maximum(last, first + INSTANT)))
        single = begin.ndim == 1
        line = self._exact._over(self.time, *((begin[None], end[None]) if single else (begin, end)))
        mean, slope = (value.to(self.mean.dtype) for value in (line.mean, line.slope))
        return (mean[..., 0, :], slope[..., 0, :]) if single else (mean, slope)

    @property
    def _edges(self) -> Tensor:
        return torch.cat([self.time, self.time[-1:] + self.length[-1]])

    def _over(self, time: Tensor, start: Tensor, stop: Tensor) -> "Command":
        """Rows at ``time`` with the command between ``start`` and ``stop`` (..., R, 1 or K)."""
        impulse, moment = self._sums
        first, first_moment = self._integrals(impulse, moment, start)
        last, last_moment = self._integrals(impulse, moment, stop)
        width = stop - start
        mean = (last - first) / width
        # ∫ (t − a) u dt by parts; the line of slope m about the middle has the moment m δ²/12 there.
        first_order = width * last - (last_moment - first_moment)
        return Command(time, mean, 12 * (first_order / width**2 - mean / 2))

    @cached_property
    def _exact(self) -> "Command":
        return replace(self, time=self.time.double(), mean=self.mean.double(), slope=self.slope.double())

    @cached_property
    def _sums(self) -> tuple[Tensor, Tensor]:
        """∫u and ∫∫u from the first row to each row's edges, (..., T + 1, K)."""
        length = self.length
        impulse = torch.cat([torch.zeros_like(self.mean[..., :1, :]), (self.mean * length).cumsum(-2)], -2)
        moment = impulse[..., :-1, :] * length + length**2 * (self.mean / 2 - self.slope / 12)
        return impulse, torch.cat([torch.zeros_like(moment[..., :1, :]), moment.cumsum(-2)], -2)

    def _integrals(self, impulse: Tensor, moment: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
        """∫u and ∫∫u from the first row to the times ``at`` (..., R, 1 or K)."""
        edges, length = self._edges, self.length
        shape = (*common(at.shape[:-2], self.mean.shape[:-2]), at.shape[-2], self.mean.shape[-1])
        at = at.expand(shape)
        row = (torch.searchsorted(edges, at.detach().contiguous(), right=True) - 1).clamp(0, len(self.time) - 1)

        def pick(values: Tensor) -> Tensor:
            return values.expand(*shape[:-2], *values.shape[-2:]).gather(-2, row)

        since = at - edges[row]  # negative before the first row, whose command held then too
        u, m, P, W = pick(self.mean), pick(self.slope), pick(impulse[..., :-1, :]), pick(moment[..., :-1, :])
        long = length[:, 0][row]
        s = (since / long).clamp(0, 1)
        bent, twice_bent = m * long * (s**2 - s) / 2, m * long**2 * (s**3 / 6 - s**2 / 4)
        return P + u * since + bent, W + P * since + u * since**2 / 2 + twice_bent

    def lagged(self, time_constant: Tensor) -> "Command":
        """First-order lag T u̇_f + u_f = u, T seconds, (K,) or (..., 1, K); the rows' means count as constant."""
        ratio = time_constant / self.length  # (..., T, K); a floor only where it is divided by, for a slope at no lag
        shape = common(self.mean.shape, ratio.shape)
        u, left = self.mean.expand(shape), torch.exp(-1 / ratio.clamp_min(1e-6)).expand(shape)
        gap = _decaying(left, u) - u  # decays as e^{−s δ/T} within the row
        mean_gap = ratio * (1 - left)  # ∫ e^{−s δ/T} ds over the row
        moment = ratio * (mean_gap - left)  # ∫ s e^{−s δ/T} ds
        return replace(self, mean=u + gap * mean_gap, slope=12 * gap * (moment - mean_gap / 2))


def _decaying(left: Tensor, u: Tensor) -> Tensor:
    """What has come, by the beginning of each row (..., T, K), of v ↦ u + (v − u) ``left`` from row to row, from u_0.

    Maps of twice as many rows at a time (Hillis & Steele 1986).
    """
    kept, added, span = left, u * (1 - left), 1
    while span < u.shape[-2]:
        added = torch.cat(
            [added[..., :span, :], added[..., span:, :] + kept[..., span:, :] * added[..., :-span, :]], -2
        )
        kept = torch.cat([kept[..., :span, :], kept[..., span:, :] * kept[..., :-span, :]], -2)
        span *= 2
    first = u[..., :1, :]
    return torch.cat([first, (added + kept * first)[..., :-1, :]], -2)

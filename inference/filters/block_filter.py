"""A controlled particle filter that draws a block of rows at once.

Controlled SMC (Heng, Bishop, Deligiannidis & Doucet 2020; :mod:`.controlled`) asks for f(x_{t−1}) before it draws x_t:
row after row of small tensors. Here the recursion is solved for all rows of a block by Newton's method (Lim, Zhu,
Selfridge & Kasim 2024, "Parallelizing non-linear sequential models over the sequence length"): along the dynamics that
its filter's Gauss–Newton smoother linearised, corrected by what f made of the last pass's states, all at once,

    m_t = F_{t−1} (x_{t−1} − x̄_{t−1}) + a_{t−1} + [f(x'_{t−1}) − x̄_t − F_{t−1} (x'_{t−1} − x̄_{t−1}) − a_{t−1}]
    x_t = x̄_t + G_t m_t + o_t + R_t ε_t ~ q(x_t) ∝ N(x_t; x̄_t + m_t, Q_t) ψ_t(x_t)

with the same ε in each pass, until m_t = f(x_{t−1}) − x̄_t or near it. A difference is weighed, as m_t depends on what
was drawn before t alone:

    w_t = W_{t−1} g(y_t | x_t) p(x_t | x_{t−1}) / q(x_t) ψ̃_t(x_t) / ψ̃_{t−1}(x_{t−1})

where log ψ̃_t(x_t) = log ∫ N(x'; f(x_t), Q) ψ_{t+1}(x') dx'. So weights and evidence are those of controlled SMC that
resamples after blocks only, and unbiased whether the passes have converged or not.

Shapes: M filters, each with parameters, path and factors of its own; N particles, B rows of a block, T in all.
"""

import math

import numpy as np
import torch
from pyro.infer.smcfilter import SMCFailed
from torch import Tensor

from invdyn.inference.filters.controlled import triangular
from invdyn.inference.filters.particles import FilterResult
from invdyn.inference.filters.resampling import check_sizes
from invdyn.inference.filters.weights import ancestors_where, row_log_prob
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.models.divergence import ran_away
from invdyn.models.state_space import StateSpaceModel, gaussian_mean

BLOCK = 32
"""Rows: enough that tensors are large, few enough that they stay in the cache."""
PASSES, PASS_TOLERANCE = 6, 0.003
"""Passes at most, and the change of |A m| under which they end; A m is what the twist's exponent squares."""


class BlockFilter:
    """M filters of N particles.

    Args:
        model: with Gaussian transition noise whose covariance does not depend on the state; parameters (M, 1, own
            shape).
        smoothers: of the M parameter sets, path (M, T, D).
        num_particles: N.
        block: rows of a block; 1 where the noise has no density.
        ess_threshold: resample a filter after a block when its ESS falls below this share of N; in (0, 1].

    Raises ValueError for no particle, no row or a threshold outside its range.
    """

    def __init__(
        self,
        model: StateSpaceModel,
        smoothers: GaussianSmoother,
        num_particles: int,
        *,
        block: int = BLOCK,
        ess_threshold: float = 0.5,
    ):
        check_sizes(len(smoothers.path), num_particles, ess_threshold)
        if block < 1:
            raise ValueError(f"expected at least one row a block, got {block}")
        self.model, self.block = model, block
        self.num_particles, self.ess_threshold = num_particles, ess_threshold
        factors, linear = smoothers.factors, smoothers.linearisation

        def rows(values: np.ndarray | Tensor) -> Tensor:
            return torch.as_tensor(np.ascontiguousarray(values))

        self._path = rows(smoothers.path)
        self._gain, self._offset, self._root = rows(factors.gain), rows(factors.offset), rows(triangular(factors.root))
        self._U, self._b = rows(factors.U), rows(factors.b)
        self._A, self._alpha = rows(factors.A), rows(factors.alpha)
        self._log_c = rows(factors.log_c - factors.log_n)
        self._F, self._a, self._m0 = rows(linear.F), rows(linear.a), rows(linear.m0)
        self._precision = rows(np.linalg.inv(linear.L)) if block > 1 else None  # its root
        self.num_filters, self.num_steps = self._path.shape[:2]

    @torch.no_grad()
    def run(self, observations: Tensor) -> FilterResult:
        """Filter observations (T, O), NaN where missing; raises SMCFailed when a filter loses all its particles."""
        filters, particles, steps = self.num_filters, self.num_particles, self.num_steps
        log_weights = torch.full((filters, particles), -math.log(particles), dtype=torch.float64)
        prediction = self._m0.expand(particles, -1, -1)
        itself = torch.arange(particles).expand(filters, -1)
        parents, kept = itself, []
        for first in range(0, steps, self.block):
            rows = slice(first, min(first + self.block, steps))
            used, deviation, moved = self._draw(rows, prediction)
            increment, twist = self._weigh(rows, observations[rows], prediction, used, deviation, moved)
            states = deviation + self._path[:, rows]
            # (N, M, B) → (B, M, N), and each row's weights from the block's first on.
            log_weights = log_weights + increment.permute(2, 1, 0).cumsum(0)
            log_weights = torch.where(torch.isnan(log_weights), -torch.inf, log_weights)
            total = log_weights.logsumexp(-1)
            if not bool(torch.isfinite(total).all()):
                row = first + int((~torch.isfinite(total)).any(-1).int().argmax())
                if not bool(torch.isfinite(states).all(-1)[:, :, row - first].any()):
                    raise SMCFailed(ran_away(row))
                raise SMCFailed(f"all particles of a filter have weight zero at row {row}: use a larger noise scale")
            log_weights = log_weights - total.unsqueeze(-1)
            ess = 1 / log_weights.exp().square().sum(-1)
            need = torch.zeros_like(ess, dtype=torch.bool)
            # The last row's weights are the posterior's, and stay.
            need[-1] = (ess[-1] < self.ess_threshold * particles) & (rows.stop < steps)
            lines = itself.repeat(len(total), 1, 1)
            lines[0] = parents
            gained = total.diff(dim=0, prepend=torch.zeros_like(total[:1]))
            kept.append((gained, ess, need, states.permute(2, 1, 0, 3), log_weights, twist.permute(2, 1, 0), lines))
            if rows.stop == steps:
                break
            log_weights, parents, prediction = log_weights[-1], itself, moved[..., -1, :]
            if bool(need[-1].any()):
                parents = ancestors_where(need[-1], log_weights, "systematic")
                log_weights = torch.where(need[-1].unsqueeze(-1), -math.log(particles), log_weights)
                prediction = prediction.gather(0, parents.T.unsqueeze(-1).expand_as(prediction))
        increments, *rest = (torch.cat(values) for values in zip(*kept, strict=True))
        return FilterResult(increments.sum(0), increments, *rest)

    def _draw(self, rows: slice, first: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """A block's states from the exact m_t (N, M, D) of its ``first`` row on, by Newton's method.

        m_t that they were drawn with and deviations from the path, (N, M, B, D); f − x̄ of all rows but a last one.
        """
        numbers = torch.arange(rows.start, rows.stop)
        followed = slice(rows.start, min(rows.stop, self.num_steps - 1))
        some = followed.stop - followed.start
        ahead = slice(followed.start + 1, followed.stop + 1)
        noise = torch.randn(*first.shape[:-1], len(numbers), first.shape[-1], dtype=first.dtype)
        shaken = _apply(self._root[:, rows], noise) + self._offset[:, rows]
        bent = self._a[:, followed].expand(*first.shape[:-1], some, -1)
        for _ in range(PASSES):
            used, deviation = [first], list[Tensor]()
            for i, t in enumerate(numbers.tolist()):
                if i:
                    used.append(_apply(self._F[:, t - 1], deviation[-1]) + bent[..., i - 1, :])
                deviation.append(_apply(self._gain[:, t], used[-1]) + shaken[..., i, :])
            m, states = torch.stack(used, -2), torch.stack(deviation, -2)
            before = (states + self._path[:, rows])[..., :some, :]
            if not some:
                return m, states, before
            moved = gaussian_mean(self.model.transition(before, numbers[:some] + 1)) - self._path[:, ahead]
            off = moved[..., : len(numbers) - 1, :] - m[..., 1:, :]
            if not _apply(self._A[:, rows.start + 1 : rows.stop], off).abs().gt(PASS_TOLERANCE).any():
                break
            bent = moved - _apply(self._F[:, followed], states[..., :some, :])
        return m, states, moved

    def _weigh(
        self, rows: slice, observations: Tensor, first: Tensor, used: Tensor, deviation: Tensor, moved: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Increments of the log weights of what :meth:`_draw` drew, and twists, (N, M, B)."""
        seen = ~torch.isnan(observations)
        emission = self.model.emission(deviation + self._path[:, rows], torch.arange(rows.start, rows.stop))
        increment = row_log_prob(emission, observations, None if bool(seen.all()) else seen)
        log_psi = self._log_c[:, rows] - 0.5 * _square(_apply(self._U[:, rows], deviation) - self._b[:, rows])
        increment = increment + self._integral(rows.start, used) - log_psi
        twist = self._integral(rows.start + 1, moved)
        if rows.stop == self.num_steps:
            twist = torch.nn.functional.pad(twist, (0, 1))  # nothing is ahead of the last row
        before = self._integral(rows.start, first.unsqueeze(-2)) * (rows.start > 0)
        increment = increment + twist - torch.cat([before, twist[..., :-1]], -1)
        if self._precision is not None:
            inner, root = slice(1, rows.stop - rows.start), self._precision[:, rows.start + 1 : rows.stop]
            exact, drawn = (
                deviation[..., inner, :] - m for m in (moved[..., : inner.stop - 1, :], used[..., inner, :])
            )
            increment[..., inner] += 0.5 * (_square(_apply(root, drawn)) - _square(_apply(root, exact)))
        return increment, twist

    def _integral(self, start: int, prediction: Tensor) -> Tensor:
        """Log ∫ N(x_t; x̄_t + m_t, Q_t) ψ_t dx_t of m_t (N, M, B, D) from row ``start`` on."""
        rows = slice(start, start + prediction.shape[-2])
        return -0.5 * _square(_apply(self._A[:, rows], prediction) - self._alpha[:, rows])


def _apply(matrix: Tensor, vector: Tensor) -> Tensor:
    """Matrices (..., P, D) times vectors (N, ..., D): one product for all N."""
    return (vector.movedim(0, -2) @ matrix.mT).movedim(-2, 0)


def _square(vector: Tensor) -> Tensor:
    """|v|² of vectors (..., D)."""
    return vector.square().sum(-1)

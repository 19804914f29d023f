"""Bridges: new states between an ancestor and a fixed later state.

Given x_{t+ℓ+1} = z, the factors ψ_j(x) ≈ p(y_{t+j} … y_{t+ℓ}, z | x_{t+j} = x), j = ℓ … 1, follow from
the square-root recursion (:mod:`.square_root`) started at the row L⁻¹(F x + a) ≈ L⁻¹ z instead
of at the recording's end. They are linear in z, so the right-hand sides are carried as affine maps of
z, (D, D + 1), and the matrices are computed once for all t at a time.

The Metropolis–Hastings move proposes (i, x_{t+1:t+ℓ}) from

    q(i) ∝ Ŵ_t^i ∫N(·; f(x_t^i), Q) ψ_1,     q(x_{t+j} | x_{t+j−1}) ∝ N(x_{t+j}; f(x_{t+j−1}), Q) ψ_j

and accepts with min(1, ω'/ω), where what is left of target over proposal is

    ω = Π_j g(y_{t+j} | x_{t+j}) / ψ_j(x_{t+j}) · Π_{j<ℓ} ∫N(·; f(x_{t+j}), Q) ψ_{j+1} · p(z | x_{t+ℓ}).

For a linear-Gaussian model ω is constant and every move is accepted.
"""

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.filters.resampling import categorical
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.models.observation.missing import observed_log_prob
from invdyn.models.state_space import StateSpaceModel, gaussian_mean


class Bridge:
    """Block moves along a smoother's path; ``block`` = ℓ states are moved at once."""

    def __init__(self, model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother, block: int):
        self.model, self.observations, self.block = model, observations, block
        self.path = smoother.path.to(observations.dtype)  # that of the draws: constants of a model keep theirs
        linear = smoother.linearisation
        steps, dim = self.path.shape
        self.starts = steps - block - 1  # t = 0 … starts − 1 have all of t+1 … t+ℓ+1
        t = np.arange(self.starts)
        end = t + block
        whiten = np.linalg.inv(linear.L[end + 1])
        eye = np.eye(dim)
        # Rows on x_{t+ℓ} from the fixed end z: L⁻¹ F d ≈ L⁻¹ (z − a), affine in z.
        rows = whiten @ linear.F[end]
        targets = np.concatenate([whiten, -(whiten @ linear.a[end][..., None])], -1)
        factors = []
        for j in range(block, 0, -1):
            row = t + j
            constant = np.zeros((*linear.E[row].shape[:-1], dim))
            targets_y = np.concatenate([constant, linear.e[row][..., None]], -1)
            U, b = _triangle(np.concatenate([rows, linear.E[row]], -2), np.concatenate([targets, targets_y], -2))
            L = linear.L[row]
            top = np.concatenate([np.broadcast_to(eye, L.shape), np.zeros_like(L), np.zeros_like(b)], -1)
            bottom = np.concatenate([U @ L, U, b], -1)
            triangle = np.asarray(np.linalg.qr(np.concatenate([top, bottom], -2), mode="r"))
            R, B, r = np.split(triangle[:, :dim], [dim, 2 * dim], -1)
            A, alpha = triangle[:, dim:, dim : 2 * dim], triangle[:, dim:, 2 * dim :]
            root = L @ np.linalg.inv(R)
            factors.append((U, b, A, alpha, eye - root @ B, root @ r, root))
            if j > 1:
                rows = A @ linear.F[row - 1]
                targets = alpha.copy()
                targets[..., -1] -= (A @ linear.a[row - 1][..., None])[..., 0]
        names = ("U", "b", "A", "alpha", "gain", "offset", "root")
        # Lists over j − 1 = 0 … ℓ − 1 of tensors (starts, …).
        self.factors = {
            name: [torch.as_tensor(f[k]).to(self.path) for f in factors[::-1]] for k, name in enumerate(names)
        }

    def move(self, t: int, states: Tensor, log_weights: Tensor, stretch: Tensor) -> Tensor:
        """Move x_t … x_{t+ℓ} given the fixed last state of ``stretch``.

        ``states`` (M, N, D) and ``log_weights`` (M, N): row t's untwisted filter; ``stretch``
        (M, R, ℓ + 2, D): rows t … t+ℓ+1 of the draws. Returns rows t … t+ℓ, (M, R, ℓ + 1, D).
        """
        end = stretch[..., -1, :] - self.path[t + self.block + 1]
        known = torch.cat([end, torch.ones_like(end[..., :1])], -1)  # (M, R, D + 1)
        first = gaussian_mean(self.model.transition(states, t + 1)) - self.path[t + 1]
        target = known @ self._get("alpha", 1, t).mT
        # −½|A m_i − α|² for all pairs of draws and particles.
        reach = (first @ self._get("A", 1, t).mT).unsqueeze(-3) - target.unsqueeze(-2)
        logits = log_weights.unsqueeze(-2) - 0.5 * reach.square().sum(-1)
        index = categorical(logits).unsqueeze(-1)

        states_of_draw = [states.gather(-2, index.expand(*index.shape[:-1], states.shape[-1]))]
        prediction = first.gather(-2, index.expand(*index.shape[:-1], first.shape[-1]))
        for j in range(1, self.block + 1):
            deviation = prediction @ self._get("gain", j, t).mT + known @ self._get("offset", j, t).mT
            deviation = deviation + torch.randn_like(deviation) @ self._get("root", j, t).mT
            states_of_draw.append(deviation + self.path[t + j])
            if j < self.block:
                prediction = self._predict(states_of_draw[-1], t + j + 1)
        proposed = torch.stack(states_of_draw, -2)

        end_state = stretch[..., -1:, :]
        both = torch.stack([torch.cat([proposed, end_state], -2), stretch])
        new, old = self.log_omega(t, both, known).unbind(0)
        accept = torch.log(torch.rand_like(new)) < new - old
        return torch.where(accept[..., None, None], proposed, stretch[..., :-1, :])

    def log_omega(self, t: int, stretch: Tensor, known: Tensor) -> Tensor:
        """Log ω of stretches (…, ℓ + 2, D); see the top of the file."""
        middle = stretch[..., 1:-1, :]
        rows = torch.arange(t + 1, t + self.block + 1)
        emission = self.model.emission(middle, rows)
        total = observed_log_prob(emission, self.observations[rows]).sum(-1)
        predictions = gaussian_mean(self.model.transition(middle[..., :-1, :], rows[1:]))
        for j in range(1, self.block + 1):
            deviation = middle[..., j - 1, :] - self.path[t + j]
            misfit = deviation @ self._get("U", j, t).mT - known @ self._get("b", j, t).mT
            total = total + 0.5 * misfit.square().sum(-1)
            if j < self.block:
                prediction = predictions[..., j - 1, :] - self.path[t + j + 1]
                misfit = prediction @ self._get("A", j + 1, t).mT - known @ self._get("alpha", j + 1, t).mT
                total = total - 0.5 * misfit.square().sum(-1)
        last = self.model.transition(middle[..., -1, :], t + self.block + 1)
        return total + last.log_prob(stretch[..., -1, :])

    def _predict(self, state: Tensor, t: int) -> Tensor:
        return gaussian_mean(self.model.transition(state, t)) - self.path[t]

    def _get(self, name: str, j: int, t: int) -> Tensor:
        return self.factors[name][j - 1][t]


def _triangle(rows: np.ndarray, targets: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compress rows (…, n, D) ≈ targets (…, n, C) to D rows by QR; the residual does not matter here."""
    dim = rows.shape[-1]
    triangle = np.asarray(np.linalg.qr(np.concatenate([rows, targets], -1), mode="r"))
    return triangle[..., :dim, :dim], triangle[..., :dim, dim:]

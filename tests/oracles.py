"""Exact answers, by other means than the code under test: plain numpy, textbook formulas.

A linear-Gaussian chain is x_0 ~ N(m, P), x_t = A x_{t−1} + N(0, Q), y_t = C x_t + N(0, R); y (T, O) has
NaN where nothing was seen.
"""

import math
from dataclasses import dataclass

import numpy as np
import torch

from invdyn.models import LinearGaussian


@dataclass
class Chain:
    """The numbers of a linear-Gaussian chain."""

    A: np.ndarray
    Q: np.ndarray
    C: np.ndarray
    R: np.ndarray
    m: np.ndarray
    P: np.ndarray

    def model(self, steps, dtype=torch.float64):
        """The same chain as the model under test."""
        numbers = (self.A, self.Q, self.C, self.R, self.m, self.P)
        return LinearGaussian(*(torch.as_tensor(x, dtype=dtype) for x in numbers), steps)

    def simulate(self, steps, seed=0):
        """States (T, D) and observations (T, O)."""
        rng = np.random.default_rng(seed)
        x = rng.multivariate_normal(self.m, self.P)
        states = [x]
        for _ in range(steps - 1):
            x = self.A @ x + rng.multivariate_normal(np.zeros_like(x), self.Q)
            states.append(x)
        noise = rng.multivariate_normal(np.zeros(len(self.R)), self.R, size=steps)
        return np.array(states), np.array(states) @ self.C.T + noise


def random_chain(seed=0, dim=3, size=2, noise=0.4):
    """A stable chain with correlated noises and a correlated start; `noise` is the observation's variance."""
    rng = np.random.default_rng(seed)

    def covariance(n, scale):
        root = rng.normal(size=(n, n))
        return scale * (root @ root.T / n + 0.5 * np.eye(n))

    A = rng.normal(size=(dim, dim))
    A *= 0.9 / np.abs(np.linalg.eigvals(A)).max()
    C = rng.normal(size=(size, dim))
    return Chain(A, covariance(dim, 0.3), C, covariance(size, noise), rng.normal(size=dim), covariance(dim, 1))


def noisy_chain():
    """Two slow states, seen in noisy entries: a bootstrap filter's weights are even."""
    A, eye = np.array([[0.8, 0.1], [0.0, 0.6]]), np.eye(2)
    return Chain(A, 0.3 * eye, eye, 2.0 * eye, np.zeros(2), eye)


def with_gaps(y):
    """A copy of y (T, O) in which single entries and whole rows are missing."""
    y = y.copy()
    y[1] = np.nan
    y[3, 0] = np.nan
    y[len(y) // 2 : len(y) // 2 + 2] = np.nan
    y[-2, -1] = np.nan
    return y


def kalman(chain, y):
    """Log-evidence, its increments (T,), filtered means (T, D) and covariances (T, D, D)."""
    mean, cov = chain.m, chain.P
    increments, means, covs = [], [], []
    for t, row in enumerate(y):
        if t > 0:
            mean, cov = chain.A @ mean, chain.A @ cov @ chain.A.T + chain.Q
        seen = np.isfinite(row)
        increment = 0.0
        if seen.any():
            C, R = chain.C[seen], chain.R[np.ix_(seen, seen)]
            S = C @ cov @ C.T + R
            surprise = row[seen] - C @ mean
            gain = np.linalg.solve(S, C @ cov).T
            increment = -0.5 * (surprise @ np.linalg.solve(S, surprise) + np.linalg.slogdet(2 * np.pi * S)[1])
            mean, cov = mean + gain @ surprise, cov - gain @ S @ gain.T
        increments.append(increment)
        means.append(mean)
        covs.append(cov)
    return sum(increments), np.array(increments), np.array(means), np.array(covs)


def rts(chain, y):
    """Smoothed means (T, D) and covariances (T, D, D), Rauch–Tung–Striebel."""
    _, _, means, covs = kalman(chain, y)
    means, covs = means.copy(), covs.copy()
    for t in range(len(y) - 2, -1, -1):
        predicted = chain.A @ covs[t] @ chain.A.T + chain.Q
        gain = np.linalg.solve(predicted, chain.A @ covs[t]).T
        means[t] = means[t] + gain @ (means[t + 1] - chain.A @ means[t])
        covs[t] = covs[t] + gain @ (covs[t + 1] - predicted) @ gain.T
    return means, covs


def dense_posterior(F, a, L, E, e, m0, V=None):
    """Brute force for the chain of :mod:`invdyn.inference.smoothing.square_root`, as one big Gaussian.

    x = G n + g with n ~ N(0, I) all noises (w_0, v_0, w_1, v_1, …), and rows E_t x_t ≈ e_t of unit noise.
    Returns the posterior mean (T, D), marginal covariances (T, D, D) and the log-integral of
    Π_t exp(−½|E_t x_t − e_t|²) over the prior, without any 2π.
    """
    steps, _, dim = E.shape
    extra = 0 if V is None else V.shape[-1]
    count = steps * dim + (steps - 1) * extra
    G, g = np.zeros((steps, dim, count)), np.zeros((steps, dim))
    g[0], G[0, :, :dim] = m0, L[0]
    for t in range(1, steps):
        g[t] = F[t - 1] @ g[t - 1] + a[t - 1]
        G[t] = F[t - 1] @ G[t - 1]
        at = t * dim
        G[t, :, at : at + dim] = L[t]
        if extra:
            at = steps * dim + (t - 1) * extra
            G[t, :, at : at + extra] = V[t - 1]
    rows = np.concatenate([E[t] @ G[t] for t in range(steps)])
    target = np.concatenate([e[t] - E[t] @ g[t] for t in range(steps)])
    precision = np.eye(count) + rows.T @ rows
    noise = np.linalg.solve(precision, rows.T @ target)
    cov = np.linalg.inv(precision)
    log_integral = -0.5 * (np.sum((target - rows @ noise) ** 2) + noise @ noise)
    log_integral -= 0.5 * np.linalg.slogdet(precision)[1]
    return (
        np.array([G[t] @ noise + g[t] for t in range(steps)]),
        np.array([G[t] @ cov @ G[t].T for t in range(steps)]),
        log_integral,
    )


CHAIN_DIM = 3


def chain_numbers(seed=0, *, rows=2, extra=0, steps=6, batch=()):
    """Random time-varying F, a, L, E, e, m0, V of :mod:`invdyn.inference.smoothing.square_root`."""
    rng = np.random.default_rng(seed)
    F = 0.7 * rng.normal(size=(*batch, steps - 1, CHAIN_DIM, CHAIN_DIM))
    a = rng.normal(size=(*batch, steps - 1, CHAIN_DIM))
    L = np.tril(rng.normal(size=(*batch, steps, CHAIN_DIM, CHAIN_DIM)))
    E, e = rng.normal(size=(*batch, steps, rows, CHAIN_DIM)), rng.normal(size=(*batch, steps, rows))
    m0 = rng.normal(size=(*batch, CHAIN_DIM))
    V = 0.5 * rng.normal(size=(*batch, steps - 1, CHAIN_DIM, extra)) if extra else None
    return [F, a, L, E, e, m0, V]


def assert_unbiased(log_evidence, exact, z=4.0):
    """E[Ẑ]/Z = 1 within z standard errors, and these are small enough to notice a bias of a few percent."""
    ratio = torch.exp(log_evidence - exact)
    error = ratio.std().item() / math.sqrt(len(ratio))
    assert error < 0.03
    assert abs(ratio.mean().item() - 1) < z * error

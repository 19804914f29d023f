"""Exact answers for the models of :mod:`gallery_models`, by other means than invdyn.

    kalman     textbook recursions (Kalman 1960; Rauch, Tung & Striebel 1965) in numpy
    grid       forward–backward sums over a dense grid of one state, or over finitely many states
    library    bootstrap filters of `particles` 0.4 (Chopin & Papaspiliopoulos 2020): RUNS of N particles,
               smoothed along their ancestral lines; their scatter gives the answers' own error

Shapes: means and sds (T, D); quantiles (T, D, Q) at ``LEVELS``.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy.special import ndtri

from invdyn.models.observation.missing import observed_log_prob

RUNS, SIZE = 5, 200_000
LEVELS = np.concatenate([[1e-4], np.arange(0.005, 1, 0.005), [1 - 1e-4]])


@dataclass(frozen=True)
class Answer:
    """Log-evidence, smoothed means and sds, quantiles, and the standard errors of the first two."""

    log_evidence: float
    mean: np.ndarray
    sd: np.ndarray
    quantiles: np.ndarray
    log_evidence_sd: float = 0.0
    mean_sd: float | np.ndarray = 0.0

    def covered(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Posterior probability (T, D) between bounds (T, D)."""

        def below(values: np.ndarray) -> np.ndarray:
            pairs = zip(values.ravel(), self.quantiles.reshape(-1, len(LEVELS)), strict=True)
            return np.array([np.interp(x, q, LEVELS, 0.0, 1.0) for x, q in pairs]).reshape(values.shape)

        return below(high) - below(low)


def answer(model, rows: torch.Tensor, cache: Path | None = None) -> Answer:
    """The answer of a model's own kind, which ``cache`` keeps."""
    if cache is not None and cache.exists():
        with np.load(cache) as kept:
            return Answer(**{name: kept[name][()] for name in kept.files})
    found = {"kalman": kalman, "grid": grid, "sum": grid, "library": library}[model.answer](model, rows)
    if cache is not None:
        cache.parent.mkdir(parents=True, exist_ok=True)
        np.savez(cache, **vars(found))
    return found


def kalman(model, rows: torch.Tensor) -> Answer:
    """Of a linear-Gaussian model whose start is N(0, I)."""
    y, size = rows.numpy(), model.state_dim
    mean, P, total = np.zeros(size), np.eye(size), 0.0
    ahead, filtered = [], []
    for t, row in enumerate(y):
        A, b, Q, C, R = (each.numpy() for each in model.matrices(t))
        if t > 0:
            mean, P = A @ mean + b, A @ P @ A.T + Q
        ahead.append((A, mean, P))
        seen = ~np.isnan(row)
        C, R, off = C[seen], R[np.ix_(seen, seen)], row[seen] - C[seen] @ mean
        S = C @ P @ C.T + R
        gain = P @ C.T @ np.linalg.inv(S)
        total -= 0.5 * (off @ np.linalg.solve(S, off) + np.linalg.slogdet(2 * math.pi * S)[1])
        mean, P = mean + gain @ off, P - gain @ C @ P
        filtered.append((mean, P))

    smoothed = [filtered[-1]]
    for t in range(len(y) - 2, -1, -1):
        (mean, P), (A, before, V) = filtered[t], ahead[t + 1]
        gain = P @ A.T @ np.linalg.pinv(V, hermitian=True)
        later, W = smoothed[-1]
        smoothed.append((mean + gain @ (later - before), P + gain @ (W - V) @ gain.T))
    means = np.array([mean for mean, _ in smoothed[::-1]])
    sds = np.array([np.sqrt(np.diagonal(P)) for _, P in smoothed[::-1]])
    return Answer(total, means, sds, means[..., None] + sds[..., None] * ndtri(LEVELS))


@torch.no_grad()
def grid(model, rows: torch.Tensor, smooth: bool = True) -> Answer:
    """Sums over all states of a finite model, or over a grid of one state."""
    if model.answer == "sum":
        x, width = model.all_states(), 1.0
    else:
        low, high, points = model.grid
        x, width = torch.linspace(low, high, points, dtype=torch.float64).unsqueeze(-1), (high - low) / (points - 1)

    def step(t: int) -> torch.Tensor:
        """p(x_t, y_t | x_{t−1}) of all pairs."""
        before, after = x.unsqueeze(1), x.unsqueeze(0)
        log = model.transition(before, t).log_prob(after)
        emission = model.emission_given(before, after, t) if model.emission_sees_previous else model.emission(x, t)
        return (log + observed_log_prob(emission, rows[t])).exp() * width

    mass = (model.initial().log_prob(x) + observed_log_prob(model.emission(x, 0), rows[0])).exp() * width
    total, masses, steps = 0.0, [], []
    for t in range(len(rows)):
        if t > 0:
            now = step(t)
            mass = mass @ now
            steps += [now] * smooth
        scale = mass.sum()
        total, mass = total + scale.log().item(), mass / scale
        masses.append(mass)
    if not smooth:
        empty = np.empty(0)
        return Answer(total, empty, empty, empty)

    later, weights = torch.ones_like(mass), [mass]
    for before, now in zip(masses[-2::-1], steps[::-1], strict=True):
        later = now @ later
        later = later / later.max()
        both = before * later
        weights.append(both / both.sum())
    smoothed = torch.stack(weights[::-1])
    mean = smoothed @ x
    sd = (smoothed @ x.square() - mean.square()).clamp_min(0).sqrt()
    # A cell's mass lies half on either side of its point.
    below = (smoothed.cumsum(-1) - 0.5 * smoothed).numpy()
    points = x.squeeze(-1).numpy()
    quantiles = np.array([np.interp(LEVELS, each, points) for each in below])[:, None]
    return Answer(total, mean.numpy(), sd.numpy(), quantiles)


def library(model, rows: torch.Tensor) -> Answer:
    """By bootstrap filters of another library, on the same three distributions."""
    import particles

    class Bound(particles.FeynmanKac):
        def M0(self, N):
            return model.initial().expand(torch.Size((N,))).sample().numpy()

        def M(self, t, xp):
            return model.transition(torch.as_tensor(xp), t).sample().numpy()

        def logG(self, t, xp, x):
            return observed_log_prob(model.emission(torch.as_tensor(x), t), rows[t]).numpy()

    evidences, means, lines = [], [], []
    for run in range(RUNS):
        torch.manual_seed(1000 + run)
        np.random.seed(1000 + run)  # noqa: NPY002 — as the library draws
        smc = particles.SMC(fk=Bound(len(rows)), N=SIZE, resampling="systematic", ESSrmin=0.5, store_history=True)
        smc.run()
        line, path = np.random.choice(SIZE, SIZE, p=smc.W / smc.W.sum()), []  # noqa: NPY002
        for t in range(len(rows) - 1, -1, -1):
            path.append(smc.hist.X[t][line])
            line = smc.hist.A[t][line] if t > 0 else line
        path = np.stack(path[::-1])  # (T, N, D)
        evidences.append(smc.logLt)
        means.append(path.mean(1))
        lines.append(path[:, ::10])
    drawn = np.concatenate(lines, 1)
    return Answer(
        float(np.logaddexp.reduce(evidences) - math.log(RUNS)),
        np.mean(means, 0),
        drawn.std(1),
        np.moveaxis(np.quantile(drawn, LEVELS, axis=1), 0, -1),
        float(np.std(evidences, ddof=1) / math.sqrt(RUNS)),
        np.std(means, 0, ddof=1) / math.sqrt(RUNS),
    )

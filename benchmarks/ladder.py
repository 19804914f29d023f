"""Particle filters against Kalman: the published ladder of 25 … 10,000 particles.

The linear-Gaussian model of pydpf's comparison with the Kalman filter: 25 states, the first of which is observed,
A_ij = .38^(|i−j|+1), Q = R = I, x_0 ~ N(0, I), 1,000 steps after the first row. Bootstrap guide, multinomial
resampling at every row. Its two errors, averaged over recordings (2,000 there) and rows:

    ε_x = mean of |m̂_t − m_t|²     squared Euclidean distance of the filter's weighted mean from Kalman's
    ε_y = mean of |1 − p̂(y_t | y_<t) / p(y_t | y_<t)|     relative error of each row's likelihood factor

Next to it the same filter with systematic resampling below half of N, and the controlled guide, exact for
this model. That guide sees all of y: its filter's ε_x is its mean without the twist, and its last column the
squared distance of its own (twisted) mean from Kalman's smoother, which for N independent exact draws is
trace(P_t)/N, in brackets. What has no Monte Carlo error at all is log Ẑ.

± is the standard error over recordings.

    python benchmarks/ladder.py [--recordings 3]
"""

import argparse
import math
import time

import numpy as np
import torch

from invdyn.inference import Bootstrap, Controlled, ParticleFilter, gauss_newton
from invdyn.models import LinearGaussian

PUBLISHED = {25: (3.839, 0.140), 100: (1.0675, 0.0705), 1_000: (0.1143, 0.0224), 10_000: (0.0117, 0.0071)}
FILTERS = {25: 64, 100: 32, 1_000: 4, 10_000: 1}
"""Independent filters that share one recording: they make the average less noisy."""
DIM, ROWS = 25, 1_001


def published() -> LinearGaussian:
    """The model."""
    index = np.arange(DIM)
    A = 0.38 ** (np.abs(np.subtract.outer(index, index)) + 1.0)
    eye, first = np.eye(DIM), np.eye(DIM)[:1]
    moments = (A, eye, first, np.eye(1), np.zeros(DIM), eye)
    return LinearGaussian(*map(torch.as_tensor, moments), ROWS)


def kalman(model: LinearGaussian, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Filtered means (T, D) and log p(y_t | y_<t) (T,), in textbook form."""
    A, C = (model.parameters[name].numpy() for name in ("transition", "emission"))
    mean, covariance, means, factors = np.zeros(DIM), np.eye(DIM), [], []
    for t, row in enumerate(y):
        if t > 0:
            mean, covariance = A @ mean, A @ covariance @ A.T + np.eye(DIM)
        S = (C @ covariance @ C.T + 1.0)[0, 0]
        surprise, gain = (row - C @ mean)[0], (covariance @ C.T)[:, 0] / S
        factors.append(-0.5 * (surprise**2 / S + math.log(2 * math.pi * S)))
        mean, covariance = mean + gain * surprise, covariance - S * np.outer(gain, gain)
        means.append(mean)
    return np.array(means), np.array(factors)


def averages(states: torch.Tensor, log_weights: torch.Tensor) -> torch.Tensor:
    """Weighted means (T, M, D)."""
    return torch.stack([w.softmax(-1).unsqueeze(-2) @ x for x, w in zip(states, log_weights, strict=True)]).squeeze(-2)


def measure(guide: str, count: int, model: LinearGaussian, y: torch.Tensor, smoother) -> dict[str, float]:
    means, factors = kalman(model, y.numpy())
    # The particles of all rows are kept to average them: in float32 where they are many.
    dtype = torch.float32 if count > 1_000 else torch.float64
    model, rows = model.to(dtype=dtype), y.to(dtype)
    published_form = {"ess_threshold": 1.0, "resampling": "multinomial"} if guide == "bootstrap" else {}
    proposal = Controlled(model, rows, smoother) if guide == "controlled" else Bootstrap(model)
    start = time.perf_counter()
    run = ParticleFilter(model, proposal, count, num_filters=FILTERS[count], **published_form).run(rows)
    found = {"s": time.perf_counter() - start}
    untwisted = run.log_weights if run.log_twist is None else run.log_weights - run.log_twist
    off = averages(run.states, untwisted) - torch.as_tensor(means, dtype=dtype).unsqueeze(1)
    found["x"] = off.square().sum(-1).mean().item()
    if guide == "controlled":
        smooth = smoother.path.to(dtype).unsqueeze(1)
        found["smoothed"] = (averages(run.states, run.log_weights) - smooth).square().sum(-1).mean().item()
        found["iid"] = smoother.covariance().diagonal(dim1=-2, dim2=-1).sum(-1).mean().item() / count
    else:
        exact = torch.as_tensor(factors).unsqueeze(-1)
        found["y"] = (1 - (run.log_evidence_increment - exact).exp()).abs().mean().item()
    off = run.log_evidence - factors.sum()
    found["Z"] = off.abs().mean().item()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, default=3, help="two or more")
    arguments = parser.parse_args()
    if arguments.recordings < 2:
        parser.error(f"expected two or more recordings, for a standard error, got {arguments.recordings}")
    torch.set_num_threads(1)
    torch.manual_seed(0)
    model = published()
    recordings = [model.simulate()[1] for _ in range(arguments.recordings)]
    smoothers = [gauss_newton(model, y) for y in recordings]
    print("| N | guide | ε_x | published | ε_y | published | mean abs(log Ẑ − log Z) | smoothed (exact draws) | s |")
    print("|---" * 9 + "|")
    for count, (x, y) in PUBLISHED.items():
        for guide in ("bootstrap", "bootstrap, adaptive", "controlled"):
            runs = [measure(guide, count, model, *pair) for pair in zip(recordings, smoothers, strict=True)]
            mean = {name: float(np.mean([run[name] for run in runs])) for name in runs[0]}
            error = {name: float(np.std([run[name] for run in runs], ddof=1) / len(runs) ** 0.5) for name in runs[0]}
            cells = [f"{mean['x']:.4f} ± {error['x']:.4f}", f"{x:g}"]
            cells += [f"{mean['y']:.4f} ± {error['y']:.4f}" if "y" in mean else "", f"{y:g}"]
            cells += [f"{mean['Z']:.2g}", f"{mean['smoothed']:.4f} ({mean['iid']:.4f})" if "iid" in mean else ""]
            print(f"| {count:,} | {guide} | " + " | ".join(cells) + f" | {mean['s']:.1f} |", flush=True)


if __name__ == "__main__":
    main()

"""Simulation-based calibration of every method on a short planar arm: are its posteriors as wide as they should be?

Talts, Betancourt, Simpson, Vehtari & Gelman (2018), "Validating Bayesian inference algorithms with simulation-based
calibration". If x* and y come from the model and x_1 … x_L from the posterior given y, then x* is exchangeable with
the draws, so that in any quantity f its rank among them is uniform. With weights W_l, Σ W_l = 1, which are worth
L = 1/Σ W_l² equal ones, and v ~ U(0, 1),

    u = (Σ_l W_l 1[f(x_l) < f(x*)] + v/L) / (1 + 1/L)  ~  U(0, 1),

which for equal weights is the rank plus v, over L + 1, and else holds up to the weights' own error. A posterior that is
too narrow puts u near 0 and 1. A method without draws states one path: many equal ones.

Säilynoja, Bürkner & Vehtari (2022), "Graphical test for discrete uniformity": of S such u the empirical distribution
function F has S F(z) ~ Binomial(S, z) at every z. Bands are pointwise intervals of the level γ at which one whole
curve stays inside with probability 1 − α; γ comes from simulated uniform samples, and so does a p-value. A panel
has Q curves, one a quantity, which share their data: its bands have α = .05/Q, its p-value is Q times the smallest
(Bonferroni).

The arm: the paper's (1 m links, .5 and .3 kg, gravity 1, keypoints to .22 m), 20 rows of .05 s, explicit Euler, torques
of sd 3 N·m that forget in ⅓ s, angles that start within .5 rad, noise of .01 rad and .05 rad/s a step; all known.
Quantities: both torques at rows 4, 9, 14, both angles at row 9, and log p(x, y) of the whole path, which sees what
single entries do not (Modrák et al. 2023).

    python benchmarks/calibration.py                         all methods: a table, and docs/calibration.png
    python benchmarks/calibration.py --ranks ranks.json      keep ranks there, and go on from what it holds
    --methods smc,laplace   --simulations 50   --workers 2
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from importlib.resources import files
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import torch
from pyro.infer.smcfilter import SMCFailed
from scipy.stats import binom, chi2

from invdyn.inference import METHODS, Problem, SMCOptions
from invdyn.models import ArmModel, Body, Keypoints, Observation, OrnsteinUhlenbeck
from invdyn.simulate import record

ROWS, STEP = 20, 0.05
TORQUE_ROWS, ANGLE_ROW = (4, 9, 14), 9
QUANTITIES = (
    *(f"torque of the {joint}, row {t}" for t in TORQUE_ROWS for joint in ("shoulder", "elbow")),
    *(f"angle of the {joint}, row {ANGLE_ROW}" for joint in ("shoulder", "elbow")),
    "log p(x, y)",
)
DRAWS = SMCOptions(num_filters=63, num_particles=100, num_draws=1)  # one a filter: draws of one filter share its luck
SETTINGS = {  # simulations, options, arguments, and which draws count
    "smc": (150, DRAWS, {}, 1),
    "bootstrap": (50, SMCOptions(num_filters=63, num_particles=3000, num_draws=1), {}, 1),
    "vsmc": (60, DRAWS, {}, 1),
    "particle-gibbs": (60, DRAWS, {}, 1),
    "nuts": (20, SMCOptions(num_filters=48, num_draws=1), {"chains": 1, "warmup": 40}, 2),
    "laplace": (200, DRAWS, {}, 1),
    "svi-markov": (40, DRAWS, {}, 1),
    "svi": (60, DRAWS, {}, 1),
    "differentiate": (200, DRAWS, {}, 1),
}
"""By method, as the figure shows them."""
OTHER_SEEDS = 1_000_000  # the method's own random numbers must not be those that made its data
ALPHA = 0.05
FIGURE = Path(__file__).parents[1] / "docs" / "calibration.png"


# -- ranks and their distribution --------------------------------------------------------------------
def uniform_ranks(draws: np.ndarray, weights: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """u (Q,) of quantities: draws (L, Q) of weight (L,), which sum to one, and truth (Q,)."""
    count = 1 / (weights**2).sum()
    below = weights @ (draws < truth)
    return (below + rng.uniform(size=truth.shape) / count) / (1 + 1 / count)


def ecdf(u: np.ndarray, grid: np.ndarray) -> np.ndarray:
    """Share (..., K) of the u (..., S) that are at most each point of the grid (K,)."""
    counts = np.stack([np.searchsorted(row, grid, side="right") for row in np.sort(u, -1).reshape(-1, u.shape[-1])])
    return counts.reshape(*u.shape[:-1], len(grid)) / u.shape[-1]


class UniformBands:
    """What the distribution function of S independent uniform numbers does.

    Args:
        size: S.
        num_points: of the grid between 0 and 1.
        num_samples: simulated samples, which give p-values their resolution.
    """

    def __init__(self, size: int, num_points: int = 99, num_samples: int = 20_000, seed: int = 0):
        self.size = size
        self.grid = np.arange(1, num_points + 1) / (num_points + 1)
        counts = np.arange(size + 1)[:, None]
        # Two-sided pointwise p-value of every count at every point of the grid.
        below, above = binom.cdf(counts, size, self.grid), binom.sf(counts - 1, size, self.grid)
        self._pointwise = np.minimum(1.0, 2 * np.minimum(below, above))
        rng = np.random.default_rng(seed)
        # Counts in the grid's cells are multinomial, and their running sums are the distribution function.
        cells = rng.multinomial(size, np.diff(self.grid, prepend=0.0, append=1.0), size=num_samples)
        self._smallest = np.sort(self._of_counts(cells[:, :-1].cumsum(1)))

    def _of_counts(self, counts: np.ndarray) -> np.ndarray:
        return self._pointwise[counts, np.arange(len(self.grid))].min(-1)

    def p_value(self, u: np.ndarray) -> np.ndarray:
        """Chance (...) that S uniform numbers look as odd as u (..., S) where they look oddest."""
        smallest = self._of_counts(np.rint(ecdf(u, self.grid) * self.size).astype(int))
        # Rounding may part what is equal.
        rank = np.searchsorted(self._smallest, smallest * (1 + 1e-9), side="right")
        return (rank + 1) / (len(self._smallest) + 1)

    def bands(self, alpha: float) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest F (K,) at each point of a curve that stays inside with probability 1 − alpha."""
        gamma = np.quantile(self._smallest, alpha, method="lower")
        inside = self._pointwise > gamma
        low = inside.argmax(0)
        high = self.size - inside[::-1].argmax(0)
        return low / self.size, high / self.size


def chi_squared(u: np.ndarray) -> np.ndarray:
    """p-value (...) of the χ² test of u (..., S), in bins that expect at least 5 each, 20 of them at most."""
    size = u.shape[-1]
    bins = int(np.clip(size // 5, 2, 20))
    place = np.minimum((u * bins).astype(int), bins - 1)
    counts = (place[..., None] == np.arange(bins)).sum(-2)
    return chi2.sf(((counts - size / bins) ** 2).sum(-1) / (size / bins), bins - 1)


# -- the arm -----------------------------------------------------------------------------------------
def short_arm() -> ArmModel:
    decay, sd = 3.0, 3.0
    return ArmModel(
        Body.from_toml(files("invdyn.models") / "bodies" / "paper_planar_arm.toml"),
        STEP * np.arange(ROWS),
        Observation(Keypoints(range(2))),
        torque=OrnsteinUhlenbeck(),
        integrator="euler",
        parameters={
            "torque.decay": decay,
            "torque.scale": sd * (2 * decay) ** 0.5,
            "noise.angle": 0.01,
            "noise.velocity": 0.05,
            "emission.keypoint_scale": 0.05**0.5,
            "initial.angle": 0.0,
            "initial.angle_scale": 0.5,
            "initial.velocity_scale": 1.0,
        },
    )


def quantities(problem: Problem, torque: np.ndarray, angle: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """(..., Q) of paths, each part of theirs (..., T, K)."""
    path = torch.as_tensor(np.concatenate([torque, angle, velocity], -1))
    joint = problem.model.log_joint(path, problem.observations).numpy()
    torques = torque[..., list(TORQUE_ROWS), :].reshape(*torque.shape[:-2], -1)
    return np.concatenate([torques, angle[..., ANGLE_ROW, :], joint[..., None]], -1)


def simulate_and_rank(method: str, number: int, options: SMCOptions, arguments: dict, thin: int) -> list[float] | None:
    """u of simulation ``number``, in the order of ``QUANTITIES``; None when the filters lose all their particles."""
    torch.set_num_threads(1)
    model = short_arm()
    recording, truth = record(model, number)
    problem = Problem(model, torch.as_tensor(recording.keypoints.reshape(ROWS, -1)), recording, truth)
    try:
        idata = METHODS[method](problem, options=options, seed=OTHER_SEEDS + number, **arguments)
    except SMCFailed:
        return None
    posterior = idata["posterior"].isel(draw=slice(thin - 1, None, thin))
    parts = [
        posterior[name].transpose("chain", "draw", "time", "joint").values for name in ("torque", "angle", "velocity")
    ]
    draws = quantities(problem, *parts)
    draws = draws.reshape(-1, draws.shape[-1])
    weights = np.full(len(draws), 1 / len(draws))
    if len(draws) == 1:
        count = options.num_filters * options.num_draws
        draws, weights = np.repeat(draws, count, 0), np.full(count, 1 / count)
    true = quantities(problem, truth.torque, truth.angle, truth.velocity)
    rng = np.random.default_rng((OTHER_SEEDS, number))
    return uniform_ranks(draws, weights, true, rng).tolist()


# -- all of them -------------------------------------------------------------------------------------
def ranks(methods: list[str], simulations: int | None, workers: int, file: Path | None) -> dict[str, np.ndarray]:
    """u (Q, S) by method: simulations 0 … S − 1, those that ``file`` lacks run here; NaN where the method failed."""
    kept = json.loads(file.read_text()) if file is not None and file.exists() else {}
    with ProcessPoolExecutor(workers, get_context("spawn")) as pool:
        for method in methods:
            count, *how = SETTINGS[method]
            wanted = [str(number) for number in range(simulations or count)]
            own = kept.setdefault(method, {})
            jobs = {
                pool.submit(simulate_and_rank, method, int(number), *how): number
                for number in wanted
                if number not in own
            }
            for job in as_completed(jobs):
                own[jobs[job]] = job.result()
                if file is not None:
                    file.write_text(json.dumps(kept))
    nothing = [np.nan] * len(QUANTITIES)
    return {
        method: np.array([kept[method][str(n)] or nothing for n in range(simulations or SETTINGS[method][0])]).T
        for method in methods
    }


def known(u: np.ndarray) -> np.ndarray:
    """Without the simulations in which the method failed."""
    return u[:, np.isfinite(u).all(0)]


def table(found: dict[str, np.ndarray]) -> str:
    """Markdown: p-values by both tests, and how often the central 50 and 90 % hold the truth."""
    lines = [
        "| method | simulations | p: torques and angles | p: log p(x, y) | p, χ² | oddest quantity "
        "| 50 % holds torques | 90 % holds torques | 90 % holds log p |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for method, every in found.items():
        u = known(every)
        failed = f" ({every.shape[1] - u.shape[1]} failed)" if u.shape != every.shape else ""
        each = UniformBands(u.shape[1]).p_value(u)
        central = np.abs(u - 0.5)
        half, most = ((central[: 2 * len(TORQUE_ROWS)] < share / 2).mean() for share in (0.5, 0.9))
        cells = [_p(p) for p in (smallest(each[:-1]), each[-1], smallest(chi_squared(u)))]
        cells += [QUANTITIES[each.argmin()], f"{half:.2f}", f"{most:.2f}", f"{(central[-1] < 0.45).mean():.2f}"]
        lines.append(f"| {method} | {every.shape[1]}{failed} | {' | '.join(cells)} |")
    return "\n".join(lines)


def smallest(p_values: np.ndarray) -> float:
    """p-value of several tests at once (Bonferroni)."""
    return min(1.0, p_values.size * p_values.min())


def _p(value: float) -> str:
    return "< .001" if value < 0.001 else f"{value:.3f}"


def draw(found: dict[str, np.ndarray], path: Path = FIGURE) -> None:
    """One panel a method: F(z) − z of every quantity, and its band."""
    import matplotlib
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    from invdyn.plots import BLUE, GREEN, GREY, INK, STYLE, VERMILION

    looks = [*[(BLUE, 1.1), (VERMILION, 1.1)] * len(TORQUE_ROWS), (GREEN, 1.1), (GREEN, 1.1), (INK, 1.4)]
    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(3.4 * columns, 2.3 * rows + 0.7), layout="constrained")
        panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
        for axes, (method, every) in zip(panels, found.items(), strict=False):
            u = known(every)
            uniform = UniformBands(u.shape[1])
            low, high = (np.pad(b - uniform.grid, 1) for b in uniform.bands(ALPHA / len(u)))
            at = np.pad(uniform.grid, 1, constant_values=(0, 1))
            axes.fill_between(at, low, high, color=GREY, alpha=0.25, linewidth=0)
            for one, (color, width) in zip(u, looks, strict=True):
                step = np.sort(one)
                # Just before and at each of its steps.
                z = np.repeat(step, 2)
                f = np.stack([np.arange(len(step)), np.arange(1, len(step) + 1)], 1).ravel() / len(step)
                axes.plot([0, *z, 1], [0, *(f - z), 0], color=color, linewidth=width, alpha=0.85)
            p = smallest(uniform.p_value(u))
            axes.set_title(f"{method}   ({u.shape[1]} simulations, p {_p(p)})", loc="left")
            axes.set(xlim=(0, 1), ylim=(-0.55, 0.55))
        for axes in panels[len(found) :]:
            axes.axis("off")
        figure.supxlabel("rank u of the truth among posterior draws", fontsize=9)
        figure.supylabel("share of ranks up to u, less u", fontsize=9)
        lines = [Line2D([], [], color=c, linewidth=1.4) for c in (BLUE, VERMILION, GREEN, INK)]
        names = ["shoulder torque", "elbow torque", "angles", "log p(x, y)", "where all curves lie if calibrated: 95 %"]
        band = Patch(color=GREY, alpha=0.25, linewidth=0)
        figure.legend([*lines, band], names, loc="outside upper left", ncols=5)
    path.parent.mkdir(exist_ok=True)
    figure.savefig(path, dpi=110)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--methods", default=",".join(SETTINGS), help="comma-separated")
    parser.add_argument("--simulations", type=int, help="of each method; by default as many as its cost allows")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--ranks", type=Path, help="JSON file that keeps the ranks")
    parser.add_argument("--figure", type=Path, default=FIGURE)
    arguments = parser.parse_args()
    found = ranks(arguments.methods.split(","), arguments.simulations, arguments.workers, arguments.ranks)
    print(table(found))
    draw(found, arguments.figure)
    print(f"\n{arguments.figure}")


if __name__ == "__main__":
    main()

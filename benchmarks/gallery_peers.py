"""Four models of the gallery by `particles` 0.4 and cuthbert 0.1.1, side by side with this project, in one run.

    bootstrap     one filter of N particles, systematic resampling below an ESS of N/2, by each of the three
    guided        the proposal of Pitt & Shephard (1999) that `particles` has for stochastic volatility; and its
                  auxiliary filter
    look-ahead    what ``method="smc"`` runs, N particles a filter, with the guide that pilots chose

"var × ms" is the variance of log Ẑ over FILTERS filters of N particles, times the CPU milliseconds of one filter:
what has a tenth of it needs a tenth of the time for the same precision. Compiling comes before, and so does the fit of
the guide, whose seconds are the last column. This project runs all filters in one batch, the others one after another.

    python benchmarks/gallery_peers.py      needs `pip install particles==0.4 cuthbert==0.1.1`
"""

import math
import os
import time
import warnings
from collections.abc import Callable

os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")

import jax
import jax.numpy as jnp
import numpy as np
import particles
import torch
from cuthbert import filter as cuthbert_filter
from cuthbert.smc.particle_filter import build_filter
from cuthbertlib.resampling import ess_decorator, systematic
from gallery_answers import grid
from gallery_models import recording
from jax.scipy.stats import norm, poisson
from jax.scipy.stats import t as student
from particles import distributions as dists
from particles import state_space_models as ssm

from invdyn.inference import SMCOptions, best_guide, run_filters

FILTERS, N = 50, 1000


# -- for `particles` -----------------------------------------------------------------------------------
class Growth(ssm.Gordon_etal):
    def PX0(self):
        return dists.Normal(scale=math.sqrt(5.0))

    def PX(self, t, xp):
        return dists.Normal(loc=xp / 2 + 25 * xp / (1 + xp**2) + 8 * np.cos(1.2 * t), scale=math.sqrt(10.0))


class Nutria(ssm.StateSpaceModel):
    def PX0(self):
        return dists.Normal(loc=3.0)

    def PX(self, t, xp):
        return dists.Normal(loc=0.8 + 0.8 * xp, scale=0.2)

    def PY(self, t, xp, x):
        return dists.Student(df=4.0, loc=x, scale=0.25)


THEIRS = {
    "volatility": ssm.StochVol(mu=0.0, rho=0.95, sigma=0.3),
    "Cox": ssm.DiscreteCox(mu=0.5, phi=0.9, sigma=0.5),  # the log-rate is the state here
    "growth": Growth(),
    "nutria": Nutria(),
}


# -- for cuthbert: mean and sd of the first state and of a step, and log p(y | x) ---------------------------
AUTOREGRESSIVE = 0.5 / math.sqrt(1 - 0.81)
JAX: dict[str, tuple[tuple[float, float], Callable, float, Callable]] = {
    "volatility": (
        (0.0, 0.3 / math.sqrt(1 - 0.95**2)),
        lambda x, t: 0.95 * x,
        0.3,
        lambda x, y: norm.logpdf(y, 0.0, jnp.exp(x / 2)),
    ),
    "Cox": ((0.0, AUTOREGRESSIVE), lambda x, t: 0.9 * x, 0.5, lambda x, y: poisson.logpmf(y, jnp.exp(x + 0.5))),
    "growth": (
        (0.0, math.sqrt(5.0)),
        lambda x, t: x / 2 + 25 * x / (1 + x**2) + 8 * jnp.cos(1.2 * t),
        math.sqrt(10.0),
        lambda x, y: norm.logpdf(y, x**2 / 20),
    ),
    "nutria": ((3.0, 1.0), lambda x, t: 0.8 + 0.8 * x, 0.2, lambda x, y: student.logpdf(y, 4.0, x, 0.25)),
}


def cuthbert_run(name: str, y: np.ndarray) -> Callable[[int], float]:
    """A jitted bootstrap filter: seed → log Ẑ. Its own first state is before row 0, and says nothing."""
    (mean, sd), step, noise, log_likelihood = JAX[name]

    def propagate(key, state, inputs):
        t, _ = inputs
        z = jax.random.normal(key)
        return jnp.where(t == 0, mean + sd * z, step(state, t) + noise * z)

    found = build_filter(
        init_sample=lambda key: jnp.zeros(()),
        propagate_sample=propagate,
        log_potential=lambda before, state, inputs: log_likelihood(state, inputs[1]),
        n_filter_particles=N,
        resampling_fn=ess_decorator(systematic.resampling, 0.5),
    )
    inputs = (jnp.arange(len(y)), jnp.asarray(y))

    @jax.jit
    def run(key):
        first, rest = jax.random.split(key)
        start = found.init_prepare(key=first)
        return cuthbert_filter(found, inputs, start, key=rest).log_normalizing_constant[-1]

    run(jax.random.key(0)).block_until_ready()
    return lambda seed: float(run(jax.random.key(seed)))


def particles_run(kind: type, name: str, y: np.ndarray) -> Callable[[int], float]:
    def run(seed: int) -> float:
        np.random.seed(seed)  # noqa: NPY002 — as the library draws
        smc = particles.SMC(fk=kind(ssm=THEIRS[name], data=y), N=N, resampling="systematic", ESSrmin=0.5)
        smc.run()
        return smc.logLt

    run(0)
    return run


def line(name: str, what: str, exact: float, values: np.ndarray, seconds: float, before: float = 0.0) -> None:
    off = float(np.logaddexp.reduce(values) - math.log(len(values))) - exact
    relative = np.exp(values - values.max())
    error = float(relative.std(ddof=1) / relative.mean() / math.sqrt(len(values)))
    variance, each = values.var(ddof=1), seconds / len(values)
    print(
        f"| {name} | {what} | {off:+.3f} ± {error:.3f} | {variance:.2g} | {1000 * each:.2g} | "
        f"{1000 * variance * each:.2g} | {before:.1f} |",
        flush=True,
    )


def timed(run: Callable[[int], float]) -> tuple[np.ndarray, float]:
    started = time.process_time()
    values = np.array([run(seed) for seed in range(1, FILTERS + 1)])
    return values, time.process_time() - started


def ours(name: str, look_ahead: bool) -> tuple[str, np.ndarray, float, float]:
    model, _, rows = recording(name)
    started, guide, smoother, size = time.process_time(), "bootstrap", None, N
    if look_ahead:
        chosen = best_guide(model, rows, SMCOptions(FILTERS, 100), seed=1)
        guide, smoother, size = chosen.name, chosen.smoother, N
    before = time.process_time() - started
    torch.manual_seed(2)
    options = SMCOptions(FILTERS, size)
    run_filters(model, rows, SMCOptions(2, 10), guide=guide, smoother=smoother, keep=0)
    started = time.process_time()
    values = run_filters(model, rows, options, guide=guide, smoother=smoother, keep=0).log_evidence.numpy()
    return f"invdyn, {guide}", values, time.process_time() - started, before


def main() -> None:
    warnings.simplefilter("ignore")
    torch.set_num_threads(1)
    print("| model | filter | log Ẑ off | variance | CPU ms a filter | var × ms | guide, s |")
    print("|---|---|---|---|---|---|---|")
    for name in THEIRS:
        model, _, rows = recording(name)
        exact, y = grid(model, rows, smooth=False).log_evidence, rows.squeeze(-1).numpy()
        kinds = {"bootstrap": ssm.Bootstrap}
        if name == "volatility":
            kinds |= {"guided": ssm.GuidedPF, "auxiliary": ssm.AuxiliaryPF}
        for what, kind in kinds.items():
            line(name, f"particles, {what}", exact, *timed(particles_run(kind, name, y)))
        line(name, "cuthbert, bootstrap", exact, *timed(cuthbert_run(name, y)))
        for look_ahead in (False, True):
            what, values, seconds, before = ours(name, look_ahead)
            line(name, what, exact, values, seconds, before)


if __name__ == "__main__":
    main()

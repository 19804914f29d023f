"""NUTS on short series: the reference that other methods are held against.

Hoffman & Gelman (2014), "The No-U-Turn Sampler". The path is written through standard normals, non-centred,
by the Gaussian smoother's chain (:class:`.laplace.GaussianChain`), x = path(ε): near ε ~ N(0, I)
where the posterior is nearly Gaussian, however stiff the dynamics, so that steps of order one fit all
coordinates. Its target is exact: log p(x(ε), y), as the map's Jacobian is constant.
"""

import math

import arviz as az
import numpy as np
import pyro
import torch
import xarray as xr
from pyro.distributions import Normal
from pyro.infer import MCMC, NUTS
from torch import Tensor

from invdyn.inference.initialise import Problem
from invdyn.inference.laplace import GaussianChain
from invdyn.inference.posterior import to_inference_data
from invdyn.inference.seeds import derived, seeded
from invdyn.inference.smc import Progress, SMCOptions, gaussian_smoother
from invdyn.models import StateSpaceModel
from invdyn.recordings import InputError

LONGEST = 100
"""Rows that NUTS can be waited for."""

FEWEST_DRAWS = 4
"""Of a chain: R-hat compares the halves of each, which need a variance."""


def whitened_model(model: StateSpaceModel, observations: Tensor, chain: GaussianChain):
    """The Pyro model whose site "noise" (T, D) makes the path, distributed as p(x, y)."""

    def noise_to_path() -> None:
        noise = pyro.sample("noise", Normal(torch.zeros_like(chain.loc), 1.0).to_event(2))
        # In place of the standard normal's own density.
        pyro.factor("ratio", model.log_joint(chain.path(noise), observations) + 0.5 * noise.square().sum())

    return noise_to_path


def nuts(
    problem: Problem,
    *,
    options: SMCOptions | None = None,
    start: Tensor | None = None,
    seed: int = 0,
    settings: dict | None = None,
    progress: Progress | None = None,
    chains: int = 4,
    warmup: int = 150,
) -> az.InferenceData:
    """Sample the posterior by NUTS; no evidence (NaN).

    Args:
        problem: model and observations, at most ``LONGEST`` rows.
        options: num_filters × num_draws draws in all, shared out among the chains.
        start: path (T, D) to linearise at first.
        seed: of every random number; same seed, same result.
        settings: recorded in the result's attributes.
        progress: called with (done, total, what).
        chains, warmup: chains, begun apart from one another, and steps of each that are thrown away.

    The attributes of sample_stats hold the largest R-hat and the smallest effective sample sizes of any torque,
    and the number of divergent steps. Raises InputError for a longer series, or fewer draws of
    a chain than ``FEWEST_DRAWS``.
    """
    options = options or SMCOptions()
    model, observations = problem.model.to(dtype=torch.float64), problem.observations.double()
    if len(observations) > LONGEST:
        raise InputError(
            f"NUTS is a reference for short series: expected at most {LONGEST} frames, got {len(observations)}; "
            "select a stretch, or use smc"
        )
    draws = math.ceil(options.num_filters * options.num_draws / chains)
    if draws < FEWEST_DRAWS:
        raise InputError(
            f"nuts: expected {FEWEST_DRAWS} draws of each of {chains} chains, for R-hat, got {draws}: "
            f"let --filters × --draws be {FEWEST_DRAWS * chains} or more"
        )
    whitening = GaussianChain.of(gaussian_smoother(model, observations, start))
    target = whitened_model(model, observations, whitening)
    paths, divergent, done = [], 0, 0

    def report(*_) -> None:
        nonlocal done
        done += 1
        if progress is not None:
            progress(done, chains * (warmup + draws), "nuts")

    with seeded(seed):
        for number in range(chains):
            # Each chain begins at a draw from the smoother, twice as wide: R-hat can tell.
            torch.manual_seed(derived(seed, number))
            begin = {"noise": 2 * torch.randn(whitening.loc.shape, dtype=torch.float64)}
            sampler = MCMC(
                NUTS(target, max_tree_depth=8),
                num_samples=draws,
                warmup_steps=warmup,
                initial_params=begin,
                hook_fn=report,
                disable_progbar=True,
            )
            sampler.run()
            paths.append(whitening.path(sampler.get_samples()["noise"]))
            divergent += len(sampler.diagnostics()["divergences"]["chain 0"])
        torch.manual_seed(seed)
        paths = torch.stack(paths)
        return to_inference_data(
            problem,
            paths,
            method="nuts",
            seed=seed,
            settings={**(settings or {}), "chains": chains, "warmup": warmup},
            diagnostics={**mixing(model.net_torque(paths).numpy()), "divergences": divergent},
        )


def mixing(torque: np.ndarray) -> dict[str, float]:
    """Largest R-hat, smallest bulk and tail effective sample size of any entry of draws (chain, draw, …)."""
    # ArviZ's own conversion warns of more chains than draws, which is what batched chains are.
    data = xr.Dataset({"torque": (["chain", "draw", *(f"dim_{k}" for k in range(torque.ndim - 2))], torque)})
    return {
        "r_hat": float(az.rhat(data)["torque"].max()),
        "ess_bulk": float(az.ess(data, method="bulk")["torque"].min()),
        "ess_tail": float(az.ess(data, method="tail")["torque"].min()),
    }

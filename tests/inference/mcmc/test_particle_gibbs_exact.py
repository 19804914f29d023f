"""Particle Gibbs on any state-space model: linear ones against RTS, nonlinear ones against a dense grid."""

import numpy as np
import oracles
import pyro.distributions as dist
import pytest
import torch
from grids import grid_posterior
from one_state import Growth

from invdyn.inference import Bootstrap, Controlled, SMCOptions, gauss_newton
from invdyn.inference.contract import ModelError
from invdyn.inference.mcmc.particle_gibbs import first_paths, run_chains, sweep
from invdyn.models import LinearGaussian


def swept(guide, y, particles, chains, sweeps, threshold=1.0):
    """Paths (M, T, D) after so many sweeps."""
    torch.manual_seed(1)
    paths = first_paths(guide, y, chains, particles, threshold=threshold)
    for _ in range(sweeps):
        paths = sweep(guide, y, paths, particles, threshold=threshold)
    return paths


@pytest.mark.quick("controlled-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("guide", ["bootstrap", "controlled", "misled"])
def test_a_linear_model_against_rts(guide, threshold):
    chain, steps = oracles.noisy_chain(), 16
    y = oracles.with_gaps(chain.simulate(steps, seed=1)[1])
    model, rows = chain.model(steps), torch.as_tensor(y)
    proposal = {
        "bootstrap": lambda: Bootstrap(model),
        "controlled": lambda: Controlled(model, rows),
        # Linearised at other data: the weights must undo it.
        "misled": lambda: Controlled(model, rows, gauss_newton(model, 0.5 * rows.roll(2, 0))),
    }[guide]()
    last = swept(proposal, rows, particles=8, chains=1000, sweeps=18, threshold=threshold).numpy()
    assert last.shape == (1000, steps, 2)
    means, covs = oracles.rts(chain, y)
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    assert np.abs((last.mean(0) - means) / sd).max() < 4.5 / np.sqrt(1000)
    assert np.abs(last.var(0) / sd**2 - 1).max() < 4.5 * np.sqrt(2 / 1000)


@pytest.mark.long
def test_the_growth_model_against_a_grid():
    """Two modes at many rows: the sign of x_t is hardly seen."""
    model = Growth(12)
    torch.manual_seed(4)
    y = model.simulate()[1]
    y[5] = torch.nan
    exact = grid_posterior(model, y, -45, 45, 900)
    assert exact.variance.max() > 20
    found = swept(Bootstrap(model), y, particles=60, chains=600, sweeps=26).squeeze(-1)
    error = np.sqrt(exact.variance / len(found))
    assert (np.abs(found.mean(0).numpy() - exact.mean) < 4.5 * error).all()
    # The variance of a variance, from the draws themselves.
    square = (found - torch.as_tensor(exact.mean)).square()
    off = (square.mean(0) - torch.as_tensor(exact.variance)).abs()
    assert (off < 4.5 * square.std(0) / len(found) ** 0.5).all()


def test_a_model_without_a_transition_density_is_refused():
    """AR(2) as a pair: its second state has no noise, and no ancestor but its own would have a density."""

    class Pair(LinearGaussian):
        def transition(self, state, t):
            mean = torch.stack([1.2 * state[..., 0] - 0.5 * state[..., 1], state[..., 0]], -1)
            return dist.Normal(mean, torch.tensor([0.6, 0.0], dtype=torch.float64), validate_args=False).to_event(1)

    eye = torch.eye(2, dtype=torch.float64)
    model = Pair(eye, eye, eye[:1], eye[:1, :1], eye[0], eye, 10)
    with pytest.raises(ModelError, match=r"Pair\.transition: expected a finite log-density"):
        run_chains(model, torch.zeros(10, 1, dtype=torch.float64), SMCOptions(4, 5), None, seed=0, warmup=1, sweeps=2)

"""Particle Gibbs on any state-space model: linear ones against RTS, nonlinear ones against a dense grid."""

import numpy as np
import oracles
import pyro.distributions as dist
import pytest
import torch
from grids import grid_posterior
from one_state import Growth

from invdyn.inference import Controlled, gauss_newton, particle_gibbs_sampler
from invdyn.inference.contract import ModelError
from invdyn.models import LinearGaussian


@pytest.mark.quick("controlled-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("guide", ["bootstrap", "controlled", "misled"])
def test_a_linear_model_against_rts(guide, threshold):
    chain, steps = oracles.noisy_chain(), 16
    y = oracles.with_gaps(chain.simulate(steps, seed=1)[1])
    model, rows = chain.model(steps), torch.as_tensor(y)
    proposal = {
        "bootstrap": lambda: None,
        "controlled": lambda: Controlled(model, rows),
        # Linearised at other data: the weights must undo it.
        "misled": lambda: Controlled(model, rows, gauss_newton(model, 0.5 * rows.roll(2, 0))),
    }[guide]()
    paths = particle_gibbs_sampler(
        model,
        rows,
        num_particles=8,
        num_chains=1000,
        num_draws=2,
        warmup=12,
        thin=3,
        seed=1,
        guide=proposal,
        ess_threshold=threshold,
    )
    assert paths.shape == (1000, 2, steps, 2)
    means, covs = oracles.rts(chain, y)
    sd = np.sqrt(np.diagonal(covs, axis1=1, axis2=2))
    last = paths[:, -1].numpy()
    assert np.abs((last.mean(0) - means) / sd).max() < 4.5 / np.sqrt(1000)
    assert np.abs(last.var(0) / sd**2 - 1).max() < 4.5 * np.sqrt(2 / 1000)


@pytest.mark.long
def test_the_growth_model_against_a_grid():
    """Two modes at many rows: the sign of x_t is hardly seen."""
    steps, model = 12, Growth(12)
    torch.manual_seed(4)
    y = model.simulate()[1]
    y[5] = torch.nan
    exact = grid_posterior(model, y, -45, 45, 900)
    assert exact.variance.max() > 20
    paths = particle_gibbs_sampler(model, y, num_particles=60, num_chains=600, num_draws=1, warmup=25, seed=2)
    found = paths.reshape(-1, steps)
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
        particle_gibbs_sampler(model, torch.zeros(10, 1, dtype=torch.float64), num_particles=5, seed=0)


def test_draws_depend_on_the_seed_alone_and_are_thinned():
    chain = oracles.noisy_chain()
    model, y = chain.model(6), torch.as_tensor(chain.simulate(6, seed=1)[1])
    options = {"num_particles": 5, "num_chains": 3, "warmup": 2}
    every = particle_gibbs_sampler(model, y, num_draws=6, seed=5, **options)
    torch.manual_seed(99)
    third = particle_gibbs_sampler(model, y, num_draws=2, thin=3, seed=5, **options)
    assert torch.equal(third, every[:, 2::3])
    assert not torch.equal(every, particle_gibbs_sampler(model, y, num_draws=6, seed=6, **options))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"num_particles": 1}, "expected two particles at least"),
        ({"num_draws": 0}, "expected one draw"),
        ({"thin": 0}, "expected one draw"),
    ],
)
def test_bad_sizes_are_refused(options, message):
    chain = oracles.noisy_chain()
    model, y = chain.model(3), torch.zeros(3, 2, dtype=torch.float64)
    with pytest.raises(ValueError, match=message):
        particle_gibbs_sampler(model, y, **{"num_particles": 5, "seed": 0, **options})

"""An emission that sees the state before, in every method that takes it: volatility with leverage, against a grid."""

import math

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from grids import Leverage, leverage_answer, log_normal
from oracles import assert_unbiased

from invdyn.inference import (
    VSMC_ELBO,
    Bootstrap,
    Controlled,
    ParticleFilter,
    SMCOptions,
    backward_mcmc,
    backward_simulation,
    filter_rows,
    gauss_newton,
    infer_states,
)
from invdyn.inference.contract import ModelError
from invdyn.inference.mcmc.particle_gibbs import run_chains

T = 12


@pytest.fixture(scope="module")
def case():
    """Model, observations (T, 1) with one missing, and the exact answer."""
    model = Leverage(T)
    torch.manual_seed(2)
    y = model.simulate()[1]
    y[4] = math.nan
    return model, y, leverage_answer(y[:, 0].numpy())


def by_hand(path, y, phi=0.9, sigma=0.5, rho=-0.8):
    """Log p(x, y) of one path (T,)."""
    total = log_normal(path[0], 0, 1) + log_normal(y[0], 0, math.exp(path[0] / 2))
    for before, x, value in zip(path[:-1], path[1:], y[1:], strict=True):
        total += log_normal(x, phi * before, sigma)
        if math.isfinite(value):
            scale = math.exp(x / 2)
            noise = (x - phi * before) / sigma
            total += log_normal(value, rho * scale * noise, scale * math.sqrt(1 - rho**2))
    return total


def test_the_joint_density(case):
    model, y, _ = case
    torch.manual_seed(0)
    paths = torch.randn(4, T, 1, dtype=torch.float64)
    expected = [by_hand(path[:, 0].numpy(), y[:, 0].numpy()) for path in paths]
    assert model.log_joint(paths, y).tolist() == pytest.approx(expected)
    # … and as the density of the Pyro model.
    conditioned = pyro.condition(model.sequence, {f"x_{t}": paths[2, t] for t in range(T)})
    trace = pyro.poutine.trace(conditioned).get_trace(y)
    assert trace.log_prob_sum().item() == pytest.approx(expected[2])


@pytest.mark.parametrize("way", ["simulate", "sequence"])
def test_simulated_noises_are_correlated(way):
    model = Leverage(2)
    torch.manual_seed(0)
    if way == "simulate":
        states, y = model.simulate((4000,))
    else:
        with pyro.plate("paths", 4000):
            trace = pyro.poutine.trace(model.sequence).get_trace()
        states = torch.stack([trace.nodes[f"x_{t}"]["value"] for t in range(2)], -2)
        y = torch.stack([trace.nodes[f"y_{t}"]["value"] for t in range(2)], -2)
    noise = (states[:, 1, 0] - 0.9 * states[:, 0, 0]) / 0.5
    scaled = y[:, 1, 0] / (states[:, 1, 0] / 2).exp()
    assert np.corrcoef(noise, scaled)[0, 1] == pytest.approx(-0.8, abs=0.03)
    assert scaled.std().item() == pytest.approx(1, abs=0.06)


@pytest.mark.quick("*-0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
@pytest.mark.parametrize("way", ["run", "steps", "rows", "vsmc"])
def test_the_evidence_is_unbiased(case, way, threshold):
    model, y, exact = case
    if way == "vsmc":
        bound = VSMC_ELBO(num_particles=200, num_filters=2000, ess_threshold=threshold)
        log_evidence = bound.log_evidence(model, Bootstrap(model), y)
    elif way == "rows":
        rows = filter_rows(model, y, 200, seed=1, num_filters=2000, ess_threshold=threshold)
        log_evidence = [row.log_evidence for row in rows][-1]
    else:
        filters = ParticleFilter(model, Bootstrap(model), 200, num_filters=2000, ess_threshold=threshold)
        if way == "run":
            log_evidence = filters.run(y).log_evidence
        else:
            filters.init(y[0])
            for t in range(1, T):
                filters.step(t, y[t])
            log_evidence = filters.log_evidence
    assert_unbiased(log_evidence, exact.log_evidence)


def assert_smoothed(paths, exact, effective):
    """Means and variances of paths (S, T), of which so many are worth an independent one."""
    sd = np.sqrt(exact.variance)
    paths = paths.reshape(-1, T).numpy()
    assert np.abs((paths.mean(0) - exact.mean) / sd).max() < 4.5 / math.sqrt(effective)
    assert np.abs(paths.var(0) / exact.variance - 1).max() < 6 / math.sqrt(effective)


@pytest.mark.quick("mcmc")
@pytest.mark.parametrize("kind", ["exact", "mcmc"])
def test_backward_sampling(case, kind):
    model, y, exact = case
    result = ParticleFilter(model, Bootstrap(model), 500, num_filters=50).run(y)
    paths = (
        backward_simulation(model, result, y, 100)
        if kind == "exact"
        else backward_mcmc(model, result, y, 100, seed=1, steps=2)
    )
    assert_smoothed(paths, exact, 2000)


@pytest.mark.quick("0.5")
@pytest.mark.parametrize("threshold", [0.5, 1.0])
def test_particle_gibbs(case, threshold):
    model, y, exact = case
    options = SMCOptions(2000, 8, ess_threshold=threshold)
    paths = run_chains(model, y, options, None, seed=3, warmup=15, sweeps=16)["paths"]
    assert paths.shape == (2000, 1, T, 1)
    assert_smoothed(paths, exact, 2000)


def test_methods_that_linearise_the_emission_refuse_it(case):
    model, y, _ = case
    assert model.emission_sees_previous
    for method in (gauss_newton, Controlled):
        with pytest.raises(ModelError, match=r"Leverage\.emission_given: expected an emission of x_t alone"):
            method(model, y)


def test_what_it_gives_is_checked(case):
    class Wide(Leverage):
        def emission_given(self, previous, state, t):
            return dist.Normal(state.expand(*state.shape[:-1], 2), 1.0).to_event(1)

    class Unbatched(Leverage):
        def emission_given(self, previous, state, t):
            return dist.Normal(torch.zeros(1, dtype=state.dtype), 1.0).to_event(1)

    for kind, got in ((Wide, r"\(2,\)"), (Unbatched, r"\(\)")):
        model = kind(T)
        with pytest.raises(ModelError, match=rf"{kind.__name__}\.emission_given: expected .* got {got}"):
            ParticleFilter(model, Bootstrap(model), 5).run(case[1])


def test_inference_data_has_its_rows(case):
    """Predictive draws and log-likelihoods by row are those of the emission given the state before."""
    model, y, _ = case
    idata = infer_states(model, y, method="bootstrap", num_filters=20, num_particles=100, num_draws=10, seed=1)
    states = idata["posterior"]["state"].stack(path=("chain", "draw")).squeeze("state_name").values
    assert states.shape == (T, 200)
    seen = np.isfinite(y[:, 0].numpy())
    rows = idata["log_likelihood"]["y"].stack(path=("chain", "draw")).values
    whole = model.log_likelihood(torch.as_tensor(states.T).unsqueeze(-1), y).numpy()
    assert np.allclose(rows, whole.T[seen])
    path = states[:, 7]
    noise = (path[3] - 0.9 * path[2]) / 0.5
    expected = log_normal(y[3, 0].item(), -0.8 * math.exp(path[3] / 2) * noise, math.exp(path[3] / 2) * 0.6)
    assert whole[7, 3] == pytest.approx(expected)


def test_other_models_are_as_they_were():
    class Plain(Leverage):
        def emission_given(self, previous, state, t):
            return self.emission(state, t)

    class Seen(Leverage):
        emission_given = Leverage.__mro__[1].emission_given  # StateSpaceModel's own

        def emission(self, state, t):
            return dist.Normal(state, 1.0).to_event(1)

    assert Plain(3).emission_sees_previous
    assert not Seen(3).emission_sees_previous

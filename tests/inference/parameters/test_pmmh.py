"""PMMH against quadrature and against SMC²; its number of particles, its evidence, and several recordings at once."""

import arviz as az
import numpy as np
import pytest
import torch
from parameter_answers import Quadrature, simulated
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.parameters.importance import importance_evidence
from invdyn.inference.parameters.pmmh import pmmh, run_chains
from invdyn.inference.parameters.smc2 import smc2
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters
from invdyn.recordings import InputError


@pytest.fixture(scope="module")
def case():
    model, y = simulated("linear")
    return model, y, Quadrature(y)


@pytest.fixture(scope="module")
def result(case):
    model, y, _ = case
    return pmmh(model, y, num_chains=40, num_warmup=100, num_draws=120, num_particles=30)


def standard_error(draws):
    """Of the mean of draws (chain, draw), by ArviZ's effective sample size."""
    return float(draws.std() / np.sqrt(az.ess(draws)))


def test_parameters_are_those_of_quadrature(case, result):
    exact = case[2]
    for name, mean in exact.mean.items():
        draws = result.draws[name].squeeze(-1).numpy()
        assert az.ess(draws) > 150
        assert az.rhat(draws) < 1.25  # chains of 120 steps, of which one in 20 is independent
        assert abs(draws.mean() - mean) < 4 * standard_error(draws)
        assert abs(draws.std() / exact.sd[name] - 1) < 4 / np.sqrt(az.ess(draws))


def test_evidence_is_that_of_quadrature(case, result):
    assert abs(result.log_evidence - case[2].log_evidence[-1]) < 3 * result.log_evidence_sd
    assert result.log_evidence_sd < 0.1


def test_states_come_with_the_parameters(case, result):
    states = result.paths.squeeze(-1).numpy()
    assert states.shape == (40, 120, 15)
    error = np.array([standard_error(states[..., t]) for t in range(15)])
    assert (np.abs(states.mean((0, 1)) - case[2].states) < 4 * error).all()


def test_the_walk_adapts_to_the_acceptance(result):
    assert abs(result.acceptance.mean().item() - 0.2) < 0.06


@pytest.mark.quick("counts")
@pytest.mark.parametrize("name", ["volatility", "counts"])
def test_it_agrees_with_smc2(name):
    model, y = simulated(name, rows=12)
    walk = pmmh(model, y, num_chains=40, num_warmup=60, num_draws=40, num_particles=30, paths=False)
    runs = smc2(model, y, num_draws=100, num_particles=30, num_runs=5, paths=False)
    assert walk.paths is None
    assert abs(walk.log_evidence - runs.log_evidence) < 3 * np.hypot(walk.log_evidence_sd, runs.log_evidence_sd)
    for parameter, draws in walk.draws.items():
        error = np.hypot(standard_error(draws.squeeze(-1).numpy()), runs.sd(parameter).item() / np.sqrt(runs.ess / 2))
        assert abs(walk.mean(parameter).item() - runs.mean(parameter).item()) < 4 * error


def test_it_chooses_particles_by_the_noise_of_the_likelihood(case):
    model, y, _ = case
    few = pmmh(model, y, num_chains=4, num_warmup=100, num_draws=2, paths=False, evidence_draws=0)
    # It starts at 100, with which the likelihood of 15 rows is sharper than it needs to be.
    assert few.num_particles < 100
    assert 0.7 < few.statistics["log_likelihood_sd"] < 1.8
    assert np.isnan(few.log_evidence)


def test_a_likelihood_too_noisy_to_use_is_marked(result):
    model, y = simulated("counts")
    y = y.clone()
    y[-1] = 2581  # which 20 particles do not reach
    few = pmmh(model, y, num_chains=4, num_warmup=20, num_draws=2, num_particles=20, paths=False, evidence_draws=50)
    assert few.statistics["log_likelihood_sd"] > 2.5
    assert few.statistics["usable"] == 0
    assert np.isnan(few.log_evidence_sd)
    assert result.statistics["usable"] == 1


@pytest.mark.long
def test_several_recordings_at_once_have_each_their_own_posterior(case):
    model, y, exact = case
    other = -0.4 * y
    space = UnconstrainedParameters(model)
    with seeded(1):
        found = run_chains(
            space, torch.stack([y, other]), num_chains=40, num_draws=80, num_warmup=80, num_particles=30, paths=False
        )
    for z, answer in zip(found.z, (exact, Quadrature(other)), strict=True):
        for name, values in space.values(z).items():
            draws = values.squeeze(-1).numpy()
            assert abs(draws.mean() - answer.mean[name]) < 4 * standard_error(draws)


def test_the_same_seed_has_the_same_bits(case):
    model, y, _ = case
    sizes = {"num_chains": 3, "num_warmup": 6, "num_draws": 4, "num_particles": 10, "evidence_draws": 20}
    steps = []
    one = pmmh(model, y, **sizes, progress=lambda done, total, what: steps.append((done, total)))
    torch.manual_seed(5)
    two, other = pmmh(model, y, **sizes), pmmh(model, y, **sizes, seed=1)
    assert torch.equal(one.paths, two.paths)
    assert one.log_evidence == two.log_evidence != other.log_evidence
    assert steps == [(done, 10) for done in range(1, 11)]


def test_importance_sampling_is_right_from_poor_draws(case):
    """Draws half as wide and off by a sd: the share of the prior keeps the weights bounded."""
    model, y, exact = case
    space = UnconstrainedParameters(model)
    from parameter_answers import exact_log_likelihood

    with seeded(1):
        z = torch.log(torch.tensor([exact.mean["process_sd"], exact.mean["noise_sd"]])) + 0.2
        draws = z + 0.1 * torch.randn(200, 2, dtype=torch.float64)
        evidence, sd = importance_evidence(space, draws, lambda z: exact_log_likelihood(y)(space.at(z)), 4000)
    assert abs(evidence - exact.log_evidence[-1]) < 3 * sd
    assert 0.005 < sd < 0.1


def test_what_cannot_be_run_is_refused(case):
    model, y, _ = case
    with pytest.raises(InputError, match="expected at least one chain, draw, warm-up step and particle"):
        pmmh(model, y, num_particles=0)
    with pytest.raises(SMCFailed, match="none of 20 draws from the prior gives the observations a density"):
        pmmh(model, torch.full_like(y, 1e200), num_chains=2)

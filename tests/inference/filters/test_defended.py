"""The defended look-ahead: unbiased for any dynamics, and at no loss of a mode."""

import pytest
import torch
from grids import grid_posterior
from one_state import Autoregression, HeavyTailed, Multiplicative, Positive
from oracles import kalman, random_chain, with_gaps

from invdyn.inference import Controlled, Corrected, Defended, ParticleFilter, SMCOptions, gauss_newton, outer_weights
from invdyn.inference.contract import ModelError
from invdyn.inference.filters.filtering import run_filters
from invdyn.inference.filters.moment_matching import matched, moment_matched, noise_varies
from invdyn.models.state_space import gaussian_moments


def recorded(kind, steps=20, seed=3):
    model = kind(steps)
    torch.manual_seed(seed)
    return model, model.simulate()[1]


@pytest.mark.parametrize("share", [0.0, 0.1])
def test_a_linear_gaussian_model_is_exact_without_a_floor_and_unbiased_with(share):
    chain = random_chain(seed=5)
    y = with_gaps(chain.simulate(12, seed=5)[1])
    model, rows = chain.model(12), torch.as_tensor(y)
    guide = Defended(model, rows, gauss_newton(model, rows), share)
    torch.manual_seed(0)
    found = outer_weights(ParticleFilter(model, guide, 100, num_filters=32).run(rows, keep=0).log_evidence)
    exact = kalman(chain, y)[0]
    assert found.log_evidence == pytest.approx(exact, abs=4 * found.log_evidence_sd + 1e-6)
    assert found.filter_sd < (1e-6 if share == 0 else 1.0)


@pytest.mark.parametrize("kind", [Multiplicative, HeavyTailed])
def test_evidence_of_any_dynamics(kind):
    model, y = recorded(kind)
    exact = grid_posterior(model, y, -8, 8).log_evidence
    like = moment_matched(model)
    smoother = gauss_newton(like, y)
    torch.manual_seed(1)
    found = outer_weights(run_filters(model, y, SMCOptions(64, 100), smoother=smoother, keep=0).log_evidence)
    assert found.ess > 32
    assert found.log_evidence == pytest.approx(exact, abs=4 * found.log_evidence_sd)


def test_one_gain_for_noise_that_varies_is_refused():
    model, y = recorded(Multiplicative)
    smoother = gauss_newton(model, y)
    assert noise_varies(model, smoother.path)
    with pytest.raises(ModelError, match="does not depend on the state"):
        Controlled(model, y, smoother)
    plain, rows = recorded(Autoregression)
    assert not noise_varies(plain, gauss_newton(plain, rows).path)


def test_a_learned_correction_takes_each_particles_own_noise():
    model, y = recorded(Multiplicative)
    exact = grid_posterior(model, y, -8, 8).log_evidence
    guide = Corrected(model, y, gauss_newton(model, y))
    torch.manual_seed(2)
    found = outer_weights(ParticleFilter(model, guide, 400, num_filters=64).run(y, keep=0).log_evidence)
    assert found.ess > 20
    assert found.log_evidence == pytest.approx(exact, abs=4 * found.log_evidence_sd)


def test_look_alikes_have_the_moments():
    model, _ = recorded(HeavyTailed)
    state = torch.tensor([[0.7], [-2.0]], dtype=torch.float64)
    truth = model.transition(state, 1)
    mean, root = gaussian_moments(moment_matched(model).transition(state, 1))
    torch.testing.assert_close(mean, truth.mean)
    torch.testing.assert_close(root[..., 0, 0].square(), truth.variance[..., 0])
    plain = Autoregression(5)
    assert moment_matched(plain) is plain
    with pytest.raises(TypeError, match="bootstrap guide takes any"):
        moment_matched(Positive(5))
    with pytest.raises(TypeError, match="on the real line"):
        matched(Positive(5).initial())


def test_both_ways_in_weigh_the_same():
    """Density and draws of Pyro's conditional are those of the proposal."""
    model, y = recorded(Multiplicative)
    guide = Defended(model, y, gauss_newton(model, y))
    state = torch.tensor([0.8], dtype=torch.float64)
    conditional = guide.conditional(3, state)
    x = torch.linspace(-6, 6, 4001, dtype=torch.float64).unsqueeze(-1)
    density = conditional.log_prob(x).exp()
    assert density.sum() * (x[1] - x[0]) == pytest.approx(1, abs=1e-3)
    torch.manual_seed(0)
    draws = conditional.expand(torch.Size((20_000,))).sample()
    mean = (density * x[:, 0]).sum() * (x[1] - x[0])
    assert draws.mean() == pytest.approx(mean.item(), abs=5 * draws.std().item() / 20_000**0.5)

"""The refitted factors: exact where they can be, unbiased always, steadier where the posterior bends."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from grids import grid_posterior
from one_state import Autoregression
from oracles import kalman, random_chain, with_gaps
from pyro.distributions import Normal, StudentT
from pyro.infer.smcfilter import SMCFailed

from invdyn.inference import SMCOptions, gauss_newton, posterior_linearisation, run_filters
from invdyn.inference.filters.filtering import adapted_smoother
from invdyn.inference.filters.iterated import iterate, refit, refitted_over_paths
from invdyn.inference.smoothing.statistical_homotopy import first_fit
from invdyn.models import LinearGaussian, StateSpaceModel

SMALL = SMCOptions(num_filters=32, num_particles=50, dtype=torch.float64)


class Heavy(LinearGaussian):
    """A linear chain seen with mildly heavy-tailed noise."""

    def emission(self, state, t):
        scale = torch.full((self.observation_dim,), 0.4, dtype=state.dtype)
        return StudentT(8.0, state @ self.parameters["emission"].mT, scale).to_event(1)


class Turning(StateSpaceModel):
    """A wandering angle and its speed, of which the camera sees the cosine and sine only, with much noise."""

    state_dim, observation_dim, num_steps = 2, 2, 40

    def __init__(self):
        super().__init__({"sd": torch.tensor([0.05, 0.3], dtype=torch.float64)})

    def initial(self):
        return Normal(torch.zeros_like(self.parameters["sd"]), 20 * self.parameters["sd"]).to_event(1)

    def transition(self, state, t):
        angle, speed = state.unbind(-1)
        mean = torch.stack([angle + 0.1 * speed, speed - 0.1 * torch.sin(2 * angle)], -1)
        return Normal(mean, self.parameters["sd"]).to_event(1)

    def emission(self, state, t):
        return Normal(torch.stack([state[..., 0].cos(), state[..., 0].sin()], -1), 0.8).to_event(1)


def pilot(model, y, options=SMALL):
    return lambda smoother: run_filters(model, y, options, smoother=smoother)


def heavy(steps=12):
    chain = random_chain(seed=3, dim=2, size=1)
    model = Heavy(*(torch.as_tensor(x) for x in (chain.A, chain.Q, chain.C, chain.R, chain.m, chain.P)), steps)
    torch.manual_seed(5)
    return model, model.simulate()[1]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_linear_gaussian_model_is_left_as_it_is(dtype):
    chain = random_chain(seed=1)
    y = with_gaps(chain.simulate(15)[1])
    model, observations = chain.model(15), torch.as_tensor(y)
    smoother = gauss_newton(model, observations)
    torch.manual_seed(0)
    options = SMCOptions(num_filters=8, num_particles=20, dtype=dtype)
    new = refit(model, observations, smoother, [pilot(model, observations, options)(smoother)])
    for name in ("U", "b", "A", "alpha", "gain", "offset", "root"):
        np.testing.assert_array_equal(getattr(new.factors, name), getattr(smoother.factors, name))
    # The constants now hold the emission's own normalisers: the whole evidence.
    assert new.factors.log_evidence == pytest.approx(kalman(chain, y)[0], abs=1e-9)


def test_the_refit_of_wrong_factors_finds_the_right_ones():
    chain = random_chain(seed=2)
    y = torch.as_tensor(chain.simulate(15)[1])
    model = chain.model(15)
    right = gauss_newton(model, y)
    blurred = model.replace(emission_root=1.5 * model.parameters["emission_root"])
    wrong = gauss_newton(blurred, y, start=right.path)
    torch.manual_seed(0)
    scatters = [pilot(model, y)(s).log_evidence.std().item() for s in (right, wrong)]
    adapted, _ = iterate(model, y, [wrong], pilot(model, y), iterations=3)
    scatter = pilot(model, y)(adapted).log_evidence.std().item()
    assert scatters[0] < 1e-8
    assert scatter < 0.05 * scatters[1]
    assert adapted.factors.log_evidence == pytest.approx(kalman(chain, y.numpy())[0], abs=0.02)


@pytest.mark.long
def test_the_evidence_stays_unbiased():
    model, y = heavy()
    torch.manual_seed(1)
    big = SMCOptions(num_filters=200, num_particles=2000, dtype=torch.float64)
    reference = run_filters(model, y, big, guide="bootstrap", keep=0).log_evidence
    many = replace(SMALL, num_filters=256)
    estimates = []
    for _ in range(10):
        smoother = adapted_smoother(model, y, SMALL)
        estimates.append(run_filters(model, y, many, smoother=smoother).log_evidence)
    means = [torch.exp(values - reference.mean()) for values in (reference, torch.cat(estimates))]
    error = sum(m.var() / len(m) for m in means).sqrt()
    assert error < 0.02
    assert abs(means[0].mean() - means[1].mean()) < 4 * error


def test_filters_are_steadier_where_the_posterior_bends():
    model = Turning()
    torch.manual_seed(4)
    y = model.simulate()[1]
    mode = gauss_newton(model, y)
    adapted = adapted_smoother(model, y, SMALL)
    run = pilot(model, y)
    before, after = (torch.cat([run(s).log_evidence for _ in range(4)]).std() for s in (mode, adapted))
    assert after < 0.7 * before


def test_a_seed_gives_the_same_factors():
    model, y = heavy()
    factors = []
    for _ in range(2):
        torch.manual_seed(7)
        factors.append(adapted_smoother(model, y, SMALL).factors)
    np.testing.assert_array_equal(factors[0].U, factors[1].U)
    np.testing.assert_array_equal(factors[0].log_c, factors[1].log_c)


def test_points_in_a_plane_do_no_harm():
    model, y = heavy()
    smoother = gauss_newton(model, y)
    torch.manual_seed(0)
    result = pilot(model, y)(smoother)
    result.states[..., 1] = 0.3
    new = refit(model, y, smoother, [result])
    assert all(np.isfinite(getattr(new.factors, name)).all() for name in ("U", "b", "log_c", "root"))


def test_no_refits_leave_the_linearised_factors():
    model, y = heavy()
    options = SMCOptions(num_filters=4, num_particles=10, refits=0)
    around = posterior_linearisation(model, y, gauss_newton(model, y), iterations=1)
    np.testing.assert_array_equal(adapted_smoother(model, y, options).factors.U, around.factors.U)


def test_no_smoother_is_refused():
    model, y = heavy()
    with pytest.raises(ValueError, match="at least one smoother"):
        iterate(model, y, [], pilot(model, y))


class Bouncing(Autoregression):
    """Thrown back where it would fall below zero: the mean has a kink there."""

    nonsmooth, rho, sd = True, 0.95, 0.3

    def transition(self, state, t):
        return Normal(self.rho * state.abs(), self.parameters["sd"]).to_event(1)


def test_a_guide_that_is_fitted_over_paths_finds_what_a_wrong_one_misses():
    model = Bouncing(30)
    _, rows = model.simulate(seed=1)
    exact = grid_posterior(model, rows, -4, 4).log_evidence
    wrong = first_fit(model, rows, torch.full((30, 1), -2.0, dtype=torch.float64))

    def pilot(smoother):
        return run_filters(model, rows, SMCOptions(16, 50), smoother=smoother)

    def half_dead(smoother):
        if smoother is dead:
            raise SMCFailed("all particles have weight zero")
        return pilot(smoother)

    torch.manual_seed(0)
    before, dead = pilot(wrong).log_evidence, object()
    _, after = refitted_over_paths(model, rows, [dead, wrong], half_dead, 2)
    assert float(after.std()) < 0.5 * float(before.std())
    assert float(after.logsumexp(0)) - np.log(16) == pytest.approx(exact, abs=float(after.std()))

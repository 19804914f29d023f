"""Draws of a model and its parameters against quadrature over exact Gaussian evidences."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pyro.distributions import MultivariateStudentT, Normal
from scipy.stats import multivariate_normal, norm

from invdyn.inference import Free, fit
from invdyn.inference.fitting.objective import Objective
from invdyn.inference.fitting.parameter_draws import (
    DF,
    Candidate,
    _student_t,
    given_the_rest,
    parameter_draws,
    probabilities,
    sets_needed,
)
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import StateSpaceModel

F64 = torch.float64
START, WIDE = 0.3, 0.8
NOISES = (0.3, 0.4)
ROWS = 25


class Walk(StateSpaceModel):
    """A point that wanders by steps of an unknown size, seen with noise of a known one."""

    state_dim, observation_dim, num_steps = 1, 1, ROWS

    def __init__(self, noise, step=START):
        super().__init__({"step": torch.tensor([step], dtype=F64), "noise": torch.tensor([noise], dtype=F64)})

    def initial(self):
        return Normal(torch.zeros(1, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(state, self.parameters["step"]).to_event(1)

    def emission(self, state, t):
        return Normal(state, self.parameters["noise"]).to_event(1)


def exact(rows, noise):
    """Log-evidence with the step's prior integrated out, and mean and sd of φ = log(step / START)."""
    phi = np.linspace(-4, 4, 801)
    places = np.minimum.outer(np.arange(ROWS), np.arange(ROWS))
    values = np.array(
        [
            multivariate_normal.logpdf(rows, cov=1 + (START * np.exp(each)) ** 2 * places + noise**2 * np.eye(ROWS))
            for each in phi
        ]
    )
    weights = np.exp(values - values.max()) * norm.pdf(phi, scale=WIDE)
    total = weights.sum() * (phi[1] - phi[0])
    mean = (weights * phi).sum() / weights.sum()
    sd = np.sqrt((weights * (phi - mean) ** 2).sum() / weights.sum())
    return values.max() + np.log(total), mean, sd


@pytest.fixture(scope="module")
def rows():
    torch.manual_seed(3)
    return Walk(NOISES[0], 0.15).simulate()[1].double()


@pytest.fixture(scope="module")
def candidates(rows):
    free = [Free("step", sd=WIDE)]
    return [Candidate(Walk(noise), free, fit(Walk(noise), rows, free)) for noise in NOISES]


def test_offsets_make_the_mixtures_evidence(rows, candidates):
    """Every set's own evidence plus its offset is the evidence of the mixture, to the error of 240 draws."""
    torch.manual_seed(0)
    sets = parameter_draws(candidates, rows, 80)
    found = [gauss_newton(each.model, rows).log_evidence.item() + each.offset for each in sets]
    wanted = np.logaddexp(*(exact(rows.squeeze(-1).numpy(), noise)[0] for noise in NOISES)) - np.log(2)
    np.testing.assert_allclose(found, found[0], atol=1e-6)
    assert found[0] == pytest.approx(wanted, abs=0.15)


def test_models_and_parameters_are_in_proportion(rows, candidates):
    """Shares and moments to three errors of 400 draws."""
    torch.manual_seed(1)
    sets = parameter_draws(candidates, rows, 400)
    oracle = [exact(rows.squeeze(-1).numpy(), noise) for noise in NOISES]
    share = 1 / (1 + np.exp(oracle[1][0] - oracle[0][0]))
    assert probabilities(candidates)[0] == pytest.approx(share, abs=0.05)
    first = [each for each in sets if each.candidate == 0]
    assert len(first) / 400 == pytest.approx(share, abs=3 * np.sqrt(share * (1 - share) / 400))
    phi = np.log([each.model.parameters["step"].item() / START for each in first])
    _, mean, sd = oracle[0]
    assert phi.mean() == pytest.approx(mean, abs=4 * sd / np.sqrt(len(phi)))
    assert phi.std() == pytest.approx(sd, rel=0.2)
    assert {each.model.parameters["noise"].item() for each in first} == {NOISES[0]}


def test_some_parameters_are_drawn_given_the_others(rows):
    """Their Gaussian is that of the fit, cut at what was fitted of the others."""
    free = [Free("noise", sd=WIDE), Free("step", sd=WIDE)]
    both = Candidate(Walk(0.3), free, fit(Walk(0.3), rows, free))
    one = given_the_rest(both, lambda each: each.name == "step")
    assert one.model.parameters["noise"].item() == pytest.approx(both.fit.model.parameters["noise"].item())
    assert one.model.parameters["step"].item() == START
    (cc, cs), (_, ss) = both.fit.covariance
    np.testing.assert_allclose(one.fit.covariance, [[ss - cs**2 / cc]])
    torch.manual_seed(0)
    sets = parameter_draws([one], rows, 100)
    phi = np.log([each.model.parameters["step"].item() / START for each in sets])
    evidence, mean, sd = exact(rows.squeeze(-1).numpy(), one.model.parameters["noise"].item())
    assert one.fit.log_marginal == pytest.approx(evidence, abs=0.1)
    assert phi.mean() == pytest.approx(mean, abs=0.4 * sd)
    assert phi.std() == pytest.approx(sd, rel=0.3)


def test_other_rows_posterior_has_no_cost_of_a_prior(rows):
    """It is the prior of these rows: nothing is integrated out, also where only some parameters are drawn."""
    free = [Free("noise", sd=WIDE), Free("step", sd=WIDE)]
    both = Candidate(Walk(0.3), free, fit(Walk(0.3), rows, free), of_more_rows=True)
    one = given_the_rest(both, lambda each: each.name == "step")
    assert one.fit.log_marginal == one.fit.log_evidence
    assert given_the_rest(replace(both, of_more_rows=False), lambda each: each.name == "step").fit.log_marginal < (
        one.fit.log_evidence
    )


@pytest.mark.parametrize("of_more_rows", [False, True])
def test_a_draw_without_evidence_is_never_drawn(rows, candidates, monkeypatch, of_more_rows):
    """Its weight is 0, so that all that are drawn have finite offsets."""
    around = Objective.around

    def half(self, phi, others):
        evidence, paths = around(self, phi, others)
        return np.where(others[:, 0] > phi[0], -np.inf, evidence), paths

    monkeypatch.setattr(Objective, "around", half)
    torch.manual_seed(0)
    one = replace(candidates[0], of_more_rows=of_more_rows)
    sets = parameter_draws([one], rows, 20)
    assert np.isfinite([each.offset for each in sets]).all()
    assert max(np.log(each.model.parameters["step"].item() / START) for each in sets) <= one.fit.phi[0]


def test_what_other_rows_told_is_not_told_again(rows, candidates):
    """Draws are of the fit's own Gaussian, and every set weighs the same beside its own evidence of these rows."""
    narrow = replace(candidates[0].fit, phi=np.array([0.4]), covariance=np.array([[0.01]]))
    torch.manual_seed(0)
    sets = parameter_draws([replace(candidates[0], fit=narrow, of_more_rows=True)], rows, 200)
    phi = np.log([each.model.parameters["step"].item() / START for each in sets])
    assert phi.mean() == pytest.approx(0.4, abs=3 * 0.1 / np.sqrt(200))
    assert phi.std() == pytest.approx(0.1, rel=0.2)
    found = [gauss_newton(each.model, rows).log_evidence.item() + each.offset for each in sets[::10]]
    np.testing.assert_allclose(found, narrow.log_evidence, atol=0.2)


def test_the_same_seed_draws_the_same(rows, candidates):
    def drawn():
        torch.manual_seed(5)
        return parameter_draws(candidates, rows, 16)

    one, two = drawn(), drawn()
    assert [each.offset for each in one] == [each.offset for each in two]
    assert [each.candidate for each in one] == sorted(each.candidate for each in one)
    assert all(torch.equal(a.path, b.path) for a, b in zip(one, two, strict=True))


def test_without_free_parameters_the_models_alone_are_drawn(rows):
    known = [Candidate(Walk(noise, 0.15), [], fit(Walk(noise, 0.15), rows, [])) for noise in NOISES]
    torch.manual_seed(0)
    sets = parameter_draws(known, rows, 50)
    share = probabilities(known)[0]
    assert sum(each.candidate == 0 for each in sets) / 50 == pytest.approx(share, abs=0.03)


def test_a_long_recording_takes_fewer_sets(rows, candidates):
    """Of what 25 rows leave open, more sets than 400 rows do; of nothing that is open, one."""
    torch.manual_seed(4)
    model = Walk(NOISES[0], 0.15)
    model.num_steps = 400
    free = [Free("step", sd=WIDE)]
    longer = Walk(NOISES[0])
    longer.num_steps = 400
    many = [Candidate(longer, free, fit(longer, model.simulate()[1].double(), free))]
    few = sets_needed(candidates[:1], [0], 256)
    assert few > 3 * sets_needed(many, [0], 256)
    known = [Candidate(Walk(NOISES[0]), [], fit(Walk(NOISES[0]), rows, []))]
    assert sets_needed(known, [0], 256) == 1


def test_sets_are_half_the_draws_times_what_one_set_is_off_by(candidates):
    """Two models of probability ½ add ¼; where it is not known how much one is off, as many as may be."""
    small, large, unknown = (
        replace(candidates[0], fit=replace(candidates[0].fit, scatter=np.array(own)))
        for own in ([0.1, 9.0], [0.3, 9.0], [])
    )
    assert sets_needed([small], [0], 256) == 13  # of 12.8
    assert sets_needed([small, large], [0], 256) == 58  # of 128 · (0.05 + 0.15 + 0.25)
    assert sets_needed([small], [0, 1], 2) == 9
    assert sets_needed([unknown], [0], 2) == 1e6


def test_the_proposal_is_pyros_student_t():
    centre, root = torch.tensor([0.3, -1.0], dtype=F64), torch.tensor([[0.5, 0.0], [-0.2, 0.1]], dtype=F64)
    torch.manual_seed(4)
    drawn, density = _student_t(centre, root, 50)
    law = MultivariateStudentT(torch.tensor(DF, dtype=F64), centre, root)
    torch.manual_seed(4)
    torch.testing.assert_close(drawn, law.sample((50,)), rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(density, law.log_prob(drawn), rtol=1e-10, atol=1e-10)

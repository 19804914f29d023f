"""Filters of many parameter sets: the same numbers as the particle filter's, exact answers, and zero likelihoods."""

import math

import numpy as np
import oracles
import pyro.distributions as dist
import pytest
import torch
from grids import Leverage
from parameter_answers import kalman_log_likelihood, simulated

from invdyn.inference import Bootstrap, Controlled, ParticleFilter
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.parameters.filter_bank import FilterBank, run_bank
from invdyn.inference.parameters.unconstrained import UnconstrainedParameters

F64 = torch.float64
Z = torch.tensor([[-1.0, -0.5], [-0.3, -1.0], [0.2, 0.3]], dtype=F64)
"""Log-parameters of three sets."""


@pytest.fixture(scope="module")
def case():
    model, y = simulated("linear")
    return UnconstrainedParameters(model), y


@pytest.mark.parametrize("name", ["linear", "volatility", "counts"])
def test_it_has_the_bits_of_the_particle_filter_with_many_parameter_sets(name):
    model, y = simulated(name)
    space = UnconstrainedParameters(model)
    with seeded(1):
        batch = space.at(space.draw((5,)))
    with seeded(2):
        filtered = ParticleFilter(batch, Bootstrap(batch), 40, num_filters=5).run(y)
    with seeded(2):
        bank = run_bank(batch, y, 5, 40)
    assert filtered.resampled.any()
    assert torch.equal(bank.log_evidence, filtered.log_evidence)


def test_an_emission_that_sees_the_state_before_is_weighed_as_such():
    model = Leverage(15)
    _, y = model.simulate(seed=1)
    with seeded(2):
        filtered = ParticleFilter(model, Bootstrap(model), 40, num_filters=5).run(y)
    with seeded(2):
        bank = run_bank(model, y, 5, 40)
    assert filtered.resampled.any()
    assert torch.equal(bank.log_evidence, filtered.log_evidence)


def test_the_evidence_of_each_set_is_unbiased(case):
    space, y = case
    z = Z.repeat_interleave(1000, 0)
    found = run_bank(space.at(z), y, len(z), 60).log_evidence.reshape(3, 1000)
    exact = kalman_log_likelihood(*Z.exp().T.numpy(), y.flatten().numpy())[0].sum(0)
    for own, answer in zip(found, exact, strict=True):
        oracles.assert_unbiased(own, answer)


def test_trajectories_are_smoothed(case):
    space, y = case
    z = Z[:2].repeat_interleave(500, 0)
    paths = run_bank(space.at(z), y, len(z), 200, keep=True).draw_paths().reshape(2, 500, len(y))
    exact = kalman_log_likelihood(*Z[:2].exp().T.numpy(), y.flatten().numpy())[1]
    error = paths.std(1) / math.sqrt(500)
    # 30 means; a particle filter of 200 adds a bias of some thousandths.
    assert (np.abs(paths.mean(1).numpy() - exact.T) < 4 * error.numpy() + 0.01).all()


def test_a_guide_of_ones_own_looks_ahead(case):
    space, y = case
    fixed = space.model.replace(process_sd=torch.tensor([0.4], dtype=F64))
    exact = kalman_log_likelihood(np.array(0.4), np.array(0.5), y.flatten().numpy())[0].sum()
    bank = run_bank(fixed, y, 2, 30, guide=lambda model: Controlled(model, y))
    assert bank.log_evidence.tolist() == pytest.approx([exact] * 2, abs=1e-8)


def test_missing_rows_and_entries_only_propagate(case):
    space, y = case
    y = y.clone()
    y[[0, 5, 6]] = torch.nan
    bank = FilterBank(3, 20)
    guide = Bootstrap(space.at(Z))
    increments = torch.stack([bank.advance(guide, row) for row in y])
    assert (increments[[0, 5, 6]].abs() < 1e-12).all()
    assert torch.isfinite(bank.log_evidence).all()


def test_rows_of_each_filters_own(case):
    space, y = case
    rows = torch.stack([y, y + 0.5, y - 1]).unsqueeze(-2).unbind(1)
    with seeded(4):
        together = run_bank(space.at(Z), rows, 3, 4000).log_evidence
    exact = [
        kalman_log_likelihood(*own.exp().numpy(), (y + shift).flatten().numpy())[0].sum()
        for own, shift in zip(Z, (0, 0.5, -1), strict=True)
    ]
    assert together.tolist() == pytest.approx(exact, abs=0.3)


def test_an_impossible_set_has_zero_likelihood_and_harms_no_other():
    model, y = simulated("counts")
    model = model.with_priors(sd=dist.Uniform(torch.zeros(1, dtype=F64), torch.full((1,), 1e4, dtype=F64)).to_event(1))
    space = UnconstrainedParameters(model)
    values = {"mean": torch.tensor([[1.0], [1e3], [1.0]]), "sd": torch.tensor([[0.4], [0.4], [0.4]])}
    batch = space.model.replace(**{name: value.double().unsqueeze(-1) for name, value in values.items()})
    bank = run_bank(batch, y, 3, 50, keep=True)
    assert torch.isfinite(bank.log_evidence).tolist() == [True, False, True]
    assert bank.log_evidence[1] == -torch.inf
    assert bank.draw_paths().shape == (3, len(y), 1)


def test_filters_are_copied_and_exchanged(case):
    space, y = case
    first, second = (run_bank(space.at(Z), y[:6], 3, 10, keep=True) for _ in range(2))
    mine, theirs = first.log_evidence, second.log_evidence
    accept = torch.tensor([True, False, True])
    first.exchange(accept, second)
    assert torch.equal(first.log_evidence, torch.where(accept, theirs, mine))
    first.select(torch.tensor([1, 1, 2]))
    assert torch.equal(first.log_evidence, torch.stack([mine[1], mine[1], theirs[2]]))

    # A bank that took all of another's filters goes on as the other does.
    one, other = (run_bank(space.at(Z), y[:6], 3, 10, keep=True) for _ in range(2))
    one.exchange(torch.ones(3, dtype=torch.bool), other)
    after = []
    for bank in (one, other):
        with seeded(5):
            for row in y[6:]:
                bank.advance(Bootstrap(space.at(Z)), row)
            after.append((bank.log_evidence, bank.draw_paths()))
    assert torch.equal(after[0][0], after[1][0])
    assert torch.equal(after[0][1], after[1][1])

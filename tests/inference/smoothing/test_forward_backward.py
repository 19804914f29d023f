"""Finite-state models against the sum over all paths."""

import itertools
import math

import numpy as np
import pyro.distributions as dist
import pytest
import torch

from invdyn.inference import (
    Bootstrap,
    ParticleFilter,
    SMCOptions,
    backward_mcmc,
    backward_simulation,
    forward_backward,
    viterbi,
)
from invdyn.inference.mcmc.particle_gibbs import run_chains
from invdyn.models import FiniteStateModel, StateNumber

K, T = 3, 6


class Levels(FiniteStateModel):
    """Each state has a level, seen with noise in two entries; with ``inertia`` the level before is seen too."""

    def __init__(self, transition, steps=T, inertia=0.0):
        initial = torch.tensor([0.5, 0.2, 0.3], dtype=torch.float64)
        super().__init__(initial, transition, observation_dim=2, num_steps=steps)
        self.inertia = inertia
        self.parameters["level"] = torch.tensor([[-1.0, 0.5], [0.2, 0.0], [1.5, -1.0]], dtype=torch.float64)

    def emission(self, state, t):
        return dist.Normal(self.parameters["level"][state.squeeze(-1).long()], 0.8).to_event(1)


class Lagging(Levels):
    def emission_given(self, previous, state, t):
        level = self.parameters["level"]
        old, new = (level[x.squeeze(-1).long()] for x in (previous, state))
        return dist.Normal(new + 0.7 * old, 0.8).to_event(1)


def matrices(kind):
    rng = np.random.default_rng(1)
    rows = torch.as_tensor(rng.dirichlet(np.ones(K), size=(T, K)))
    if kind == "sparse":
        rows[:, 0, 2] = 0
        rows = rows / rows.sum(-1, keepdim=True)
    return rows if kind == "by row" else rows[0]


@pytest.fixture(params=["constant", "by row", "sparse", "lagging"])
def case(request):
    """A model and what it saw, with single entries and a whole row missing."""
    model = (Lagging if request.param == "lagging" else Levels)(matrices(request.param))
    torch.manual_seed(3)
    _, y = model.simulate()
    y[1, 0] = y[2] = math.nan
    return model, y


def enumerated(model, y):
    """All paths (K^T, T, 1) and their log p(x, y), by log_joint alone."""
    paths = torch.tensor(list(itertools.product(range(K), repeat=T)), dtype=torch.float64).unsqueeze(-1)
    return paths, model.log_joint(paths, y)


def test_evidence_and_smoothed_probabilities_are_the_sums_over_all_paths(case):
    model, y = case
    paths, log_joint = enumerated(model, y)
    exact = forward_backward(model, y)
    assert exact.log_evidence.item() == pytest.approx(log_joint.logsumexp(0).item(), abs=1e-10)
    assert exact.log_evidence_increment.sum().item() == pytest.approx(exact.log_evidence.item())
    weights = torch.softmax(log_joint, 0)
    one = torch.nn.functional.one_hot(paths.squeeze(-1).long(), K).double()
    assert torch.allclose(exact.smoothed, torch.einsum("p,ptk->tk", weights, one), atol=1e-12)
    pairs = torch.einsum("p,ptk,ptl->tkl", weights, one[:, :-1], one[:, 1:])
    assert torch.allclose(exact.log_pairs.exp(), pairs, atol=1e-12)
    assert torch.allclose(exact.log_filtered.exp().sum(-1), torch.ones(T, dtype=torch.float64))


def test_the_most_probable_path(case):
    model, y = case
    paths, log_joint = enumerated(model, y)
    path, value = viterbi(model, y)
    assert value.item() == pytest.approx(log_joint.max().item())
    assert torch.equal(path, paths[log_joint.argmax()])


def test_draws_are_paths_of_the_posterior(case):
    model, y = case
    _, log_joint = enumerated(model, y)
    draws = forward_backward(model, y).sample(20_000, seed=1)
    number = (draws.squeeze(-1) * K ** torch.arange(T - 1, -1, -1)).sum(-1).long()
    probability = torch.softmax(log_joint, 0)
    share = torch.bincount(number, minlength=K**T) / len(draws)
    likely = probability > 1e-3
    z = (share - probability)[likely] / (probability * (1 - probability) / len(draws)).sqrt()[likely]
    assert likely.sum() > 15
    assert z.abs().max() < 4.5
    assert share[probability == 0].sum() == 0
    assert torch.equal(draws, forward_backward(model, y).sample(20_000, seed=1))


def test_many_rows_do_not_underflow():
    model = Levels(matrices("constant"), steps=1000)
    torch.manual_seed(0)
    _, y = model.simulate()
    exact = forward_backward(model, y)
    assert torch.isfinite(exact.log_smoothed).all()
    assert torch.allclose(exact.smoothed.sum(-1), torch.ones(1000, dtype=torch.float64), atol=1e-8)


@pytest.mark.parametrize("threshold", [0.5, 1.0])
def test_particle_methods_agree_with_it(case, threshold):
    model, y = case
    exact = forward_backward(model, y)
    result = ParticleFilter(model, Bootstrap(model), 50, num_filters=1500, ess_threshold=threshold).run(y)
    ratio = torch.exp(result.log_evidence - exact.log_evidence)
    assert abs(ratio.mean() - 1) < 4 * ratio.std() / len(ratio) ** 0.5

    # Of each filter one path, weighted by its evidence: exact for any number of particles.
    for paths in (
        backward_simulation(model, result, y, 4),
        backward_mcmc(model, result, y, 4, seed=1),
    ):
        for state in range(K):
            share = (paths == state).double().mean((1, 3))
            weighted = ratio.unsqueeze(-1) * share
            p = exact.smoothed[:, state]
            # Where hardly any filter drew the state, its sample variance says too little.
            error = torch.maximum(weighted.var(0), p * (1 - p)).div(len(ratio)).sqrt()
            assert ((weighted.mean(0) - p).abs() < 4 * error + 1e-12).all()


def test_particle_gibbs_draws_its_paths(case):
    model, y = case
    exact = forward_backward(model, y)
    options = SMCOptions(1000, 5, ess_threshold=1.0)
    paths = run_chains(model, y, options, None, seed=4, warmup=20, sweeps=21)["paths"]
    for state in range(K):
        p = exact.smoothed[:, state]
        share = (paths == state).double().mean((0, 1, 3))
        assert ((share - p).abs() < 4 * (p * (1 - p) / 1000).sqrt() + 1e-12).all()


def test_a_state_number_is_a_distribution():
    p = torch.tensor([0.2, 0.0, 0.8], dtype=torch.float64)
    draws = StateNumber(p).expand(torch.Size([4, 1000])).sample()
    assert draws.shape == (4, 1000, 1)
    assert draws.dtype == torch.float64
    assert set(draws.unique().tolist()) == {0.0, 2.0}
    assert abs((draws == 2).double().mean() - 0.8) < 4 * (0.16 / 4000) ** 0.5
    assert StateNumber(p).log_prob(torch.tensor([[0.0], [1.0], [2.0]])).exp().tolist() == pytest.approx([0.2, 0.0, 0.8])


@pytest.mark.parametrize(
    ("transition", "message"),
    [
        (torch.full((2, 3), 1 / 3), "expected a transition matrix of shape"),
        (torch.full((3, 3), 0.5), "expected transition probabilities that sum to one"),
    ],
)
def test_a_wrong_matrix_is_refused(transition, message):
    with pytest.raises(ValueError, match=message):
        Levels(transition.double())


def test_a_row_that_no_state_can_produce_is_named():
    class Exact(Levels):
        def emission(self, state, t):
            level = self.parameters["level"][state.squeeze(-1).long()]
            return dist.Uniform(level - 0.5, level + 0.5, validate_args=False).to_event(1)

    model = Exact(matrices("constant"))
    y = model.parameters["level"][[0, 1, 2, 0, 1, 2]].clone()
    assert torch.isfinite(forward_backward(model, y).log_evidence)
    y[3] = 50.0
    with pytest.raises(ValueError, match="row 3"):
        forward_backward(model, y)

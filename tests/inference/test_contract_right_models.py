"""Right models of every kind pass the check once, and give right answers."""

from dataclasses import replace

import pyro.distributions as dist
import pytest
import torch
from contract_models import F64, Jumps, Positive, Right, StateNoise, by_filter, line, normal, poisson
from pyro.distributions import Normal
from torch import nan

from invdyn.inference import (
    Bootstrap,
    Controlled,
    GaussianChain,
    ModelError,
    ParticleFilter,
    SMCOptions,
    backward_simulation,
    check_model,
    gauss_newton,
    gaussian_smoother,
    genealogy,
    run_chains,
    run_filters,
    run_task,
)
from invdyn.models import StateSpaceModel, observed_log_prob


class Volatility(Right):
    """Only the emission's scale depends on the state."""

    def emission(self, state, t):
        mean = self.seen(state)
        return normal(0 * mean, (mean / 2).exp())


class Counts(Right):
    emission = poisson


class Pair(Right):
    """An AR(2) process as the pair (x_t, x_{t−1}): its second state has no noise."""

    def __init__(self, steps=8):
        super().__init__(2, 1, steps)

    def transition(self, state, t):
        before, earlier = state.unbind(-1)
        root = torch.diag(torch.tensor([0.5, 0.0], dtype=F64))
        mean = torch.stack([1.2 * before - 0.5 * earlier, before], -1)
        return dist.MultivariateNormal(mean, scale_tril=root, validate_args=False)

    def emission(self, state, t):
        return normal(state[..., :1], 0.3)


class Plain(StateSpaceModel):
    """Without parameters, in torch's default type."""

    state_dim = observation_dim = 1
    num_steps = 6

    def initial(self):
        return normal(torch.zeros(1))

    def transition(self, state, t):
        return normal(0.9 * state)

    def emission(self, state, t):
        return normal(state)


class Single(Right):
    """Constants in torch's default type, and parameters, too."""

    def __init__(self):
        super().__init__(dtype=torch.float32)

    def initial(self):
        return normal(torch.zeros(2))

    def transition(self, state, t):
        return normal(state, torch.tensor([0.3, 0.5]))


class Hidden(StateSpaceModel):
    """A finite chain: integer states by which it indexes, and their outputs."""

    state_dim = observation_dim = 1
    num_steps = 8
    start = torch.tensor([0.5, 0.3, 0.2], dtype=F64)
    chances = torch.tensor([[0.8, 0.1, 0.1], [0.2, 0.6, 0.2], [0.1, 0.3, 0.6]], dtype=F64)
    means = torch.tensor([-1.0, 0.0, 2.0], dtype=F64)

    def initial(self):
        return dist.Categorical(self.start[None]).to_event(1)

    def transition(self, state, t):
        return dist.Categorical(self.chances[state]).to_event(1)

    def emission(self, state, t):
        return normal(self.means[state])


class Inputs(Right):
    """Driven by a table of inputs, by row."""

    def transition(self, state, t):
        return normal(state + torch.linspace(0, 1, self.num_steps, dtype=F64)[t].unsqueeze(-1))


def emits(family):
    """A model whose emission is a ``family`` of what is seen."""
    return type("Emits", (Right,), {"emission": lambda m, x, t: family(m.seen(x))})()


def mixture(mean):
    parts = dist.Gamma(mean.exp().unsqueeze(-1).expand(*mean.shape, 2), torch.tensor([1.0, 2.0], dtype=F64))
    return dist.MixtureSameFamily(dist.Categorical(torch.ones_like(parts.rate)), parts).to_event(1)


def torchs_own(mean):
    return torch.distributions.Independent(torch.distributions.Normal(mean, 0.5), 1)


def correlated(mean):
    size = mean.shape[-1]
    return dist.MultivariateNormal(mean, torch.eye(size, dtype=F64) + 0.5)


RIGHT = {
    "Gaussian": Right,
    "one row": lambda: Right(steps=1),
    "one column": lambda: Right(width=1),
    "float32": lambda: Right(dtype=torch.float32),
    "no parameters": Plain,
    "constants in float32": Single,
    "integer states": Hidden,
    "inputs": Inputs,
    "state-dependent noise": StateNoise,
    "volatility": Volatility,
    "Student-t transition": Jumps,
    "Gamma start": Positive,
    "a pair without noise": Pair,
    "Poisson": Counts,
    "Bernoulli": lambda: emits(lambda mean: dist.Bernoulli(logits=mean).to_event(1)),
    "Binomial": lambda: emits(lambda mean: dist.Binomial(5, logits=mean).to_event(1)),
    "negative binomial": lambda: emits(lambda mean: dist.NegativeBinomial(5, logits=mean).to_event(1)),
    "categories": lambda: emits(lambda mean: dist.Categorical(logits=torch.stack([mean, -mean], -1)).to_event(1)),
    "Gamma": lambda: emits(lambda mean: dist.Gamma(mean.exp(), 1.0).to_event(1)),
    "Beta": lambda: emits(lambda mean: dist.Beta(mean.exp(), 1.0).to_event(1)),
    "log-normal": lambda: emits(lambda mean: dist.LogNormal(mean, 0.5).to_event(1)),
    "half-Cauchy": lambda: emits(lambda mean: dist.HalfCauchy(mean.exp()).to_event(1)),
    "von Mises": lambda: emits(lambda mean: dist.VonMises(mean, 2.0).to_event(1)),
    "Cauchy": lambda: emits(lambda mean: dist.Cauchy(mean, 2.0).to_event(1)),
    "mixture": lambda: emits(mixture),
    "correlated": lambda: emits(correlated),
    "torch's own": lambda: emits(torchs_own),
}


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("kind", RIGHT)
def test_right_models_pass_and_the_callers_random_numbers_are_left(kind, gap):
    model = RIGHT[kind]()
    rows = model.simulate(seed=3)[1].to(model.dtype)
    if gap:
        rows[0, 0] = nan
    before = torch.get_rng_state()
    checked = check_model(model, rows)
    assert torch.equal(torch.get_rng_state(), before)
    assert checked.dtype == model.dtype
    assert torch.equal(checked.isnan(), rows.isnan())
    result = by_filter(model, rows)
    assert result.log_evidence.isfinite().all()
    assert result.log_weights.logsumexp(-1).exp().numpy() == pytest.approx(1, abs=1e-5)


@pytest.mark.parametrize("kind", ["Gaussian", "one row", "float32", "no parameters", "constants in float32", "inputs"])
def test_right_models_pass_where_methods_linearise(kind):
    model = RIGHT[kind]()
    rows = model.simulate(seed=3)[1]
    smoother = gaussian_smoother(model, rows)
    result = ParticleFilter(model, Controlled(model, rows, smoother), 20, num_filters=2).run(rows)
    assert result.log_evidence.numpy() == pytest.approx(smoother.log_evidence.item(), abs=0.01)
    assert backward_simulation(model, result, rows, 3, smoother=smoother).isfinite().all()


def test_rows_in_any_form_give_the_same_answer():
    model = RIGHT["Poisson"]()
    one = emits(lambda mean: dist.Poisson(mean.clamp(-5, 5).exp()).to_event(1))
    one.observation_dim = 1
    rows = one.simulate(seed=2)[1]
    forms = [rows, rows.numpy(), rows.long(), rows.int().numpy(), rows.tolist(), rows[:, 0], rows[:, 0].float()]
    answers = {ParticleFilter(one, Bootstrap(one), 5).run(form, seed=1).log_evidence.item() for form in forms}
    assert len(answers) == 1
    assert model.observation_dim == 2


def test_many_parameter_sets_at_once():
    """(B, 1, own shape), as fits evaluate them."""
    model = Right()
    _, rows = model.simulate(seed=1)
    values = torch.tensor([0.3, 0.5, 0.9], dtype=F64)
    many = model.replace(noise=values[:, None, None])
    start = torch.zeros(3, 6, 2, dtype=F64)
    found = gauss_newton(many, rows, start=start).log_evidence
    for value, evidence in zip(values, found, strict=True):
        assert gauss_newton(model.replace(noise=value), rows).log_evidence.item() == pytest.approx(evidence.item())


class Counted(Right):
    calls = 0

    def transition(self, state, t):
        type(self).calls += 1
        return super().transition(state, t)


def calls_of(model, rows, **needs):
    before = Counted.calls
    check_model(model, rows, **needs)
    return Counted.calls - before


def test_a_model_is_checked_once_and_again_only_where_it_differs():
    model = Counted()
    _, rows = model.simulate(seed=1)
    assert calls_of(model, rows) > 0
    assert calls_of(model, rows) == 0
    assert calls_of(model, rows.clone()) == 0
    assert calls_of(model.replace(noise=torch.tensor(0.7, dtype=F64)), rows) == 0
    assert calls_of(model.replace(noise=torch.ones(2, dtype=F64)), rows) > 0  # another shape
    assert calls_of(model.to(torch.float32), rows) > 0
    assert calls_of(model.to(torch.float32), rows) == 0  # what a copy was checked for its original knows
    assert calls_of(model, rows, needs=("constant_covariance",)) == 0
    model.observation_dim = 3
    with pytest.raises(ModelError, match=r"got shape \(6, 2\)"):
        check_model(model, rows)
    model.seen = lambda state: state
    with pytest.raises(ModelError, match="emission: expected event"):
        check_model(model, torch.zeros(6, 3))


def test_unknown_needs_are_refused():
    with pytest.raises(ValueError, match="expected needs among"):
        check_model(Right(), Right().simulate()[1], needs=("luck",))


def exact_chain(model, rows):
    """Log-evidence and smoothed probabilities (T, S) of a finite chain, by forward and backward sums."""
    likelihood = Normal(model.means, 0.5).log_prob(rows).exp()
    forward, backward = [model.start * likelihood[0]], [torch.ones(3, dtype=F64)]
    for row in likelihood[1:]:
        forward.append(forward[-1] @ model.chances * row)
    for row in likelihood.flip(0)[:-1]:
        backward.insert(0, model.chances @ (row * backward[0]))
    evidence = forward[-1].sum()
    return evidence.log().item(), torch.stack(forward) * torch.stack(backward) / evidence


def test_a_finite_chain_has_its_exact_evidence_and_smoothed_states():
    model = Hidden()
    rows = model.simulate(seed=5)[1]
    evidence, smoothed = exact_chain(model, rows)
    result = ParticleFilter(model, Bootstrap(model), 200, num_filters=100).run(rows, seed=1)
    assert result.log_weights.is_floating_point()
    ratio = (result.log_evidence - evidence).exp()
    assert ratio.mean().item() == pytest.approx(1, abs=4 * ratio.std().item() / 10)
    for paths in (backward_simulation(model, result, rows, 50, seed=2), genealogy(result, 50)):
        assert not paths.is_floating_point()
        share = torch.nn.functional.one_hot(paths[..., 0], 3).double().mean(1)  # of filters, which count each
        error = share.std(0) / 10
        assert ((share.mean(0) - smoothed).abs() < 4.5 * error + 0.005).all()


@pytest.mark.parametrize("kind", ["Poisson", "Bernoulli", "Gamma", "half-Cauchy", "mixture", "torch's own"])
def test_a_missing_entry_gives_no_likelihood_term(kind):
    """As of a model that never had the entry, and with a finite gradient."""
    state = torch.full((4, 2), 0.3, dtype=F64, requires_grad=True)
    emission = RIGHT[kind]().emission(state, 0)
    row = emission.sample()[0].detach()
    row[0] = nan
    found = observed_log_prob(emission, row)
    expected = emission.base_dist.log_prob(torch.nan_to_num(row, nan=row[1].item()))[..., 1]
    torch.testing.assert_close(found, expected, rtol=0, atol=0)
    (slope,) = torch.autograd.grad(found.sum(), state)
    assert slope.isfinite().all()


def test_backward_simulation_refuses_a_state_without_noise_and_genealogy_does_not():
    model = Pair()
    _, rows = model.simulate(seed=4)
    result = ParticleFilter(model, Bootstrap(model), 200, num_filters=20).run(rows, seed=1)
    message = line(lambda *pair: backward_simulation(pair[0], result, pair[1], 5), model, rows)
    assert "transition: expected a finite log-density" in message
    assert "genealogy" in message
    paths = genealogy(result, 5)
    assert torch.equal(paths[..., 1:, 1], paths[..., :-1, 0])  # the pair stays one
    options = SMCOptions(num_filters=2, num_particles=20, num_draws=3)
    assert "genealogy" in line(lambda *pair: run_task(*pair, options, "bootstrap", None, 1), model, rows)
    assert "genealogy" in line(lambda *pair: run_chains(*pair, options, None, 1, 0, 1), model, rows)
    followed = run_task(model, rows, replace(options, smoothing="genealogy"), "bootstrap", None, 1)["paths"]
    assert torch.equal(followed[..., 1:, 1], followed[..., :-1, 0])
    assert followed.dtype == F64  # its constants are, so particles cannot be in float32
    line(lambda *pair: run_filters(*pair, replace(options, dtype=torch.float32), guide="bootstrap"), model, rows)


def test_a_density_that_is_missing_in_one_row_is_refused_there():
    class Still(Right):
        def transition(self, state, t):
            scale = torch.where(torch.as_tensor(t) == 34, 0.0, 0.5).unsqueeze(-1).expand_as(state)
            return Normal(0.8 * state, scale, validate_args=False).to_event(1)

    model = Still(steps=40)
    _, rows = model.simulate(seed=4)
    result = by_filter(model, rows)
    message = line(lambda *pair: backward_simulation(pair[0], result, pair[1], 5), model, rows)
    assert "in row 34" in message


def test_seeds():
    model = Right()
    rows = model.simulate(seed=1)[1]
    chain = GaussianChain.of(gaussian_smoother(model, rows))
    result = by_filter(model, rows)
    for draw in (
        lambda seed: model.simulate((3,), seed=seed)[1],
        lambda seed: ParticleFilter(model, Bootstrap(model), 9, num_filters=2).run(rows, seed=seed).states,
        lambda seed: backward_simulation(model, result, rows, 5, seed=seed),
        lambda seed: chain.sample((3,), seed=seed),
    ):
        before = torch.get_rng_state()
        first, same, other = draw(7), draw(7), draw(8)
        assert torch.equal(torch.get_rng_state(), before)
        assert torch.equal(first, same)
        assert not torch.equal(first, other)
        torch.manual_seed(7)
        assert torch.equal(first, draw(None))
        assert not torch.equal(torch.get_rng_state(), before)

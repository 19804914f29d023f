"""Wrong models and rows get one clear line each, from every way in; right ones pass, and nothing is changed by it.

Each kind of wrong model is a small function that breaks a right one, or its rows.
"""

import math
from dataclasses import replace

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from pyro.distributions import Normal
from torch import nan

from invdyn.inference import (
    VSMC_ELBO,
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
    posterior_linearisation,
    run_chains,
    run_filters,
    run_task,
)
from invdyn.models import StateSpaceModel, observed_log_prob

F64 = torch.float64


class Right(StateSpaceModel):
    """x' = 0.8 x + N(0, noise²), y = x_1 + … + x_D in each entry, + N(0, error²)."""

    def __init__(self, dim=2, width=2, steps=6, dtype=F64):
        super().__init__({"noise": torch.tensor(0.5, dtype=dtype), "error": torch.tensor(0.3, dtype=dtype)})
        self.state_dim, self.observation_dim, self.num_steps = dim, width, steps

    def initial(self):
        return Normal(torch.zeros(self.state_dim, dtype=self.dtype), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(0.8 * state, self.parameters["noise"]).to_event(1)

    def seen(self, state):
        return state.sum(-1, keepdim=True).expand(*state.shape[:-1], self.observation_dim)

    def emission(self, state, t):
        return Normal(self.seen(state), self.parameters["error"]).to_event(1)


class Sizes:
    """Of a model and its rows, drawn by hypothesis."""

    def __init__(self, dim=2, width=2, steps=6, seed=0):
        self.dim, self.width, self.steps, self.seed = dim, width, steps, seed

    def right(self):
        return Right(self.dim, self.width, self.steps)

    def rows(self):
        return self.right().simulate(seed=self.seed)[1]

    def variant(self, **methods):
        """A right model with other methods, and rows of the right one."""
        return type("Wrong", (Right,), methods)(self.dim, self.width, self.steps), self.rows()

    def values(self, **parameters):
        model = self.right()
        model.parameters.update(parameters)
        return model, self.rows()

    def attributes(self, **attributes):
        model = self.right()
        rows = self.rows()
        vars(model).update(attributes)
        return model, rows


class NotSummed(torch.distributions.Normal):
    """Its log-density keeps the event's axis."""

    def __init__(self, loc, scale):
        super().__init__(loc, scale)
        self._batch_shape, self._event_shape = loc.shape[:-1], loc.shape[-1:]


class WrongDraws(NotSummed):
    def sample(self, sample_shape=()):
        return super().sample(sample_shape)[..., :1]


def normal(mean, scale=0.5, **options):
    return Normal(mean, scale, **options).to_event(1)


def cut(value, columns):
    return value[..., :columns]


def wide(value):
    return torch.cat([value, value[..., :1]], -1)


WRONG = {
    # event shapes
    "initial without to_event": lambda s: s.variant(initial=lambda m: Normal(torch.zeros(s.dim, dtype=F64), 1.0)),
    "transition without to_event": lambda s: s.variant(transition=lambda m, x, t: Normal(0.8 * x, 0.5)),
    "emission without to_event": lambda s: s.variant(emission=lambda m, x, t: Normal(m.seen(x), 0.5)),
    "initial of events in two dimensions": lambda s: s.variant(
        initial=lambda m: Normal(torch.zeros(1, s.dim, dtype=F64), 1.0).to_event(2)
    ),
    "emission one wide too many": lambda s: s.variant(emission=lambda m, x, t: normal(wide(m.seen(x)))),
    "emission one column": lambda s: s.variant(emission=lambda m, x, t: normal(cut(m.seen(x), 1))),
    "initial too wide": lambda s: s.variant(initial=lambda m: normal(torch.zeros(s.dim + 1, dtype=F64))),
    "transition too wide": lambda s: s.variant(transition=lambda m, x, t: normal(wide(x))),
    "transition of the first state alone": lambda s: s.variant(transition=lambda m, x, t: normal(cut(x, s.dim - 1))),
    "emission of one category": lambda s: s.variant(
        emission=lambda m, x, t: dist.Categorical(logits=m.seen(x)),
    ),
    # batch shapes
    "initial of a batch": lambda s: s.variant(initial=lambda m: normal(torch.zeros(5, s.dim, dtype=F64))),
    "transition without the batch": lambda s: s.variant(
        transition=lambda m, x, t: normal(torch.zeros(s.dim, dtype=F64))
    ),
    "emission without the batch": lambda s: s.variant(emission=lambda m, x, t: normal(torch.zeros(s.width, dtype=F64))),
    "transition that averages over the batch": lambda s: s.variant(
        transition=lambda m, x, t: normal(x.reshape(-1, s.dim).mean(0))
    ),
    "transition that indexes from the left": lambda s: s.variant(
        transition=lambda m, x, t: normal(torch.stack([x[0], x[1]], -1))
    ),
    "emission that indexes from the left": lambda s: s.variant(emission=lambda m, x, t: normal(x[0].expand(s.width))),
    "initial of sets that the emission has not": lambda s: s.variant(
        initial=lambda m: normal(torch.zeros(5, 1, s.dim, dtype=F64)),
        emission=lambda m, x, t: normal(torch.zeros(4, 1, s.width, dtype=F64)),
    ),
    "transition with one axis more": lambda s: s.variant(transition=lambda m, x, t: normal(0.8 * x.unsqueeze(0))),
    "emission with one axis more": lambda s: s.variant(emission=lambda m, x, t: normal(m.seen(x).unsqueeze(-2))),
    # rows at once
    "transition with if t": lambda s: s.variant(transition=lambda m, x, t: normal(x if t > 2 else 0.5 * x)),
    "transition with float(t)": lambda s: s.variant(transition=lambda m, x, t: normal(x * math.cos(t))),
    "emission with range(t)": lambda s: s.variant(emission=lambda m, x, t: normal(m.seen(x) + len(range(t)))),
    "emission with one table for all rows": lambda s: s.variant(
        emission=lambda m, x, t: normal(m.seen(x) + torch.zeros(17, s.width, dtype=F64))
    ),
    "emission with a list of tables": lambda s: s.variant(
        emission=lambda m, x, t: normal(m.seen(x) + [0.0, *range(1, 99)][t])
    ),
    # what comes back
    "transition that gives a tensor": lambda s: s.variant(transition=lambda m, x, t: 0.8 * x),
    "emission that gives nothing": lambda s: s.variant(emission=lambda m, x, t: None),
    "initial that gives an array": lambda s: s.variant(initial=lambda m: np.zeros(s.dim)),
    "transition with a slip": lambda s: s.variant(transition=lambda m, x, t: normal(x * m.spring)),
    "emission of an unknown parameter": lambda s: s.variant(
        emission=lambda m, x, t: normal(m.seen(x), m.parameters["typo"])
    ),
    "transition of the wrong number of arguments": lambda s: s.variant(transition=lambda m, x: normal(x)),
    "log_prob not summed": lambda s: s.variant(transition=lambda m, x, t: NotSummed(x, torch.ones_like(x))),
    "draws too narrow": lambda s: s.variant(emission=lambda m, x, t: WrongDraws(m.seen(x), torch.ones_like(m.seen(x)))),
    # numbers
    "scale zero": lambda s: s.variant(transition=lambda m, x, t: normal(x, 0.0)),
    "scale below zero": lambda s: s.values(noise=torch.tensor(-0.5, dtype=F64)),
    "emission without noise": lambda s: s.variant(emission=lambda m, x, t: normal(m.seen(x), 0.0, validate_args=False)),
    "initial of no number": lambda s: s.variant(
        initial=lambda m: normal(torch.full((s.dim,), nan, dtype=F64), validate_args=False)
    ),
    "transition of no number": lambda s: s.variant(transition=lambda m, x, t: normal(nan * x, validate_args=False)),
    "a covariance that is none": lambda s: s.variant(
        transition=lambda m, x, t: dist.MultivariateNormal(x, -torch.eye(s.dim, dtype=F64))
    ),
    "parameter NaN": lambda s: s.values(noise=torch.tensor(nan, dtype=F64)),
    "parameter infinite": lambda s: s.values(noise=torch.tensor(math.inf, dtype=F64)),
    "parameter a float": lambda s: s.values(noise=0.5),
    # types and devices
    "parameters of two types": lambda s: s.values(noise=torch.tensor(0.5)),
    "parameters on two devices": lambda s: s.values(noise=torch.tensor(0.5, dtype=F64, device="meta")),
    "initial in float32": lambda s: s.variant(initial=lambda m: normal(torch.zeros(s.dim))),
    "transition to float32": lambda s: s.variant(transition=lambda m, x, t: normal(x.float())),
    "matrix in float32": lambda s: s.variant(transition=lambda m, x, t: normal(x @ torch.eye(s.dim))),
    "initial on another device": lambda s: s.variant(
        initial=lambda m: normal(torch.zeros(s.dim, dtype=F64, device="meta"), validate_args=False)
    ),
    # attributes
    "no super().__init__": lambda s: s.variant(
        __init__=lambda m, *sizes: vars(m).update(state_dim=s.dim, observation_dim=s.width, num_steps=s.steps)
    ),
    "no state_dim": lambda s: (type("Wrong", (Right,), {"__init__": StateSpaceModel.__init__})(), s.rows()),
    "state_dim one too large": lambda s: s.attributes(
        state_dim=s.dim + 1, initial=lambda: normal(torch.zeros(s.dim, dtype=F64))
    ),
    "observation_dim zero": lambda s: s.attributes(observation_dim=0),
    "num_steps a float": lambda s: s.attributes(num_steps=float(s.steps)),
    "no state-space model": lambda s: (torch.nn.Linear(s.dim, s.width), s.rows()),
    # rows
    "one row too many": lambda s: s.attributes(num_steps=s.steps - 1),
    "one row too few": lambda s: s.attributes(num_steps=s.steps + 1),
    "rows without columns": lambda s: (s.right(), s.rows()[:, 0]),
    "rows as one row": lambda s: (s.right(), s.rows().reshape(1, -1)),
    "rows in a batch": lambda s: (s.right(), s.rows()[None]),
    "rows one column too wide": lambda s: (s.right(), wide(s.rows())),
    "rows with infinity": lambda s: (s.right(), s.rows().index_fill(0, torch.tensor([1]), math.inf)),
    "complex rows": lambda s: (s.right(), s.rows() * 1j),
    "rows of words": lambda s: (s.right(), [["a"] * s.width] * s.steps),
    "no rows": lambda s: (s.right(), None),
    "rows of several lengths": lambda s: (s.right(), [[0.0], [0.0] * 2]),
    "negative counts": lambda s: (s.variant(emission=poisson)[0], -torch.ones(s.steps, s.width, dtype=F64)),
    "broken counts": lambda s: (s.variant(emission=poisson)[0], torch.full((s.steps, s.width), 1.5, dtype=F64)),
    "two of yes and no": lambda s: (s.variant(emission=bernoulli)[0], torch.full((s.steps, s.width), 2.0)),
    "gaps in a correlated family": lambda s: (
        s.variant(emission=correlated_t)[0],
        s.rows().index_put((torch.tensor(1), torch.tensor(0)), torch.tensor(nan, dtype=F64)),
    ),
}


def poisson(model, state, t):
    return dist.Poisson(model.seen(state).clamp(-5, 5).exp()).to_event(1)


def bernoulli(model, state, t):
    return dist.Bernoulli(logits=model.seen(state)).to_event(1)


def correlated_t(model, state, t):
    mean = model.seen(state)
    root = torch.eye(mean.shape[-1], dtype=F64).expand(*mean.shape, -1)
    return dist.MultivariateStudentT(torch.full(mean.shape[:-1], 4.0, dtype=F64), mean, root)


def by_filter(model, rows):
    return ParticleFilter(model, Bootstrap(model), 5, num_filters=2).run(rows)


WAYS = {"run": by_filter, "gauss_newton": gauss_newton, "Controlled": Controlled, "check_model": check_model}


def line(way, model, rows):
    """The message, which must be one line."""
    with pytest.raises(ModelError) as caught:
        way(model, rows)
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 400
    expected, _, got = message.partition(", got ")
    assert ": expected " in expected
    assert ": " in got  # and the usual fix
    return message


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("kind", WRONG)
def test_every_kind_of_wrong_model_gets_one_line(kind, way):
    message = line(WAYS[way], *WRONG[kind](Sizes()))
    method = kind.partition(" ")[0]
    if method in ("initial", "transition", "emission") and "sets" not in kind:
        assert f".{method}: expected" in message
    if "to_event" in kind:
        assert "add .to_event(1)" in message


def test_there_are_forty_kinds():
    assert len(WRONG) >= 40


@given(
    kind=st.sampled_from(sorted(WRONG)),
    way=st.sampled_from(sorted(WAYS)),
    steps=st.integers(5, 9),
    seed=st.integers(0, 99),
)
@settings(max_examples=60)
def test_wrong_models_of_other_sizes(kind, way, steps, seed):
    line(WAYS[way], *WRONG[kind](Sizes(steps=steps, seed=seed)))


# -- what single methods cannot do -----------------------------------------------------------------
class StateNoise(Right):
    """The covariance grows with the state."""

    def transition(self, state, t):
        return normal(0.8 * state, 0.3 + 0.1 * state.abs())


class Volatility(Right):
    """Only the emission's scale depends on the state."""

    def emission(self, state, t):
        mean = self.seen(state)
        return normal(0 * mean, (mean / 2).exp())


class Jumps(Right):
    def transition(self, state, t):
        return dist.StudentT(4.0, 0.8 * state, 0.5).to_event(1)


class Positive(Right):
    def initial(self):
        return dist.Gamma(torch.ones(self.state_dim, dtype=F64), 1.0).to_event(1)


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


@pytest.mark.parametrize(
    ("kind", "way", "message"),
    [
        (StateNoise, Controlled, "transition: expected a covariance that does not depend on the state"),
        (Jumps, gauss_newton, "transition: expected Normal"),
        (Jumps, Controlled, "transition: expected Normal"),
        (Positive, gauss_newton, "initial: expected Normal"),
        (Positive, gaussian_smoother, "initial: expected Normal"),
    ],
)
def test_a_method_refuses_what_it_cannot_do(kind, way, message):
    model = kind()
    _, rows = model.simulate(seed=1)
    assert message in line(way, model, rows)
    assert by_filter(model, rows).log_evidence.isfinite().all()  # which the bootstrap guide can


def test_a_refit_refuses_too():
    model, other = Right(), Jumps()
    _, rows = model.simulate(seed=1)
    assert "transition: expected Normal" in line(
        lambda *pair: posterior_linearisation(*pair, gauss_newton(model, rows)), other, rows
    )


def test_variational_smc_checks_its_model():
    model, rows = WRONG["one row too many"](Sizes())
    line(lambda *pair: VSMC_ELBO(4, 2).loss(pair[0], Bootstrap(pair[0]), pair[1]), model, rows)


# -- right models ----------------------------------------------------------------------------------
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


# -- checked once ----------------------------------------------------------------------------------
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


# -- right answers off the beaten track ------------------------------------------------------------
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

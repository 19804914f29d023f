"""Wrong models and rows get one clear line each, from every way in; right ones pass, and nothing is changed by it.

Each kind of wrong model is a small function that breaks a right one, or its rows.
"""

import math

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from contract_models import F64, Jumps, Positive, Right, StateNoise, by_filter, line, normal, poisson
from hypothesis import given, settings
from hypothesis import strategies as st
from pyro.distributions import Normal
from torch import nan

from invdyn.inference import (
    VSMC_ELBO,
    Bootstrap,
    Controlled,
    check_model,
    gauss_newton,
    gaussian_smoother,
    posterior_linearisation,
)
from invdyn.models import StateSpaceModel


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


def bernoulli(model, state, t):
    return dist.Bernoulli(logits=model.seen(state)).to_event(1)


def correlated_t(model, state, t):
    mean = model.seen(state)
    root = torch.eye(mean.shape[-1], dtype=F64).expand(*mean.shape, -1)
    return dist.MultivariateStudentT(torch.full(mean.shape[:-1], 4.0, dtype=F64), mean, root)


WAYS = {"run": by_filter, "gauss_newton": gauss_newton, "Controlled": Controlled, "check_model": check_model}


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

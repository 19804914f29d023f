"""Pyro's own algorithms run on every state-space model: SMCFilter, SVI and NUTS."""

import copy

import numpy as np
import pyro
import pyro.distributions as dist
import pytest
import torch
from model_cases import EVERY, SOME, STEPS, gappy
from pyro import poutine
from pyro.infer import MCMC, NUTS, SVI, SMCFilter, Trace_ELBO
from pyro.infer.autoguide import AutoDelta


class Prior:
    """The bootstrap guide, written for Pyro."""

    def __init__(self, model):
        self.model = model

    def init(self, state, observation):
        pyro.sample("x_0", self.model.initial())

    def step(self, state, t, observation):
        pyro.sample(f"x_{t}", self.model.transition(state["x"], t))


@EVERY
def test_runs_in_pyros_smc_filter(model):
    observations = gappy(model.simulate()[1])
    smc = SMCFilter(model, Prior(model), 20, 0)
    # the stock filter has float32 weights, which float64 ones cannot be added to in place
    smc.state._log_weights = smc.state._log_weights.double()
    smc.init(observations[0])
    weights = []
    for t in range(1, STEPS):
        before = smc.state["x"].clone()
        smc.step(t, observations[t])
        weights.append(smc.state._log_weights.clone())
        assert not torch.equal(before, smc.state["x"])
    assert smc.state["x"].shape == (20, model.state_dim)
    assert all(torch.isfinite(w).any() for w in weights)


@SOME
def test_sequence_samples_observations_when_none_are_given(model):
    trace = poutine.trace(model.sequence).get_trace()
    assert trace.nodes["y_3"]["value"].shape == (model.observation_dim,)
    assert not trace.nodes["y_3"]["is_observed"]


@EVERY
def test_learned_parameters_are_pyro_params_that_svi_moves(model):
    observations = gappy(model.simulate()[1])
    names = [name for name in model.parameters if name not in ("body.com", "body.inertia")]
    learning = model.learn(names)
    assert model.learned == ()
    guide = AutoDelta(poutine.block(learning.sequence, hide=names, expose_types=["sample"]))
    svi = SVI(learning.sequence, guide, pyro.optim.Adam({"lr": 0.01}), Trace_ELBO())
    losses = [svi.step(observations) for _ in range(3)]
    assert np.isfinite(losses).all()
    store = pyro.get_param_store()
    for name in names:
        assert torch.isfinite(store[name]).all(), name
        if name == "body.base" and not model.observation.tracked:
            continue
        assert not torch.equal(store[name], model.parameters[name]), name
        if name not in model.unconstrained | model.roots:
            assert (store[name] > 0).all(), name


def a_prior(model):
    """One parameter of the model and a prior of it."""
    name = "mean" if "mean" in model.parameters else "torque.scale"
    value = model.parameters[name]
    if name == "mean":
        return name, dist.Normal(value, 0.5).to_event(1)
    return name, dist.LogNormal(value.log(), 0.3).to_event(1)


@SOME
def test_priors_are_pyro_sites_and_svi_runs(model):
    observations = gappy(model.simulate()[1])
    name, prior = a_prior(model)
    uncertain = model.with_priors(**{name: prior})
    assert model.priors == {}
    path, _ = model.simulate()
    value = prior.sample()
    conditioned = poutine.condition(uncertain.sequence, {name: value, **{f"x_{t}": path[t] for t in range(STEPS)}})
    trace = poutine.trace(conditioned).get_trace(observations)
    expected = model.replace(**{name: value}).log_joint(path, observations) + prior.log_prob(value)
    torch.testing.assert_close(trace.log_prob_sum(), expected, rtol=1e-9, atol=1e-9)
    svi = SVI(uncertain.sequence, AutoDelta(uncertain.sequence), pyro.optim.Adam({"lr": 0.01}), Trace_ELBO())
    assert np.isfinite([svi.step(observations) for _ in range(3)]).all()


@pytest.mark.quick("linear", "random_walk-*")
@SOME
def test_nuts_runs_on_the_sequence(model):
    observations = gappy(model.simulate()[1])
    short = copy.copy(model)
    short.num_steps = 5
    name, prior = a_prior(model)
    kernel = NUTS(short.with_priors(**{name: prior}).sequence, max_tree_depth=2, jit_compile=False)
    mcmc = MCMC(kernel, num_samples=3, warmup_steps=2, disable_progbar=True)
    mcmc.run(observations)
    samples = mcmc.get_samples()
    assert set(samples) == {name, *(f"x_{t}" for t in range(5))}
    assert all(torch.isfinite(value).all() for value in samples.values())

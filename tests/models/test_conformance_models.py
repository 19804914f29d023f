"""What every state-space model owes: shapes, densities, gradients and names; one set of tests over all of them."""

import math

import numpy as np
import pyro.distributions as dist
import pytest
import torch
from model_cases import EVERY, F32, F64, STEPS, gappy, sets, states
from pyro import poutine

from invdyn.models import ArmModel
from invdyn.models.observation.missing import RowDistribution, observed_log_prob


# -- shapes ------------------------------------------------------------------------------------------
@EVERY
@pytest.mark.parametrize("dtype", [F32, F64])
def test_shapes_and_dtypes(model, dtype):
    model = model.to(dtype=dtype)
    assert model.dtype == dtype
    assert len(model.initial().event_shape) == 1
    assert model.initial().sample().shape == (model.state_dim,)
    for batch in ((), (5,), (3, 5)):
        x = states(model, *batch)
        for distribution, size in (
            (model.transition(x, 2), model.state_dim),
            (model.emission(x, 2), model.observation_dim),
        ):
            assert distribution.batch_shape == batch
            assert distribution.event_shape == (size,)
            sample = distribution.sample()
            assert sample.dtype == dtype
            log_prob = distribution.log_prob(sample)
            assert log_prob.shape == batch
            assert log_prob.dtype == dtype
            assert torch.isfinite(log_prob).all()


@EVERY
def test_a_batch_is_a_loop(model):
    x = states(model, 2, 3)
    x_next, y = model.transition(x, 3).sample(), model.emission(x, 3).sample()
    together = model.transition(x, 3).log_prob(x_next), model.emission(x, 3).log_prob(y)
    for i in np.ndindex(2, 3):
        torch.testing.assert_close(together[0][i], model.transition(x[i], 3).log_prob(x_next[i]))
        torch.testing.assert_close(together[1][i], model.emission(x[i], 3).log_prob(y[i]))


@EVERY
def test_rows_as_a_tensor_are_rows_one_by_one(model):
    path, observations = model.simulate((2,))
    rows = torch.arange(STEPS)
    moves = model.transition(path[:, :-1], rows[1:]).log_prob(path[:, 1:])
    seen = model.emission(path, rows).log_prob(observations)
    assert moves.shape == (2, STEPS - 1)
    assert seen.shape == (2, STEPS)
    for t in range(STEPS):
        torch.testing.assert_close(
            seen[:, t], model.emission(path[:, t], t).log_prob(observations[:, t]), rtol=1e-9, atol=1e-9
        )
        if t:
            one = model.transition(path[:, t - 1], t).log_prob(path[:, t])
            torch.testing.assert_close(moves[:, t - 1], one, rtol=1e-9, atol=1e-9)


@EVERY
def test_float32_agrees_with_float64(model):
    path, observations = model.simulate()
    rows = torch.arange(STEPS)
    wide = model.transition(path[:-1], rows[1:]).mean, model.emission(path, rows)
    model = model.to(dtype=F32)
    narrow = model.transition(path[:-1].float(), rows[1:]).mean, model.emission(path.float(), rows)
    torch.testing.assert_close(narrow[0].double(), wide[0], rtol=1e-4, atol=1e-4 * wide[0].abs().max().item())
    narrow, wide = (e.log_prob(observations.to(t)) for e, t in ((narrow[1], F32), (wide[1], F64)))
    torch.testing.assert_close(narrow.double(), wide, rtol=1e-2, atol=5e-2)


# -- densities ---------------------------------------------------------------------------------------
@EVERY
def test_log_joint_is_the_sum_of_its_pieces(model):
    path, observations = model.simulate((2,))
    total = model.initial().log_prob(path[:, 0]) + model.emission(path[:, 0], 0).log_prob(observations[:, 0])
    for t in range(1, STEPS):
        total = total + model.transition(path[:, t - 1], t).log_prob(path[:, t])
        total = total + model.emission(path[:, t], t).log_prob(observations[:, t])
    torch.testing.assert_close(model.log_joint(path, observations), total, rtol=1e-9, atol=1e-9)


@EVERY
@pytest.mark.parametrize("gaps", [False, True])
def test_log_joint_is_that_of_the_pyro_sequence(model, gaps):
    path, observations = model.simulate()
    if gaps:
        observations = gappy(observations)
    # not the model's own numbers, so that the sequence must use those that it was given
    model = sets(model)[1][2]
    conditioned = poutine.condition(model.sequence, {f"x_{t}": path[t] for t in range(STEPS)})
    trace = poutine.trace(conditioned).get_trace(observations)
    torch.testing.assert_close(trace.log_prob_sum(), model.log_joint(path, observations), rtol=1e-9, atol=1e-9)
    torch.testing.assert_close(trace.nodes["_RETURN"]["value"], path)
    if gaps:
        assert "y_2" not in trace.nodes  # nothing seen, no site


@EVERY
def test_missing_entries_are_marginalised(model):
    path, observations = model.simulate()
    holes = gappy(observations)
    total = model.log_joint(path, observations)
    for t in range(STEPS):
        emission, seen = model.emission(path[t], t), ~torch.isnan(holes[t])
        total = total - emission.log_prob(observations[t])
        if isinstance(emission, torch.distributions.MultivariateNormal):
            if bool(seen.any()):
                cov = emission.covariance_matrix[seen][:, seen]
                total = total + dist.MultivariateNormal(emission.loc[seen], cov).log_prob(holes[t][seen])
        elif isinstance(emission, RowDistribution):
            total = total + emission.log_prob(holes[t])  # its own tests hold that against marginals
        else:
            total = total + emission.base_dist.log_prob(observations[t])[seen].sum()
    torch.testing.assert_close(model.log_joint(path, holes), total, rtol=1e-9, atol=1e-9)
    # a path of several, as filters and smoothers have them
    many = path.expand(2, 3, *path.shape)
    torch.testing.assert_close(model.log_joint(many, holes), total.expand(2, 3), rtol=1e-9, atol=1e-9)
    # and row by row
    rows = torch.stack([observed_log_prob(model.emission(path[t], t), holes[t]) for t in range(STEPS)])
    together = observed_log_prob(model.emission(path, torch.arange(STEPS)), holes)
    torch.testing.assert_close(rows, together, rtol=1e-9, atol=1e-9)


@EVERY
@pytest.mark.parametrize("gaps", [False, True])
def test_many_parameter_sets_are_a_loop_over_them(model, gaps):
    path, observations = model.simulate((3,))
    observations = gappy(observations[0]) if gaps else observations[0]
    stacked, loop = sets(model)
    found = stacked.log_joint(path, observations)
    assert found.shape == (3,)
    expected = torch.stack([one.log_joint(path[i], observations) for i, one in enumerate(loop)])
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-8)
    # one path under all of them
    found = stacked.log_joint(path[0], observations)
    expected = torch.stack([one.log_joint(path[0], observations) for one in loop])
    torch.testing.assert_close(found, expected, rtol=1e-8, atol=1e-8)


@EVERY
def test_simulation_is_reproducible_and_scattered_as_the_model_says(model):
    results = []
    for seed in (3, 3, 4):
        torch.manual_seed(seed)
        results.append(model.simulate((4,)))
    assert results[0][0].shape == (4, STEPS, model.state_dim)
    assert results[0][1].shape == (4, STEPS, model.observation_dim)
    assert all(torch.equal(a, b) for a, b in zip(results[0], results[1], strict=True))
    assert not torch.equal(results[0][0], results[2][0])
    path, _ = model.simulate((500,))
    distribution = model.transition(path[:, 1], 2)
    surprise = path[:, 2] - distribution.mean
    # E[−log p] of a Gaussian is its entropy: half a nat and a constant a dimension, sd √(D/2)
    entropy = -distribution.log_prob(path[:, 2]).mean()
    assert entropy.item() == pytest.approx(
        distribution.entropy().mean().item(), abs=5 * math.sqrt(model.state_dim / 2 / 500)
    )
    assert surprise.mean(0).abs().max() <= 5 * surprise.std(0).max() / 500**0.5


@EVERY
def test_gradients_reach_every_parameter(model):
    path, observations = model.simulate()
    observations = gappy(observations)
    leaves = {name: value.clone().requires_grad_() for name, value in model.parameters.items()}
    path.requires_grad_()
    model.replace(**leaves).log_joint(path, observations).backward()
    assert torch.isfinite(path.grad).all()
    # com and inertia that follow length and mass do not use the numbers that are stored for them, and
    # encoders do not see where the base is
    idle = {"body.com", "body.inertia"}
    if isinstance(model, ArmModel) and not model.observation.tracked:
        idle.add("body.base")
    for name, leaf in leaves.items():
        if name not in idle:
            assert leaf.grad is not None, name
            assert torch.isfinite(leaf.grad).all(), name
            assert (leaf.grad != 0).any(), name


# -- parameters --------------------------------------------------------------------------------------
@EVERY
def test_replace_leaves_the_model_alone_and_knows_its_names(model):
    name = next(iter(model.parameters))
    other = model.replace(**{name: 2 * model.parameters[name]})
    assert type(other) is type(model)
    assert not torch.equal(other.parameters[name], model.parameters[name])
    for method in (model.learn, model.replace, model.with_priors):
        argument = (["nonsense"],) if method == model.learn else ()
        with pytest.raises(KeyError, match=f"no parameter nonsense.*{name}"):
            method(*argument, **({} if argument else {"nonsense": torch.ones(1)}))

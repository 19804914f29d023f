"""What every state-space model owes: one set of tests over all of them.

Each torque process, integrator, emission and number of joints occurs, and each pair of torque process and
integrator, in the list of cases below.
"""

import copy
import itertools
import math

import numpy as np
import oracles
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro import poutine
from pyro.infer import MCMC, NUTS, SVI, SMCFilter, Trace_ELBO
from pyro.infer.autoguide import AutoDelta
from scenes import ring

from invdyn.inference.posterior.cameras import pinhole
from invdyn.models import (
    INTEGRATORS,
    TORQUE_PROCESSES,
    ArmModel,
    Body,
    Encoders,
    Joint,
    Keypoints,
    Link,
    Observation,
    OrnsteinUhlenbeck,
    Pixels,
    SpatialLink,
    Tree,
)
from invdyn.models.observation.missing import observed_log_prob

F32, F64 = torch.float32, torch.float64
STEPS = 6
TIME = np.array([0.0, 0.03, 0.06, 0.1, 0.12, 0.15])


def body(joints):
    lengths = (0.4, 0.3, 0.25)
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=lengths[k], mass=1.2 - 0.3 * k) for k in range(joints)]
    return Body("arm", links, base=(0.1, -0.2))


def emissions(joints):
    """By name; the last has one tip less than there are links, where that is possible."""
    tips = range(joints)
    confidence = np.random.default_rng(0).uniform(size=(STEPS, joints))
    return {
        "keypoints": Observation(Keypoints(tips)),
        "encoders": Observation(Encoders()),
        "both": Observation(Keypoints(tips), Encoders()),
        "student": Observation(Keypoints(tips), Encoders(), family="student_t"),
        "confidence": Observation(Keypoints(tips, confidence=confidence)),
        "last tip": Observation(Keypoints([joints - 1], confidence=confidence[:, -1:]), family="student_t"),
    }


def arm(torque, integrator, emission, joints, command=False):
    kind = TORQUE_PROCESSES[torque]
    moved = np.random.default_rng(1).normal(size=(STEPS, joints)) if command else None
    return ArmModel(
        body(joints),
        TIME,
        emissions(joints)[emission],
        torque=kind(),
        command=moved,
        integrator=integrator,
        substeps=1 + joints % 2,
    )


def pixels():
    """A rod before two cameras, one of them with a clock and a pose of its own, and what lasts in both."""
    calibration = ring(2)
    size = torch.tensor([camera.size for camera in calibration], dtype=F64)
    seen = Pixels(pinhole(calibration), calibration.names, size, ("tip",), timed=True, posed=True)
    link = SpatialLink("rod", Joint("pivot", "universal"), length=0.4, tip="tip", mass=1.0)
    own = {"initial.angle_scale": 0.3, "camera.offset": [0.0, 0.01], "camera.turn": [[0.0] * 3, [0.02, 0.0, -0.01]]}
    return ArmModel(Tree("rod", [link]), TIME, Observation(seen, family="student_t"), parameters=own)


def cases():
    found = {"linear": lambda: oracles.random_chain(2).model(STEPS)}
    names, joints = itertools.cycle(emissions(1)), itertools.cycle([1, 2, 3, 2, 1, 3, 3])
    for torque, integrator in itertools.product(TORQUE_PROCESSES, INTEGRATORS):
        what = (torque, integrator, next(names), next(joints))
        command = len(found) % 3 == 0
        title = "-".join(map(str, what)) + ("-command" if command else "")
        found[title] = lambda what=what, command=command: arm(*what, command)
    found["printed"] = lambda: ArmModel(body(2), TIME, torque=OrnsteinUhlenbeck("printed"), integrator="euler")
    found["pixels"] = pixels
    return found


CASES = cases()
EVERY = pytest.mark.parametrize("case", CASES)
SOME = pytest.mark.parametrize("case", list(CASES)[::4])


@pytest.fixture
def model(case):
    return CASES[case]()


def gappy(observations):
    """Missing: a whole row, and single entries."""
    observations = observations.clone()
    observations[2] = torch.nan
    observations[0, -1] = observations[4, 0] = torch.nan
    return observations


def states(model, *batch):
    """A few states that are not far from where the model starts, (*batch, D)."""
    return model.initial().expand(torch.Size(batch)).sample()


def sets(model, count=3):
    """The model with parameters (S, 1, own shape), and the S models of them."""
    factors = 1 + 0.05 * torch.arange(count, dtype=model.dtype)
    stacked = {name: value * factors.reshape(count, 1, *[1] * value.ndim) for name, value in model.parameters.items()}
    loop = [model.replace(**{name: value * factor for name, value in model.parameters.items()}) for factor in factors]
    return model.replace(**stacked), loop


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


# -- Pyro's own algorithms ---------------------------------------------------------------------------
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

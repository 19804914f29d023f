"""Models and guides written for Pyro's own filter, as in its documentation, in this one."""

import numpy as np
import oracles
import pyro
import pyro.distributions as dist
import pytest
import torch
from pyro.infer import SMCFilter

from invdyn.inference import ParticleFilter


class Tracked:
    """A model as in Pyro's documentation: scalar sites, several a step, one that its guide leaves out."""

    def __init__(self, left_out=False):
        self.left_out = left_out

    def init(self, state, y):
        state["position"] = pyro.sample("position_0", dist.Normal(0.0, 2.0))
        state["speed"] = pyro.sample("speed_0", dist.Normal(0.0, 1.0))
        pyro.sample("y_0", dist.Normal(state["position"], 0.5), obs=y)

    def step(self, state, t, y):
        state["speed"] = pyro.sample(f"speed_{t}", dist.Normal(0.9 * state["speed"], 0.3))
        if self.left_out:
            state["wind"] = pyro.sample(f"wind_{t}", dist.Normal(0.0, 0.2))
        drift = state["speed"] + (state["wind"] if self.left_out else 0.0)
        state["position"] = pyro.sample(f"position_{t}", dist.Normal(state["position"] + drift, 0.3))
        pyro.sample(f"y_{t}", dist.Normal(state["position"], 0.5), obs=y)


class TrackedGuide:
    def init(self, state, y):
        pyro.sample("position_0", dist.Normal(0.5 * y, 1.5))
        pyro.sample("speed_0", dist.Normal(0.0, 1.2))

    def step(self, state, t, y):
        pyro.sample(f"speed_{t}", dist.Normal(0.8 * state["speed"], 0.4))
        pyro.sample(f"position_{t}", dist.Normal(0.5 * (state["position"] + y), 0.6))


def tracked_chain(left_out):
    """The same model as a chain over (position, speed)."""
    A = np.array([[1.0, 0.9], [0.0, 0.9]])
    root = np.array([[0.3, 0.3], [0.0, 0.3]])
    Q = root @ root.T
    Q[0, 0] += 0.04 * left_out
    return oracles.Chain(A, Q, np.array([[1.0, 0.0]]), np.array([[0.25]]), np.zeros(2), np.diag([4.0, 1.0]))


OBSERVED = [0.4, 1.1, 0.9, 1.7, 2.9, 3.1]


def feed(smc):
    smc.init(torch.tensor(OBSERVED[0]))
    for t, value in enumerate(OBSERVED[1:], 1):
        smc.step(t, torch.tensor(value))


@pytest.mark.parametrize("left_out", [False, True])
@pytest.mark.parametrize("filters", [None, 1000])
def test_a_stock_pair_runs_unchanged_with_the_right_evidence(filters, left_out):
    smc = ParticleFilter(Tracked(left_out), TrackedGuide(), 200, 0, num_filters=filters)
    feed(smc)
    exact = oracles.kalman(tracked_chain(left_out), np.array(OBSERVED)[:, None])[0]
    if filters is None:
        assert smc.state["position"].shape == (200,)
        assert smc.log_evidence.item() == pytest.approx(exact, abs=1.0)
        empirical = smc.get_empirical()["position"]
        assert empirical.mean.item() == pytest.approx(3.1, abs=0.6)
    else:
        assert smc.state["position"].shape == (1000, 200)
        oracles.assert_unbiased(smc.log_evidence, exact)


def test_weights_are_those_of_stock_smc_filter():
    states = []
    for kind in (SMCFilter, ParticleFilter):
        torch.manual_seed(1)
        # a threshold that is never met: afterwards the two resamplers would part ways
        smc = kind(Tracked(), TrackedGuide(), 30, 0, ess_threshold=1e-3)
        feed(smc)
        states.append(smc.state)
    stock, ours = states
    for name in ("position", "speed"):
        assert torch.equal(stock[name], ours[name])
    torch.testing.assert_close(torch.log_softmax(stock._log_weights, -1), ours._log_weights.float(), rtol=0, atol=2e-5)


@pytest.mark.parametrize("num_filters", [None, 3])
def test_plates_inside_the_model(num_filters):
    """max_plate_nesting as in Pyro: a plate of three sensors right of the particles."""

    class Sensors:
        def init(self, state, y):
            state["x"] = pyro.sample("x_0", dist.Normal(0.0, 1.0))
            with pyro.plate("sensors", 3, dim=-1):
                pyro.sample("y_0", dist.Normal(state["x"], 0.5), obs=y)

        def step(self, state, t, y):
            state["x"] = pyro.sample(f"x_{t}", dist.Normal(0.8 * state["x"], 0.6))
            with pyro.plate("sensors", 3, dim=-1):
                pyro.sample(f"y_{t}", dist.Normal(state["x"], 0.5), obs=y)

    class Guide:
        def init(self, state, y):
            pyro.sample("x_0", dist.Normal(y.mean(), 0.5))

        def step(self, state, t, y):
            pyro.sample(f"x_{t}", dist.Normal(y.mean(), 0.5))

    one = np.ones((1, 1))
    chain = oracles.Chain(0.8 * one, 0.36 * one, np.ones((3, 1)), 0.25 * np.eye(3), np.zeros(1), np.ones((1, 1)))
    y = chain.simulate(5, seed=1)[1]
    smc = ParticleFilter(Sensors(), Guide(), 5000, 1, num_filters=num_filters)
    smc.init(torch.as_tensor(y[0]))
    for t in range(1, 5):
        smc.step(t, torch.as_tensor(y[t]))
    exact = oracles.kalman(chain, y)[0]
    # sd of log Ẑ is 0.03
    assert np.asarray(smc.log_evidence) == pytest.approx(np.full(smc.log_evidence.shape, exact), abs=0.15)


def test_a_guide_cannot_write_and_states_must_have_the_particles_shape():
    class Writes(TrackedGuide):
        def init(self, state, y):
            state["mine"] = torch.zeros(10)

    class Scalar(Tracked):
        def init(self, state, y):
            super().init(state, y)
            state["constant"] = torch.zeros(3)

    with pytest.raises(RuntimeError, match="only the model can"):
        ParticleFilter(Tracked(), Writes(), 10).init(torch.tensor(0.0))
    with pytest.raises(ValueError, match=r"state\['constant'\].*\(10,\)"):
        ParticleFilter(Scalar(), TrackedGuide(), 10).init(torch.tensor(0.0))

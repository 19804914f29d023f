"""Methods on models of one's own: right, refused in one line, or not usable, as their own results say."""

import pytest
import torch
from grids import Leverage, grid_posterior, leverage_answer
from one_state import Counts, Growth, HeavyTailed, Multiplicative, Positive, Switches, Volatility
from pyro.distributions import Normal

from invdyn.inference import infer_states
from invdyn.inference.contract import ModelError
from invdyn.inference.posterior.posterior import evidence_note
from invdyn.models import StateSpaceModel

SIZES = {"num_filters": 16, "num_particles": 60, "seed": 1}
QUICK = {"vsmc": {"steps": 3}, "svi": {"max_steps": 200}, "svi-markov": {"max_steps": 200}}
METHODS = ("laplace", "svi", "svi-markov", "vsmc")


class Constants(StateSpaceModel):
    """Its numbers are constants in float64, and not parameters."""

    state_dim = observation_dim = 1
    num_steps = 8
    one = torch.ones(1, dtype=torch.float64)

    def __init__(self):
        super().__init__({"noise": 0.5 * self.one})

    def initial(self):
        return Normal(0 * self.one, self.one).to_event(1)

    def transition(self, state, t):
        return Normal(0.8 * state, 0.5 * self.one).to_event(1)

    def emission(self, state, t):
        return Normal(state, self.parameters["noise"]).to_event(1)


class Pair(Constants):
    """AR(2) as a pair: the second state has no noise."""

    state_dim = 2

    def initial(self):
        return Normal(torch.zeros(2, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        latest = 1.2 * state[..., 0] - 0.5 * state[..., 1]
        scale = torch.tensor([0.6, 0.0], dtype=torch.float64)
        return Normal(torch.stack([latest, state[..., 0]], -1), scale, validate_args=False).to_event(1)

    def emission(self, state, t):
        return Normal(state[..., :1], self.parameters["noise"]).to_event(1)


@pytest.mark.quick("vsmc", "laplace", "svi")
@pytest.mark.parametrize("method", METHODS)
def test_a_posterior_far_from_the_methods_own_is_not_usable(method):
    model = Growth(25)
    y = model.simulate(seed=501)[1]
    exact = grid_posterior(model, y, -30, 30, 400).log_evidence
    idata = infer_states(model, y, method=method, **SIZES, **QUICK.get(method, {}))
    assert idata.attrs["log_evidence"] < exact - 20  # in a wrong mode
    assert "bootstrap" in evidence_note(idata)


@pytest.mark.quick("vsmc", "laplace", "svi")
@pytest.mark.parametrize("method", METHODS)
def test_a_posterior_near_the_methods_own_is_usable(method):
    model = Counts(20)
    y = model.simulate(seed=3)[1]
    idata = infer_states(model, y, method=method, **SIZES, **QUICK.get(method, {}))
    assert not evidence_note(idata)


def test_vsmc_takes_constants_in_float64():
    model = Constants()
    y = model.simulate(seed=1)[1]
    exact = grid_posterior(model, y, -6, 6).log_evidence
    idata = infer_states(model, y, method="vsmc", **SIZES, steps=1)
    assert idata.attrs["log_evidence"] == pytest.approx(exact, abs=1e-3)


@pytest.mark.parametrize("method", ["laplace", "svi", "vsmc", "nuts"])
def test_a_state_without_noise_is_refused_in_one_line(method):
    model = Pair()
    with pytest.raises(ModelError, match=r"Pair\.transition: expected a finite log-density"):
        infer_states(model, model.simulate(seed=1)[1], method=method)


@pytest.mark.quick("model0*")
@pytest.mark.parametrize(("model", "low", "high"), [(Growth(12), -30, 30), (Positive(12), 1e-3, 9)])
def test_particle_gibbs_takes_the_guide_that_pilots_chose(model, low, high):
    y = model.simulate(seed=2)[1]
    filtered = grid_posterior(model, y, low, high, 600).filtered
    sizes = {"num_filters": 32, "num_particles": 60, "num_draws": 8}
    states = infer_states(model, y, method="particle-gibbs", seed=1, **sizes)["posterior"]["state"]
    last = states.isel(time=-1).values.ravel()
    # The last smoothed mean is the filter's; 32 chains count at least as 32 independent draws.
    assert last.mean() == pytest.approx(float(filtered[-1]), abs=4.5 * last.std() / 32**0.5)


def nuts_of_last_state(model, y):
    """Mean and sd of the last state by NUTS, and what its draws are worth."""
    idata = infer_states(model, y, method="nuts", seed=1, num_filters=20, num_draws=8, chains=2, warmup=30)
    assert idata["sample_stats"].attrs["r_hat"] < 1.1
    draws = idata["posterior"]["state"].values[:, :, -1, 0]
    return draws.mean(), draws.std(), min(idata["sample_stats"].attrs["ess_bulk"], draws.size)


@pytest.mark.quick("Counts")
@pytest.mark.parametrize(
    "kind",
    [
        Counts,
        HeavyTailed,
        Multiplicative,
        *(pytest.param(kind, marks=pytest.mark.slow) for kind in (Switches, Volatility)),
    ],
)
def test_nuts_samples_any_model_with_a_gradient(kind):
    """Dynamics that are not Gaussian, too, or whose noise depends on the state; the last state is that of a grid."""
    model = kind(4)
    y = model.simulate(seed=2)[1]
    mean, sd, size = nuts_of_last_state(model, y)
    assert size > 20
    exact = grid_posterior(model, y, -12, 12, 800).mean[-1]
    assert mean == pytest.approx(exact, abs=4 * sd / size**0.5)


@pytest.mark.long
def test_nuts_samples_where_rows_see_the_state_before():
    model = Leverage(6)
    y = model.simulate(seed=2)[1]
    mean, sd, size = nuts_of_last_state(model, y)
    exact = leverage_answer(y[:, 0].numpy()).mean[-1]
    assert mean == pytest.approx(exact, abs=4 * sd / size**0.5)


class Rounded(Constants):
    """What is seen passes through numpy: there is no gradient."""

    def emission(self, state, t):
        return Normal(torch.as_tensor(state.detach().numpy()), self.parameters["noise"]).to_event(1)

    def transition(self, state, t):
        return Normal(0 * state.detach(), 0.5 * self.one).to_event(1)


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        (Positive, "expected a transition on the real line.* got Gamma"),
        (Rounded, "expected a log-density with a finite gradient"),
        (Pair, "expected a finite log-density of its own draws"),
    ],
)
def test_nuts_refuses_others_in_one_line(kind, said):
    model = kind()
    with pytest.raises(ModelError, match=said) as refused:
        infer_states(model, model.simulate(seed=0)[1], method="nuts")
    assert "\n" not in str(refused.value)

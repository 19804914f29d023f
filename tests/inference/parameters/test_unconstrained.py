"""Transforms, priors with their Jacobian, and models that take many parameter sets at once, or are refused."""

import pyro.distributions as dist
import pytest
import torch
from parameter_answers import MODELS

from invdyn.inference.parameters.unconstrained import UnconstrainedParameters
from invdyn.models import StateSpaceModel
from invdyn.recordings import InputError

F64 = torch.float64


class Walk(StateSpaceModel):
    """A random walk in the plane whose parameters enter as the test wants."""

    state_dim = observation_dim = 2
    num_steps = 3

    def __init__(self, scale, use=lambda scale: scale):
        super().__init__({"scale": torch.as_tensor(scale, dtype=F64)})
        self.use = use

    def initial(self):
        return dist.Normal(torch.zeros(2, dtype=F64), 1.0).to_event(1)

    def transition(self, state, t):
        return dist.Normal(state, self.use(self.parameters["scale"]) * torch.ones_like(state)).to_event(1)

    def emission(self, state, t):
        return dist.Normal(state, 1.0).to_event(1)


PRIORS = {
    "positive": dist.Gamma(torch.tensor(2.0, dtype=F64), 1.5),
    "interval": dist.Beta(torch.tensor(2.0, dtype=F64), 3.0),
    "real": dist.StudentT(torch.tensor(4.0, dtype=F64), 0.3, 2.0),
}


@pytest.mark.parametrize("kind", PRIORS)
def test_the_prior_of_the_unconstrained_vector_integrates_to_one(kind):
    space = UnconstrainedParameters(Walk(1.0, torch.abs).with_priors(scale=PRIORS[kind]))
    z = torch.linspace(-400 if kind == "real" else -60, 400 if kind == "real" else 60, 400_001, dtype=F64)
    density = space.log_prior(z.unsqueeze(-1)).exp()
    assert torch.trapezoid(density, z).item() == pytest.approx(1, abs=1e-4)


def test_a_simplex_has_one_free_entry_less():
    prior = dist.Dirichlet(torch.tensor([2.0, 3.0, 4.0], dtype=F64))
    model = Walk([0.2, 0.3, 0.5], lambda p: p[..., :2]).with_priors(scale=prior)
    space = UnconstrainedParameters(model)
    assert space.size == 2
    axis = torch.linspace(-12, 12, 601, dtype=F64)
    density = space.log_prior(torch.cartesian_prod(axis, axis)).exp()
    assert (density.sum() * (axis[1] - axis[0]) ** 2).item() == pytest.approx(1, abs=1e-3)
    values = space.values(space.draw((4, 5)))["scale"]
    assert values.shape == (4, 5, 3)
    assert torch.allclose(values.sum(-1), torch.ones(4, 5, dtype=F64))


def test_draws_have_the_priors_moments():
    space = UnconstrainedParameters(MODELS["volatility"](4))
    values = space.values(space.draw((20_000,)))
    assert values["persistence"].mean().item() == pytest.approx(20 / 22, abs=0.002)
    assert values["mean"].std().item() == pytest.approx(0.5, abs=0.01)
    assert values["sd"].log().mean().exp().item() == pytest.approx(0.3, abs=0.005)


def test_the_model_at_many_vectors_is_each_of_them():
    space = UnconstrainedParameters(MODELS["volatility"](4))
    z = space.draw((3,))
    batch, values = space.at(z), space.values(z)
    x = torch.randn(3, 7, 1, dtype=F64)
    for m in range(3):
        one = space.model.replace(**{name: value[m] for name, value in values.items()})
        assert torch.equal(batch.transition(x, 1).log_prob(x)[m], one.transition(x[m], 1).log_prob(x[m]))
        assert torch.allclose(batch.initial().log_prob(x)[m], one.initial().log_prob(x[m]))


@pytest.mark.parametrize(
    ("scale", "use"),
    [(1.0, lambda s: s), (1.0, lambda s: s.unsqueeze(-1)), ([1.0], lambda s: s), ([1.0, 2.0], lambda s: s)],
    ids=["number for states", "number for batches", "one entry", "two entries"],
)
def test_a_number_may_stand_for_states_or_for_batches(scale, use):
    size = torch.as_tensor(scale).shape
    model = Walk(scale, use).with_priors(scale=dist.Gamma(torch.full(size, 2.0), 1.0).to_event(len(size)))
    space = UnconstrainedParameters(model)
    z = space.draw((3,))
    x = torch.randn(3, 2, 2, dtype=F64)
    expected = [dist.Normal(x[m], space.values(z)["scale"][m]).log_prob(x[m] + 1).sum(-1) for m in range(3)]
    assert torch.allclose(space.at(z).transition(x, 1).log_prob(x + 1), torch.stack(expected))


def test_a_prior_of_a_number_is_shared_by_all_entries():
    space = UnconstrainedParameters(Walk([1.0, 2.0]).with_priors(scale=dist.Gamma(2.0, 1.0)))
    assert space.size == 1
    assert space.at(space.draw((4,))).parameters["scale"].shape == (4, 1, 1)


@pytest.mark.parametrize("use", [lambda s: s.squeeze(), lambda s: s.mean(), lambda s: s.flatten()[0]])
def test_a_model_that_mixes_parameter_sets_up_is_refused(use):
    model = Walk([1.0], use).with_priors(scale=dist.Gamma(torch.full((1,), 2.0), 1.0).to_event(1))
    with pytest.raises(
        InputError, match=r"^expected a model that takes many parameter sets at once, .*\(2, 1, 1\)"
    ) as e:
        UnconstrainedParameters(model)
    assert "\n" not in str(e.value)


def test_priors_that_cannot_be_sampled_so_are_refused():
    with pytest.raises(InputError, match="expected a model with priors, got none"):
        UnconstrainedParameters(Walk([1.0]))
    with pytest.raises(InputError, match="prior of scale: expected a continuous distribution"):
        UnconstrainedParameters(Walk([1.0]).with_priors(scale=dist.Poisson(3.0)))

"""The variational bound: exact where the answer is known, its gradients right, and what it learns."""

import numpy as np
import pyro
import pytest
import torch
from learning import GRADIENTS, disturb, small
from oracles import Chain, kalman
from pyro.distributions import LogNormal, MultivariateNormal, Normal
from pyro.infer import SVI
from pyro.infer.smcfilter import SMCFailed
from pyro.optim import Adam
from torch.distributions import constraints

from invdyn.inference import Bootstrap, Controlled, ParticleFilter, gauss_newton
from invdyn.inference.variational.affine import Affine, Corrected, jacobian
from invdyn.inference.variational.vsmc import VSMC_ELBO
from invdyn.models import ArmModel, Keypoints, Link, Observation, StateSpaceModel, planar_body


def published():
    """The linear-Gaussian example of Naesseth et al.'s public code: α .42, r .1, its own random numbers."""
    numbers = np.random.RandomState(0)  # the published data come from this generator
    dim, size, steps = 5, 3, 10
    A = 0.42 ** (np.abs(np.subtract.outer(np.arange(dim), np.arange(dim))) + 1.0)
    chain = Chain(A, np.eye(dim), np.eye(dim)[:size], 0.1 * np.eye(size), np.zeros(dim), np.eye(dim))
    x, y = np.zeros(dim), []
    for _ in range(steps):
        x = numbers.multivariate_normal(A @ x, chain.Q)
        y.append(numbers.multivariate_normal(chain.C @ x, chain.R))
    return chain, chain.model(steps), torch.as_tensor(np.array(y))


def bound(model, guide, y, num_particles, num_filters=2000):
    """Mean of log p̂ by the plain filter."""
    result = ParticleFilter(model, guide, num_particles, num_filters=num_filters).run(y, keep=0)
    return result.log_evidence.mean().item()


def test_jacobian():
    matrix = torch.randn(3, 4, 2, 5, dtype=torch.float64)

    def function(x):
        return torch.sin(matrix @ x.unsqueeze(-1)).squeeze(-1)

    x = torch.randn(3, 4, 5, dtype=torch.float64)
    value, slope = jacobian(function, x, 2)
    torch.testing.assert_close(value, function(x))
    torch.testing.assert_close(slope, torch.cos(matrix @ x.unsqueeze(-1)) * matrix)


# -- exact values ------------------------------------------------------------------------------
def test_published_example_has_the_published_evidence():
    chain, _, y = published()
    assert kalman(chain, y.numpy())[0] == pytest.approx(-46.8917, abs=5e-5)


@pytest.mark.long
def test_training_closes_the_gap_of_the_published_example():
    chain, model, y = published()
    exact = kalman(chain, y.numpy())[0]
    blind = bound(model, Bootstrap(model), y, 4)
    guide = Affine(model)
    assert bound(model, guide, y, 4) == pytest.approx(blind, abs=9.0)  # it starts as the bootstrap guide; sd 2.1
    for rate, steps in ((0.03, 120), (0.01, 60)):
        svi = SVI(model.sequence, guide, Adam({"lr": rate}), loss=VSMC_ELBO(4, 16))
        for _ in range(steps):
            svi.step(y)
    with torch.no_grad():
        learned = bound(model, guide.sampled(model), y, 4)
    assert learned <= exact
    assert (learned - blind) / (exact - blind) > 0.98


@pytest.mark.parametrize("make", [Corrected, Controlled])
def test_controlled_start_is_exact_on_a_linear_model(make):
    chain, model, y = small(steps=12)
    loss = VSMC_ELBO(5, 3)
    log_evidence = loss.log_evidence(model, make(model, y), y)
    torch.testing.assert_close(log_evidence, torch.full_like(log_evidence, kalman(chain, y.numpy())[0]))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_untrained_correction_is_the_controlled_guide(dtype):
    model, y = arm()
    smoother = gauss_newton(model, y)
    model, y = model.to(dtype=dtype), y.to(dtype)
    runs = []
    for guide in (Controlled(model, y, smoother), Corrected(model, y, smoother)):
        runs.append(ParticleFilter(model, guide, 2000, num_filters=16).run(y, keep=0).log_evidence)
    error = torch.stack([run.std() / 4 for run in runs]).norm()
    assert (runs[0].mean() - runs[1].mean()).abs() < 4 * error + 1e-3
    assert runs[1].std() < 0.2


@pytest.mark.quick("systematic-*")
@pytest.mark.parametrize("kind", ["affine", "corrected"])
@pytest.mark.parametrize("resampling", ["systematic", "multinomial"])
def test_evidence_stays_unbiased_with_a_guide_far_from_the_best(kind, resampling):
    chain, model, y = small(steps=8)
    guide = Affine(model) if kind == "affine" else Corrected(model, y)
    disturb(guide)
    result = VSMC_ELBO(50, 4000, resampling=resampling).log_evidence(model, guide, y)
    ratio = (result - kalman(chain, y.numpy())[0]).exp()
    assert (ratio.mean() - 1).abs() < 4 * ratio.std() / len(ratio) ** 0.5
    assert ratio.std() > 0.05  # far from exact, or the test would say nothing


@pytest.mark.parametrize("gradient", GRADIENTS)
def test_loss_is_the_filters_evidence_for_any_gradient(gradient):
    _, model, y = small(steps=8)
    loss = VSMC_ELBO(400, 200, resampling="multinomial", gradient=gradient)
    plain = bound(model, Bootstrap(model), y, 400, 200)
    assert loss.loss(model.sequence, Bootstrap(model), y) == pytest.approx(-plain, abs=0.1)


def arm(steps=20):
    """A short film of a planar arm without a command."""
    links = [Link("upper", "shoulder", "elbow", 1.0, 0.5), Link("fore", "elbow", "wrist", 1.0, 0.3)]
    body = planar_body("arm", links, gravity=(0.0, -1.0))
    model = ArmModel(body, 0.03 * np.arange(steps), Observation(Keypoints(range(2))), integrator="euler")
    torch.manual_seed(3)
    return model, model.simulate()[1]


# -- learning ----------------------------------------------------------------------------------
@pytest.mark.long
def test_parameters_of_a_linear_model_are_those_of_maximum_likelihood():
    chain = Chain(*(np.array(x) for x in ([[0.8]], [[0.25]], [[1.0]], [[0.1]], [0.0], [[1.0]])))
    y = chain.simulate(60, 2)[1]
    grid = np.linspace(0.3, 0.99, 70)
    best = grid[np.argmax([kalman(Chain(np.array([[a]]), *list(vars(chain).values())[1:]), y)[0] for a in grid])]
    model = chain.model(60).replace(transition=torch.tensor([[0.2]], dtype=torch.float64)).learn(["transition"])
    y = torch.as_tensor(y)
    guide = Corrected(model, y)
    for rate, steps in ((0.1, 30), (0.02, 30)):
        svi = SVI(model, guide, Adam({"lr": rate}), loss=VSMC_ELBO(20, 8))
        for _ in range(steps):
            svi.step(y)
    assert pyro.param("transition").item() == pytest.approx(best, abs=0.03)


class Autoregression(StateSpaceModel):
    """x_t = a x_{t−1} + q η, y_t = x_t + r ε, begun far from what made the rows."""

    state_dim, observation_dim, num_steps = 1, 1, 60
    unconstrained = frozenset({"a"})

    def __init__(self, a=0.0, q=3.0, r=2.0):
        values = {"a": a, "q": q, "r": r}
        super().__init__({name: torch.tensor([value], dtype=torch.float64) for name, value in values.items()})

    def initial(self):
        return Normal(torch.zeros(1, dtype=torch.float64), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(self.parameters["a"] * state, self.parameters["q"]).to_event(1)

    def emission(self, state, t):
        return Normal(state, self.parameters["r"]).to_event(1)

    def chain(self):
        a, q, r = (np.array([[value.item()]]) for value in self.parameters.values())
        return Chain(a, q**2, np.eye(1), r**2, np.zeros(1), np.eye(1))


@pytest.mark.long
def test_a_bootstrap_guide_learns_parameters_by_the_default_gradient():
    """Without the ancestors' part of the gradient the same steps end some nats lower."""
    torch.manual_seed(0)
    right = Autoregression(0.9, 0.5, 0.7)
    _, y = right.simulate()
    pyro.clear_param_store()
    torch.manual_seed(1)
    model = Autoregression().learn(["a", "q", "r"])
    svi = SVI(model, Bootstrap(model), Adam({"lr": 0.05}), loss=VSMC_ELBO(20, 4))
    for _ in range(100):
        svi.step(y)
    found = Autoregression(*(pyro.param(name).item() for name in "aqr"))
    assert kalman(found.chain(), y.numpy())[0] > kalman(right.chain(), y.numpy())[0]


@pytest.mark.long
def test_posterior_of_a_parameter_with_a_prior():
    """q(θ) learned beside the filter, against a grid."""
    chain = Chain(*(np.array(x) for x in ([[0.8]], [[0.25]], [[1.0]], [[0.1]], [0.0], [[1.0]])))
    y = chain.simulate(25, 2)[1]
    prior = LogNormal(torch.tensor(-0.5, dtype=torch.float64), torch.tensor(0.5, dtype=torch.float64))
    prior_matrix = prior.expand([1, 1]).to_event(2)
    grid = torch.linspace(-1.6, 0.4, 400, dtype=torch.float64)
    density = torch.stack(
        [
            kalman(Chain(a.exp().reshape(1, 1).numpy(), *list(vars(chain).values())[1:]), y)[0]
            + prior.log_prob(a.exp())
            + a
            for a in grid
        ]
    )
    weights = density.softmax(0)
    mean = (weights * grid).sum().item()
    sd = ((weights * (grid - mean) ** 2).sum() ** 0.5).item()
    evidence = (density.logsumexp(0) + (grid[1] - grid[0]).log()).item()

    model = chain.model(25).replace(transition=torch.tensor([[0.8]], dtype=torch.float64))
    y = torch.as_tensor(y)
    guide = Corrected(model, y)
    model = model.with_priors(transition=prior_matrix)

    def parameters():
        loc = pyro.param("q.loc", torch.full((1, 1), -0.5, dtype=torch.float64))
        scale = pyro.param("q.scale", torch.full((1, 1), 0.3, dtype=torch.float64), constraint=constraints.positive)
        pyro.sample("transition", LogNormal(loc, scale).to_event(2))

    guide.parameters = parameters
    loss = VSMC_ELBO(10, 2)
    for rate, steps in ((0.05, 80), (0.01, 80)):
        svi = SVI(model.sequence, guide, Adam({"lr": rate}), loss=loss)
        for _ in range(steps):
            svi.step(y)
    assert pyro.param("q.loc").item() == pytest.approx(mean, abs=0.5 * sd)
    assert pyro.param("q.scale").item() == pytest.approx(sd, rel=0.35)
    reached = -np.mean([svi.evaluate_loss(y) for _ in range(40)])
    assert evidence - 0.5 < reached < evidence + 0.1


def test_svi_collects_the_model_s_and_the_guide_s_parameters():
    model, y = arm()
    model = model.learn(["body.length", "torque.scale"])
    svi = SVI(model.sequence, Corrected(model, y), Adam({"lr": 0.01}), loss=VSMC_ELBO(10, 2))
    svi.step(y)
    store = pyro.get_param_store()
    assert set(store.keys()) == {"body.length", "torque.scale", "guide.matrix", "guide.offset", "guide.log_scale"}
    start = model.parameters["body.length"]
    # Adam's first step is its rate, in log-length, whatever the gradient's size.
    torch.testing.assert_close((pyro.param("body.length") / start).log().abs(), torch.full_like(start, 0.01))
    for key in ("matrix", "offset", "log_scale"):
        moved = pyro.param(f"guide.{key}").abs()
        assert (moved > 0).double().mean() > 0.9
        assert moved.max() <= 0.0101


def test_the_same_seed_gives_the_same_training():
    runs = []
    for _ in range(2):
        pyro.clear_param_store()
        pyro.set_rng_seed(7)
        _, model, y = small(steps=8)
        svi = SVI(model, Affine(model), Adam({"lr": 0.05}), loss=VSMC_ELBO(5, 2))
        runs.append([svi.step(y) for _ in range(5)])
    assert runs[0] == runs[1]


# -- errors ------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gradient": "ot"}, "dropped, score, stop-gradient"),
        ({"gradient": "score"}, "multinomial"),
        ({"resampling": "none"}, "resampling scheme"),
        ({"ess_threshold": 0.0}, "ess_threshold"),
        ({"num_filters": 0}, "at least one"),
        ({"chunk": 0}, "at least one"),
    ],
)
def test_options_that_cannot_be_meant(options, message):
    with pytest.raises(ValueError, match=message):
        VSMC_ELBO(**options)


def test_other_models_and_guides():
    _, model, y = small()
    with pytest.raises(TypeError, match="StateSpaceModel"):
        VSMC_ELBO().loss(lambda y: None, Bootstrap(model), y)
    with pytest.raises(TypeError, match="StateSpaceModel"):
        VSMC_ELBO().loss(model.simulate, Bootstrap(model), y)
    with pytest.raises(TypeError, match="Proposal"):
        VSMC_ELBO().loss(model, lambda y: None, y)


class Shifted(Bootstrap):
    """A guide that looks a parameter up row by row."""

    def conditional(self, t, state):
        shift = pyro.param("shift", torch.zeros(self.model.state_dim, dtype=torch.float64))
        return MultivariateNormal(
            self.model.transition(state, t).loc + shift, scale_tril=self.model.parameters["transition_root"]
        )


def test_parameters_looked_up_row_by_row_get_their_gradient_or_an_error():
    _, model, y = small()
    loss = VSMC_ELBO(5, 2)
    loss.loss_and_grads(model, Shifted(model), y)
    assert (pyro.param("shift").grad.abs() > 0).all()
    with pytest.raises(TypeError, match="shift looked up row by row"):
        VSMC_ELBO(5, 2, chunk=2).loss_and_grads(model, Shifted(model), y)


def test_out_of_reach():
    _, model, y = small()
    y = y.clone()
    y[2] = 1e200
    with pytest.raises(SMCFailed, match="out of the model's reach"):
        VSMC_ELBO(5, 2).loss(model, Bootstrap(model), y)

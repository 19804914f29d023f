"""Variational guides: two forms of one model and one guide, and bounds that are known exactly."""

import numpy as np
import pyro
import pytest
import torch
from oracles import kalman, random_chain, with_gaps
from pyro import poutine
from pyro.infer import SVI, Trace_ELBO
from pyro.infer.autoguide import AutoNormal, init_to_value

from invdyn.inference import gauss_newton
from invdyn.inference.methods.svi import GUIDES, bound, maximise, path_model
from invdyn.inference.smoothing.gaussian_chain import GaussianChain
from invdyn.inference.variational.path_guides import Markov, MeanField
from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body

T = 8


def linear(seed=0, steps=T, gaps=False):
    chain = random_chain(seed)
    _, y = chain.simulate(steps, seed)
    y = torch.as_tensor(with_gaps(y) if gaps else y)
    return chain, chain.model(steps), y


def arm(steps=T):
    links = [Link(f"l{k}", f"j{k}", f"t{k}", length=0.3, mass=1.0) for k in range(2)]
    model = ArmModel(planar_body("arm", links), 0.03 * np.arange(steps), Observation(Keypoints([0, 1])))
    torch.manual_seed(0)
    _, y = model.simulate()
    y[2, :2] = torch.nan
    y[5] = torch.nan
    return model, y


@pytest.mark.parametrize("kind", GUIDES)
@pytest.mark.parametrize("case", [linear(gaps=True)[1:], arm()], ids=["linear", "arm"])
def test_the_one_site_path_has_the_bound_of_the_sequence_under_markov(kind, case):
    """A draw from the guide has the same log p by model.sequence as by the fast path."""
    model, y = case
    guide = GUIDES[kind](gauss_newton(model, y))
    for parameter in guide.parameters():  # away from the start
        parameter.data += 0.1 * torch.randn_like(parameter)
    path = guide().detach()
    states = {f"x_{t}": state for t, state in enumerate(path)}
    slow = poutine.trace(poutine.condition(model.sequence, data=states)).get_trace(y).log_prob_sum()

    q = poutine.trace(poutine.condition(guide, data={"path": path})).get_trace()
    p = poutine.trace(poutine.condition(path_model(model, y), data={"path": path})).get_trace()
    fast = p.log_prob_sum() - q.log_prob_sum()
    assert p.log_prob_sum().item() == pytest.approx(slow.item(), abs=1e-7)
    assert fast.item() == pytest.approx(
        (model.log_joint(path, y) - guide.distribution().log_prob(path)).item(), abs=1e-7
    )


@pytest.mark.parametrize("kind", GUIDES)
def test_particles_in_one_tensor_are_independent(kind):
    """Trace_ELBO's mean over vectorised particles is the bound."""
    model, y = arm()
    guide = GUIDES[kind](gauss_newton(model, y))
    elbo = Trace_ELBO(num_particles=3000, vectorize_particles=True, max_plate_nesting=0)
    loss = elbo.loss(path_model(model, y), guide)
    value, error = bound(guide, model, y)
    assert -loss == pytest.approx(value, abs=5 * error + 1e-9)


def test_a_markov_guide_is_exact_for_a_linear_model_and_stays_so():
    chain, model, y = linear()
    guide = Markov(gauss_newton(model, y))
    evidence = kalman(chain, y.numpy())[0]
    assert bound(guide, model, y) == pytest.approx((evidence, 0.0), abs=1e-7)
    # Sticking the landing: no gradient at all, whatever the draw.
    elbo = Trace_ELBO(num_particles=2, vectorize_particles=True, max_plate_nesting=0)
    elbo.differentiable_loss(path_model(model, y), guide).backward()
    assert max(p.grad.abs().max().item() for p in guide.parameters()) < 1e-7


@pytest.mark.long
def test_a_markov_guide_finds_back():
    chain, model, y = linear()
    guide = Markov(gauss_newton(model, y))
    for parameter in guide.parameters():
        parameter.data += 0.3 * torch.randn_like(parameter)
    evidence = kalman(chain, y.numpy())[0]
    assert bound(guide, model, y)[0] < evidence - 0.5
    steps, converged = maximise(guide, path_model(model, y))
    assert converged
    assert steps < 3000
    assert bound(guide, model, y)[0] == pytest.approx(evidence, abs=0.02)
    assert not maximise(guide, path_model(model, y), max_steps=5)[1]


@pytest.mark.long
def test_mean_field_begins_at_the_best_of_its_family():
    """KL(q, p) is least where σ_i² = 1/Λ_ii; then the bound is below log p(y) by ½ Σ log Λ_ii − ½ log |Λ|."""
    chain, model, y = linear()
    smoother = gauss_newton(model, y)
    whole, guide = GaussianChain.of(smoother), MeanField(smoother)
    log_volume = whole.root.diagonal(dim1=-2, dim2=-1).log().sum()
    gap = 0.5 * whole.precision_diagonal().log().sum() + log_volume
    best = kalman(chain, y.numpy())[0] - gap.item()
    value, error = bound(guide, model, y)
    assert value == pytest.approx(best, abs=4 * error)
    maximise(guide, path_model(model, y))
    value, error = bound(guide, model, y)
    assert value == pytest.approx(best, abs=4 * error + 0.02)
    assert best < kalman(chain, y.numpy())[0] - 1


def test_the_score_term_that_is_dropped_is_zero_on_average():
    model, y = arm()
    smoother = gauss_newton(model, y)
    guide = Markov(smoother)
    guide.shift.data += 0.2
    gradients = []
    for dropped in (True, False):
        torch.manual_seed(0)

        def sample(dropped=dropped):
            return guide() if dropped else pyro.sample("path", guide.distribution())

        guide.zero_grad()
        elbo = Trace_ELBO(num_particles=20_000, vectorize_particles=True, max_plate_nesting=0)
        elbo.differentiable_loss(path_model(model, y), sample).backward()
        gradients.append(guide.shift.grad.clone())
    off = gradients[0] - gradients[1]
    # the score of a standard normal's mean has sd 1 a draw: 48 entries of sd 1/√20,000, times √2 at most
    assert off.abs().max() < 5 / 20_000**0.5
    assert gradients[0].abs().max() > 0.1


@pytest.mark.long
def test_pyros_own_autonormal_on_the_sequence_reaches_the_same_bound():
    chain, model, y = linear(steps=6)
    smoother = gauss_newton(model, y)
    mine = bound(MeanField(smoother), model, y)
    start = {f"x_{t}": smoother.path[t] for t in range(6)}
    guide = AutoNormal(model.sequence, init_loc_fn=init_to_value(values=start), init_scale=0.3)
    svi = SVI(model.sequence, guide, pyro.optim.ClippedAdam({"lr": 0.03, "lrd": 0.99}), Trace_ELBO())
    for _ in range(400):
        svi.step(y)
    sites = {name: value for name, value in guide.median(y).items() if name.startswith("x_")}
    scales = [guide._get_loc_and_scale(f"x_{t}") for t in range(6)]
    q = torch.distributions.Normal(*(torch.stack([pair[i] for pair in scales]).detach() for i in (0, 1)))
    paths = q.sample((2000,))
    values = model.log_joint(paths, y) - q.log_prob(paths).sum((-2, -1))
    error = values.std().item() / 2000**0.5
    assert set(sites) == set(start)
    assert values.mean().item() == pytest.approx(mine[0], abs=4 * (error + mine[1]) + 0.1)
    assert values.mean().item() < kalman(chain, y.numpy())[0]

"""Gradients of the variational bound: those of finite differences and of Kalman's evidence, in chunks too."""

import numpy as np
import pyro
import pytest
import torch
from learning import GRADIENTS, NAMES, disturb, shifted, small, step_along
from oracles import Chain, kalman, random_chain
from pyro.distributions import LogNormal
from pyro.infer import Trace_ELBO

from invdyn.inference.variational.affine import Affine, Corrected
from invdyn.inference.variational.vsmc import VSMC_ELBO


@pytest.mark.parametrize("kind", ["affine", "corrected"])
@pytest.mark.parametrize("particles", [1, 6])
def test_without_resampling_the_gradient_is_that_of_finite_differences(kind, particles):
    _, model, y = small(steps=8)
    model = model.learn(NAMES[:3])
    guide = Affine(model) if kind == "affine" else Corrected(model, y)
    names = [*NAMES, "guide.scale" if kind == "affine" else "guide.log_scale"]
    disturb(guide)
    loss = VSMC_ELBO(particles, 3, ess_threshold=1e-9)
    _, gradients = step_along(loss, model, guide, y, names)
    for name, gradient in zip(names, gradients, strict=True):
        direction = torch.randn_like(gradient)
        up, down = (shifted(loss, model, guide, y, name, direction, size) for size in (1e-5, -1e-5))
        assert (gradient * direction).sum().item() == pytest.approx((up - down) / 2e-5, rel=1e-5, abs=1e-6)


def test_one_particle_gives_the_evidence_lower_bound():
    _, model, y = small(steps=8)
    guide = Affine(model)
    disturb(guide)
    mine = VSMC_ELBO(1, 20_000).log_evidence(model, guide, y)

    def trajectory(_):
        bound = guide.sampled(model)
        state = pyro.sample("x_0", bound.conditional_initial())
        for t in range(1, 8):
            state = pyro.sample(f"x_{t}", bound.conditional(t, state))

    elbo = Trace_ELBO(num_particles=2000, vectorize_particles=True, max_plate_nesting=0)
    other = -elbo.loss(model.sequence, trajectory, y)
    scatter = mine.std().item() * (1 / 20_000 + 1 / 2000) ** 0.5
    assert mine.mean().item() == pytest.approx(other, abs=4 * scatter)


@pytest.mark.parametrize("gradient", GRADIENTS)
@pytest.mark.parametrize("chunk", [1, 3, 100])
def test_chunks_leave_the_gradient_as_it_is(gradient, chunk):
    _, model, y = small(steps=8)
    model = model.learn(NAMES[:3])
    guide = Corrected(model, y)
    disturb(guide)
    options = {"resampling": "multinomial", "gradient": gradient, "ess_threshold": 0.9}
    whole, chunked = (
        step_along(VSMC_ELBO(6, 3, **options, chunk=rows), model, guide, y, NAMES) for rows in (None, chunk)
    )
    assert whole[0] == chunked[0]
    for one, other in zip(whole[1], chunked[1], strict=True):
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-12)


def test_chunks_and_a_parameter_with_a_prior():
    _, model, y = small(steps=8)
    guide = Corrected(model, y)
    prior = LogNormal(torch.zeros(2, dtype=torch.float64), 1.0).to_event(1)

    def parameters():
        loc = pyro.param("q.loc", torch.full((2,), 0.1, dtype=torch.float64))
        pyro.sample("mean", LogNormal(loc, 0.1).to_event(1))

    guide.parameters = parameters
    model = model.with_priors(mean=prior).learn(["transition"])
    names = ["q.loc", "transition", "guide.offset"]
    whole, chunked = (step_along(VSMC_ELBO(6, 3, chunk=rows), model, guide, y, names) for rows in (None, 3))
    assert whole[0] == chunked[0]
    for one, other in zip(whole[1], chunked[1], strict=True):
        assert one.norm() > 0
        torch.testing.assert_close(one, other, rtol=1e-10, atol=1e-12)


def test_chunks_hold_no_graph_of_the_other_rows():
    def nodes(chunk, steps):
        pyro.clear_param_store()
        _, model, y = small(steps)
        loss = VSMC_ELBO(6, 3, chunk=chunk).differentiable_loss(model.learn(NAMES[:3]), Affine(model), y)
        found, todo = set(), [loss.grad_fn]
        while todo:
            node = todo.pop()
            if node is not None and node not in found:
                found.add(node)
                todo += [after for after, _ in node.next_functions]
        return len(found)

    assert nodes(10, 80) - nodes(10, 40) < 10
    assert nodes(None, 80) - nodes(None, 40) > 400


def crude():
    """One-dimensional chain, three rows, two particles: much resampling, and a guide that is off."""
    chain = random_chain(4, dim=1, size=1, noise=0.5)
    y = torch.as_tensor(chain.simulate(3, 4)[1])
    model = chain.model(3).learn(["transition"])
    guide = Affine(model)
    guide.sampled(model)
    with torch.no_grad():
        pyro.param("guide.offset").add_(0.5)
    return chain, model, guide, y


def test_stop_gradient_estimates_the_gradient_of_the_evidence():
    """E[p̂ ∇log p̂] = ∇p(y), known by Kalman; with the ancestors' part dropped it is another number."""
    chain, model, guide, y = crude()
    step = 1e-5
    exact = []
    for sign in (1, -1):
        moved = Chain(chain.A + sign * step, chain.Q, chain.C, chain.R, chain.m, chain.P)
        exact.append(np.exp(kalman(moved, y.numpy())[0]))
    exact = (exact[0] - exact[1]) / (2 * step)
    found = {}
    for gradient in ("stop-gradient", "dropped"):
        loss = VSMC_ELBO(2, 10_000, ess_threshold=1.0, resampling="multinomial", gradient=gradient)
        draws = []
        for _ in range(20):
            value = loss.log_evidence(model, guide, y).exp().mean()
            draws.append(torch.autograd.grad(value, pyro.param("transition"))[0].item())
        found[gradient] = np.mean(draws), np.std(draws) / len(draws) ** 0.5
    mean, error = found["stop-gradient"]
    assert abs(mean - exact) < 4 * error
    mean, error = found["dropped"]
    assert abs(mean - exact) > 6 * error


@pytest.mark.long
def test_score_estimates_the_gradient_of_the_bound():
    """Against a wide finite difference of the bound over many filters; dropped, it is another number."""
    _, model, guide, y = crude()
    width, many = 0.1, VSMC_ELBO(2, 200_000, ess_threshold=1.0, resampling="multinomial")
    leaf = pyro.param("guide.offset")
    direction = torch.zeros_like(leaf)
    direction[0] = 1.0
    values = []
    for size in (width, -width, 2 * width, -2 * width):
        with torch.no_grad():
            pyro.param("guide.offset").add_(size * direction)
            torch.manual_seed(1)
            values.append(many.log_evidence(model, guide, y))
            pyro.param("guide.offset").sub_(size * direction)
    # Richardson: the error of the two widths' combination is of order width⁴.
    slope = (8 * (values[0] - values[1]) - (values[2] - values[3])) / (12 * width)
    exact, scatter = slope.mean().item(), (slope.std() / len(slope) ** 0.5).item()
    found = {}
    for gradient in ("score", "dropped"):
        loss = VSMC_ELBO(2, 1000, ess_threshold=1.0, resampling="multinomial", gradient=gradient)
        draws = []
        for _ in range(200):
            value = loss.log_evidence(model, guide, y).mean()
            draws.append(torch.autograd.grad(value, pyro.param("guide.offset"))[0][0].item())
        found[gradient] = np.mean(draws), np.hypot(np.std(draws) / len(draws) ** 0.5, scatter)
    mean, error = found["score"]
    assert abs(mean - exact) < 4 * error
    mean, error = found["dropped"]
    assert abs(mean - exact) > 6 * error

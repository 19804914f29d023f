"""The Gaussian chain of a smoother: its algebra against dense matrices."""

import numpy as np
import pytest
import torch
from oracles import kalman, random_chain, rts, with_gaps

from invdyn.inference import GaussianChain, gauss_newton, posterior_linearisation
from invdyn.inference.smoothing.gaussian_chain import accumulate, composed
from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body

T = 9


def smoother_of(seed=0):
    chain = random_chain(seed)
    _, y = chain.simulate(T, seed)
    y = with_gaps(y)
    return chain, y, gauss_newton(chain.model(T), torch.as_tensor(y))


def arm_smoother():
    """Bent enough that the linearisation over the posterior has an error of its own (scatter)."""
    body = planar_body("arm", [Link("l", "shoulder", "elbow", length=1.0, mass=1.0)])
    values = {"emission.keypoint_scale": 0.3, "noise.angle": 0.1, "noise.velocity": 0.3}
    model = ArmModel(body, 0.05 * np.arange(T), Observation(Keypoints([0])), parameters=values)
    torch.manual_seed(3)
    _, y = model.simulate()
    return posterior_linearisation(model, y, gauss_newton(model, y))


def dense(chain):
    """Mean (T·D,) and covariance of the whole path, by pushing unit noises through."""
    size = chain.loc.numel()
    units = torch.eye(size, dtype=torch.float64).reshape(size, *chain.loc.shape)
    map_ = (chain.path(units) - chain.loc).reshape(size, size)
    return chain.loc.reshape(-1), map_.T @ map_


@pytest.mark.parametrize("steps", [1, 2, 7, 8])
def test_accumulate_is_the_recursion(steps):
    gain, pushed = torch.randn(steps, 3, 3), torch.randn(2, 4, steps, 3)
    expected = [pushed[..., 0, :]]
    for t in range(1, steps):
        expected.append((gain[t] @ expected[-1].unsqueeze(-1)).squeeze(-1) + pushed[..., t, :])
    assert accumulate(composed(gain), pushed) == pytest.approx(torch.stack(expected, -2), rel=1e-4, abs=1e-4)


def test_the_chain_is_the_exact_posterior_of_a_linear_model():
    chain, y, smoother = smoother_of()
    whole = GaussianChain.of(smoother)
    means, covariances = rts(chain, y)
    mean, covariance = dense(whole)
    blocks = torch.stack([covariance[3 * t : 3 * t + 3, 3 * t : 3 * t + 3] for t in range(T)])
    assert mean.reshape(T, 3).numpy() == pytest.approx(means, abs=1e-9)
    assert blocks.numpy() == pytest.approx(covariances, abs=1e-9)
    assert smoother.log_evidence.item() == pytest.approx(kalman(chain, y)[0], abs=1e-8)


@pytest.mark.parametrize("make", [lambda: smoother_of()[2], arm_smoother], ids=["linear", "arm"])
def test_the_algebra_of_the_chain(make):
    smoother = make()
    whole = GaussianChain.of(smoother)
    mean, covariance = dense(whole)
    marginal = smoother.covariance()
    D = whole.loc.shape[-1]
    blocks = torch.stack([covariance[D * t : D * t + D, D * t : D * t + D] for t in range(T)])
    assert blocks.numpy() == pytest.approx(marginal.numpy(), rel=1e-8, abs=1e-10)
    paths = whole.sample((5,))
    flat = torch.distributions.MultivariateNormal(mean, covariance)
    assert whole.log_prob(paths).numpy() == pytest.approx(flat.log_prob(paths.flatten(-2)).numpy(), abs=1e-5)
    assert whole.path(whole.noise(paths)).numpy() == pytest.approx(paths.numpy(), abs=1e-9)
    exact = torch.linalg.inv(covariance).diagonal().reshape(T, D)
    assert whole.precision_diagonal().numpy() == pytest.approx(exact.numpy(), rel=1e-4)
    assert whole.expand((4,)).sample().shape == (4, T, D)


def test_the_arms_smoother_has_an_error_to_test():
    assert np.abs(arm_smoother().factors.error_root).max() > 1e-3

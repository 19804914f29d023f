"""The likelihood of pixels against SciPy's distributions; the bias against the covariance of its process."""

import math

import numpy as np
import torch
from scipy import stats

from invdyn.models.observation.pixels import bias_transition, pixel_log_likelihood

CAMERAS, POINTS = 2, 3
AREA = torch.tensor([1e6, 2e6], dtype=torch.float64)


def some(seed=0, batch=4):
    torch.manual_seed(seed)
    predicted = 500 + 100 * torch.randn(batch, CAMERAS, POINTS, 2, dtype=torch.float64)
    pixels = predicted + 8 * torch.randn_like(predicted)
    scale = 2 + torch.rand(CAMERAS, POINTS, dtype=torch.float64)
    return pixels, predicted, scale


def test_the_density_is_that_of_a_students_t_in_the_plane():
    pixels, predicted, scale = some()
    bias = torch.randn_like(pixels)
    for freedom in (1.5, 4.0):
        ours = pixel_log_likelihood(pixels, predicted, scale, freedom, AREA, bias)
        for index in np.ndindex(*ours.shape):
            center = (predicted[index] + bias[index]).numpy()
            shape = float(scale[index[1:]]) ** 2 * np.eye(2)
            expected = stats.multivariate_t(center, shape, freedom).logpdf(pixels[index].numpy())
            assert math.isclose(float(ours[index]), expected, rel_tol=1e-12)


def test_without_end_of_freedom_it_is_gaussian():
    pixels, predicted, scale = some()
    ours = pixel_log_likelihood(pixels, predicted, scale, math.inf, AREA)
    expected = torch.distributions.Normal(predicted, scale[..., None]).log_prob(pixels).sum(-1)
    torch.testing.assert_close(ours, expected)
    near = pixel_log_likelihood(pixels, predicted, scale, 1e9, AREA)
    torch.testing.assert_close(near, expected, rtol=1e-6, atol=1e-6)


def test_what_is_missing_has_no_term_and_what_cannot_be_seen_is_anywhere():
    pixels, predicted, scale = some()
    pixels[0, 0, 1, 0] = torch.nan
    predicted[:, 1, 2] = torch.nan
    pixels[2, 1, 2] = torch.nan
    predicted.requires_grad_()
    scale.requires_grad_()
    terms = pixel_log_likelihood(pixels, predicted, scale, 4.0, AREA)
    assert terms[0, 0, 1] == 0
    assert terms[2, 1, 2] == 0
    torch.testing.assert_close(terms[[0, 1, 3], 1, 2], -AREA[1].log().expand(3))
    terms.sum().backward()
    assert torch.isfinite(predicted.grad).all()
    assert torch.isfinite(scale.grad).all()
    assert (predicted.grad[:, 1, 2] == 0).all()
    assert (predicted.grad[0, 0, 1] == 0).all()


def test_gradients_are_those_of_differences():
    pixels, predicted, scale = some(batch=1)
    freedom = torch.tensor(4.0, dtype=torch.float64, requires_grad=True)
    inputs = (predicted.requires_grad_(), scale.requires_grad_(), freedom, torch.zeros_like(pixels).requires_grad_())
    assert torch.autograd.gradcheck(lambda mu, s, nu, b: pixel_log_likelihood(pixels, mu, s, nu, AREA, b), inputs)


def test_a_bias_keeps_its_variance_and_forgets_at_its_own_pace():
    """Mean and covariance after steps of any length are those of exp(−|t|/ℓ)."""
    sd, pace = torch.tensor(5.0, dtype=torch.float64), torch.tensor(0.4, dtype=torch.float64)
    factor, variance = torch.ones(1, dtype=torch.float64), sd**2
    for step in (0.01, 0.5, 1e-9, 0.2):
        mean, spread = bias_transition(factor, step, pace, sd)
        ratio = mean / factor
        variance = ratio**2 * variance + spread**2
        factor = mean
        torch.testing.assert_close(variance, sd.square().expand(1))  # stationary
    torch.testing.assert_close(factor, torch.exp(-torch.tensor([0.71 + 1e-9], dtype=torch.float64) / 0.4))
    _, spread = bias_transition(torch.zeros(1), 1e-9, torch.tensor(0.4), torch.tensor(5.0))
    # In single precision, too: β √(2 δ/ℓ).
    torch.testing.assert_close(spread, torch.full((1,), 5 * math.sqrt(2e-9 / 0.4)))

"""What a sampler of parameters returns: weighted moments, and joined runs."""

import pytest
import torch

from invdyn.inference.parameters.posterior import ParameterPosterior


def normal(*shape, seed=0):
    return torch.randn(*shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def test_moments_are_weighted():
    """Draws of N(0, 1) with weights of N(.7, 1)."""
    x = normal(4, 5000)
    log_weights = 0.7 * x - (0.7 * x).flatten().logsumexp(0)
    made = ParameterPosterior("smc2", 0, {"x": x}, log_weights, torch.zeros_like(x), torch.ones(4).double())
    assert made.mean("x").item() == pytest.approx(0.7, abs=0.06)
    assert made.sd("x").item() == pytest.approx(1, abs=0.06)
    # The ESS of such weights is exp(−.7²) of the draws.
    assert made.ess == pytest.approx(20_000 * 0.613, rel=0.06)

"""Gaussians by their root, against torch's constructor."""

import pytest
import torch
from pyro.distributions import MultivariateNormal

from invdyn.models.gaussian import by_root

F64 = torch.float64


def drawn(*shape, seed):
    return torch.randn(shape, generator=torch.Generator().manual_seed(seed), dtype=F64)


@pytest.mark.parametrize("batches", [((), ()), ((5,), ()), ((), (5,)), ((4, 1), (5,))])
def test_it_is_what_the_constructor_makes(batches):
    mean, root = drawn(*batches[0], 3, seed=0), drawn(*batches[1], 3, 3, seed=1)
    root = root.tril(-1) + torch.diag_embed(root.diagonal(dim1=-2, dim2=-1).exp())
    one, other = by_root(mean, root), MultivariateNormal(mean, scale_tril=root, validate_args=False)
    assert one.batch_shape == other.batch_shape
    assert one.event_shape == other.event_shape
    value = drawn(2, *one.batch_shape, 3, seed=2)
    for made in (lambda law: law, lambda law: law.expand((7, *law.batch_shape))):
        same, own = made(one), made(other)
        near = value if made(one) is one else value[:, None]
        torch.testing.assert_close(same.log_prob(near), own.log_prob(near), rtol=0, atol=0)
        for name in ("mean", "variance", "covariance_matrix", "precision_matrix", "scale_tril"):
            torch.testing.assert_close(getattr(same, name), getattr(own, name), rtol=0, atol=0)
        draws = []
        for law in (same, own):
            torch.manual_seed(3)
            draws.append(law.rsample((6,)))
        torch.testing.assert_close(*draws, rtol=0, atol=0)


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="shape mismatch"):
        by_root(torch.zeros(4, 3), torch.eye(3).expand(5, 3, 3))

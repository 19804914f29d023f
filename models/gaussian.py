"""Gaussians by their root.

torch's constructor asks `torch.broadcast_shapes`, which imports SymPy when it is first called (half a second of CPU in
every process), and then takes fifty times as long as numpy does.
"""

import torch
from pyro.distributions import MultivariateNormal
from torch import Tensor
from torch.distributions import Distribution

from invdyn.models.shapes import common


def by_root(mean: Tensor, root: Tensor) -> MultivariateNormal:
    """N(mean, L Lᵀ) of means (..., D) and lower triangles L (..., D, D): what the constructor makes, not validated."""
    batch = torch.Size(common(mean.shape[:-1], root.shape[:-2]))
    made = MultivariateNormal.__new__(MultivariateNormal)
    made.loc = mean.expand(*batch, -1)
    made.scale_tril = root.expand(*batch, -1, -1)
    made._unbroadcasted_scale_tril = root
    Distribution.__init__(made, batch, mean.shape[-1:], validate_args=False)
    return made

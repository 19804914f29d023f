"""Stochastic variational inference over the whole trajectory: mean field, and a Markov guide.

    bound = E_q[log p(x_{0:T}, y) − log q(x_{0:T})] ≤ log p(y),        reparametrised gradients

* :class:`MeanField` (method "svi"), the family of Pyro's AutoNormal: every entry of every state is an independent
  Gaussian. A path's neighbouring states are strongly correlated, so its best fit is far too narrow:
  1/Λ_ii instead of (Λ⁻¹)_ii for a posterior of precision Λ.
* :class:`Markov` (method "svi-markov"): a Gaussian with block-tridiagonal precision, given by the blocks of the
  precision's Cholesky factor (:class:`.gaussian_chain.GaussianChain`). It contains the exact posterior of a
  linear-Gaussian model.

Both start at the Gaussian smoother, and their means move in its whitened coordinates m,

    μ = path(m),    mean field:  σ = σ⁰ e^ρ with σ⁰² = 1/Λ_ii,    Markov:  A_t = A⁰_t + L⁰_t G_t S_{t−1}⁻¹,
    L_t = L⁰_t C_t

(S: the smoother's sds), so that one learning rate suits angles known to a millionth and torques in N·m.

``guide()`` samples the whole path at one site, which fits :func:`..methods.svi.path_model`.
"""

from collections.abc import Sequence
from typing import Any, ClassVar

import pyro
import torch
from pyro.distributions import Normal, TorchDistribution
from torch import Tensor, nn
from torch.distributions import constraints

from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.gaussian_chain import GaussianChain


class PathwiseOnly(TorchDistribution):
    """``live`` to sample from, its equal ``frozen`` for densities: drops the gradient's score term.

    Roeder, Wu & Duvenaud (2017), "Sticking the landing": that term is zero on average, and without it the
    gradient's variance is zero too where the guide is the posterior. (Where the guide is far off, as mean field is, the
    term helps instead.)
    """

    has_rsample = True
    arg_constraints: ClassVar[dict[str, constraints.Constraint]] = {}

    def __init__(self, live: TorchDistribution, frozen: TorchDistribution):
        self.live, self.frozen = live, frozen
        super().__init__(live.batch_shape, live.event_shape, validate_args=False)

    @property
    def support(self) -> constraints.Constraint:
        """That of the live one."""
        return self.live.support

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> "PathwiseOnly":
        """Both expanded."""
        return PathwiseOnly(self.live.expand(batch_shape), self.frozen.expand(batch_shape))

    def rsample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Reparametrised draws of ``live``."""
        return self.live.rsample(sample_shape)

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density of ``frozen``."""
        return self.frozen.log_prob(value)


class PathGuide(nn.Module):
    """A distribution of paths (T, D) whose mean moves in the whitened coordinates of a Gaussian smoother."""

    def __init__(self, smoother: GaussianSmoother):
        super().__init__()
        self.start = GaussianChain.of(smoother)
        self.shift = nn.Parameter(torch.zeros_like(self.start.loc))

    def distribution(self) -> TorchDistribution:
        """Of the whole path; event shape (T, D)."""
        raise NotImplementedError

    def forward(self) -> Tensor:
        """Sample the site "path"."""
        return pyro.sample("path", self.distribution())


class MeanField(PathGuide):
    """Independent Gaussians, started at the best ones for the linearised model."""

    def __init__(self, smoother: GaussianSmoother):
        super().__init__(smoother)
        self.first_scale = self.start.precision_diagonal().rsqrt()
        self.log_scale = nn.Parameter(torch.zeros_like(self.shift))

    def distribution(self) -> TorchDistribution:
        """Normal(μ, σ) over (T, D)."""
        return Normal(self.start.path(self.shift), self.first_scale * self.log_scale.exp()).to_event(2)


class Markov(PathGuide):
    """Gaussian Markov chain, started at the smoother's own."""

    def __init__(self, smoother: GaussianSmoother):
        super().__init__(smoother)
        sd = smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt()
        self.before = 1 / torch.cat([sd[:1], sd[:-1]])
        self.steer = nn.Parameter(torch.zeros_like(self.start.gain))
        self.skew = nn.Parameter(torch.zeros_like(self.start.root))

    def distribution(self) -> GaussianChain:
        """The chain, with gains and roots corrected."""
        start = self.start
        gain = start.gain + start.root @ self.steer * self.before.unsqueeze(-2)
        scale = torch.diag_embed(self.skew.diagonal(dim1=-2, dim2=-1).exp())
        root = start.root @ (self.skew.tril(-1) + scale)
        return GaussianChain(start.path(self.shift), gain, root)

    def forward(self) -> Tensor:
        """Sample the site "path"; gradients flow through the path alone."""
        live = self.distribution()
        frozen = GaussianChain(live.loc.detach(), live.gain.detach(), live.root.detach())
        return pyro.sample("path", PathwiseOnly(live, frozen))

"""The posterior of a linearised model as a distribution of whole paths.

The posterior of the linearised model (:mod:`.gauss_newton`, then :mod:`.posterior_linearisation`) is a
Gaussian Markov chain. In deviations from its mean path μ_t,

    δ_0 = L_0 ε_0,     δ_t = A_t δ_{t−1} + L_t ε_t,     ε ~ N(0, I),     x = μ + δ,

with A_t = gain_t F_{t−1} and L_t L_tᵀ = root_t root_tᵀ + (gain_t error_root_{t−1})(…)ᵀ from
:class:`.square_root.BackwardFactors`. Draws are exact forward samples of that chain. It whitens NUTS
(:mod:`invdyn.inference.mcmc.nuts`) and starts the variational guides (:mod:`invdyn.inference.variational.path_guides`).

Draws without gradients take row after row, a block of paths at a time. Where gradients are needed, all T steps of the
recursion are done in log₂ T batched ones (Blelloch 1990, "Prefix sums and their applications": affine maps compose
associatively), so that they are fast and differentiable.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from pyro.distributions import TorchDistribution
from torch import Tensor
from torch.distributions import constraints

from invdyn.inference.execution.seeds import seeded
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.square_root import forward_mean

PATHS_AT_ONCE = 16
"""That are drawn without gradients."""


class GaussianChain(TorchDistribution):
    """Distribution of a whole path (T, D): the Gaussian Markov chain at the top of the file.

    Its precision is BᵀB, block-tridiagonal, and B, its block-bidiagonal Cholesky factor, has the blocks
    L_t⁻¹ and −L_t⁻¹ A_t.

    Args:
        loc: (T, D) mean path μ.
        gain: (T, D, D) A_t; A_0 is not used.
        root: (T, D, D) L_t, lower triangular with a positive diagonal.
    """

    arg_constraints = {"loc": constraints.real, "gain": constraints.real, "root": constraints.lower_triangular}  # noqa: RUF012
    support = constraints.independent(constraints.real, 2)
    has_rsample = True

    def __init__(self, loc: Tensor, gain: Tensor, root: Tensor):
        self.loc, self.gain, self.root = loc, gain, root
        super().__init__(event_shape=loc.shape, validate_args=False)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> "GaussianChain":
        """Independent paths; batch shape () or a plain repetition of one chain."""
        new = self._get_checked_instance(GaussianChain, _instance)
        new.loc, new.gain, new.root = self.loc, self.gain, self.root
        super(GaussianChain, new).__init__(torch.Size(batch_shape), self.event_shape, validate_args=False)
        return new

    def path(self, noise: Tensor) -> Tensor:
        """Path (…, T, D) of standardised innovations ε (…, T, D)."""
        pushed = (self.root @ noise.unsqueeze(-1)).squeeze(-1)
        reaches = composed(self.gain) if self.gain.requires_grad else self._composed
        return self.loc + accumulate(reaches, pushed)

    @cached_property
    def _composed(self) -> list[Tensor]:
        """Of gains that are not learned: one chain gives a path in every step of a guide's ascent, or of NUTS."""
        return composed(self.gain)

    def noise(self, path: Tensor) -> Tensor:
        """Innovations ε (…, T, D) of a path: the inverse of :meth:`path`."""
        deviation = (path - self.loc).unsqueeze(-1)
        rest = deviation[..., 1:, :, :] - self.gain[1:] @ deviation[..., :-1, :, :]
        innovation = torch.cat([deviation[..., :1, :, :], rest], -3)
        return torch.linalg.solve_triangular(self.root, innovation, upper=False).squeeze(-1)

    @torch.no_grad()
    def sample(
        self, sample_shape: Sequence[int] = (), *, seed: int | None = None, dtype: torch.dtype | None = None
    ) -> Tensor:
        """Draws (…, T, D) without gradients, kept as ``dtype``; by torch's global seed without one of their own."""
        shape = self._extended_shape(torch.Size(sample_shape))
        steps, dim = self.event_shape
        out = torch.empty(shape.numel() // (steps * dim), steps, dim, dtype=dtype or self.loc.dtype)
        gain, root = (each.detach().cpu() for each in (self.gain, self.root))
        with seeded(seed, self.loc.device):
            for paths in out.split(PATHS_AT_ONCE):
                noise = torch.randn(len(paths), steps, dim, dtype=self.loc.dtype, device=self.loc.device).cpu()
                deviation = (root @ noise.permute(1, 2, 0)).numpy()  # (T, D, paths): one product a row
                for before, here, own in zip(deviation, deviation[1:], gain[1:].numpy(), strict=False):
                    here += own @ before
                paths.copy_(self.loc.detach().cpu() + torch.as_tensor(deviation).permute(2, 0, 1))
        return out.reshape(shape).to(self.loc.device)

    def rsample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Reparametrised draws (…, T, D)."""
        shape = self._extended_shape(torch.Size(sample_shape))
        return self.path(torch.randn(shape, dtype=self.loc.dtype, device=self.loc.device))

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density of paths (…, T, D)."""
        noise = self.noise(value)
        log_volume = self.root.diagonal(dim1=-2, dim2=-1).log().sum()
        constant = 0.5 * math.log(2 * math.pi) * noise.shape[-2:].numel()
        return -0.5 * noise.square().sum((-2, -1)) - log_volume - constant

    def precision_diagonal(self) -> Tensor:
        """Diagonal (T, D) of the path's precision: 1 / Var(one entry given all the others)."""
        eye = torch.eye(self.loc.shape[-1], dtype=self.loc.dtype)
        inverse = torch.linalg.solve_triangular(self.root, eye.expand_as(self.root), upper=False)
        later = torch.cat([inverse[1:] @ self.gain[1:], torch.zeros_like(inverse[:1])])
        return inverse.square().sum(-2) + later.square().sum(-2)

    @classmethod
    def of(cls, smoother: GaussianSmoother) -> "GaussianChain":
        """The posterior of a smoother's linearised model (one parameter set)."""
        factors = smoother.factors
        gain, root = np.zeros_like(factors.gain), factors.root
        gain[1:] = factors.gain[1:] @ factors.F
        if factors.error_root.shape[-1]:
            scattered = factors.gain[1:] @ factors.error_root
            root = np.concatenate([root, np.pad(scattered, [(1, 0), (0, 0), (0, 0)])], -1)
        # Orthogonal triangularisation, as a Cholesky of the covariance would lose half the digits.
        lower = np.swapaxes(np.linalg.qr(np.swapaxes(root, -1, -2), mode="r"), -1, -2)
        lower = lower * np.where(np.diagonal(lower, axis1=-2, axis2=-1) < 0, -1.0, 1.0)[:, None, :]
        shift = forward_mean(factors, smoother.linearisation.m0)
        return cls(smoother.path + torch.as_tensor(shift), torch.as_tensor(gain), torch.as_tensor(lower))


def composed(gain: Tensor) -> list[Tensor]:
    """Of gains A (T, D, D), for 1, 2, 4, … rows: what t's row has of the state so many rows before."""
    reach, found = 1, [gain]
    while 2 * reach < len(gain):
        gain = torch.cat([gain[:reach], gain[reach:] @ gain[:-reach]])
        found.append(gain)
        reach *= 2
    return found


def accumulate(reaches: Sequence[Tensor], pushed: Tensor) -> Tensor:
    """Solve δ_t = A_t δ_{t−1} + b_t, δ_0 = b_0, for pushed b (…, T, D), and gains A as :func:`composed`."""
    steps, dim = pushed.shape[-2:]
    columns = pushed.reshape(-1, steps, dim).permute(1, 2, 0)  # (T, D, paths): one product a row
    for doubled, gain in enumerate(reaches if steps > 1 else ()):
        # After this round row t holds what rows t − 2·reach + 1 … t have pushed.
        reach = 2**doubled
        columns = torch.cat([columns[:reach], columns[reach:] + gain[reach:] @ columns[:-reach]])
    return columns.permute(2, 0, 1).reshape(pushed.shape)

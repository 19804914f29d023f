"""The look-ahead for any dynamics, with a defensive share of the prior.

Hesterberg (1995), "Weighted average importance sampling and defensive mixture distributions", Technometrics 37;
Heng et al. (2020). Each particle has the closed form of :mod:`.controlled` with its own covariance Q(x_{t−1}) = L Lᵀ,

    I_t(x_{t−1}) = ∫ N(x; f(x_{t−1}), Q(x_{t−1})) ψ_t(x) dx = exp(c_t − ½ |C⁻¹ v|²) / |C|,
    C Cᵀ = I + S Sᵀ,   S = U_t L,   v = b_t − U_t (f − x̄_t),

and ψ_t gets a floor κ, so that no future is given up for what ψ believes of it:

    q(x_t | x_{t−1}) ∝ p(x_t | x_{t−1}) (ψ_t(x_t) + κ)
                     = [I_t · N(f, Q)ψ_t/I_t + κ · p(x_t | x_{t−1})] / (I_t + κ),
    log ψ̃_{t−1}(x_{t−1}) = log (I_t(x_{t−1}) + κ).

That is a mixture in which a particle follows ψ with probability I/(I + κ) and the prior otherwise: one that ψ thinks
impossible moves as in the bootstrap filter, and keeps a weight in the resampling. ψ is scaled so that I is at most
about one, and κ = α/(1 − α) e^{−D/2}, so that a particle as far from ψ's peak as the posterior's own scatter draws from
the prior with probability α = 10 %. Weights p/q ≤ (I + κ)/κ are bounded even where tails of N(f, Q) are too light;
N(f, Q) has the mean and covariance of dynamics that need not be Gaussian, and the weight is by their true density.

Use it where ψ may be wrong: several modes, jumps, heavy-tailed dynamics, covariances that depend on the state.
"""

import math

import torch
from pyro.distributions import Distribution, TorchDistribution
from torch import Tensor
from torch.distributions import constraints

from invdyn.inference.contract import ModelError
from invdyn.inference.filters.controlled import Controlled
from invdyn.inference.filters.moment_matching import matched
from invdyn.inference.filters.proposal import Particles, Proposal, draw
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.models.gaussian import by_root
from invdyn.models.state_space import StateSpaceModel, gaussian_moments


class Defended(Controlled):
    """Guide twisted by a smoother's factors over a floor; any dynamics with a density, a mean and a covariance.

    Args:
        model: its transition's covariance may depend on the state, and need not be Gaussian.
        observations: (T, O), NaN where missing.
        smoother: of the model or of its approximation (:func:`.moment_matching.moment_matched`).
        share: α in [0, 1), of the prior in the proposal of a particle as far from ψ's peak as the posterior scatters;
            0 trusts ψ.
    """

    one_gain = False

    def __init__(self, model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother, share: float = 0.1):
        super().__init__(model, observations, smoother)
        if not 0 <= share < 1:
            raise ValueError(f"expected a defensive share in [0, 1), got {share}")
        self._log_floor = math.log(share / (1 - share)) - model.state_dim / 2 if share > 0 else -math.inf

    def _parts(self, t: int | Tensor, before: Distribution) -> tuple[Tensor, Tensor, Tensor]:
        """Log I (…), and the mean (…, D) and root (…, D, D) of N(f, Q) ψ_t / I, for p(x_t | x_{t−1}) = ``before``."""
        mean, L = gaussian_moments(matched(before))
        S = self._U[t] @ L
        v = self._b[t] - (self._U[t] @ (mean - self.path[t]).unsqueeze(-1)).squeeze(-1)
        eye = torch.eye(v.shape[-1], dtype=v.dtype, device=v.device)
        C = torch.linalg.cholesky(eye + S @ S.mT)
        z = torch.linalg.solve_triangular(C, v.unsqueeze(-1), upper=False)
        log_det = C.diagonal(dim1=-2, dim2=-1).log().sum(-1)
        log_integral = self._log_c[t] - 0.5 * z.square().sum((-2, -1)) - log_det
        w = S.mT @ torch.linalg.solve_triangular(C.mT, z, upper=True)
        # Noise w given ψ has precision K Kᵀ, so L K⁻ᵀ is a square root of the covariance.
        K = torch.linalg.cholesky(eye + S.mT @ S)
        root = torch.linalg.solve_triangular(K, L.mT, upper=False).mT
        return log_integral, mean + (L @ w).squeeze(-1), root

    def _mixture(self, t: int | Tensor, before: Distribution) -> "Mixture":
        log_integral, mean, root = self._parts(t, before)
        tril = torch.linalg.cholesky(root @ root.mT)
        guided = by_root(mean, tril)
        return Mixture(guided, before, torch.sigmoid(self._log_floor - log_integral))

    def conditional_initial(self) -> Distribution:
        """q(x_0)."""
        return self._mixture(0, self.model.initial())

    def conditional(self, t: int | Tensor, state: Tensor) -> Distribution:
        """q(x_t | x_{t−1} = state)."""
        return self._mixture(t, self.model.transition(state, t))

    def propose_initial(self, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
        """Draw x_0 and weigh it by the true density."""
        particles, log_ratio = Proposal.propose_initial(self, shape)
        return self.at(0, particles["x"]), log_ratio

    def propose(self, t: int | Tensor, particles: Particles) -> tuple[Particles, Tensor]:
        """Draw x_t and weigh it by the true density."""
        before = self.model.transition(particles["x"], t)
        proposal = self._mixture(t, before)
        x = draw(proposal)
        return self.at(t, x), before.log_prob(x) - proposal.log_prob(x)

    def at(self, t: int | Tensor, x: Tensor) -> Particles:
        """x_t and its twist; at the last row there is nothing ahead."""
        if not isinstance(t, Tensor) and t + 1 >= self.num_steps:
            return {"x": x, "log_twist": x.new_zeros(x.shape[:-1])}
        log_integral, *_ = self._parts(t + 1, self.model.transition(x, t + 1))
        floor = torch.full_like(log_integral, self._log_floor)
        return {"x": x, "log_twist": torch.logaddexp(log_integral, floor)}


class Mixture(TorchDistribution):
    """Draws from ``second`` with probability ``share`` (…), else from ``first``; both (…, D) over the real numbers."""

    arg_constraints: dict = {}  # noqa: RUF012
    support = constraints.real_vector
    has_rsample = False

    def __init__(self, first: Distribution, second: Distribution, share: Tensor):
        self.first, self.second, self.share = first, second, share
        super().__init__(share.shape, first.event_shape, validate_args=False)

    def expand(self, batch_shape: torch.Size, _instance: object = None) -> "Mixture":
        """The same for a larger batch."""
        return Mixture(self.first.expand(batch_shape), self.second.expand(batch_shape), self.share.expand(batch_shape))

    def sample(self, sample_shape: torch.Size = torch.Size()) -> Tensor:  # noqa: B008
        """Draw (…, D)."""
        with torch.no_grad():
            first, second = self.first.sample(sample_shape), self.second.sample(sample_shape)
            chosen = torch.rand(first.shape[:-1], dtype=first.dtype, device=first.device) < self.share
            return torch.where(chosen.unsqueeze(-1), second, first)

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density (…)."""
        return torch.logaddexp(
            torch.log1p(-self.share) + self.first.log_prob(value), self.share.log() + self.second.log_prob(value)
        )


def look_ahead(model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother) -> Controlled:
    """The guide that a smoother's factors give: one gain a row where that is exact, else :class:`Defended`."""
    try:
        return Controlled(model, observations, smoother)
    except ModelError:
        return Defended(model, observations, smoother)

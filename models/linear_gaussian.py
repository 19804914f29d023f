"""Linear-Gaussian state-space model: the one whose answers are known exactly.

    x_0 ~ N(m, P),   x_t = A x_{t−1} + N(0, Q),   y_t = C x_t + N(0, R)

Shapes: A (D, D), Q (D, D), C (O, D), R (O, O), m (D,), P (D, D).
"""

import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.models.gaussian import by_root
from invdyn.models.shapes import apply
from invdyn.models.state_space import StateSpaceModel


class LinearGaussian(StateSpaceModel):
    """See the top of the file. Covariances must be positive definite (ValueError otherwise)."""

    unconstrained = frozenset({"transition", "emission", "mean"})
    roots = frozenset({"transition_root", "emission_root", "root"})

    def __init__(
        self,
        transition: Tensor,
        transition_covariance: Tensor,
        emission: Tensor,
        emission_covariance: Tensor,
        mean: Tensor,
        covariance: Tensor,
        num_steps: int,
    ):
        def root(matrix: Tensor) -> Tensor:
            try:
                return torch.linalg.cholesky(matrix)
            except torch.linalg.LinAlgError:
                raise ValueError("expected a positive definite covariance, got one that is not") from None

        super().__init__(
            {
                "transition": transition,
                "transition_root": root(transition_covariance),
                "emission": emission,
                "emission_root": root(emission_covariance),
                "mean": mean,
                "root": root(covariance),
            }
        )
        self.num_steps = num_steps
        self.observation_dim, self.state_dim = emission.shape[-2:]

    def initial(self) -> Distribution:
        """N(m, P)."""
        p = self.parameters
        return by_root(p["mean"], p["root"])

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """N(A x, Q)."""
        p = self.parameters
        mean = apply(p["transition"], state)
        return by_root(mean, p["transition_root"])

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """N(C x, R)."""
        p = self.parameters
        mean = apply(p["emission"], state)
        return by_root(mean, p["emission_root"])

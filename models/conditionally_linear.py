"""Conditionally linear-Gaussian models: an outer state of any kind, and a linear-Gaussian one given it.

Chen & Liu (2000), "Mixture Kalman filters"; Doucet, de Freitas, Murphy & Russell (2000), "Rao–Blackwellised particle
filtering for dynamic Bayesian networks". The outer state u is a Markov chain of its own,

    u_0 ~ outer_initial(),            u_t ~ outer_transition(u_{t−1}, t),
    x_0 ~ N(m(u_0), P(u_0)),          x_t = A(u_t) x_{t−1} + b(u_t) + N(0, Q(u_t)),
    y_t = C(u_t) x_t + d(u_t) + N(0, R(u_t)),

such as a switch between linear dynamics, a time-varying variance or a non-Gaussian noise as a mixture. Given the path
of u everything else is a Kalman filter's; :mod:`invdyn.inference.filters.rao_blackwellised` samples u alone. As a
:class:`StateSpaceModel` its state is (u, x), so that every other method takes it too.

Shapes: u (..., U), x (..., D), y (O,); A and Q (..., D, D), b and m (..., D), C (..., O, D), d (..., O), R (..., O, O).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import torch
from pyro.distributions import Distribution, TorchDistribution
from torch import Tensor
from torch.distributions import constraints

from invdyn.models.gaussian import by_root
from invdyn.models.shapes import apply, common, join
from invdyn.models.state_space import StateSpaceModel

Linear = tuple[Tensor, Tensor, Tensor]
"""A matrix, an offset and a covariance: of y = matrix x + offset + N(0, covariance)."""


class ConditionallyLinear(StateSpaceModel, ABC):
    """A subclass writes the five methods below, and sets ``outer_dim`` and ``inner_dim``.

    P and Q may be singular: (u, x) is simulated and filtered then, and has no density. R must be positive definite.
    """

    outer_dim: int
    inner_dim: int

    @property
    def state_dim(self) -> int:  # type: ignore[override]  # the sum of two that a subclass gives
        """U + D."""
        return self.outer_dim + self.inner_dim

    @abstractmethod
    def outer_initial(self) -> Distribution:
        """Distribution of u_0, event shape (U,)."""

    @abstractmethod
    def outer_transition(self, outer: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of u_t given u_{t−1} = ``outer`` (..., U), event shape (U,)."""

    @abstractmethod
    def inner_initial(self, outer: Tensor) -> tuple[Tensor, Tensor]:
        """Mean m and covariance P of x_0 given u_0 = ``outer`` (..., U)."""

    @abstractmethod
    def inner_transition(self, outer: Tensor, t: int | Tensor) -> Linear:
        """A, b and Q of the step into row t, given u_t = ``outer`` (..., U)."""

    @abstractmethod
    def inner_emission(self, outer: Tensor, t: int | Tensor) -> Linear:
        """C, d and R of row t, given u_t = ``outer`` (..., U)."""

    # -- as a state-space model of (u, x) --------------------------------------------------------
    def split(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """The outer (..., U) and the inner state (..., D) of states (..., U + D)."""
        return state[..., : self.outer_dim], state[..., self.outer_dim :]

    def initial(self) -> Distribution:
        """Distribution of (u_0, x_0)."""

        def inner(outer: Tensor) -> Distribution:
            mean, covariance = self.inner_initial(outer)
            return _normal(mean, covariance)

        return OuterThenInner(self.outer_initial(), inner, self.inner_dim)

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Distribution of (u_t, x_t) given (u_{t−1}, x_{t−1})."""
        before, x = self.split(state)

        def inner(outer: Tensor) -> Distribution:
            A, b, Q = self.inner_transition(outer, t)
            return _normal(apply(A, x) + b, Q)

        outer = self.outer_transition(before, t)
        # An outer state without memory has no batch of its own.
        batch = torch.Size(common(outer.batch_shape, before.shape[:-1]))
        return OuterThenInner(outer.expand(batch), inner, self.inner_dim)

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """N(C(u_t) x_t + d(u_t), R(u_t))."""
        outer, x = self.split(state)
        C, d, R = self.inner_emission(outer, t)
        return _normal(apply(C, x) + d, R)


class OuterThenInner(TorchDistribution):
    """Joint distribution of (u, x), event shape (U + D,): p(u) p(x | u).

    Args:
        outer: p(u), event shape (U,).
        inner: p(x | u) of u (..., U), event shape (D,).
        inner_dim: D.
    """

    arg_constraints: dict = {}  # noqa: RUF012
    support = constraints.real_vector
    has_rsample = False

    def __init__(self, outer: Distribution, inner: Callable[[Tensor], Distribution], inner_dim: int):
        self.outer, self.inner, self.inner_dim = outer, inner, inner_dim
        event = torch.Size([outer.event_shape[0] + inner_dim])
        super().__init__(outer.batch_shape, event, validate_args=False)

    def expand(self, batch_shape: Sequence[int], _instance: Any = None) -> "OuterThenInner":
        """Independent pairs."""
        return OuterThenInner(self.outer.expand(torch.Size(batch_shape)), self.inner, self.inner_dim)

    def sample(self, sample_shape: Sequence[int] = ()) -> Tensor:
        """Draws (..., U + D)."""
        outer = self.outer.sample(torch.Size(sample_shape))
        inner = self.inner(outer)
        # An inner distribution that is one for all u still draws once for each of them.
        batch = torch.Size(common(outer.shape[:-1], inner.batch_shape))
        return join(outer, inner.expand(batch).sample())

    def log_prob(self, value: Tensor) -> Tensor:
        """Log-density of pairs (..., U + D)."""
        size = value.shape[-1] - self.inner_dim
        outer, x = value[..., :size], value[..., size:]
        return self.outer.log_prob(outer) + self.inner(outer).log_prob(x)


def _normal(mean: Tensor, covariance: Tensor) -> Distribution:
    """N(mean, covariance); where the covariance is singular it has draws, and its log-density is NaN or infinite."""
    root, failed = torch.linalg.cholesky_ex(covariance)
    if bool(failed.any()):
        values, vectors = torch.linalg.eigh(covariance)
        # V √λ is a square root, and QR of its transpose makes it triangular.
        root = torch.linalg.qr((vectors * values.clamp_min(0).sqrt().unsqueeze(-2)).mT).R.mT
    return by_root(mean, root)

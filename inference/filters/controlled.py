"""Controlled sequential Monte Carlo: the exact dynamics, twisted towards the future.

Heng, Bishop, Deligiannidis & Doucet (2020), "Controlled sequential Monte Carlo"; Guarniero, Johansen
& Lee (2017), "The iterated auxiliary particle filter". With Gaussian factors ψ_t(x) ≈
p(y_{t:T} | x_t = x) from the Gauss–Newton smoother,

    q(x_t | x_{t−1}) ∝ N(x_t; f(x_{t−1}), Q) ψ_t(x_t)         closed form, with the exact f
    log ψ̃_t(x_t) = log ∫ N(x'; f(x_t), Q) ψ_{t+1}(x') dx'      the twist, closed form
    log weight   = log g(y_t | x_t) + log ψ̃_t(x_t) − log ψ_t(x_t)

so a particle at row t already bends towards everything that is still to be seen. The evidence is
unbiased for any ψ; ψ only sets the variance.

Everything is relative to the smoother's path, which keeps float32 particles accurate where
observations are sharp.
"""

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.linearised import at_mode
from invdyn.models.gaussian import by_root
from invdyn.models.state_space import StateSpaceModel, gaussian_mean


class Controlled(Proposal):
    """Guide twisted by the Gaussian smoother's information; the default.

    Args:
        model: with Gaussian transition noise whose covariance does not depend on the state: :mod:`.defended` takes
            any other.
        observations: (T, O), NaN where missing.
        smoother: whose factors to twist by: Gauss–Newton's, or refitted ones (:mod:`.iterated`);
            Gauss–Newton's are computed when not given.

    Raises ModelError for a model that does not fit the observations, or whose noise is not as said: its evidence would
    be biased.
    """

    one_gain = True
    """Whether all particles of a row share a gain."""

    def __init__(self, model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother | None = None):
        covariance = ("constant_covariance",) if self.one_gain else ()
        observations = check_model(model, observations, needs=("emission_of_state", *covariance))
        super().__init__(model)
        self.smoother = smoother or at_mode(model, observations)
        factors, path = self.smoother.factors, self.smoother.path

        def rows(values: np.ndarray | Tensor) -> Tensor:
            return torch.as_tensor(np.asarray(values)).to(dtype=model.dtype, device=model.device)

        self.path = rows(path)
        self.num_steps = len(self.path)
        self._gain, self._offset = rows(factors.gain), rows(factors.offset)
        self._root = rows(triangular(factors.root))
        # Each ψ_t may be scaled at will: with ∫N ψ_t = exp(−½|A m − α|²) a long recording's log-evidence
        # is summed row by row, and not as the difference of two large numbers in float32.
        self._U, self._b = rows(factors.U), rows(factors.b)
        self._A, self._alpha = rows(factors.A), rows(factors.alpha)
        self._log_c = rows(factors.log_c - factors.log_n)

    def _prediction(self, t: int | Tensor, state: Tensor | None) -> Tensor:
        """f(x_{t−1}) − x̄_t, shape (…, D); the prior mean for t = 0."""
        before = self.model.initial() if state is None else self.model.transition(state, t)
        return gaussian_mean(before) - self.path[t]

    def _integral(self, t: int | Tensor, prediction: Tensor) -> Tensor:
        """Log ∫ N(x_t; x̄_t + prediction, Q_t) ψ_t(x_t) dx_t, shape (…), with ψ_t scaled as above."""
        misfit = prediction @ self._A[t].mT - self._alpha[t]
        return -0.5 * misfit.square().sum(-1)

    def _log_psi(self, t: int | Tensor, deviation: Tensor) -> Tensor:
        misfit = deviation @ self._U[t].mT - self._b[t]
        return self._log_c[t] - 0.5 * misfit.square().sum(-1)

    # -- the particle filter's way in ----------------------------------------------------------
    def propose_initial(self, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
        """Draw x_0 ~ p(x_0) ψ_0(x_0), normalised."""
        prediction = self._prediction(0, None).expand(*shape, -1)
        return self._propose(0, prediction, self._integral(0, prediction))

    def propose(self, t: int | Tensor, particles: Particles) -> tuple[Particles, Tensor]:
        """Draw x_t ~ p(x_t | x_{t−1}) ψ_t(x_t), normalised."""
        return self._propose(t, particles["prediction"], particles["log_twist"])

    def _propose(self, t: int | Tensor, prediction: Tensor, integral: Tensor) -> tuple[Particles, Tensor]:
        deviation = prediction @ self._gain[t].mT + self._offset[t]
        deviation = deviation + torch.randn_like(deviation) @ self._root[t].mT
        return self.at(t, deviation + self.path[t]), integral - self._log_psi(t, deviation)

    def at(self, t: int | Tensor, x: Tensor) -> Particles:
        """x_t, where the model takes it, f(x_t) − x̄_{t+1}, and the twist; at the last row there is nothing ahead."""
        # A compiled row's t is a tensor, and never the last.
        if not isinstance(t, Tensor) and t + 1 >= self.num_steps:
            return {"x": x, "log_twist": x.new_zeros(x.shape[:-1])}
        prediction = self._prediction(t + 1, x)
        return {"x": x, "prediction": prediction, "log_twist": self._integral(t + 1, prediction)}

    # -- Pyro's way in -------------------------------------------------------------------------
    def conditional_initial(self) -> Distribution:
        """q(x_0)."""
        return self._conditional(0, self._prediction(0, None))

    def conditional(self, t: int | Tensor, state: Tensor) -> Distribution:
        """q(x_t | x_{t−1} = state)."""
        return self._conditional(t, self._prediction(t, state))

    def _conditional(self, t: int | Tensor, prediction: Tensor) -> Distribution:
        loc = self.path[t] + prediction @ self._gain[t].mT + self._offset[t]
        return by_root(loc, self._root[t])

    def log_twist(self, state: Particles, t: int | Tensor) -> Tensor:
        """Log ψ̃_t(x_t) of the particles in Pyro's state; zero at the last row."""
        return self.at(t, state["x"])["log_twist"]


def triangular(root: np.ndarray) -> np.ndarray:
    """Lower-triangular square roots with positive diagonals of root rootᵀ, (T, D, D)."""
    lower = np.swapaxes(np.linalg.qr(np.swapaxes(root, -1, -2), mode="r"), -1, -2)
    sign = np.where(np.diagonal(lower, axis1=-2, axis2=-1) < 0, -1.0, 1.0)
    return lower * sign[..., None, :]

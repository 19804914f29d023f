"""Guides to be learned: one Gaussian a row, affine in the state before.

    Affine      x_t ~ N(A_t x_{t−1} + b_t, diag s_t²)                                A, b, s learned
    Corrected   x_t = f(x_{t−1}) + L w_t,   w_t = G_t m_t + g_t + S_t z_t            the controlled guide
                z_t ~ N(C_t m̃_t + c_t, diag e^{2 s_t})                               C, c, s learned, from zero

with L Lᵀ the model's transition covariance and m_t = f(x_{t−1}) − x̄_t the prediction's deviation from the
smoother's path (m̃ in units of its posterior sd). G, g, S are the controlled guide's closed form (:mod:`.controlled`)
in terms of the transition's own standard noise w ~ N(0, I), so that

    log p(x_t | x_{t−1})/q(x_t) = ½|ε|² − ½|w|² + Σ s_t + log|S_t|,   z = C m̃ + c + e^s ε,

holds for a singular L too, and for parameters of the model that are learned with the guide's. The twist stays
the smoother's: unbiased with any.

Parameters are ``pyro.param`` "<name>.…", each one tensor over all rows; used outside of
SVI (:meth:`ParticleFilter.run`), a guide stands at its start until ``guide.sampled(model)`` has looked them up.

Shapes: T rows, D states; particles (M, N, D).
"""

import copy
from collections.abc import Callable, Sequence

import numpy as np
import pyro
import torch
from pyro.distributions import Distribution, Normal
from torch import Tensor
from torch.distributions import constraints

from invdyn.inference.filters.controlled import Controlled, triangular
from invdyn.inference.filters.moment_matching import noise_varies
from invdyn.inference.filters.proposal import Particles, Proposal
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.square_root import eliminate
from invdyn.models.gaussian import by_root
from invdyn.models.state_space import StateSpaceModel, gaussian_mean, gaussian_moments


def jacobian(function: Callable[[Tensor], Tensor], x: Tensor, size: int) -> tuple[Tensor, Tensor]:
    """Values (…, P) and Jacobians (…, P, D) of a batched function (…, D) → (…, P = ``size``), by one backward pass."""
    with torch.enable_grad():
        copies = x.detach().expand(size, *x.shape).clone().requires_grad_()
        value = function(copies)
        # Copy i contributes output i only, so one gradient holds all rows.
        picked = value.diagonal(dim1=0, dim2=-1).sum()
        rows = torch.autograd.grad(picked, copies)[0]
    return value[0].detach(), rows.movedim(0, -2)


class Affine(Proposal):
    """Guide N(A_t x_{t−1} + b_t, diag s_t²); the transition must have a density.

    Starts as the model linearised along ``path``, with the transition's sds: for a linear model with
    independent noise that is the bootstrap guide.

    Args:
        model: with Gaussian transition noise whose covariance does not depend on the state.
        path: (T, D) to linearise along at first; by default the prior mean, constant.
        name: prefix of the parameters "<name>.matrix" (T, D, D), "<name>.offset" and "<name>.scale" (T, D).
            Row 0 has no state before, and its matrix is not used.
    """

    reparameterised = True

    def __init__(self, model: StateSpaceModel, path: Tensor | None = None, *, name: str = "guide"):
        super().__init__(model)
        self.name = name
        start = gaussian_mean(model.initial()).detach()
        path = start.expand(model.num_steps, -1) if path is None else path.to(start)
        after = torch.arange(1, model.num_steps, device=model.device)
        mean, slope = jacobian(lambda x: gaussian_mean(model.transition(x, after)), path[:-1], path.shape[-1])
        sds = _noise_roots(model, path).detach().norm(dim=-1)
        offset = torch.cat([start[None], mean - (slope @ path[:-1, :, None]).squeeze(-1)])
        self._use(torch.cat([torch.zeros_like(slope[:1]), slope]), offset, sds)

    def _use(self, matrix: Tensor, offset: Tensor, scale: Tensor) -> None:
        self._start = {"matrix": matrix.detach(), "offset": offset.detach(), "scale": scale.detach()}
        self._matrix, self._offset, self._scale = matrix.unbind(0), offset.unbind(0), scale.unbind(0)

    def sampled(self, model: StateSpaceModel) -> "Affine":
        """Look up the guide's parameters in Pyro's store; return the guide of ``model`` that has them."""
        other = copy.copy(self)
        other.model = model
        other._use(
            *(
                pyro.param(f"{self.name}.{key}", start.clone(), constraint=constraint)
                for (key, start), constraint in zip(
                    self._start.items(), (constraints.real, constraints.real, constraints.positive), strict=True
                )
            )
        )
        return other

    def conditional_initial(self) -> Distribution:
        """q(x_0)."""
        return Normal(self._offset[0], self._scale[0], validate_args=False).to_event(1)

    def conditional(self, t: int | Tensor, state: Tensor) -> Distribution:
        """q(x_t | x_{t−1} = state)."""
        loc = state @ self._matrix[t].mT + self._offset[t]
        return Normal(loc, self._scale[t], validate_args=False).to_event(1)

    def propose_initial(self, shape: tuple[int, ...]) -> tuple[Particles, Tensor]:
        """Draw x_0, differentiable in the parameters, and log p(x_0)/q(x_0)."""
        return _weighed(self.model.initial(), self.conditional_initial().expand(torch.Size(shape)))

    def propose(self, t: int | Tensor, particles: Particles) -> tuple[Particles, Tensor]:
        """Draw x_t, differentiable in the parameters, and log p/q."""
        return _weighed(self.model.transition(particles["x"], t), self.conditional(t, particles["x"]))


class Corrected(Controlled):
    """The controlled guide, plus an affine correction that is learned and starts at none.

    Args:
        model: with Gaussian transition noise, whose covariance may depend on the state: w has none, and the twist need
            not be exact.
        observations, smoother: as for :class:`Controlled`.
        name: prefix of the parameters "<name>.matrix" (T, D, D), "<name>.offset" and "<name>.log_scale" (T, D),
            all zero at first and without units.
    """

    reparameterised = True
    one_gain = False

    def __init__(
        self,
        model: StateSpaceModel,
        observations: Tensor,
        smoother: GaussianSmoother | None = None,
        *,
        name: str = "guide",
    ):
        super().__init__(model, observations, smoother)
        self.name = name
        factors, L = self.smoother.factors, self.smoother.linearisation.L

        def tensor(values: np.ndarray | Tensor) -> Tensor:
            return torch.as_tensor(values).to(dtype=model.dtype, device=model.device)

        R, B, r, _, _ = eliminate(factors.U, factors.b, L)
        inverse = np.linalg.inv(R)
        self._closed_gain = tensor(-inverse @ B)
        self._closed_offset = tensor((inverse @ r[..., None])[..., 0])
        self._closed_root = tensor(triangular(inverse))
        sds = self.smoother.covariance().diagonal(dim1=-2, dim2=-1).sqrt().numpy()
        self._unit = tensor(np.where(sds > 0, sds, 1.0))
        self._one_noise = not noise_varies(model, self.path)
        zero = torch.zeros_like(self._closed_offset)
        self._use(torch.zeros_like(self._closed_gain), zero, zero)

    def _use(self, matrix: Tensor, offset: Tensor, log_scale: Tensor) -> None:
        """Put the correction into the closed form, all rows at once: w = K m + k + W ε."""
        self._start = {"matrix": matrix.detach(), "offset": offset.detach(), "log_scale": log_scale.detach()}
        S = self._closed_root
        gain = self._closed_gain + S @ (matrix / self._unit.unsqueeze(-2))
        self._w_gain = gain.mT.unbind(0)
        self._w_offset = (self._closed_offset + (S @ offset.unsqueeze(-1)).squeeze(-1)).unbind(0)
        self._w_root = (S * log_scale.exp().unsqueeze(-2)).mT.unbind(0)
        self._log_det = (S.diagonal(dim1=-2, dim2=-1).log() + log_scale).sum(-1).unbind(0)
        self._noise = _noise_roots(self.model, self.path).mT.unbind(0)

    def sampled(self, model: StateSpaceModel) -> "Corrected":
        """Look up the guide's parameters in Pyro's store; return the guide of ``model`` that has them."""
        other = copy.copy(self)
        other.model = model
        other._use(*(pyro.param(f"{self.name}.{key}", start.clone()) for key, start in self._start.items()))
        return other

    @classmethod
    def stacked(cls, guides: Sequence["Corrected"], model: StateSpaceModel) -> "Corrected":
        """One guide of M filters from M guides, each of a parameter set and a smoother of its own.

        ``model`` holds the sets, parameters (M, 1, own shape). For particles (M, N, D) alone.
        """
        whole = copy.copy(guides[0])
        whole.model = model

        def rows(name: str) -> Tensor:
            own = (getattr(guide, name) for guide in guides)
            return torch.stack([each if isinstance(each, Tensor) else torch.stack(each) for each in own], 1)

        for name in ("path", "_alpha", "_w_offset"):
            setattr(whole, name, rows(name).unsqueeze(-2))
        for name in ("_A", "_w_gain", "_w_root", "_noise"):
            setattr(whole, name, rows(name))
        whole._log_det = rows("_log_det").unsqueeze(-1).unbind(0)
        return whole

    def propose(self, t: int | Tensor, particles: Particles) -> tuple[Particles, Tensor]:
        """Draw x_t, differentiable in the parameters, and log p/q, with each particle's own noise where it varies."""
        return self._drawn(t, particles["prediction"], self._root_at(t, particles["x"]))

    def _propose(self, t: int | Tensor, prediction: Tensor, integral: Tensor) -> tuple[Particles, Tensor]:
        return self._drawn(t, prediction, self._noise[t])

    def _root_at(self, t: int | Tensor, state: Tensor) -> Tensor:
        """Lᵀ (…, D, D) of the transition from ``state``."""
        return self._noise[t] if self._one_noise else gaussian_moments(self.model.transition(state, t))[1].mT

    def _drawn(self, t: int | Tensor, prediction: Tensor, root: Tensor) -> tuple[Particles, Tensor]:
        noise = torch.randn_like(prediction)
        w = prediction @ self._w_gain[t] + noise @ self._w_root[t] + self._w_offset[t]
        log_ratio = 0.5 * (noise.square() - w.square()).sum(-1) + self._log_det[t]
        return self.at(t, self.path[t] + prediction + _times(w, root)), log_ratio

    def conditional(self, t: int | Tensor, state: Tensor) -> Distribution:
        """q(x_t | x_{t−1} = state)."""
        return self._gaussian(t, self._prediction(t, state), self._root_at(t, state))

    def _conditional(self, t: int | Tensor, prediction: Tensor) -> Distribution:
        return self._gaussian(t, prediction, self._noise[t])

    def _gaussian(self, t: int | Tensor, prediction: Tensor, noise: Tensor) -> Distribution:
        w = prediction @ self._w_gain[t] + self._w_offset[t]
        root = (self._w_root[t] @ noise).mT
        loc = self.path[t] + prediction + _times(w, noise)
        return by_root(loc, root)


def _times(w: Tensor, root: Tensor) -> Tensor:
    """Rows w (…, D) times one matrix, or one each (…, D, D)."""
    return w @ root if root.ndim < w.ndim + 1 else (w.unsqueeze(-2) @ root).squeeze(-2)


def _weighed(before: Distribution, proposal: Distribution) -> tuple[Particles, Tensor]:
    x = proposal.rsample()
    return {"x": x}, before.log_prob(x) - proposal.log_prob(x)


def _noise_roots(model: StateSpaceModel, path: Tensor) -> Tensor:
    """Square roots (T, D, D) of the initial and the transition covariances, differentiable."""
    after = torch.arange(1, len(path), device=path.device)
    _, first = gaussian_moments(model.initial())
    _, root = gaussian_moments(model.transition(path[:-1], after))
    return torch.cat([first[None], root.expand(len(after), *first.shape)])

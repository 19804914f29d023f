"""A Gaussian approximation of a model's dynamics, for guides that compute with Gaussians.

A guide needs no more than a mean and a covariance of x_t given x_{t−1}: the filter weighs by the true density, so that
the evidence is unbiased for any approximation of the dynamics by the guide. Gaussian dynamics are their own;
others with a mean and a finite covariance on the whole real line (Student-t, Laplace, mixtures) are matched in both.

Shapes: states (…, D).
"""

from contextlib import suppress

import torch
from pyro.distributions import Distribution, MultivariateNormal, Normal
from torch import Tensor
from torch.distributions import constraints

from invdyn.inference.smoothing.newton_rows import nudged
from invdyn.models.state_space import StateSpaceModel, gaussian_moments

NOT_MATCHED = (
    "expected a transition on the real line with a mean and a finite variance, got {}: the bootstrap guide takes any"
)


class MomentMatched(StateSpaceModel):
    """``model`` with Gaussian dynamics of the same means and covariances; its emission is the model's."""

    def __init__(self, model: StateSpaceModel):
        super().__init__(model.parameters)
        self.model = model
        self.state_dim, self.observation_dim = model.state_dim, model.observation_dim
        self.num_steps = model.num_steps

    def initial(self) -> Distribution:
        """Gaussian distribution of x_0."""
        return matched(self.model.initial())

    def transition(self, state: Tensor, t: int | Tensor) -> Distribution:
        """Gaussian distribution of x_t given x_{t−1}."""
        return matched(self.model.transition(state, t))

    def emission(self, state: Tensor, t: int | Tensor) -> Distribution:
        """The model's own."""
        return self.model.emission(state, t)

    def replace(self, **values: Tensor) -> "MomentMatched":
        """Return the approximation of the model with other parameter values."""
        return MomentMatched(self.model.replace(**values))


def matched(distribution: Distribution) -> Distribution:
    """Gaussian with the mean and covariance of ``distribution``, event shape (D,); itself if it is one.

    Raises TypeError where there is none: a support other than the real line, or no mean.
    """
    if has_gaussian_moments(distribution):
        return distribution
    support = distribution.support
    while isinstance(support, constraints.independent):
        support = support.base_constraint
    if len(distribution.event_shape) == 1 and support in (constraints.real, constraints.real_vector):
        with suppress(NotImplementedError):
            mean, full = distribution.mean, getattr(distribution, "covariance_matrix", None)
            if full is not None:
                return MultivariateNormal(mean, covariance_matrix=full, validate_args=False)
            return Normal(mean, distribution.variance.sqrt(), validate_args=False).to_event(1)
    raise TypeError(NOT_MATCHED.format(_kind(distribution)))


def _kind(distribution: Distribution) -> str:
    return type(getattr(distribution, "base_dist", distribution)).__name__


def has_gaussian_moments(distribution: Distribution) -> bool:
    """Whether :func:`.state_space.gaussian_moments` takes it as it is."""
    try:
        gaussian_moments(distribution)
    except TypeError:
        return False
    return True


def moment_matched(model: StateSpaceModel) -> StateSpaceModel:
    """The model itself if its dynamics are Gaussian, else :class:`MomentMatched`; raises TypeError as :func:`matched`.

    Dynamics are tried at draws of the first state.
    """
    with torch.no_grad():
        first = model.initial()
        state = first.expand(torch.Size((2,))).sample()
        later = model.transition(state, 1) if model.num_steps > 1 else first
        if has_gaussian_moments(first) and has_gaussian_moments(later):
            return model
        for each in (first, later):
            mean, root = gaussian_moments(matched(each))
            if not bool(torch.isfinite(mean).all() and torch.isfinite(root).all()):
                raise TypeError(NOT_MATCHED.format(_kind(each)))
    return MomentMatched(model)


def noise_varies(model: StateSpaceModel, path: Tensor) -> bool:
    """Whether the covariance of a Gaussian transition depends on the state, at ``path`` (T, D) and to either side."""
    rows = torch.arange(1, path.shape[-2])
    if len(rows) == 0:
        return False
    with torch.no_grad():
        here, *others = (
            gaussian_moments(model.transition(states[..., :-1, :], rows))[1] for states in (path, *nudged(model, path))
        )
    # To rounding, in which factors of one and the same matrix may differ.
    return any(not torch.allclose(here, other, rtol=1e-9, atol=0.0) for other in others)


def exact_closed_form(model: StateSpaceModel, path: Tensor) -> bool:
    """Whether dynamics are Gaussian, with a covariance that is the same in all states: what one gain a row serves."""
    with torch.no_grad():
        later = model.transition(path[:1], 1) if len(path) > 1 else model.initial()
        return has_gaussian_moments(model.initial()) and has_gaussian_moments(later) and not noise_varies(model, path)

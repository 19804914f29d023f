"""The Gaussian smoother that suits a model: by tangents where its transition is smooth, else by fitted lines.

Where it is smooth, Gauss–Newton finds the mode and :mod:`.posterior_linearisation` the Gaussian over the posterior;
where it has kinks (:attr:`.StateSpaceModel.nonsmooth`), :mod:`.statistical_homotopy` gives both at once.
"""

from torch import Tensor

from invdyn.inference.contract import check_model
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, gauss_newton
from invdyn.inference.smoothing.posterior_linearisation import posterior_linearisation
from invdyn.inference.smoothing.statistical_homotopy import statistical_homotopy
from invdyn.models.state_space import StateSpaceModel


def at_mode(model: StateSpaceModel, observations: Tensor, start: Tensor | None = None) -> GaussianSmoother:
    """Gauss–Newton's smoother, or of a model with kinks the fitted one; raises as they do."""
    if model.nonsmooth:
        return statistical_homotopy(model, observations, start)
    return gauss_newton(model, observations, start=start)


def linearised(
    model: StateSpaceModel, observations: Tensor, start: Tensor | None = None
) -> tuple[GaussianSmoother, GaussianSmoother]:
    """At the mode, and over the posterior around it, from a ``start`` (T, D); raises as the smoothers do."""
    mode = at_mode(model, observations, start)
    return mode, mode if model.nonsmooth else posterior_linearisation(model, observations, mode)


def gaussian_smoother(model: StateSpaceModel, observations: Tensor, start: Tensor | None = None) -> GaussianSmoother:
    """Of :func:`linearised` the one over the posterior.

    Raises as the smoothers do, and ModelError for a transition without a density, as of a state without noise.
    """
    check_model(model, observations, needs=("gaussian_transition", "emission_of_state", "transition_density"))
    return linearised(model, observations, start)[1]

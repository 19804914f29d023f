"""What single methods need of a model beyond the contract, each checked on a :class:`.Probe`."""

from collections.abc import Callable

import torch

from invdyn.inference.probe import Probe
from invdyn.models.state_space import gaussian_moments

SAME = 1e-6
"""Relative difference up to which two covariances are equal."""

NO_DENSITY = 'use genealogy, or SMCOptions(smoothing="genealogy"), which needs none, or give every state noise'


def _continuous_state(probe: Probe) -> None:
    if not probe.floating:
        raise probe.error("initial", "a continuous state", "integers", "use the bootstrap guide")


def _gaussian_transition(probe: Probe) -> None:
    _continuous_state(probe)
    model = probe.model
    found = {"initial": model.initial()}
    if probe.transition is not None:
        found["transition"] = probe.transition.distribution
    for method, distribution in found.items():
        try:
            gaussian_moments(distribution)
        except TypeError:
            expected, got = (
                "Normal(…).to_event(1) or MultivariateNormal",
                type(getattr(distribution, "base_dist", distribution)).__name__,
            )
            raise probe.error(method, expected, got, "use the bootstrap guide") from None


def _constant_covariance(probe: Probe) -> None:
    _gaussian_transition(probe)
    if probe.model.num_steps == 1:
        return
    _, root = gaussian_moments(probe.model.transition(probe.states, 1))
    covariance = root @ root.mT
    first = covariance[:1, ..., :1, :, :]
    sd = first.diagonal(dim1=-2, dim2=-1).sqrt()
    if bool(((covariance - first).abs() > SAME * sd.unsqueeze(-1) * sd.unsqueeze(-2)).any()):
        expected = "a covariance that does not depend on the state"
        raise probe.error("transition", expected, "one that does", "use the bootstrap guide")


def _emission_of_state(probe: Probe) -> None:
    if probe.model.emission_sees_previous:
        expected, got = "an emission of x_t alone", "one that depends on x_{t−1} too"
        raise probe.error("emission_given", expected, got, "use the bootstrap guide")


def _transition_density(probe: Probe) -> None:
    if probe.transition is None:
        return
    _, value, density = probe.transition
    if bool((torch.isfinite(value).all(-1) & ~torch.isfinite(density)).any()):
        got = "NaN or infinity, as where a state has no noise"
        raise probe.error("transition", "a finite log-density of its own draws", got, NO_DENSITY)


NEEDS: dict[str, Callable[[Probe], None]] = {
    "continuous_state": _continuous_state,
    "gaussian_transition": _gaussian_transition,
    "constant_covariance": _constant_covariance,
    "emission_of_state": _emission_of_state,
    "transition_density": _transition_density,
}
"""Preconditions by name, in the order in which they are checked:

* ``continuous_state``: states are real numbers;
* ``gaussian_transition``: ``initial`` and ``transition`` are Normal or MultivariateNormal;
* ``constant_covariance``: and the transition's covariance does not depend on the state;
* ``emission_of_state``: y_t depends on x_t alone;
* ``transition_density``: the transition has a finite density wherever it draws.
"""

LINEARISABLE = ("gaussian_transition", "emission_of_state")
"""What Gaussian smoothers need."""
LINEARISING = {"gaussian_transition", "constant_covariance"}
"""Needs of methods that linearise, which compute on the CPU in float64."""

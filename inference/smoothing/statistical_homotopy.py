"""The Gaussian smoother of dynamics with kinks: statistical linearisation under process noise that is tightened.

Contacts make the transition f a function of several smooth pieces. A tangent at a path knows one piece, and
Gauss–Newton moves back and forth between them. The best linear fit over a Gaussian (:mod:`.posterior_linearisation`;
García-Fernández, Svensson & Särkkä, "Iterated posterior linearization smoother", IEEE Trans. Automatic Control 62,
2017) averages over the pieces,

    f(x) ≈ f̄_t + F_t (x − x̄_t) + error of covariance V_t,    over N(x̄_t, P_t),

but P_t, of a sharp model, is too narrow to see a contact that a wrong path misses. So the process noise is relaxed at
first (:meth:`.StateSpaceModel.relaxed`, amounts α from 1 to 0), by which P_t spans the pieces; the rows then place the
path, and each pass begins at the posterior of the last one. A path that is given is at the right pieces already, and
the passes without more noise alone begin at it:

    (x̄, P)_{k+1} = smoother of the model with noise Q(α_k), fitted over (x̄, P)_k.

This is graduated optimisation (A. Blake & A. Zisserman, "Visual Reconstruction", MIT Press, 1987) in the noise. At
α = 0 passes end when one changes the evidence by less than ``SETTLED`` nats, or after ``PASSES`` of them: where a kink
divides the posterior, they alternate, and the particles that follow share it out. That of the highest evidence is kept;
of legs that land it is within a nat of that of more passes.

Shapes: observations (T, O), path (T, D). All in float64; the model gives no derivatives.
"""

import contextlib
import math

import torch
from torch import Tensor

from invdyn.inference.contract import in_float64
from invdyn.inference.preconditions import LINEARISABLE
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother
from invdyn.inference.smoothing.posterior_linearisation import fit_linear, one_pass, recentred_on_mean
from invdyn.models.divergence import Diverged, Singular, diverging
from invdyn.models.state_space import StateSpaceModel, gaussian_moments

AMOUNTS = (1.0, 0.8, 0.6, 0.5, 0.4, 0.3, 0.2, 0.1)
PASSES, SETTLED = 12, 0.5
"""At most, and nats between two, without more noise."""


def statistical_homotopy(
    model: StateSpaceModel, observations: Tensor, start: Tensor | GaussianSmoother | None = None
) -> GaussianSmoother:
    """The Gaussian smoother of a model whose transition has kinks.

    Args:
        model: with Gaussian transition noise, and :meth:`.StateSpaceModel.relaxed` dynamics.
        observations: (T, O), NaN where missing.
        start: path (T, D), or smoother, of a nearby model, from which no noise is relaxed; by default the homotopy
            begins at the model's own path.

    Raises ModelError for a model that does not fit its rows, Diverged where no pass has a finite path.
    """
    model, observations = in_float64(model, observations, needs=LINEARISABLE)
    if isinstance(start, GaussianSmoother):
        return _tightest(model, observations, start)
    if start is not None:
        return _tightest(model, observations, first_fit(model, observations, start.detach().cpu().double()))
    path, smoother = model.initial_paths(observations)[0], None
    for amount in AMOUNTS:
        relaxed = model.relaxed(amount)
        if relaxed is model:
            break
        with contextlib.suppress(Singular), diverging():
            smoother = one_pass(relaxed, observations, smoother or first_fit(relaxed, observations, path))
    return _tightest(model, observations, smoother or first_fit(model, observations, path))


def first_fit(model: StateSpaceModel, observations: Tensor, path: Tensor) -> GaussianSmoother:
    """The smoother of a model that is fitted over its own process noise about a ``path`` (T, D)."""
    with torch.no_grad():
        _, root = gaussian_moments(model.transition(path[:-1], torch.arange(1, len(path))))
    covariance = root @ root.mT
    covariance = torch.cat([covariance[:1], covariance])
    with diverging():
        linear = fit_linear(model, observations, path, covariance)
        return recentred_on_mean(model, observations, path, linear)


def _tightest(model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother) -> GaussianSmoother:
    """The best of some passes; the evidence of the last ones is settled, or they alternate."""
    best, before, settled = None, math.inf, False
    for _ in range(PASSES):
        try:
            with diverging():
                smoother = one_pass(model, observations, smoother)
        except Singular:
            break
        evidence = float(smoother.log_evidence)
        settled, before = abs(evidence - before) < SETTLED, evidence
        best = smoother if best is None or evidence > float(best.log_evidence) else best
        if settled:
            break
    if best is None:
        raise Diverged("the linearised model's smoother has no finite path: check units, axes, noise scales, start")
    best.converged = torch.tensor(settled)
    return best

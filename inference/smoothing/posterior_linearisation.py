"""Linearise over the posterior instead of at its mode.

García-Fernández, Svensson, Morelande & Särkkä (2015), "Posterior linearization filter"; with
smoothing (2017). The best linear fit to f over N(x̄_t, P_t), by 2D cubature points
x̄ ± √D S_i (S Sᵀ = P, columns S_i), instead of the tangent:

    f_i± = f(x̄ ± √D S_i),   f̄ = mean,   F = [ (f_i+ − f_i−) / (2√D) ] S⁻¹
    V = [ ((f_i+ + f_i−)/2 − f̄) / √D ]      the error of the fit, a sum of squares, no subtraction

and likewise for the emission's mean, whose error is added to the observation noise; an emission that no mean sums up
gives averages of a Newton step instead (:mod:`.newton_rows`). Where the
posterior is narrow this is the tangent; where it is wide ψ follows the bend and becomes as broad as it should,
which is what lowers the variance of log Ẑ in noisy settings.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from pyro.distributions import Distribution
from torch import Tensor

from invdyn.inference.contract import in_float64
from invdyn.inference.preconditions import LINEARISABLE
from invdyn.inference.smoothing.gauss_newton import GaussianSmoother, solve
from invdyn.inference.smoothing.linearisation import Linearisation, emission_mean, over_rows, prior_chain
from invdyn.inference.smoothing.newton_rows import averaged_newton_rows, keeps_noise
from invdyn.inference.smoothing.square_root import apply, forward_mean
from invdyn.models.divergence import Singular, diverging
from invdyn.models.observation.missing import explained, gaussian_rows
from invdyn.models.state_space import StateSpaceModel, gaussian_mean

Mean = Callable[[StateSpaceModel, Tensor, Tensor], Tensor]
"""From a model, states (…, T, D) and their rows (T,) to means (…, T, P)."""
Fits = tuple[Tensor, Tensor, Tensor]
"""Value, slope and error, as :func:`regress` has them."""


def posterior_linearisation(
    model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother, iterations: int = 2
) -> GaussianSmoother:
    """Refine a Gauss–Newton result; its path (…, T, D) becomes the approximate posterior mean.

    A fixed-point iteration, kept up only while it contracts: where the posterior is very wide a pass
    can widen it further, and run away. ``log_evidence`` of the result is that of the refitted linear model. A model
    with contact states (:attr:`.StateSpaceModel.contact_states`) is left as it is linearised: no line fits their jumps.
    """
    model, observations = in_float64(model, observations, needs=LINEARISABLE)
    if model.contact_states is not None:
        return smoother
    change = math.inf
    for _ in range(iterations):
        try:
            with diverging():
                refined = one_pass(model, observations, smoother)
        except Singular:
            break  # a covariance that overflowed: the previous pass is the better answer
        moved = (refined.log_evidence - smoother.log_evidence).abs().max().item()
        if not moved <= change:
            break
        smoother, change = refined, moved
    return smoother


def one_pass(model: StateSpaceModel, observations: Tensor, smoother: GaussianSmoother) -> GaussianSmoother:
    """The smoother of ``model`` linearised over the posterior of another one.

    Raises Singular where its path is not finite.
    """
    linear = fit_linear(model, observations, smoother.path, smoother.covariance())
    return recentred_on_mean(model, observations, smoother.path, linear, smoother.converged)


def recentred_on_mean(
    model: StateSpaceModel,
    observations: Tensor,
    path: Tensor,
    linear: Linearisation,
    converged: Tensor | None = None,
) -> GaussianSmoother:
    """The smoother of a linearised model (about ``path``), in deviations from its own mean.

    Raises Singular where that is not finite.
    """
    factors = solve(linear)
    shift = forward_mean(factors, linear.m0)
    path = path + torch.as_tensor(shift)
    if not bool(torch.isfinite(path).all()):
        # Before a model that checks its values is evaluated there.
        raise Singular("the smoother has no finite path: check units, axes, noise scales, start")
    # Coordinates are deviations from the path that was fitted along: move them to the new one.
    linear, factors = _recentred(linear, shift), factors.seen_from(shift)
    evidence = torch.as_tensor(factors.log_evidence + linear.log_constant)
    with torch.no_grad():
        joint = model.log_joint(path, observations)
    return GaussianSmoother(
        path, factors, linear, evidence, joint, torch.tensor(False) if converged is None else converged
    )


@dataclass(frozen=True)
class SharedMeans:
    """A model of B parameter sets by fewer, U, that have the same means: a noise scale, say, moves none.

    Means are those of transitions, or of emissions.

    ``number`` (B,) is that of each set's mean among the U; None where each has its own. ``fits`` are those of the U,
    once they are known, for other sets with the same means.
    """

    model: StateSpaceModel
    number: Tensor | None = None
    fits: list[Tensor] = field(default_factory=list)

    def regressed(self, mean: Mean, rows: Tensor, path: Tensor, covariance: Tensor, shown: Sequence[int]) -> Fits:
        """:func:`regress` of a ``mean`` of the model, over the same N(path, covariance) in all sets."""
        independent, _ = self.model.independent_sensor_states or ([], [])

        def fitted(rows: Tensor, centre: Tensor, covariance: Tensor) -> Fits:
            root = _root_of_others(covariance, independent)
            return regress(lambda x: mean(self.model, x, rows), centre, root, independent, shown)

        if not self.fits:
            sets = slice(None) if self.number is None else slice(int(self.number.max()) + 1)
            self.fits.extend(over_rows(fitted, rows, path[sets], covariance[sets]))
        value, slope, error = (each if self.number is None else each[self.number] for each in self.fits)
        return value, slope, error


def fit_linear(
    model: StateSpaceModel,
    observations: Tensor,
    path: Tensor,
    covariance: Tensor,
    moved: SharedMeans | None = None,
    seen: SharedMeans | None = None,
) -> Linearisation:
    """Best linear model over N(path, covariance), (…, T, D) and (…, T, D, D), in deviations from path.

    Where N is one and the same in B parameter sets, (B, T, …), ``moved`` and ``seen`` may say which of them have the
    same transitions' and emissions' means, whose fits are most of the work (:func:`moved_means`).
    """
    transitions = _transitions(moved or SharedMeans(model), path, covariance)
    return _linear(model, observations, path, covariance, transitions, seen or SharedMeans(model))


def _linear(
    model: StateSpaceModel,
    observations: Tensor,
    path: Tensor,
    covariance: Tensor,
    transitions: Fits,
    seen: "SharedMeans | Fits",
) -> Linearisation:
    """The linear model of fitted ``transitions``, and of emissions' means that are fitted or are to be."""
    predicted, F, V = transitions
    L, m0 = prior_chain(model, path)
    with torch.no_grad():
        emission = model.emission(path, torch.arange(path.shape[-2]))
    if isinstance(seen, tuple) or keeps_noise(model, path, emission):
        fits = seen if isinstance(seen, tuple) else _emissions(seen, path, covariance)
        E, e, constant = _about_mean(fits, emission, observations)
    else:
        E, e, constant = averaged_newton_rows(model, path, _root(covariance), observations)
    pieces = (F, predicted - path[..., 1:, :], L, E, e, m0, constant.sum(-1), V)
    F_, a, L_, E_, e_, m0_, log_constant, V_ = (piece.detach().numpy() for piece in pieces)
    return Linearisation(F_, a, L_, E_, e_, m0_, log_constant, V_)


@dataclass(frozen=True)
class Fitted:
    """Means of transitions and emissions fitted once over N(path, covariance), for models with other noise.

    Emissions keep their noise as it is along the path (:func:`.newton_rows.keeps_noise`).
    """

    observations: Tensor
    path: Tensor
    covariance: Tensor
    transitions: Fits
    emissions: Fits

    @classmethod
    def of(cls, model: StateSpaceModel, observations: Tensor, path: Tensor, covariance: Tensor) -> "Fitted":
        """Fit the means of a ``model`` over N(path, covariance), (T, D) and (T, D, D)."""
        model = model.to(dtype=torch.float64, device="cpu")
        transitions = _transitions(SharedMeans(model), path, covariance)
        emissions = _emissions(SharedMeans(model), path, covariance)
        return cls(observations.detach().cpu().double(), path, covariance, transitions, emissions)

    def linear(self, model: StateSpaceModel) -> Linearisation:
        """The linear model with the noise of ``model``, whose means are the same."""
        return _linear(model, self.observations, self.path, self.covariance, self.transitions, self.emissions)


def _about_mean(fits: Fits, emission: Distribution, observations: Tensor) -> Fits:
    """Rows E (…, T, O, D), e (…, T, O) and constants (…, T) of an ``emission`` along path, about its mean."""
    h, H, error = fits
    with torch.no_grad():
        whitening, constant = gaussian_rows(emission, observations)
        observations = explained(emission, observations)
    if whitening.ndim == H.ndim - 1:
        whitening = torch.diag_embed(whitening)
    # W R Wᵀ = I where seen; with the fit's error the noise is I + (W Ω^½)(W Ω^½)ᵀ.
    scaled = whitening @ error
    eye = torch.eye(scaled.shape[-2], dtype=scaled.dtype)
    tril = torch.linalg.cholesky(eye + scaled @ scaled.mT)
    whitening = torch.linalg.solve_triangular(tril, whitening, upper=False)
    constant = constant - torch.log(tril.diagonal(dim1=-2, dim2=-1)).sum(-1)
    residual = torch.where(torch.isnan(observations), 0.0, observations - h).unsqueeze(-1)
    return whitening @ H, (whitening @ residual).squeeze(-1), constant


@torch.no_grad()
def moved_means(model: StateSpaceModel, path: Tensor, covariance: Tensor) -> tuple[Tensor, Tensor]:
    """Whether means of transitions and of emissions, (B,) each, are other than the first of B parameter sets has.

    They are compared on both sides of ``path``, as far off as the cubature's points are: √D standard deviations.
    """
    rows = torch.arange(path.shape[-2])
    off = (path.shape[-1] * covariance.diagonal(dim1=-2, dim2=-1)).sqrt()
    sides = (path + off, path - off)
    keeps = keeps_noise(model, path, model.emission(path, rows))
    moved = _differ([gaussian_mean(model.transition(x[..., :-1, :], rows[1:])) for x in sides])
    return moved, _differ([emission_mean(model, x, rows) for x in sides]) if keeps else torch.ones_like(moved)


def _differ(values: Sequence[Tensor]) -> Tensor:
    """Which (B,) of B sets of values are other than the first."""
    return torch.stack([(each != each[:1]).flatten(1).any(1) for each in values]).any(0)


def _transitions(shared: SharedMeans, path: Tensor, covariance: Tensor) -> Fits:
    def mean(model: StateSpaceModel, x: Tensor, rows: Tensor) -> Tensor:
        return gaussian_mean(model.transition(x, rows))

    independent, _ = shared.model.independent_sensor_states or ([], [])
    rows = torch.arange(1, path.shape[-2])
    return shared.regressed(mean, rows, path[..., :-1, :], covariance[..., :-1, :, :], independent)


def _emissions(shared: SharedMeans, path: Tensor, covariance: Tensor) -> Fits:
    _, shown = shared.model.independent_sensor_states or ([], [])
    return shared.regressed(emission_mean, torch.arange(path.shape[-2]), path, covariance, shown)


def regress(
    function: Callable[[Tensor], Tensor],
    mean: Tensor,
    root: Tensor,
    independent: Sequence[int] = (),
    shown: Sequence[int] = (),
) -> tuple[Tensor, Tensor, Tensor]:
    """Linear fit over N(mean, root rootᵀ): value (…, P) at the mean, slope (…, P, D), error (…, P, D).

    ``root`` is of all arguments but the ``independent`` ones, each of which changes an entry of its own, ``shown``.
    """
    others = [k for k in range(mean.shape[-1]) if k not in set(independent)]
    dim = len(others)
    columns = root.mT.movedim(-2, 0) * dim**0.5  # (D, …, D)
    if independent:
        columns = columns.new_zeros(*columns.shape[:-1], mean.shape[-1]).index_copy(-1, torch.tensor(others), columns)
    with torch.no_grad():
        plus, minus = function(mean + columns), function(mean - columns)
    odd = (plus - minus).movedim(0, -1) / (2 * dim**0.5)
    even = (plus + minus) / 2
    average = even.mean(0)
    error = (even - average).movedim(0, -1) / dim**0.5
    slope = torch.linalg.solve_triangular(root, odd, upper=False, left=False)
    if not independent:
        return average, slope, error
    unit = mean.new_zeros(mean.shape[-1]).index_fill(0, torch.tensor(independent), 1.0)
    with torch.no_grad():
        change = (function(mean + unit) - function(mean - unit))[..., list(shown)] / 2
    whole = slope.new_zeros(*slope.shape[:-1], mean.shape[-1])
    whole[..., others] = slope
    whole[..., list(shown), list(independent)] = change
    return average, whole, error


def _root_of_others(covariance: Tensor, independent: Sequence[int]) -> Tensor:
    """What independent states add is linear: over them there is nothing to fit, and nothing of them in the rest."""
    others = [k for k in range(covariance.shape[-1]) if k not in set(independent)]
    whole = covariance[..., others, :][..., others] if independent else covariance
    shared = covariance.ndim > 3 and covariance.stride(0) == 0  # one of all parameter sets
    return _root(whole[:1]).expand_as(whole) if shared else _root(whole)


def _root(covariance: Tensor) -> Tensor:
    """Cholesky factor; a relative floor keeps directions without scatter differentiable."""
    diagonal = covariance.diagonal(dim1=-2, dim2=-1)
    scale = diagonal.clamp_min(1e-18).sqrt()
    correlation = covariance / (scale.unsqueeze(-1) * scale.unsqueeze(-2))
    eye = torch.eye(covariance.shape[-1], dtype=covariance.dtype)
    return scale.unsqueeze(-1) * torch.linalg.cholesky(correlation + 1e-10 * eye)


def _recentred(linear: Linearisation, shift: np.ndarray) -> Linearisation:
    before, after = shift[..., :-1, :], shift[..., 1:, :]
    return Linearisation(
        F=linear.F,
        a=linear.a + apply(linear.F, before) - after,
        L=linear.L,
        E=linear.E,
        e=linear.e - apply(linear.E, shift),
        m0=linear.m0 - shift[..., 0, :],
        log_constant=linear.log_constant,
        V=linear.V,
    )

"""A model along a path: linearised by tangents, and by what the path itself is off.

At a path x̄ the transition f and the emission h are

    x_{t+1} ≈ f(x̄_t) + F_t (x_t − x̄_t) + L w,     W_t (y_t − h(x̄_t) − H_t (x_t − x̄_t)) ~ N(0, I),

with slopes F and H by differences; rows of an emission whose noise depends on the state, or that is neither Gaussian
nor Student-t, are those of a Newton step on log g itself (:mod:`.newton_rows`). What the path itself is off,
a = f(x̄_t) − x̄_{t+1} and e = W (y − h(x̄)), takes a quarter of the work, and tells log p(x̄, y) exactly: it is all
that a search for a path needs of a step that it refuses.

Shapes: observations (T, O), path (…, T, D); the leading dimensions are many parameter sets of
one model, each with its own path. All in float64.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from invdyn.inference.smoothing.newton_rows import keeps_noise, newton_rows
from invdyn.inference.smoothing.square_root import log_abs_det
from invdyn.models.observation.missing import explained, gaussian_rows, times
from invdyn.models.state_space import StateSpaceModel, gaussian_mean, gaussian_moments

NUDGE, JUMP = 1e-6, 1e-6
"""Of every state for its slopes, in its standard deviations at the first row; and as it is, of a model with jumps."""
ONE_SIDED_FROM, ONE_SIDED_NUDGE, MIN_SD = 12, 3e-8, 0.1
"""States from which differences are one-sided: half of a work that grows with their square, for seven digits instead of
ten. The nudge is then near the root of float64's rounding, where that and curvature do equal harm, in standard
deviations that count as ``MIN_SD`` (rad, rad/s, N·m) at least."""
NUMBERS_AT_ONCE = 500_000
"""Of states, times D, at which a model is evaluated in one call."""


@dataclass
class Linearisation:
    """A model along a path, in deviations from it; shapes as in :mod:`.square_root`, plus constants (…).

    ``rows`` are what E and e were made of, if by tangents.
    """

    F: np.ndarray
    a: np.ndarray
    L: np.ndarray
    E: np.ndarray
    e: np.ndarray
    m0: np.ndarray
    log_constant: np.ndarray
    V: np.ndarray | None = None
    rows: "SeenRows | None" = None


def emission_mean(model: StateSpaceModel, state: Tensor, rows: Tensor) -> Tensor:
    """Location (…, T, O) of the emission along states (…, T, D)."""
    emission = model.emission(state, rows)
    return getattr(emission, "base_dist", emission).loc


def prior_chain(model: StateSpaceModel, path: Tensor, root: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Noise roots L (…, T, D, D) and prior mean m_0 − x̄_0 (…, D) of a model along ``path``.

    ``root`` (…, T−1, D, D) are the transitions', if the caller has them.
    """
    rows = torch.arange(path.shape[-2])
    batch, dim = path.shape[:-2], path.shape[-1]
    with torch.no_grad():
        mean, first = gaussian_moments(model.initial())
        if root is None:
            _, root = gaussian_moments(model.transition(path[..., :-1, :], rows[1:]))
    # Parameter sets carry a row axis of length one; a single set carries none.
    mean = mean.reshape(*mean.shape[:-1], 1, dim) if mean.ndim == 1 else mean
    first = first.reshape(1, dim, dim) if first.ndim == 2 else first
    root = root.expand(*batch, len(rows) - 1, dim, dim)
    L = torch.cat([first.expand(*batch, 1, dim, dim), root], -3)
    return L, (mean - path[..., :1, :]).squeeze(-2)


@dataclass
class SeenRows:
    """What is seen, whitened about where a path has it.

    Attributes:
        whitening: W, as :func:`.missing.gaussian_rows` has it.
        e: (…, T, O) by what rows are off, zero where missing.
        normaliser: (…, T) log densities where nothing is off.
        E: (…, T, D, D) rows of the state itself, and e (…, T, D), of emissions that no mean sums up
            (:mod:`.newton_rows`); None of all others.
    """

    whitening: Tensor
    e: np.ndarray
    normaliser: np.ndarray
    E: Tensor | None = None

    def on_state(self, H: Tensor) -> Tensor:
        """Rows (…, T, O, D) on the state; H (…, T, O, D) are the slopes of the emission's mean."""
        return times(self.whitening, H) if self.E is None else self.E

    @property
    def log_constant(self) -> np.ndarray:
        """(…): of all rows."""
        return self.normaliser.sum(-1)


@torch.no_grad()
def seen_rows(model: StateSpaceModel, path: Tensor, observations: Tensor) -> SeenRows:
    """What ``model`` says of ``observations`` (T, O) along ``path`` (…, T, D)."""
    emission = model.emission(path, torch.arange(path.shape[-2]))
    if not keeps_noise(model, path, emission):
        E, e, normaliser = newton_rows(model, path, observations)
        return SeenRows(torch.eye(path.shape[-1]).to(path), e.numpy(), normaliser.numpy(), E)
    whitening, constant = gaussian_rows(emission, observations)
    seen = explained(emission, observations)
    residual = torch.where(torch.isnan(seen), 0.0, seen - getattr(emission, "base_dist", emission).loc)
    return SeenRows(whitening, times(whitening, residual.unsqueeze(-1)).squeeze(-1).numpy(), constant.numpy())


@dataclass
class Deviations:
    """By what a path is off: fields of a :class:`Linearisation`."""

    a: np.ndarray
    L: np.ndarray
    m0: np.ndarray
    rows: SeenRows


@torch.no_grad()
def deviations(model: StateSpaceModel, path: Tensor, observations: Tensor) -> Deviations:
    """What ``model`` says of ``path`` (…, T, D), without slopes: a quarter or less of :func:`linearise`'s work."""
    transition = model.transition(path[..., :-1, :], torch.arange(1, path.shape[-2]))
    L, m0 = prior_chain(model, path, gaussian_moments(transition)[1])
    a = gaussian_mean(transition) - path[..., 1:, :]
    return Deviations(a.numpy(), L.numpy(), m0.numpy(), seen_rows(model, path, observations))


Slopes = tuple[Tensor, Tensor]
"""F (…, T−1, D, D) of the transition and H (…, T, O, D) of the emission along a path."""


@torch.no_grad()
def slopes_along(model: StateSpaceModel, path: Tensor, by_mean: bool = True) -> Slopes:
    """Slopes of ``model`` along ``path`` (…, T, D) by differences, which take a fraction of a backward pass's time.

    The emission's are those of its mean; empty, (…, T, 0, D), unless ``by_mean``.

    Central ones, of an error of ``NUDGE``²; one-sided ones from ``ONE_SIDED_FROM`` states on, and with
    ``contact_states``, which lie at stops.
    """
    rows = torch.arange(path.shape[-2])
    nudges, central = nudges_of(model)
    independent, shown = model.independent_sensor_states or ([], [])

    def emission(rows: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        return differences(lambda x: emission_mean(model, x, rows), x, nudges, independent, shown, central)

    def transition(rows: Tensor, x: Tensor) -> tuple[Tensor, Tensor]:
        mean = lambda x: gaussian_mean(model.transition(x, rows))  # noqa: E731
        return differences(mean, x, nudges, independent, independent, central)

    H = path.new_zeros(*path.shape[:-1], 0, path.shape[-1])
    if by_mean:
        H = over_rows(emission, rows, path)[1]
    if model.contact_states is not None:
        nudges, central = JUMP * torch.ones(path.shape[-1]).to(path), False
    return over_rows(transition, rows[1:], path[..., :-1, :])[1], H


def over_rows(function: Callable[..., Sequence[Tensor]], rows: Tensor, *pieces: Tensor) -> list[Tensor]:
    """What a ``function`` of ``rows`` (T,) and ``pieces``, states (…, T, D) first, has of all, by blocks of rows.

    It is called at the ends of D steps of each state: copies of a long recording would take most of the memory.
    """
    axis, dim = pieces[0].ndim - 2, pieces[0].shape[-1]
    size = max(1, NUMBERS_AT_ONCE * len(rows) // max(1, pieces[0].numel() * dim))
    blocks = zip(rows.split(size), *(each.split(size, axis) for each in pieces), strict=True)
    return [torch.cat(each, axis) for each in zip(*(function(*block) for block in blocks), strict=True)]


def nudges_of(model: StateSpaceModel) -> tuple[Tensor, bool]:
    """Steps (D,) of differences by the states' standard deviations at the first row, and whether they are central."""
    root, dim = gaussian_moments(model.initial())[1], model.state_dim
    scale = root.reshape(-1, dim, dim)[0].norm(dim=-1)
    central = dim < ONE_SIDED_FROM
    nudges = torch.where(scale > 0, scale, 1.0)
    return NUDGE * nudges if central else ONE_SIDED_NUDGE * nudges.clamp_min(MIN_SD), central


def differences(
    function: Callable[[Tensor], Tensor],
    x: Tensor,
    nudges: Tensor,
    independent: list[int],
    shown: list[int],
    central: bool,
) -> tuple[Tensor, Tensor]:
    """Values (…, P) of a batched function (…, D) → (…, P), up to ``nudges``² if central, and Jacobians (…, P, D).

    Jacobians are by ``nudges`` (D,) of one argument after the other. The ``independent`` ones are nudged all at once:
    each changes an entry of its own, which ``shown`` says.
    """
    others = [k for k in range(len(nudges)) if k not in set(independent)]
    steps = torch.diag(nudges)[others]
    if independent:
        steps = torch.cat(
            [steps, steps.new_zeros(1, len(nudges)).index_copy(1, torch.tensor(independent), nudges[independent][None])]
        )
    steps = steps.reshape(-1, *[1] * (x.ndim - 1), x.shape[-1])
    values = function(x + torch.cat([steps, -steps if central else torch.zeros_like(steps[:1])]))
    up, down = values[: len(steps)], values[len(steps) :]
    change, value = (up - down) / (1 + central), (up[0] + down[0]) / 2 if central else down[0]
    own = (change[: len(others)] / nudges[others].reshape(-1, *[1] * x.ndim)).movedim(0, -1)
    if not independent:
        return value, own
    slopes = own.new_zeros(*own.shape[:-1], len(nudges))
    slopes[..., others] = own
    slopes[..., shown, independent] = change[-1][..., shown] / nudges[independent]
    return value, slopes


def linearise(
    model: StateSpaceModel,
    path: Tensor,
    observations: Tensor,
    known: Deviations | None = None,
    slopes: Slopes | None = None,
) -> Linearisation:
    """Linearise ``model`` along ``path`` (…, T, D) by tangents; ``known`` are its :func:`deviations` there.

    Or with the ``slopes`` of a model that is nearly the same along a path that is.
    """
    here = known or deviations(model, path, observations)
    slopes = slopes or slopes_along(model, path, here.rows.E is None)
    F, H = (each.expand(*path.shape[:-2], *each.shape[-3:]) for each in slopes)
    E = here.rows.on_state(H).numpy()
    return Linearisation(F.numpy(), here.a, here.L, E, here.rows.e, here.m0, here.rows.log_constant, rows=here.rows)


def seen_as(linear: Linearisation, rows: SeenRows, H: Tensor) -> Linearisation:
    """``linear`` of a model with the same transitions, with observations ``rows`` of slopes H (…, T, O, D)."""
    E = rows.on_state(H).numpy()
    return replace(linear, E=E, e=rows.e, log_constant=rows.log_constant, rows=rows)


def log_joint(here: Deviations) -> np.ndarray:
    """Log p(x̄, y) (…) of a path: exact, not linearised."""
    driven = np.concatenate([here.m0[..., None, :], here.a], -2)
    still = np.diagonal(here.L, axis1=-2, axis2=-1) == 0
    with np.errstate(all="ignore"):  # a path may have run away, or have no density
        own = np.linalg.solve(here.L + still[..., None] * np.eye(driven.shape[-1]), driven[..., None])[..., 0]
        squares = (own**2).sum((-2, -1)) + (here.rows.e**2).sum((-2, -1))
        volume = log_abs_det(here.L).sum(-1) + 0.5 * math.log(2 * math.pi) * driven.shape[-2] * driven.shape[-1]
        return np.where(still.any((-2, -1)), -np.inf, here.rows.log_constant - volume - 0.5 * squares)

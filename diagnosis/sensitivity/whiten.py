"""Data and columns, whitened about a path for every size of the residual torque.

One Kalman pass (:mod:`.innovations`) under the model linearised about the path. Sizes are those of the recording's
regime (:mod:`.regime`).

Shapes: T rows, D states, O observations, J columns, G sizes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.innovations import Gains, gains, innovations
from invdyn.diagnosis.sensitivity.sensitivities import Columns
from invdyn.inference.smoothing.linearisation import Linearisation, Slopes, linearise
from invdyn.inference.smoothing.square_root import square
from invdyn.models import ArmModel
from invdyn.models.observation.missing import times


@dataclass(frozen=True)
class Whitened:
    """Data and columns, whitened for every size.

    Attributes:
        sizes: (G,) of the residual.
        gram: (G, 1 + J, 1 + J).
        row_log_det: (G, T) ½ log |S_t|, less the observations' own normaliser.
        seen: (T,) observations seen in each row.
        columns: (G, rows that were seen · O, 1 + J).
        follows: (rows that were seen · O,) whether the same was seen in the row before, so that its error may be
            remembered.
    """

    sizes: np.ndarray
    gram: np.ndarray
    row_log_det: np.ndarray
    seen: np.ndarray
    columns: np.ndarray
    follows: np.ndarray

    @property
    def width(self) -> int:
        """O."""
        return len(self.follows) // max(int((self.seen > 0).sum()), 1)

    @property
    def log_det(self) -> np.ndarray:
        """(G,): with it the regression's evidence is that of the data, not of whitened rows."""
        return self.row_log_det.sum(-1)

    @property
    def count(self) -> int:
        """Observations seen."""
        return int(self.seen.sum())


def linear_of(problem: DiagnosisProblem, model: ArmModel, path: Tensor, slopes: Slopes | None = None) -> Linearisation:
    """``model`` linearised about ``path``, with a residual of size one, where it begins, too.

    With ``slopes`` that are known, if they are.
    """
    known = {name: torch.zeros_like(sd) for name, sd in problem.initial_scale.items()}
    return linearise(problem.with_residual(1.0, model).replace(**known), path, problem.observations, slopes=slopes)


@dataclass(frozen=True)
class Filter:
    """The Kalman filter of a model linearised about a path, for every size.

    Attributes:
        sizes: (G,) of the residual.
        linear: the model about the path.
        gained: the filter's gains.
    """

    sizes: np.ndarray
    linear: Linearisation
    gained: Gains

    def at(self, number: int) -> "Filter":
        """For one of the sizes alone."""
        one = slice(number, number + 1)
        gained = Gains(self.gained.whitening[:, one], self.gained.gain[:, one], self.gained.log_det[one])
        return Filter(self.sizes[one], self.linear, gained)


def filter_of(
    problem: DiagnosisProblem, model: ArmModel, path: Tensor, levels: np.ndarray, linear: Linearisation | None = None
) -> Filter:
    """The filter of ``model`` about ``path`` (T, D); ``linear`` is what :func:`linear_of` gives."""
    problem.budget.spend(FIXED.linearise_cost * (linear is None) + len(levels) * FIXED.filter_cost, model, len(path))
    linear = linear or linear_of(problem, model, path)
    joints = model.body.num_joints
    scale = np.ones((len(levels), model.state_dim))
    scale[:, :joints] = levels[:, None]
    covariance = square(scale[:, None, :, None] * linear.L)
    for sd in problem.initial_scale.values():
        covariance[:, [0, *problem.starts], :joints, :joints] += np.diag(sd.numpy() ** 2)
    late = model.replace(**problem.initial_scale).late(torch.arange(1, len(path))) if problem.initial_scale else None
    if late is not None:
        ahead = np.setdiff1d(np.arange(1, len(path)), problem.starts)
        covariance[:, ahead[:, None], np.arange(joints), np.arange(joints)] += late.numpy()[ahead - 1] ** 2
    filtered = gains(linear.F, covariance[:, 1:], linear.E, covariance[:, 0])
    return Filter(levels, linear, filtered)


def products(
    problem: DiagnosisProblem, about: Filter, columns: Columns, groups: Sequence[slice] | None = None
) -> Whitened:
    """What :func:`whiten` gives, and of many numbers the products alone: whitened for one size after the other."""
    count = len(about.sizes) * columns.d.shape[0] * columns.d.shape[1] * (1 + columns.d.shape[2])
    if count <= FIXED.max_whitened:
        return whiten(problem, about, columns, groups)
    gram = np.concatenate([whiten(problem, about.at(g), columns, groups).gram for g in range(len(about.sizes))])
    none = replace(columns, g=columns.g[..., :0], d=columns.d[..., :0])
    return replace(whiten(problem, about, none), gram=gram)


def whiten(
    problem: DiagnosisProblem, about: Filter, columns: Columns, groups: Sequence[slice] | None = None
) -> Whitened:
    """Whiten the data and ``columns`` by a filter.

    Of thousands of columns not all products are wanted: those within ``groups``, which are numbered as the Gram matrix
    is, from 1 on; and those with the data and with columns behind all groups.
    """
    linear, levels = about.linear, about.sizes
    if linear.rows is None:
        raise TypeError("expected a linearisation by tangents, got one over a posterior")
    w = innovations(
        about.gained,
        linear.F,
        linear.a,
        linear.E,
        linear.e,
        linear.m0,
        columns.g,
        times(linear.rows.whitening, torch.as_tensor(columns.d)).numpy(),
    )
    seen = (~torch.isnan(problem.observations)).numpy()
    rows_seen = seen.any(-1)
    if not rows_seen.all():
        w = w[:, rows_seen.repeat(seen.shape[-1])]
    # The regression counts −½ log 2π for each observation, as the normaliser does.
    row_log_det = about.gained.log_det - linear.rows.normaliser - 0.5 * np.log(2 * np.pi) * seen.sum(-1)
    follows = _follows(problem, seen)[rows_seen].ravel()
    return Whitened(levels, _gram(w, groups), row_log_det, seen.sum(-1), w, follows)


def _follows(problem: DiagnosisProblem, seen: np.ndarray) -> np.ndarray:
    """Of what was ``seen`` (T, O) that which was seen in the row before, too, at the usual distance.

    Nothing where the torque is unknown: a limb's own may be smoother than its prior, and correlate errors by that.
    """
    apart = problem.model.dt[: len(seen)].numpy()
    near = (apart < problem.rules.residual.max_interval_ratio * np.median(apart)) & problem.regime.knows_torque
    near[[0, *problem.starts]] = False
    return seen & np.roll(seen, 1, axis=0) & near[:, None]


@np.errstate(over="ignore", invalid="ignore")  # A column that runs away is one that :mod:`.evidence` leaves out.
def _gram(w: np.ndarray, groups: Sequence[slice] | None) -> np.ndarray:
    """Products (G, J, J) of columns (G, N, J), those that are wanted."""
    if not groups:
        return np.swapaxes(w, -1, -2) @ w
    count = w.shape[-1]
    gram = np.zeros((len(w), count, count))
    common = np.r_[0, max(group.stop for group in groups) : count]
    gram[:, common] = np.swapaxes(w[..., common], -1, -2) @ w
    gram[:, :, common] = np.swapaxes(gram[:, common], -1, -2)
    for group in groups:
        part = w[..., group]
        gram[:, group, group] = np.swapaxes(part, -1, -2) @ part
    return gram

"""Which shape an effect has: the one with which its columns explain most besides those of other effects.

With y what is missing, X the other columns under the weights W and the prior N(0, Λ⁻¹), C = (XᵀWX + Λ)⁻¹, and Λ_z that
of an effect's columns Z, these explain

    g = ½ bᵀ S⁻¹ b,     b = Zᵀ W (y − X C XᵀWy),     S = Λ_z + Zᵀ (W − W X C Xᵀ W) Z

nats of rows that are independent (variable projection: Golub & Pereyra 1973; Kaufman 1975). First X has what a robot's
file usually lacks, at all places, and Z each shape of a coarse grid. Of effects that were chosen the grid is a fine
one, and X what was chosen besides: with one row of τ that counts, a shape ψ has the probability e^{g(ψ)/τ}.

Shapes: R rows, K joints, P columns, p of them in X, n of an effect. Units: rad, s, N·m.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from invdyn.diagnosis.catalogue.linear_laws import INERTIAL, USUAL
from invdyn.diagnosis.regression.columns import Columns
from invdyn.diagnosis.regression.linear_effects import LinearEffects
from invdyn.diagnosis.regression.low_pass import low_passed
from invdyn.diagnosis.regression.shaped_effects import Along, Shape, Shaped, lowest, sizes_of
from invdyn.diagnosis.regression.weighted_fit import Fitted, correlation_times, left_by
from invdyn.diagnosis.rules import FIXED

Shapes = Mapping[tuple[str, str], Shape]
"""By effect and joint."""


def first_shapes(
    shaped: Sequence[Shaped], along: Along, known: LinearEffects, fit: Fitted, factor: np.ndarray
) -> Shapes:
    """Of each effect the shape of its coarse grid that explains most beside all usual effects.

    ``known`` are these effects' columns, and ``factor`` (K,) is that of :func:`.linear_effects.linear_effects`.
    """
    usual = known.free & known.columns.moving & np.isin(known.kinds, (*USUAL, INERTIAL))
    context = _context(known, fit, np.flatnonzero(usual))
    found = {}
    for each in shaped:
        explained = partial(_explained, context, each, along, known, factor)
        value = each.grid[int(np.argmax([explained(shape)[0] for shape in each.grid]))]
        found[each.key] = Shape(_settled(each, explained, value), len(each.grid))
    return found


def nearer_shapes(
    shaped: Sequence[Shaped], along: Along, known: LinearEffects, fit: Fitted, factor: np.ndarray
) -> Shapes | None:
    """The shapes again, as near as the rows tell at joints where a fit chose any; None where those chosen stay."""
    times = correlation_times(left_by(known, fit.chosen), along.motion.stretch)
    keys = {each.key: each.joint for each in shaped}
    own = [(p, keys.get((known.kinds[p], known.places[p]))) for p in fit.chosen.columns]
    found = dict(known.shapes)
    for joint in {joint for _, joint in own} - {None}:
        context = _context(known, fit, np.array([p for p, k in own if k != joint], dtype=int))
        for each in (each for each in shaped if each.joint == joint):
            explained = partial(_explained, context, each, along, known, factor)
            value, count = found[each.key].value, found[each.key].count
            if each.is_size:
                found[each.key] = Shape(_settled(each, explained, value), count)
                continue
            grid = each.near(value)
            gains = np.array([explained(v)[0] for v in grid.tolist()])
            share = np.exp((gains - gains.max()) / times[joint])
            share /= share.sum()
            mean = float(share @ grid)
            low, high = (float(np.interp(q, share.cumsum(), grid)) for q in (0.05, 0.95))
            found[each.key] = Shape(mean, count, float(np.sqrt(share @ (grid - mean) ** 2)), (low, high))
    there = {(known.kinds[p], known.places[p]) for p in fit.chosen.columns} & found.keys()
    moved = [abs(found[key].value / known.shapes[key].value - 1) for key in there]
    return found if max(moved, default=0.0) > FIXED.equal_shape else None


def _settled(shaped: Shaped, explained: Callable[[float], tuple[float, np.ndarray]], value: float) -> float:
    """A number that is its effect's shape, by secants: the coefficient of τ(λ)/λ is λ where both agree."""
    least, most = FIXED.finest_shape * min(shaped.grid), max(shaped.grid)
    for _ in range(FIXED.shape_passes if shaped.is_size and shaped.shape.grid else 0):
        value = float(np.clip(explained(value)[1][0], least, most))
    return value


def _context(known: LinearEffects, fit: Fitted, columns: np.ndarray) -> "Context":
    weights = fit.weights / np.maximum(fit.chosen.noise, 1e-300) ** 2
    return Context(known.columns, columns, known.size, known.missing, weights)


def _explained(
    context: "Context", shaped: Shaped, along: Along, known: LinearEffects, factor: np.ndarray, value: float
) -> tuple[float, np.ndarray]:
    """Nats of an effect with a shape, and its coefficients (n,)."""
    Z = np.stack([column.numpy() for column in along.columns(shaped, value)])
    if shaped.of_command:
        Z = Z * known.usable / factor
    Z = low_passed(Z, along.motion, known.cutoff)
    gain, values = context.explains(Z, sizes_of(Z, known.unit))
    least = np.array([lowest(each) for each in shaped.sizes])
    return (gain if (values >= least).all() else 0.0), values


class Context:
    """What columns of effects leave, and what further ones explain of it.

    Args:
        columns: of P effects, p of them ``chosen``, whose sds of a prior are ``size`` (P,).
        missing: (R, K) N·m; ``weights`` (R, K) of it, 1/(N·m)².
    """

    def __init__(
        self, columns: Columns, chosen: np.ndarray, size: np.ndarray, missing: np.ndarray, weights: np.ndarray
    ):
        self.weights, place = weights, np.full(columns.number, -1)
        place[chosen] = np.arange(len(chosen))
        mine = [place[at] >= 0 for at in columns.at]
        self.at = [place[at[own]] for at, own in zip(columns.at, mine, strict=True)]
        self.weighted = [X[own] * w for X, own, w in zip(columns.values, mine, weights.T, strict=True)]
        A, cross = np.diag(1 / size[chosen] ** 2), np.zeros(len(chosen))
        for X, own, Xw, at, y in zip(columns.values, mine, self.weighted, self.at, missing.T, strict=True):
            A[np.ix_(at, at)] += Xw @ X[own].T
            cross[at] += Xw @ y
        self.unit = np.sqrt(np.diag(A))
        self.inverse = np.linalg.pinv(A / self.unit[:, None] / self.unit, hermitian=True)
        values = self.inverse @ (cross / self.unit) / self.unit
        self.left = weights * (missing - columns.torque(chosen, values))

    def explains(self, Z: np.ndarray, size: np.ndarray) -> tuple[float, np.ndarray]:
        """Nats g of columns (n, R, K) with sds (n,) of a prior, of rows that are independent; coefficients (n,)."""
        M = np.zeros((len(self.unit), len(Z)))
        for k, (X, at) in enumerate(zip(self.weighted, self.at, strict=True)):
            M[at] += X @ Z[:, :, k].T
        M /= self.unit[:, None]
        S = np.einsum("nrk,mrk->nm", Z * self.weights, Z, optimize=True) - M.T @ self.inverse @ M + np.diag(1 / size**2)
        b = np.einsum("nrk,rk->n", Z, self.left)
        values = np.linalg.solve(S, b)
        return 0.5 * float(b @ values), values

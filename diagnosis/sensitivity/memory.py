"""Memory of the observations' error from row to row, integrated out: the discrepancy on the side of what is seen.

A tracker smooths, or takes the last frame along: its error in a row is like that in the row before. Whitened errors of
prediction are then an autoregressive process of first order (Box, Jenkins & Reinsel 2008, §3.2),

    w_t = m w_{t−1} + √(1 − m²) n_t,    n_t ~ N(0, κ² I),

with one m for all observations. Errors are linear in a cause's parameters, w = w₀ + Aφ, and so is what a known memory
leaves of them, (w_t − m w_{t−1}) / √(1 − m²). Its products follow from those of neighbouring rows. Memory has a spike
and a slab, as the residual torque has (Kennedy & O'Hagan 2001):

    P(m = 0) = ½,    p(m) = ½/M on (0, M)

The slab's integral is that of a Gaussian about the correlation of neighbouring errors, of variance (1 − m²)/n.

Shapes: G sizes of the residual, J columns, n errors that follow another one.
"""

from dataclasses import dataclass, replace

import numpy as np

from invdyn.diagnosis.problem.unknowns import Unknowns
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.diagnosis.sensitivity.evidence import Regression, regression
from invdyn.diagnosis.sensitivity.whiten import Whitened


@dataclass(frozen=True)
class Expansion:
    """Evidence of one candidate about a point, and its parameters, for one size of the residual.

    Attributes:
        log_evidence: parameters and memory integrated out.
        mean, covariance: (p,), (p, p) of the parameters, from the point on, under the most probable memory.
        kappa: factor on the noise.
        memory: the most probable one.
        gain: nats of ``log_evidence`` that are due to it.
    """

    log_evidence: float
    mean: np.ndarray
    covariance: np.ndarray
    kappa: float
    memory: float
    gain: float


def expansions(whitened: Whitened, among: Unknowns, point: np.ndarray, rules: Rules = DEFAULT) -> list[Expansion]:
    """Regression on all unknowns' columns, expanded about ``point`` (p,), for each size."""
    index = np.arange(1, len(point) + 1)[None]
    prior = (among.mean - point)[None], among.sd[None], (among.lower - point)[None], (among.upper - point)[None]
    after = np.flatnonzero(whitened.follows)

    def at(gram: np.ndarray, log_det: float) -> Regression:
        return regression(gram, index, np.zeros(1, int), *prior, whitened.count, log_det)

    found, limit = [], rules.residual.max_memory
    for gram, log_det, columns in zip(whitened.gram, whitened.log_det, whitened.columns, strict=True):
        white = best = at(gram, log_det)
        late, early = columns[after], columns[after - whitened.width]
        memory, slab = _correlation(late, early, white.mean[0], limit), -np.inf
        spike = float(white.log_evidence[0]) + np.log(0.5)
        if 0.5 * len(after) * memory**2 > rules.residual.min_memory_gain:
            left = _forgotten(late, early, memory)
            best = at(gram - late.T @ late + left.T @ left, log_det + len(after) * _log_det(memory))
            width = np.sqrt(2 * np.pi * (1 - memory**2) / len(after))
            slab = float(best.log_evidence[0]) + np.log(0.5 * width / limit)
        if not slab > spike:
            best, memory = white, 0.0
        total = float(np.logaddexp(spike, slab))
        gain = total - float(white.log_evidence[0])
        found.append(Expansion(total, best.mean[0], best.covariance[0], float(best.kappa[0]), memory, gain))
    return found


def forgotten(whitened: Whitened, memory: float) -> Whitened:
    """What is left where the errors' ``memory`` is known."""
    if memory == 0.0:
        return whitened
    after = np.flatnonzero(whitened.follows)
    columns = whitened.columns.copy()
    columns[:, after] = _forgotten(columns[:, after], columns[:, after - whitened.width], memory)
    row_log_det = whitened.row_log_det.copy()
    row_log_det[:, whitened.seen > 0] += _log_det(memory) * whitened.follows.reshape(-1, whitened.width).sum(-1)
    gram = np.swapaxes(columns, -1, -2) @ columns
    return replace(whitened, gram=gram, row_log_det=row_log_det, columns=columns)


def _forgotten(late: np.ndarray, early: np.ndarray, memory: float) -> np.ndarray:
    """Errors without what they remember of the ``early`` ones."""
    return (late - memory * early) / np.sqrt(1 - memory**2)


def _log_det(memory: float) -> float:
    """What a memory adds to ½ log |S| of an error that follows another one."""
    return 0.5 * float(np.log1p(-(memory**2)))


def _correlation(late: np.ndarray, early: np.ndarray, mean: np.ndarray, limit: float) -> float:
    """Of neighbouring errors (n,) where the parameters are ``mean`` (J,), from columns (n, 1 + J); 0 to ``limit``."""
    one, other = (columns @ np.r_[1.0, mean] for columns in (late, early))
    size = float(np.sqrt((one @ one) * (other @ other)))
    return float(np.clip(one @ other / size, 0.0, limit)) if 0 < size < np.inf else 0.0

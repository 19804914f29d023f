"""How similarly two effects change a recording: the squared cosine between their predicted changes, whitened.

Along the path of the first screen (:mod:`.screen`) an effect with columns A, and what it adds as it is, b, explains of
the whitened data r

    v = b − A (AᵀA + S⁻²)⁻¹ Aᵀ (r + b),        overlap = (v₁ᵀ v₂)² / (|v₁|² |v₂|²),

with its parameters' prior N(0, S²) about where they are expanded, hardly any residual torque, and what the body's
uncertain numbers could do taken out of all. At 1 only priors tell the two apart.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from invdyn.diagnosis.assessment.findings import key
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import Added, Screened, added, stacked
from invdyn.diagnosis.sensitivity.sensitivities import slopes
from invdyn.diagnosis.sensitivity.whiten import filter_of, linear_of, whiten


def change(problem: DiagnosisProblem, screened: Added) -> np.ndarray:
    """What an effect explains of the whitened data, (N,)."""
    model, path, best = problem.model, screened.path, screened.best
    levels, common = np.array([problem.rules.residual.spike_size]), unknowns(problem, ())
    about = filter_of(problem, model, path, levels, linear_of(problem, model, path))
    body = slopes(model, common, common.mean, problem.rules.screening.slope_step * common.sd, path)
    columns = whiten(problem, about, stacked([screened.columns, body])).columns[0]
    offset, free = int(best.offset is not None), len(best.free)
    basis, _ = np.linalg.qr(columns[:, 1 + offset + free :])
    columns = columns - basis @ (basis.T @ columns)
    A = columns[:, 1 + offset : 1 + offset + free]
    b = columns[:, 1] if offset else np.zeros(len(columns))
    precision = 1 / np.square(best.sd)
    return b - A @ np.linalg.solve(A.T @ A + np.diag(precision), A.T @ (columns[:, 0] + b))


def overlaps(
    problem: DiagnosisProblem, rivals: Sequence[str], first: Sequence[Screened]
) -> tuple[tuple[str, str, float], ...]:
    """Of every two of the rivals' keys, (one, other, overlap); of those alone that the first screen had as one effect.

    Two that it followed along different paths are compared each along its own.
    """
    found = {key(s.effect): s for s in added(first)}
    changed = {name: change(problem, found[name]) for name in rivals if name in found}
    return tuple((one, other, _overlap(changed[one], changed[other])) for one, other in combinations(changed, 2))


def _overlap(one: np.ndarray, other: np.ndarray) -> float:
    size = float(one @ one) * float(other @ other)
    return float(one @ other) ** 2 / size if 0 < size < np.inf else 0.0

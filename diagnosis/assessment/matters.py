"""Whether a gap matters: more torque than a stated tolerance, or than another engine's integration errs by.

A share of each joint's typical torque is the tolerance. A simulator that takes first-order steps, as engines do, errs
in an acceleration by half of what that changes in one step of h seconds (Hairer, Nørsett & Wanner 1993, §II.3),

    |τ_k| ≲ I_k h/2 |d³θ_k/dt³|,        h = 2 ms, or as short as rows are, I_k the inertia that joint k carries,

and that, too, is no gap. The third derivative is the motion's, of cubics through a tenth of a second of its velocity
(Savitzky & Golay 1964). From row to row a path is as rough as the torque that the simulation lacks. A gap may not raise
the tolerance that it is compared with.

A torque counts as large as it is in its worst second: a push is over soon. Where errors exceed their noise with any
torque, or only the noise itself differs, no torque decides, and the gap matters. An unknown torque
has no tolerance.

Shapes: T rows, K joints.
"""

import numpy as np
from torch import Tensor

from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_noise
from invdyn.diagnosis.rules import FIXED


def tolerated(problem: DiagnosisProblem, path: Tensor) -> np.ndarray:
    """Torques (K,) N·m that need no cause, along ``path`` (T, D)."""
    model, rules = problem.model, problem.rules.evidence
    time, velocity = model.time.numpy(), path[:, -model.body.num_joints :].numpy()
    starts = [*problem.starts]
    stretches = zip(np.split(time, starts), np.split(velocity, starts), strict=True)
    jerk = np.concatenate([_jerk(*stretch) for stretch in stretches])
    step = min(rules.engine_error_step, float(np.median(np.diff(time))))
    own = model.dynamics.typical_inertia(model.scale.body).numpy() * step / 2 * np.sqrt((jerk**2).mean(0))
    return np.maximum(rules.tolerance * np.array(model.scale.torque), own)


def _jerk(time: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """The second derivative (…, K) rad/s³ of a velocity (T, K), on an even grid of its own."""
    from scipy.signal import savgol_filter  # a third of a second to import, which a fit does not need

    first, last = float(time[0]), float(time[-1])
    count = max(round((FIXED.jerk_points - 1) * (last - first) / FIXED.jerk_span) + 1, FIXED.jerk_points)
    even, step = np.linspace(first, last, count, retstep=True)
    columns = [np.interp(even, time, column) for column in velocity.T]
    return savgol_filter(np.stack(columns, -1), FIXED.jerk_points, 3, deriv=2, delta=step, axis=0)


def matters(
    problem: DiagnosisProblem, none: FittedHypothesis, best: FittedHypothesis, missing: np.ndarray, limit: np.ndarray
) -> bool:
    """Whether the torque ``missing`` (T, K) without a cause exceeds a ``limit`` (K,), or another sign says so."""
    unexplained = none.kappa > problem.rules.residual.max_error_ratio
    if unexplained or not problem.regime.knows_torque or any(is_noise(effect) for effect in best.effects):
        return True
    rows = max(round(problem.rules.evidence.worst_window / float(problem.model.dt[1:].median())), 1)
    rows = min(rows, len(missing))
    total = np.concatenate([np.zeros((1, missing.shape[1])), (missing**2).cumsum(0)])
    worst = np.sqrt((total[rows:] - total[:-rows]).max(0) / rows)
    return bool((worst > limit).any())

"""Whether a gap matters: more torque than a stated tolerance, or than another engine's integration errs by.

A share of each joint's typical torque is the tolerance. A simulator that takes first-order steps, as engines do, errs
in an acceleration by half of what that changes in one step of h seconds (Hairer, Nørsett & Wanner 1993, §II.3),

    |τ_k| ≲ I_k h/2 |d³θ_k/dt³|,        h = 2 ms, or as short as rows are, I_k the inertia that joint k carries,

and that, too, is no gap. A torque counts as large as it is in its worst second: a push is over soon. Where detections
are louder than their noise whatever the torque does, or only the noise itself is otherwise, no torque tells, and the
gap matters. An unknown torque has no tolerance.

Shapes: T rows, K joints.
"""

import numpy as np
from torch import Tensor

from invdyn.diagnosis.decision import RULE
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_noise


def tolerated(problem: DiagnosisProblem, path: Tensor, share: float = RULE.tolerance) -> np.ndarray:
    """Torques (K,) N·m that nobody need explain, along ``path`` (T, D)."""
    model = problem.model
    time, velocity = model.time.numpy(), path[:, -model.body.num_joints :].numpy()
    jerk = np.gradient(np.gradient(velocity, time, axis=0), time, axis=0)
    step = min(RULE.step, float(np.median(np.diff(time))))
    own = model.dynamics.typical_inertia(model.scale.body).numpy() * step / 2 * np.sqrt((jerk**2).mean(0))
    return np.maximum(share * np.array(model.scale.torque), own)


def matters(
    problem: DiagnosisProblem, none: FittedHypothesis, best: FittedHypothesis, missing: np.ndarray, limit: np.ndarray
) -> bool:
    """Whether the torque ``missing`` (T, K) without a cause exceeds a ``limit`` (K,), or another sign says so."""
    if problem.regime == "unknown_torque" or none.kappa > RULE.loud or any(is_noise(effect) for effect in best.effects):
        return True
    rows = max(round(RULE.worst / float(problem.model.dt[1:].median())), 1)
    rows = min(rows, len(missing))
    total = np.concatenate([np.zeros((1, missing.shape[1])), (missing**2).cumsum(0)])
    worst = np.sqrt((total[rows:] - total[:-rows]).max(0) / rows)
    return bool((worst > limit).any())

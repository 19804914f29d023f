"""A cause on another recording of the same arm: its path there, and whether it leaves something there.

Its parameters' posterior is the prior there, N(μ, LLᵀ). The path is whichever of a few has the highest predictive
score (:mod:`.predict`), under the residual that the first recording needs. With one-step prediction errors w_s of each
size s of the residual (:mod:`.whiten`), linear in z ~ N(0, I), and an unknown noise scale, evidence by size is that of
a regression (:mod:`.evidence`). A cause that explained the first recording, and for which a residual gains
evidence here beyond chance (:func:`.pool.leaves`), imitated there what else was at work: two recordings move otherwise.

No camera sees how many whole turns a joint has made, but a spring, a cable and a stop depend on it: what is at rest at
−3.5 rad in one recording is at 2.8 rad in another whose angles begin in the next turn.

Shapes: T rows, D states.
"""

import math
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from invdyn.diagnosis.budget import attempt
from invdyn.diagnosis.hypotheses.continuation import continued, lifted
from invdyn.diagnosis.hypotheses.pool import leaves
from invdyn.diagnosis.prediction.predict import posterior_columns, scores, whitened
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import CannotFollow, DiagnosisProblem
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.evidence import regression
from invdyn.diagnosis.sensitivity.memory import forgotten
from invdyn.inference.smoothing.gauss_newton import gauss_newton_path


def carried(
    problem: DiagnosisProblem, cause: FittedHypothesis, other: DiagnosisProblem, start: Tensor
) -> FittedHypothesis:
    """``cause``, found in ``problem``, with its model and path on another recording.

    ``start`` (T, D) is the other recording's data path (:func:`.continuation.data_path`).
    Gauss–Newton by itself may end in a poor one, and so may a homotopy; where joints stick, also one after the
    other. Raises CannotFollow where no path can be followed.
    """
    model, size = cause.carried_to(other), best_size(problem, cause)
    steps, tolerance = other.rules.descent.transfer_steps, other.rules.descent.path_tolerance
    rows, seen = np.ones(len(start), bool), other.observations.isfinite().any(-1).numpy()

    def along(first: FittedHypothesis, *, by_itself: bool) -> FittedHypothesis:
        start = first.path if by_itself else continued(other, first.model, first.path, size)
        quiet = other.with_residual(max(size, other.min_size), first.model)
        return replace(first, path=gauss_newton_path(quiet, other.observations, start, steps, tolerance))

    def score(there: FittedHypothesis | None) -> float:
        found = None if there is None else attempt(scores, other, there, rows)
        total = np.nan if found is None else found.score[seen].sum()
        return float(total) if np.isfinite(total) else -np.inf

    first = replace(cause, model=model, path=lifted(model, start))
    starts = [first, *whole_turns_away(first)]
    tried = [attempt(along, each, by_itself=True) for each in starts]
    best = int(np.argmax([score(each) for each in tried])) if len(tried) > 1 else 0
    first, own = starts[best], tried[best]
    tried = [own, attempt(along, first, by_itself=False)]
    if model.effects.abrupt and own is not None:
        tried.append(attempt(along, own, by_itself=False))
    worth = [score(each) for each in tried]
    there = tried[int(np.argmax(worth))]
    if there is None or not np.isfinite(worth).any():
        raise CannotFollow(
            f"{other.problem.recording.name}: body {model.body.name!r} cannot follow it, even with torque of its own "
            "at each joint: hold out a calmer recording of the same arm, or none"
        )
    return there


@torch.no_grad()
def whole_turns_away(there: FittedHypothesis) -> list[FittedHypothesis]:
    """A cause on a recording, a whole turn of one joint away, either way, where its torques tell, and no encoder does.

    None where it is all the same to them, as it is to gravity and friction.
    """
    model, path, found = there.model, there.path, list[FittedHypothesis]()
    if model.observation.encoders:
        return found
    rows, joints = torch.arange(len(path)), model.body.num_joints
    after = model.transition_mean(path, rows)
    for turn in math.tau * torch.eye(joints, dtype=path.dtype):
        step = torch.cat([path.new_zeros(path.shape[-1] - 2 * joints), turn, torch.zeros_like(turn)])
        if not torch.allclose(model.transition_mean(path + step, rows) - step, after, rtol=0.0, atol=FIXED.negligible):
            begin = model.parameters["initial.angle"]
            found += [
                replace(there, model=model.replace(**{"initial.angle": begin + way * turn}), path=path + way * step)
                for way in (1, -1)
            ]
    return found


def leaves_there(other: DiagnosisProblem, none: FittedHypothesis, cause: FittedHypothesis) -> bool:
    """Whether a cause leaves something beyond chance on another recording, to which both were carried."""
    # What happened at some moment of the first recording does not happen in another.
    if any(other.catalogue.of(effect).per_recording for effect in cause.effects):
        return False
    there, without = (replace(each, by_size=_by_size(other, each)) for each in (cause, none))
    return leaves(there, without, other.regime, other.rules)


def _by_size(other: DiagnosisProblem, there: FittedHypothesis) -> np.ndarray:
    """Log evidence (G,) of another recording's rows and each size of the residual."""
    levels = other.regime.sizes
    rows = forgotten(whitened(other, there, levels, posterior_columns(other, there)), there.memory)
    p = len(there.mean)
    index, unit, far = np.arange(1, p + 1)[None], np.ones((1, p)), np.full((1, p), np.inf)
    found = [
        regression(gram, index, np.zeros(1, int), 0.0 * unit, unit, -far, far, rows.count, log_det).log_evidence[0]
        for gram, log_det in zip(rows.gram, rows.log_det, strict=True)
    ]
    return np.array(found) + other.regime.log_prior

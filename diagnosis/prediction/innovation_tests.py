"""What is left in a cause's errors of prediction: correlation, direction, size, or outliers that come together.

Whitened one-step prediction errors w_t of a right simulation are independent, and isotropic (whiteness
tests: Mehra 1970, "On the identification of variances and adaptive Kalman filtering"):

    correlation     Σ w_t w_{t+1} / Σ w_t²                          0 ± 1/√n; towards 1 where the path itself is off
    along motion    the share of |w · v| > |w × v|, v a velocity    ½ ± 1/(2√n); towards 1 where rows are mistimed

v is not whitened, which costs power where predictions are uncertain. Noise of unlike width in x and y shows, too.

How much louder errors are than the noise at rest, κ says; but that noise is hardly known where a cause has it grow with
speed. There the cause's own noise, drawn about its path, is compared with the recording's, both as neighbouring rows
show them (:func:`.jitter.jitter`).

And outliers of a tracker come upon each keypoint independently. With r_t the probability
that one is an outlier in row t and s_t that another is, of all pairs together,

    together        (Σ r_t s_t − E) / (M − E)                       0 ± √E/(M − E); 1 where all come together

with E = Σr Σs / T what chance gives, and M = min(Σr, Σs) the most there could be.

Shapes: T rows, O observations, P keypoints.
"""

from itertools import combinations

import numpy as np
import torch

from invdyn.diagnosis.prediction.predict import seen_tips, whitened
from invdyn.diagnosis.problem.cause import FittedHypothesis, best_size
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.outliers import calm
from invdyn.models.effects.base import stages_of
from invdyn.models.observation.mixture import MistakenRows
from invdyn.recordings.jitter import jitter


def show_more(problem: DiagnosisProblem, cause: FittedHypothesis, errors: np.ndarray) -> bool:
    """Whether a cause's errors of prediction (T, O) are large, correlated, or outliers that come together."""
    rules = problem.rules.residual
    if noise_ratio(problem, cause) > rules.max_error_ratio:
        return True
    correlated, chance = correlation(errors)
    company, by_chance = shared_outliers(problem, cause)
    remembers = correlated > rules.max_error_correlation + rules.error_margin * chance
    return remembers or company > rules.max_shared_outliers + rules.error_margin * by_chance


def prediction_errors(problem: DiagnosisProblem, cause: FittedHypothesis) -> np.ndarray:
    """Whitened one-step prediction errors (T, O), NaN where nothing was seen.

    With unknown torque under an ample one, which correlates no errors by being smoother than its prior: what is
    then correlated, no torque can explain.
    """
    size = best_size(problem, cause) * (1.0 if problem.regime.knows_torque else problem.rules.residual.limb_margin)
    rows = whitened(problem, cause, [size])
    errors = np.full(problem.observations.shape, np.nan)
    errors[rows.seen > 0] = rows.columns[0, :, 0].reshape(-1, errors.shape[-1])
    errors[np.isnan(problem.observations.numpy())] = np.nan
    return errors


def noise_ratio(problem: DiagnosisProblem, cause: FittedHypothesis) -> float:
    """Size of the errors of prediction, in units of the noise that the recording shows; 1 where nothing is left."""
    grows = any("noise" in stages_of(effect) for effect in cause.effects)
    observation = cause.model.observation
    if not grows or observation.encoders or observation.keypoints is None:
        return cause.kappa
    points = observation.part(observation.keypoints)
    rows = cause.model.emission(cause.path, torch.arange(len(cause.path)))
    rows = getattr(rows, "base_dist", rows)
    draws = np.random.default_rng(0).normal(size=(problem.rules.outcome.num_noise_draws, *rows.loc.shape))
    drawn = rows.loc + cause.kappa * rows.scale * torch.from_numpy(draws) + 0 * problem.observations

    def shown(observations: torch.Tensor) -> np.ndarray:
        return jitter(calm(problem.model.time, observations, problem.starts).numpy()[:, points])

    own, theirs = np.mean([shown(each) for each in drawn], 0), shown(problem.observations)
    known = (own > 0) & (theirs > 0)
    return float(np.exp(np.log(own[known] / theirs[known]).mean())) if known.any() else cause.kappa


def correlation(errors: np.ndarray) -> tuple[float, float]:
    """Of the errors (T, O) of neighbouring rows, all observations together; and its sd under no correlation."""
    pairs = errors[1:] * errors[:-1]
    count = int(np.isfinite(pairs).sum())
    return (float(np.nanmean(pairs) / np.nanmean(errors**2)), count**-0.5) if count else (0.0, 1.0)


def along_motion(errors: np.ndarray, cause: FittedHypothesis) -> tuple[float, float]:
    """Share of the keypoints' errors that are larger along the motion than across; and its sd under no preference.

    Of ``errors`` (T, O) of any size and distribution. Of the faster half of all detections: at rest there is
    no direction; of encoders alone, nor is there any.
    """
    if cause.model.observation.keypoints is None:
        return 0.5, 0.5
    tips = seen_tips(cause.model, cause.path)
    errors = cause.model.observation.points(errors)
    velocity = np.gradient(tips, cause.model.time.numpy(), axis=0)
    speed = np.linalg.norm(velocity, axis=-1)
    seen = np.isfinite(errors).all(-1)
    fast = seen & (speed > np.median(speed[seen])) if seen.any() else seen
    if not fast.any():
        return 0.5, 0.5
    errors, velocity = errors[fast], velocity[fast]
    along, across = (np.abs((errors * way).sum(-1)) for way in (velocity, _across(velocity)))
    return float(np.mean(along > across)), 0.5 * int(fast.sum()) ** -0.5


def _across(vectors: np.ndarray) -> np.ndarray:
    """Vectors as long as ``vectors`` (N, d) and at right angles to them; in space any one of these."""
    if vectors.shape[-1] == 2:
        return vectors[:, ::-1] * [-1.0, 1.0]
    normal = np.cross(vectors, np.eye(3)[np.abs(vectors).argmin(-1)])
    lengths = [np.linalg.norm(each, axis=-1, keepdims=True) for each in (vectors, normal)]
    return normal * lengths[0] / np.maximum(lengths[1], 1e-300)


def shared_outliers(problem: DiagnosisProblem, cause: FittedHypothesis) -> tuple[float, float]:
    """How far outliers share their rows, and its sd if they are independent (of one chance coincidence at least).

    Where the cause has rows swapped or mistimed, or knows of no outliers: 0.
    """
    rows = cause.model.emission(cause.path, torch.arange(len(cause.path)))
    if not isinstance(rows, MistakenRows) or not rows.outliers or rows.swaps or rows.shift:
        return 0.0, 1.0
    outliers = rows.outlier_probability(problem.observations).numpy()
    together = by_chance = most = 0.0
    for one, other in combinations(outliers.T, 2):
        seen = ~np.isnan(one + other)
        r, s = one[seen], other[seen]
        together += float(r @ s)
        by_chance += float(r.sum() * s.sum() / max(seen.sum(), 1))
        most += float(min(r.sum(), s.sum()))
    if most - by_chance < 1.0:
        return 0.0, 1.0
    return (together - by_chance) / (most - by_chance), max(by_chance, 1.0) ** 0.5 / (most - by_chance)

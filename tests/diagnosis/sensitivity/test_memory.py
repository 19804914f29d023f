"""Errors that remember the row before: their evidence by brute force, and what they do to a cause."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import FRICTION, LOOSE, MANY, PENDULUM, path_of, recorded
from scipy.integrate import quad
from scipy.optimize import minimize_scalar
from scipy.stats import multivariate_normal

from invdyn.diagnosis.assessment.model_posterior import share_explained
from invdyn.diagnosis.diagnose import diagnose
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.innovation_tests import correlation, prediction_errors
from invdyn.diagnosis.prediction.predict import scores
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import Unknowns
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.memory import expansions, forgotten
from invdyn.diagnosis.sensitivity.whiten import Whitened

ROWS, WIDTH, SLOPES = 100, 2, 2
PRIOR_SD = np.array([0.5, 2.0])


def remembering(rng, memory, shape):
    """Autoregressive noise (T, ...) of unit variance."""
    noise = rng.normal(size=shape)
    for t in range(1, len(noise)):
        noise[t] = memory * noise[t - 1] + np.sqrt(1 - memory**2) * noise[t]
    return noise


def whitened(memory, seed=0, lost=()):
    """Errors that remember, and two columns, as a filter of one size would give them."""
    rng = np.random.default_rng(seed)
    columns = rng.normal(size=(ROWS, WIDTH, 1 + SLOPES))
    columns[..., 0] = 1.3 * remembering(rng, memory, (ROWS, WIDTH)) - columns[..., 1:] @ [0.3, -1.0]
    seen = np.ones((ROWS, WIDTH), dtype=bool)
    for row, column in lost:
        seen[row, column], columns[row, column] = False, 0.0
    follows = seen & np.vstack([np.zeros((1, WIDTH), dtype=bool), seen[:-1]])
    flat = columns.reshape(1, ROWS * WIDTH, 1 + SLOPES)
    gram = np.swapaxes(flat, -1, -2) @ flat
    return Whitened(np.array([1e-4]), gram, np.zeros((1, ROWS)), seen.sum(-1), flat, follows.ravel())


def among():
    far = np.full(SLOPES, np.inf)
    return Unknowns(("a", "b"), (), np.zeros(SLOPES), PRIOR_SD, -far, far)


def correlation_of(given, memory):
    """Matrix (N, N) of the errors: powers of the memory within a stretch that was seen without a gap."""
    follows = given.follows.reshape(-1, WIDTH)
    stretch = np.cumsum(~follows, axis=0)
    row = np.arange(ROWS)
    R = np.zeros((ROWS, WIDTH, ROWS, WIDTH))
    for c in range(WIDTH):
        same = stretch[:, None, c] == stretch[None, :, c]
        R[:, c, :, c] = same * memory ** np.abs(row[:, None] - row[None])
    return R.reshape(ROWS * WIDTH, ROWS * WIDTH)


def brute_force(given, memory):
    """Log density of the data, slopes integrated out, the noise's factor at its maximum."""
    A, data = given.columns[0, :, 1:], given.columns[0, :, 0]
    known = np.flatnonzero(np.abs(given.columns[0]).sum(-1) > 0)
    R, A, data = correlation_of(given, memory)[np.ix_(known, known)], A[known], data[known]

    def lacking(log_kappa):
        covariance = np.exp(2 * log_kappa) * R + A @ np.diag(PRIOR_SD**2) @ A.T
        return -multivariate_normal(np.zeros(len(data)), covariance).logpdf(data)

    return -minimize_scalar(lacking, bounds=(-0.5, 1.0), method="bounded", options={"xatol": 1e-4}).fun


@pytest.mark.quick("0.2-*", "0.0-*")
@pytest.mark.parametrize(("memory", "lost"), [(0.0, ()), (0.2, ()), (0.4, ((10, 0), (11, 0), (70, 1)))])
def test_evidence_is_that_of_a_spike_and_a_slab(memory, lost):
    """The slab integrated by quadrature; with rows lost, a stretch after them begins anew."""
    given = whitened(memory, lost=lost)
    (found,) = expansions(given, among(), np.zeros(SLOPES))
    white = brute_force(given, 0.0)
    top = brute_force(given, max(found.memory, 0.01))
    slab = (
        quad(lambda m: np.exp(brute_force(given, m) - top), 0.0, DEFAULT.residual.max_memory, epsrel=1e-3)[0]
        / DEFAULT.residual.max_memory
    )
    exact = np.logaddexp(white, top + np.log(slab)) + np.log(0.5)
    assert found.log_evidence == pytest.approx(exact, abs=0.3)
    assert found.log_evidence - found.gain == pytest.approx(white, abs=0.05)
    assert abs(found.memory - memory) < 4 * ROWS**-0.5 / np.sqrt(WIDTH)
    assert (found.memory == 0.0) is (memory == 0.0)
    assert np.all(np.abs(found.mean - [0.3, -1.0]) < 4 * np.sqrt(np.diag(found.covariance)))


def test_what_is_forgotten_is_white_and_has_the_same_density():
    given = whitened(0.4)
    left = forgotten(given, 0.4)
    errors = left.columns[0].reshape(ROWS, WIDTH, -1) @ [1.0, 0.3, -1.0]
    assert abs(correlation(errors)[0]) < 4 / np.sqrt(ROWS * WIDTH)
    data = left.columns[0, :, 0]
    normal = -0.5 * data @ data - 0.5 * len(data) * np.log(2 * np.pi) - left.log_det[0]
    R = correlation_of(given, 0.4)
    assert normal == pytest.approx(multivariate_normal(np.zeros(len(data)), R).logpdf(given.columns[0, :, 0]), abs=1e-6)
    assert forgotten(given, 0.0) is given


def trailing(memory, seed=0, rows=400):
    """A damped pendulum's recording whose tracker takes the last frame's error along."""
    still = recorded(0.05, seed, rows=rows)
    quiet = diagnosis_problem(still, PENDULUM)
    rng = np.random.default_rng(seed)
    path = path_of(quiet)
    with torch.no_grad():
        seen = quiet.model.emission(path, torch.arange(len(path))).base_dist.loc.numpy()
    noisy = seen + 0.002 * remembering(rng, memory, seen.shape)
    keypoints = still.keypoints.copy()
    keypoints[:, -1] = noisy
    return replace(still, keypoints=keypoints)


@pytest.mark.long
def test_a_tracker_that_trails_is_no_gap():
    """Friction is found, and nothing else is left."""
    here = diagnosis_problem(trailing(0.25), PENDULUM)
    path = path_of(here)
    none, right = (refine(here, effects, {}, path, LOOSE) for effects in ((), (FRICTION,)))
    assert right.memory == pytest.approx(0.25, abs=4 / np.sqrt(800))
    assert right.complete
    assert right.of_memory > 10
    assert abs(right.mean[0] - 0.05) < 4 * right.sd[0]
    assert correlation(prediction_errors(here, right))[0] > 0.1
    pool = HypothesisPool(here, [], {"": none}, [], path, False)
    assert share_explained(here, pool, right) > 0.9
    score = scores(here, right).score
    white = scores(here, replace(right, memory=0.0)).score
    assert 0.5 * right.of_memory < np.nansum(score - white) < 2 * right.of_memory


@pytest.mark.long
def test_errors_that_remember_much_are_something_else():
    here = diagnosis_problem(trailing(DEFAULT.residual.max_error_correlation + 0.25), PENDULUM)
    path = path_of(here)
    none, right = (refine(here, effects, {}, path, LOOSE) for effects in ((), (FRICTION,)))
    pool = HypothesisPool(here, [], {"": none}, [], path, False)
    assert share_explained(here, pool, right) == 0.0


@pytest.mark.long
def test_a_diagnosis_says_what_errors_remember():
    found = diagnose(trailing(0.25), PENDULUM, without=MANY)
    assert [finding.key for finding in found.causes[0].effects] == [FRICTION.key]
    assert found.outside.probability < 0.1
    assert found.to_json()["noise"] == {
        "factor": pytest.approx(1.0, abs=0.3),
        "memory": pytest.approx(0.25, abs=0.15),
        "degrees_of_freedom": None,
    }
    assert f"{found.noise.memory:.2f}" in found.method["evidence"]

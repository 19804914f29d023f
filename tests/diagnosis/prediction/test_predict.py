"""What a cause predicts: scores of rows, residual torque, replay."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, DAMPING, LOOSE, PENDULUM, at_best, causes, path_of, recording_of
from scipy.special import logsumexp

from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.predict import replay, replay_rms, residual, scores, smoothed
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns


def test_scores_sum_to_the_evidence():
    """The chain rule: Σ log p(y_t | y_<t), at the best size; exact without parameters."""
    here, none, _ = causes()
    evidence, _ = at_best(here, none)
    assert scores(here, none).score.sum() == pytest.approx(evidence, abs=1e-6)


def test_the_floor_is_what_a_perfect_simulation_scores():
    here, none, cause = causes()
    for setting_, perfect in ((causes(0.0)[0], causes(0.0)[1]), (here, cause)):
        both = scores(setting_, perfect)
        # The noise's size is that of these very innovations, so their squares' scatter cancels: what is left is
        # what parameters cost.
        assert abs((both.floor - both.score).sum()) < 2
    poor = scores(here, none)
    assert (poor.floor - poor.score).sum() > 10


def test_parameters_are_integrated_over_on_rows_that_they_have_not_seen():
    """Row by row against Gauss–Hermite quadrature of p(y_t | y_<t, damping) over a broad posterior of the damping."""
    here, _, cause = causes()
    broad = replace(cause, mean=cause.mean + 4 * cause.sd, covariance=9 * cause.covariance)
    among = unknowns(here, cause.effects)
    broad = replace(broad, model=among.set_in(cause.model, broad.mean), path=cause.path)
    unseen = np.arange(80) >= 30
    nodes, weights = np.polynomial.hermite_e.hermegauss(40)
    plain = np.array(
        [
            scores(here, replace(broad, model=among.set_in(cause.model, broad.mean + node * broad.sd))).score
            for node in nodes
        ]
    )
    total = logsumexp(plain[:, unseen].cumsum(1) + np.log(weights / weights.sum())[:, None], axis=0)
    found = scores(here, broad, unseen).score
    at_mean = scores(here, broad).score
    np.testing.assert_allclose(found[unseen], np.diff(total, prepend=0.0), atol=0.02)
    np.testing.assert_allclose(found[~unseen], at_mean[~unseen], rtol=1e-12)
    assert (found - at_mean).sum() > 1


def test_rows_that_were_not_seen_have_no_score():
    here, none, _ = causes()
    gaps = here.observations.clone()
    gaps[[3, 40]] = torch.nan
    both = scores(here.observing(gaps), none)
    for values in (both.score, both.floor):
        assert np.flatnonzero(np.isnan(values)).tolist() == [3, 40]


def test_residual_torque_is_what_the_simulation_lacks():
    here, none, cause = causes()
    mean, sd, _ = residual(here, none)
    assert mean.shape == sd.shape == (80, 1)
    missing = -DAMPING * none.path[:, 2].numpy()
    # A Gaussian process through noise: its own spread says how far off it may be.
    assert 0.25 < np.sqrt((((mean[:, 0] - missing) / sd[:, 0]) ** 2).mean()) < 2
    assert np.corrcoef(mean[:, 0], missing)[0, 1] > 0.8
    after, _, _ = residual(here, cause)
    assert np.sqrt((after**2).mean()) < 0.05 * np.sqrt((mean**2).mean())


def test_residual_torque_is_as_large_as_what_is_missing():
    """A command that is told .4 N·m too small, all the time."""
    arm = recording_of(rows=80, effort=1.0)
    here = diagnosis_problem(replace(arm, torques=arm.torques - 0.4), PENDULUM)
    none = refine(here, (), {}, path_of(here), LOOSE)
    mean, sd, _ = residual(here, none)
    assert (sd[10:-10] < 0.25).all()
    assert mean[10:-10].mean() == pytest.approx(0.4, rel=0.04)


def test_replay_follows_once_the_cause_is_in():
    here, none, cause = causes()
    path = smoothed(here, cause).path
    _, q, _ = here.model.split(path)
    tips = here.model.dynamics.keypoints(q, here.model.body_parameters()).numpy()
    with_cause, without = (replay_rms(replay(c.model, path), tips) for c in (cause, none))
    assert with_cause < 0.001
    assert without > 10 * with_cause
    assert replay(cause.model, path).shape == (80, 1, 2)
    np.testing.assert_allclose(replay(cause.model, path)[[0, 50]], tips[[0, 50]], atol=1e-9)  # set back every second
    assert replay_rms(tips + 0.3, tips) == pytest.approx(0.3 * np.sqrt(2))


def test_a_replay_has_the_order_that_another_process_sends_it_in():
    """Sums over it would else depend in their last digit on how many workers there are."""
    here = diagnosis_problem(recording_of(body=ARM), ARM)
    there = pickle.loads(pickle.dumps(tips := replay(here.model, path_of(here))))
    assert tips.strides == there.strides

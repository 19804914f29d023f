"""A tracker's noise with heavy tails is no cause to be named; detections that stray are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pendulum import ARM, FEW, MANY, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.laws import heavy_tailed
from invdyn.diagnosis.hypotheses.search import search
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS

FRICTION = EFFECTS["viscous_friction"]("elbow")
LEFT_OUT = tuple(name for name in (*MANY, *FEW) if name not in ("viscous_friction", "outliers", "label_swap"))


@cache
def searched(law, rows=150):
    """An arm with friction at its elbow under a tracker’s noise of 6 mm: normal, Student's t, or with strays."""
    still = recording_of(FRICTION, ARM, rows=rows, damping=0.05)
    rng = np.random.default_rng(0)
    shape = still.keypoints[:, 1:].shape
    noise = rng.normal(size=shape) if law != "heavy" else rng.standard_t(4, size=shape) / np.sqrt(2)
    if law == "strays":
        noise += 30 * rng.normal(size=shape) * (rng.random(shape[:2]) < 0.02)[..., None]
    keypoints = still.keypoints.copy()
    keypoints[:, 1:] += 0.006 * noise
    here = diagnosis_problem(replace(still, keypoints=keypoints), ARM)
    path, stray = data_path(here)
    return here, stray, search(here, path, stray, LEFT_OUT)


@pytest.mark.long
def test_heavy_tails_take_the_place_of_stray_detections():
    _, stray, found = searched("heavy", 300)
    assert stray
    assert found.ranked[0].key == f"outliers+{FRICTION.key}"
    carried = heavy_tailed(found)
    tailed = carried.problem
    assert tailed.model.observation.family == "multivariate_t"
    degrees = tailed.model.parameters["emission.df"]
    assert degrees.item() in DEFAULT.residual.tail_degrees
    best = carried.ranked[0]
    assert best.key == FRICTION.key
    assert best.complete
    assert abs(best.mean[0] - 0.05) < 4 * best.sd[0]
    assert best.kappa == pytest.approx(1.0, abs=0.05)
    assert best.log_evidence > found.ranked[0].log_evidence
    assert "" in carried.pool
    assert not any("outliers" in key for key in carried.pool)
    # Of what was looked for the report still tells, but for what the law says now.
    mistimed = EFFECTS["timestamp_jitter"]()
    other = heavy_tailed(replace(found, candidates=[*found.candidates, mistimed]))
    left = {e.name for e in (*found.candidates, mistimed)} - {"outliers", "label_swap"}
    assert {e.name for e in other.candidates} == left
    other = diagnosis_problem(recording_of(FRICTION, ARM, seed=1, damping=0.05), ARM)
    there = best.carried_to(other)
    assert there.observation.family == "multivariate_t"
    assert torch.equal(there.parameters["emission.df"], degrees)


@pytest.mark.quick("normal")
@pytest.mark.parametrize("law", ["normal", "strays"])
def test_normal_noise_and_stray_detections_stay_what_they_are(law):
    _, stray, found = searched(law)
    assert stray is (law == "strays")
    assert heavy_tailed(found) is found
    assert ("outliers" in found.ranked[0].key) is (law == "strays")


@pytest.mark.long
def test_strays_that_bent_their_own_path_are_looked_for_along_that_of_the_other_law():
    here, _, found = searched("strays")
    best, none = found.best, found.pool[""]
    bent = replace(best, log_evidence=none.log_evidence + 100, path=none.path)
    pool = heavy_tailed(replace(found, pool={"": none, best.key: bent}))
    assert pool.problem is here
    assert pool.best.key == best.key
    assert pool.best.log_evidence == pytest.approx(best.log_evidence, abs=1.0)

"""Whole turns over gaps: the most probable way is taken, and what is in doubt is reported."""

import json
from dataclasses import replace

import numpy as np
import pytest

from invdyn.inference import SMCOptions, infer, prepare
from invdyn.inference.posterior import gap_branches
from invdyn.inference.posterior.gap_branches import differs_in_turns, gaps, most_probable_turns
from invdyn.inference.posterior.initialise import arm_problem
from invdyn.inference.smoothing.gauss_newton import gauss_newton
from invdyn.models import Link, planar_body
from invdyn.simulate import random_arm, record
from invdyn.summary import summary_text

GAP = slice(40, 56)


def body():
    links = [
        Link("upper", "shoulder", "elbow", length=0.3, mass=0.56),
        Link("fore", "elbow", "wrist", length=0.2, mass=0.6),
    ]
    return planar_body("arm", links, gravity=(0.0, -9.81))


def recorded(seed, torque=0.15, gap=GAP):
    """A recording of a whirling arm, 30 frames/s, with its keypoints missing for a while, and its truth."""
    arm = body()
    recording, truth = record(random_arm(arm, duration=3.0, torque_scale=torque), seed)
    keypoints = recording.keypoints.copy()
    keypoints[gap] = np.nan
    return arm, replace(recording, keypoints=keypoints), truth


def slips(model, path, truth):
    """Whole turns (K,) that a path makes more than the truth from the beginning to the end."""
    off = model.split(path)[1].numpy() - truth.angle
    return np.round((np.median(off[GAP.stop + 2 :], 0) - np.median(off[: GAP.start - 2], 0)) / (2 * np.pi))


@pytest.mark.quick("8")
@pytest.mark.parametrize("seed", [6, 8])
def test_the_most_probable_way_over_a_gap_is_the_true_one(seed):
    """One path through the gap is a turn off, 6 nats and more behind; another start finds the right one."""
    arm, recording, truth = recorded(seed)
    problem = arm_problem(recording, arm)
    model, rows = problem.model, problem.observations
    first = gauss_newton(model, rows)
    assert slips(model, first.path, truth).any()  # else this recording tests nothing
    path, doubts = most_probable_turns(model, rows, first.path)
    assert not slips(model, path, truth).any()
    assert differs_in_turns(model, path, first.path)
    assert not doubts
    assert gauss_newton(model, rows, start=path).log_evidence > first.log_evidence


@pytest.mark.slow
def test_the_fit_begins_and_ends_with_the_most_probable_way():
    arm, recording, truth = recorded(27)
    task = prepare(recording, arm, options=SMCOptions(), seed=0)
    assert not slips(task.problem.model, task.path, truth).any()
    assert "in_doubt" not in task.record


@pytest.mark.long
def test_a_way_that_is_nearly_as_probable_is_reported():
    arm, recording, _ = recorded(12)
    problem = arm_problem(recording, arm)
    _, (doubt,) = most_probable_turns(problem.model, problem.observations)
    assert (doubt.begin, doubt.end) == pytest.approx((1.3, 56 / 30))
    assert list(doubt.turns) == ["fore"]
    assert 0.05 < doubt.probability < 0.5
    assert "from 1.3 to 1.867 s" in str(doubt)
    assert "from 1700000001.3 to 1700000001.867 s" in str(replace(doubt, begin=1.7e9 + 1.3, end=1.7e9 + 56 / 30))


@pytest.mark.long
def test_what_is_in_doubt_is_in_the_summary_and_outlives_a_checkpoint(monkeypatch, tmp_path):
    """The most probable of other ways is reported at any probability, if requested."""
    monkeypatch.setattr(gap_branches, "REPORTED", 0.0)
    arm, recording, _ = recorded(12)
    options = {"method": "laplace", "num_filters": 2, "num_draws": 20, "checkpoint": tmp_path / "run"}
    with pytest.warns(UserWarning, match="fore 1 turn"):
        first, again = (infer(recording, arm, **options) for _ in range(2))
    (reported,) = json.loads(again.attrs["settings"])["in_doubt"]
    assert "fore 1 turn" in reported
    assert reported in summary_text(first)


def test_gaps_are_those_of_links_that_are_not_seen_and_not_counted():
    arm, recording, _ = recorded(0, gap=slice(0))
    keypoints = recording.keypoints.copy()
    keypoints[:3] = np.nan  # nothing before it: no way leads here
    keypoints[10:14, 1] = np.nan  # the wrist alone: the upper arm is seen
    keypoints[20:22, 0] = np.nan
    keypoints[-2:] = np.nan
    problem = arm_problem(replace(recording, keypoints=keypoints), arm)
    assert gaps(problem.model, problem.observations) == {(9, 14): [1], (19, 22): [0, 1]}
    counted = random_arm(arm, duration=3.0, encoder_noise=1e-3)
    seen, _ = record(counted, 0)
    problem = arm_problem(replace(seen, keypoints=keypoints), arm)
    assert problem.model.observation.encoders
    assert gaps(problem.model, problem.observations) == {}

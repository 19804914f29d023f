"""A cause on another recording of the same arm: its path there, its noise, and whether it leaves something there."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pendulum import ARM, DAMPING, LOOSE, MANY, PENDULUM, causes, path_of, recorded, recording_of

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.assessment import transfer as elsewhere
from invdyn.diagnosis.assessment.gap_closure import closed, unseen
from invdyn.diagnosis.assessment.transfer import carried, whole_turns_away
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.predict import scores
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import Link, planar_body
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError
from invdyn.simulate import random_arm, record


@pytest.mark.long
def test_what_another_recording_does_not_bear_out_is_a_part():
    """An arm whose friction is another one there: what was found was not all there was."""
    first, same, other = recorded(DAMPING, rows=200), recorded(DAMPING, seed=5), recorded(3 * DAMPING, seed=5)
    confirmed, odd = (diagnose(first, PENDULUM, held_out=second, without=MANY) for second in (same, other))
    likely = confirmed.causes[0]
    assert [effect.effect for effect in likely.effects] == ["viscous_friction"]
    assert likely.probability > 0.9
    assert confirmed.outside.probability < 0.01
    part = next(cause for cause in odd.causes if cause.effects == likely.effects)
    assert (part.probability, part.in_part) == (0.0, pytest.approx(likely.probability))
    assert odd.outside.probability == pytest.approx(likely.probability)
    assert confirmed.method["held out"] == "another recording"
    assert odd.method["held out"] == "another recording, in which the best cause leaves something"
    # Predicted under the residual that the first recording needs, which is none.
    assert confirmed.shrinkage.gap_closed > 0.95
    assert odd.shrinkage.gap_closed < 0


def test_of_paths_elsewhere_one_with_unknown_scores_is_none(monkeypatch):
    here, _, cause = causes()
    other = diagnosis_problem(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    start, _ = data_path(other)
    known = scores(other, carried(here, cause, other, start))
    unknown = replace(known, score=np.where(np.arange(60) > 5, np.nan, known.score))
    tried = []

    def scored(_, there, rows):
        tried.append(there)
        return unknown if len(tried) == 1 else known

    monkeypatch.setattr(elsewhere, "scores", scored)
    assert carried(here, cause, other, start) is tried[1]
    monkeypatch.setattr(elsewhere, "scores", lambda *_: unknown)
    with pytest.raises(InputError, match="cannot follow it"):
        carried(here, cause, other, start)


def test_a_push_is_not_missed_in_another_recording():
    """It came at a moment of the first one: that another one goes without it says nothing of the catalogue."""
    push = EFFECTS["external_push"]("tip")
    truth = {"impulse_x": 0.72, "impulse_y": 0.36, "moment": 0.7, "duration": 0.12}
    here = diagnosis_problem(recording_of(push, **truth), PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (push,), {f"external_push.tip.{n}": v for n, v in truth.items()}, path, LOOSE)
    assert cause.log_evidence > none.log_evidence + 20
    there = unseen(here, none, cause, diagnosis_problem(recording_of(seed=5), PENDULUM))
    without, with_cause = there.scores
    assert np.nansum(with_cause.score - without.score) < -10
    assert not there.leaves


@pytest.mark.long
@pytest.mark.parametrize("seed", [10, 20])
def test_another_recording_has_its_own_swapped_labels(seed):
    """Its path is found as the first one's is: not along detections that stray."""
    swap = EFFECTS["label_swap"]("elbow", "wrist")
    here, other = (
        diagnosis_problem(recording_of(swap, body=ARM, rows=150, seed=s, rate=0.06), ARM) for s in (seed, seed + 1)
    )
    path, stray = data_path(here)
    assert stray
    none = refine(here, (), {}, path, LOOSE)
    cause = refine(here, (swap,), {"label_swap.elbow.wrist.rate": 0.06}, path, DEFAULT.residual.min_path_size)
    there = unseen(here, none, cause, other)
    without, with_cause = there.scores
    assert not there.leaves
    assert with_cause.score.mean() > without.score.mean() + 5
    # Half the squares of 600 unit innovations: sd √300; and as much for the noise scale, known from as many.
    assert abs((with_cause.score - with_cause.floor).sum()) < 4 * np.sqrt(2 * 300)


def test_the_noise_of_another_recording_is_no_part_of_the_prediction():
    """Its own jitter would be scaled by a factor that belongs to the first recording's."""
    here, none, cause = causes()
    quieter = diagnosis_problem(recorded(DAMPING, seed=5, rows=60), PENDULUM)
    name = "emission.keypoint_scale"
    assert not torch.equal(here.model.parameters[name], quieter.model.parameters[name])
    for each in (none, cause):
        assert torch.equal(each.carried_to(quieter).parameters[name], here.model.parameters[name])


@pytest.mark.long
def test_the_noise_goes_with_its_keypoint():
    """Another recording may have its columns in another order, or a keypoint that the first one did not track."""
    links = [Link("upper", "shoulder", "elbow", 0.3, 1.5), Link("fore", "elbow", "wrist", 0.25, 1.0)]
    body = planar_body("arm", links, gravity=(0.0, -9.81))
    arm = random_arm(body, duration=1.0, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=0)
    both = record(arm, 0)[0]
    reversed_points = replace(both, keypoints=both.keypoints[:, ::-1], keypoint_names=both.keypoint_names[::-1])
    one = replace(both, keypoints=both.keypoints[:, 1:], keypoint_names=both.keypoint_names[1:])
    name = "emission.keypoint_scale"

    def scales(first, second):
        here, other = diagnosis_problem(first, body), diagnosis_problem(second, body)
        carried = refine(here, (), {}, path_of(here), LOOSE, rounds=1).carried_to(other)
        return [
            dict(zip(model.observation.tracked, model.parameters[name].tolist(), strict=True))
            for model in (here.model, other.model, carried)
        ]

    mine, _, carried = scales(both, reversed_points)
    assert carried == mine
    mine, _, carried = scales(both, one)
    assert carried == {1: mine[1]}
    mine, own, carried = scales(one, both)
    assert carried == {0: own[0], 1: mine[1]}


SPRING = EFFECTS["joint_stiffness"]("pivot")
STIFFNESS, REST = 1.0, 3.3


@cache
def sprung(begin, seed):
    """A pendulum on a spring, let go under known commands at an angle ``begin`` that no camera sees the turns of."""
    arm = random_arm(PENDULUM, duration=2.0, fps=50, noise=0.002, torque_scale=0.5, commanded=True, seed=seed)
    values = {"stiffness": STIFFNESS, "torque": STIFFNESS * REST}
    given = {f"effect.joint_stiffness.pivot.{n}": torch.tensor([v], dtype=torch.float64) for n, v in values.items()}
    given |= {"initial.angle": torch.tensor([begin], dtype=torch.float64), "initial.angle_scale": torch.tensor([1e-3])}
    return record(arm.with_effects(SPRING).replace(**given), seed)[0]


@pytest.mark.quick("2.9")
@pytest.mark.parametrize("begin", [3.7, 2.9])
def test_another_recording_may_begin_a_whole_turn_away(begin):
    """A spring feels turns that no camera sees: in one recording it rests at 3.3 rad, in the other at −3."""
    here, other = diagnosis_problem(sprung(2.9, 0), PENDULUM), diagnosis_problem(sprung(begin, 1), PENDULUM)
    path = path_of(here)
    none = refine(here, (), {}, path, LOOSE)
    values = {"joint_stiffness.pivot.stiffness": STIFFNESS, "joint_stiffness.pivot.torque": STIFFNESS * REST}
    cause = refine(here, (SPRING,), values, path, LOOSE)
    there = unseen(here, none, cause, other)
    shares = closed(*there.scores, there.rows, other.model.time.numpy(), 0)
    assert not there.leaves
    assert shares.share > 0.95
    seen = other.model.split(there.cause.path)[1][0].item()
    assert seen == pytest.approx(begin, abs=0.05)


def test_turns_are_told_by_what_feels_them():
    """By a spring, not by gravity and friction; and an encoder counts them itself."""
    here, none, friction = causes()
    assert whole_turns_away(none) == []
    assert whole_turns_away(friction) == []
    one = {"effect.joint_stiffness.pivot.stiffness": torch.ones(1)}
    spring = replace(none, model=here.model.with_effects(SPRING).replace(**one))
    for there, turn in zip(whole_turns_away(spring), (2 * np.pi, -2 * np.pi), strict=True):
        _, angle, velocity = here.model.split(there.path - none.path)
        assert torch.allclose(angle, torch.full_like(angle, turn))
        assert not velocity.any()
        begins = there.model.parameters["initial.angle"] - here.model.parameters["initial.angle"]
        assert begins.item() == pytest.approx(turn)
    counted = replace(recorded(), angles=here.model.split(none.path)[1].numpy(), joint_names=("pivot",))
    model = diagnosis_problem(counted, PENDULUM).model.with_effects(SPRING).replace(**one)
    assert whole_turns_away(replace(spring, model=model)) == []

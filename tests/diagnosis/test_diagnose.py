"""The whole way from a recording to a diagnosis, where a part of it says something else."""

import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from pendulum import ARM, MANY, PENDULUM, recording_of

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.assessment.assemble import ambiguous, unseen_effects
from invdyn.diagnosis.assessment.result import Cause, Finding
from invdyn.diagnosis.problem.diagnosis_problem import CannotFollow, diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError

ROOM = sys.modules[diagnose.__module__]
SEARCHED = ROOM.searched


@cache
def rubbing():
    """A pendulum that rubs, and its search, which takes longer than all else and is the same every time."""
    recording = recording_of(EFFECTS["viscous_friction"]("pivot"), rows=120, damping=0.05)
    return recording, SEARCHED(diagnosis_problem(recording, PENDULUM), MANY, 1)


@pytest.mark.long
def test_held_out_rows_are_scored_with_the_cause_that_is_named(monkeypatch):
    """They are scored beside the confirmation, with the cause that is likely: SMC may name another."""
    recording, searched = rubbing()
    monkeypatch.setattr(ROOM, "searched", lambda *_: searched)
    closed = diagnose(recording, PENDULUM).to_json()["shrinkage"]
    assert closed["gap_closed"] > 0.8
    alone = {name: closed[name] for name in ("gap_closed", "interval_90")}
    assert closed["by_effect"] == {"viscous_friction.pivot": alone}
    weigh = ROOM.weigh

    def other(bound, found, seed):
        return ROOM.only(bound, found, found.pool[""], weigh(bound, found, seed).log_evidence)

    monkeypatch.setattr(ROOM, "weigh", other)
    named = diagnose(recording, PENDULUM).to_json()
    assert named["causes"][0]["effects"] == []
    told = named["gap"]["elpd_per_frame"]
    assert told["corrected"] == told["nominal"] < told["noise_floor"]
    assert named["shrinkage"]["by_effect"] == {}


@pytest.mark.long
def test_what_is_likely_may_fail_on_another_recording(monkeypatch):
    """It is tried there before anybody knows whether it is the best; only the best one's failure is the user's."""
    recording, searched = rubbing()
    monkeypatch.setattr(ROOM, "searched", lambda *_: searched)
    unseen, failed = ROOM.unseen, []

    def fails(bound, none, cause, other):
        if cause.effects and len(failed) < times:
            failed.append(cause.key)
            raise CannotFollow("cannot follow it")
        return unseen(bound, none, cause, other)

    monkeypatch.setattr(ROOM, "unseen", fails)
    times = 1
    named = diagnose(recording, PENDULUM)
    assert failed == [effect.key for effect in named.causes[0].effects] == ["viscous_friction.pivot"]
    times = 3
    with pytest.raises(CannotFollow, match="cannot follow it"):
        diagnose(recording, PENDULUM)


@pytest.mark.parametrize("most", [0, -1])
def test_no_effect_at_once_is_told(most):
    with pytest.raises(InputError, match=f"expected one effect at once or more, got at most {most}"):
        diagnose(recording_of(), PENDULUM, most=most)


@pytest.mark.parametrize(("body", "times"), [(PENDULUM, 1e3), (ARM, 1e4)])
def test_torques_in_other_units_are_told_before_anything_is_looked_for(body, times):
    """The arm moves so fast that it could do with a thousand; ten times as many N·m are no other unit yet."""
    recording = recording_of(body=body, rows=100)
    with pytest.raises(InputError, match=r"expected torques in N·m.*check their unit"):
        diagnose(replace(recording, torques=times * recording.torques), body, checked=True)
    assert diagnosis_problem(replace(recording, torques=10 * recording.torques), body).regime == COMMANDED


def test_what_check_refuses_is_refused_unless_somebody_asked_before(monkeypatch):
    recording = recording_of()
    backwards = replace(recording, torques=-recording.torques)
    for given, other in ((backwards, None), ([recording, backwards], None), (recording, backwards)):
        with pytest.raises(InputError, match="the torques have the other sign"):
            diagnose(given, PENDULUM, held_out=other, most=1)
    monkeypatch.setattr(ROOM, "check_before", lambda *_: pytest.fail("asked twice"))
    monkeypatch.setattr(ROOM, "searched", lambda *_: sys.exit())
    with pytest.raises(SystemExit):
        diagnose(recording, PENDULUM, checked=True)


@pytest.mark.quick("LinAlgError-*")
@pytest.mark.parametrize("part", ["data_path", "finely_stepped", "search"])
@pytest.mark.parametrize("error", [np.linalg.LinAlgError, torch.linalg.LinAlgError])
def test_a_simulation_that_runs_away_is_told_in_one_line(monkeypatch, part, error):
    def singular(*_, **__):
        raise error("Singular matrix")

    monkeypatch.setattr(sys.modules[diagnose.__module__], part, singular)
    with pytest.raises(InputError, match=r"cannot follow it.*check units of torques"):
        diagnose(recording_of(), PENDULUM, without=MANY, checked=True)


@pytest.mark.long
def test_what_is_named_is_not_said_to_be_hidden():
    """With unknown torque a base that shakes is the one effect of the dynamics that can be named."""
    shake = {"sine_x": 0.02, "cosine_x": 0.006, "sine_y": 0.006, "cosine_y": 0.006, "frequency": 3.1}
    recording = recording_of(EFFECTS["base_motion"](), rows=150, **shake)
    found = diagnose(replace(recording, torques=None), PENDULUM)
    assert [effect.key for effect in found.causes[0].effects] == ["base_motion"]
    assert found.causes[0].probability > 0.9
    assert "base_motion" not in found.not_identifiable
    assert "viscous_friction.pivot" in found.not_identifiable


def test_what_a_torque_could_do_is_hidden_and_what_moves_the_whole_arm_is_not():
    here = diagnosis_problem(replace(recording_of(), torques=None), PENDULUM)
    hidden = unseen_effects(here, SimpleNamespace(first=[]))
    assert {"payload", "armature.pivot", "actuator_gain.pivot", "gravity_tilt", "camera_latency"} <= hidden
    assert "base_motion" not in hidden


@pytest.mark.parametrize(
    ("probabilities", "rivals"),
    [
        ((0.5, 0.46, 0.04), 2),  # .96 of all that is named is held by the first two
        ((0.4, 0.2, 0.1), 3),  # .86 by two
        ((0.99, 0.01, 0.0), 0),  # one alone is no set
        ((0.0, 0.0, 0.0), 0),
    ],
)
def test_a_set_holds_the_most_probable_causes_that_name_something(probabilities, rivals):
    names = ("armature", "payload", "gravity_tilt")
    causes = [
        Cause((Finding(name, "dynamics", {}, {}),), p, 0.0, None) for name, p in zip(names, probabilities, strict=True)
    ]
    nothing = Cause((), 0.3, 0.0, None)
    assert ambiguous([nothing, *causes]) == names[:rivals]
    assert ambiguous([replace(nothing, probability=0.6), *causes]) == ()


@pytest.mark.parametrize(
    ("without", "said"), [(("payloda",), "unknown effect 'payloda': known are"), ("payload", "got the text 'payload'")]
)
def test_effects_that_are_struck_must_exist(without, said):
    with pytest.raises(InputError, match=said):
        diagnose(recording_of(rows=30), PENDULUM, without=without)

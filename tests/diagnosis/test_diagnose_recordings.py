"""What recordings a diagnosis takes: several at once, with an end that nobody saw, with too little in them."""

import json
from dataclasses import replace

import numpy as np
import pytest
from pendulum import ALL_BUT_THREE, ARM, FRICTION, MANY, PENDULUM, diagnosed, recording_of

from invdyn.diagnosis import diagnose, save
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError
from invdyn.simulate import random_arm, record

DAMPING = 0.05


def rubbing(seed, rows=80):
    return replace(recording_of(FRICTION, rows=rows, seed=seed, damping=DAMPING), name=f"rubbing {seed}")


def named(found):
    return [effect.key for effect in found.causes[0].effects]


@pytest.mark.long
def test_several_have_their_causes_in_common():
    """Both know the damping better than one does, and nothing follows from one's last row to the other's first."""
    both = diagnose([rubbing(0), rubbing(1)], PENDULUM, without=ALL_BUT_THREE)
    assert named(both) == ["viscous_friction.pivot"]
    first, together = (found.causes[0].effects[0].parameters["damping"] for found in (diagnosed(), both))
    assert together.sd < first.sd
    assert abs(together.mean - DAMPING) < 4 * together.sd
    assert len(both.tracks.time) == 160


@pytest.mark.long
def test_an_end_that_nobody_saw_changes_nothing():
    """Commands go on where the camera has stopped: the answer is that of the rows before."""
    whole = rubbing(0, rows=110)
    keypoints = whole.keypoints.copy()
    keypoints[80:] = np.nan
    found = diagnose(replace(whole, keypoints=keypoints), PENDULUM, without=ALL_BUT_THREE)
    assert named(found) == ["viscous_friction.pivot"]
    assert len(found.tracks.time) == 80
    damping = found.causes[0].effects[0].parameters["damping"]
    assert abs(damping.mean - DAMPING) < 4 * damping.sd


@pytest.mark.long
def test_what_the_missing_torque_follows_is_said_of_a_named_cause():
    """And of what the camera does nothing is: no torque is missing."""
    assert diagnosed().to_json()["where"]["depends_on"] == ["velocity:pivot"]
    off = recording_of(EFFECTS["keypoint_offset"]("tip"), rows=80, along=0.0, across=0.03)
    with pytest.warns(UserWarning, match="off all along.*, or a shifted marker"):
        found = diagnose(off, PENDULUM, without=MANY)
    assert {effect.side for effect in found.causes[0].effects} == {"observation"}
    assert found.where.depends_on == ()


@pytest.mark.slow
def test_an_arm_at_thirty_frames_a_second_lacks_nothing():
    """Steps of one row would be wrong by what the camera notices, and some effect would be blamed."""
    arm = random_arm(ARM, duration=4.0, fps=30, noise=0.002, torque_scale=0.4, commanded=True, seed=2)
    arm = arm.in_substeps(64)
    found = diagnose(record(arm, 2)[0], ARM, without=MANY)
    assert named(found) == []
    assert not found.gap.detected
    assert found.ambiguity_set == ()


@pytest.mark.long
def test_rows_that_last_no_longer_than_a_push_show_nothing():
    """Forty milliseconds at a thousand frames a second, with all of the catalogue."""
    arm = random_arm(PENDULUM, duration=0.04, fps=1000, noise=0.0005, torque_scale=0.5, commanded=True, seed=3)
    found = diagnose(record(arm, 3)[0], PENDULUM)
    assert "in 40 rows of 0.039 s a torque of" in found.not_enough_data
    assert not found.gap.detected


@pytest.mark.quick("False-known0", "True-known1")
@pytest.mark.parametrize("known", [(), ("viscous_friction",)])
@pytest.mark.parametrize("uncertain", [False, True])
def test_a_catalogue_may_have_one_effect_or_none(known, uncertain):
    """Who knows which one it is asks how far it closes the gap; with none, all that is missing lies outside."""
    body = replace(PENDULUM, uncertainty={"mass": 0.05}) if uncertain else PENDULUM
    found = diagnose(rubbing(0), body, without=[name for name in EFFECTS if name not in known])
    assert named(found) == [f"{name}.pivot" for name in known]
    assert (found.outside.probability > 0.9) is not bool(known)


def test_too_few_rows_are_an_answer_and_leave_no_posterior_of_another(tmp_path):
    found = diagnose(rubbing(0, rows=12), PENDULUM)
    assert "12 rows with an observation, a diagnosis needs 20" in found.not_enough_data
    (tmp_path / "posterior.nc").write_text("an earlier one's")
    save(found, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["diagnosis.json", "report.html"]
    assert json.loads((tmp_path / "diagnosis.json").read_text())["not_enough_data"] == found.not_enough_data


def test_too_few_rows_held_out_are_an_error_that_names_them():
    """The recording itself has enough: its diagnosis must not be "not enough data"."""
    with pytest.raises(InputError, match="rubbing 1: 12 rows"):
        diagnose(rubbing(0), PENDULUM, held_out=rubbing(1, rows=12), without=MANY)

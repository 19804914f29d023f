"""When the gap shows, and at which joints."""

import numpy as np
import pytest
from pendulum import ARM, LOOSE, causes, path_of, recording_of

from invdyn.diagnosis.assessment.localisation import intervals, joints_of, where
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.regime import COMMANDED, UNKNOWN_TORQUE
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS

TIME = 0.01 * np.arange(400)


def gap_at(*stretches):
    gap = np.full(400, 0.001)
    for start, stop, size in stretches:
        gap[(start <= TIME) & (stop > TIME)] = size
    return gap


def test_intervals_hold_most_of_the_gap():
    found = intervals(TIME, gap_at((0.5, 0.8, 2.0), (2.0, 2.5, 2.0)))
    assert len(found) == 2
    first, second = found  # the larger share first
    assert abs(first.start - 2.0) <= 0.06
    assert abs(first.stop - 2.5) <= 0.06
    assert abs(second.start - 0.5) <= 0.2
    assert DEFAULT.outcome.interval_mass - 0.05 < first.share + second.share <= 1.0
    assert first.share == pytest.approx(1.0 / 1.6, abs=0.12)  # smoothing blunts the edges


def test_intervals_say_nothing_where_the_gap_is_everywhere_or_nowhere():
    assert intervals(TIME, np.ones(400)) == ()
    assert intervals(TIME, np.zeros(400)) == ()
    assert intervals(TIME, -np.ones(400)) == ()
    assert intervals(TIME, np.full(400, np.nan)) == ()


def test_intervals_of_rows_that_were_not_all_seen():
    gap = gap_at((2.0, 2.5, 2.0))
    gap[::3] = np.nan
    (only,) = intervals(TIME, gap)
    assert abs(only.start - 2.0) <= 0.1
    assert abs(only.stop - 2.5) <= 0.1


def test_joints_of_effects():
    joints = {
        e.key: joints_of(e.bound(ARM), ARM) for e in considered(diagnosis_problem(recording_of(body=ARM, rows=30), ARM))
    }
    assert joints["viscous_friction.elbow"] == [1]
    assert joints["joint_coupling.shoulder.elbow"] == [0, 1]
    assert joints["gravity_tilt"] == joints["keypoint_offset.wrist"] == []


@pytest.mark.parametrize(("regime", "side"), [(COMMANDED, "dynamics"), (UNKNOWN_TORQUE, "observation")])
def test_what_the_catalogue_lacks_is_a_torque_or_in_the_picture_where_torques_do_what_they_like(regime, side):
    here, none, _ = causes()
    residual, shifts = np.ones((80, 1)), np.zeros(1)
    found = where(here.model, {"": (none, 1.0)}, 1.0, regime, residual, np.ones(1), shifts, np.ones(80), ())
    assert found.side[side] == 1.0
    assert found.joints == {"pivot": 1.0 if side == "dynamics" else 0.0}
    assert found.keypoints == {"tip": 1.0 if side == "observation" else 0.0}


def test_shares_are_those_of_the_causes():
    """Friction at the elbow .6, a marker beside the wrist .3, and .1 of which nobody knows the joint."""
    here = diagnosis_problem(recording_of(body=ARM, rows=30), ARM)
    friction, offset = EFFECTS["viscous_friction"]("elbow"), EFFECTS["keypoint_offset"]("wrist")
    path = path_of(here)
    found = {e.key: refine(here, (e.bound(ARM),), {}, path, LOOSE) for e in (friction, offset)}
    shares = dict(zip(found, zip(found.values(), (0.6, 0.3), strict=True), strict=True))
    rows, ones = len(here.observations), np.ones(2)
    said = where(here.model, shares, 0.1, COMMANDED, np.ones((rows, 2)), ones, ones, np.ones(rows), ())
    assert said.side == pytest.approx({"dynamics": 0.7, "observation": 0.3})
    assert said.joints == pytest.approx({"shoulder": 0.05 / 0.7, "elbow": 0.65 / 0.7})
    assert said.keypoints == pytest.approx({"elbow": 0.0, "wrist": 1.0})

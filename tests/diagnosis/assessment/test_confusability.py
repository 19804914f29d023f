"""How much alike two effects change a recording."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from pendulum import ARM, recording_of

from invdyn.diagnosis.assessment.confusability import change, overlaps
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import screen
from invdyn.models.effects import EFFECTS


@cache
def screened(name, place, **values):
    """The setting of an arm with an effect, and what a screen says of some."""
    here = diagnosis_problem(recording_of(EFFECTS[name](*place), ARM, rows=150, effort=1.0, **values), ARM)
    path, _ = data_path(here)
    arms = [EFFECTS[other]() for other in ("camera_latency", "actuator_delay", "gravity_tilt", "camera_roll")]
    joints = [EFFECTS[other]("elbow") for other in ("viscous_friction", "joint_stiffness")]
    common = unknowns(here, ())
    effects = [effect.bound(ARM) for effect in (*arms, *joints)]
    return here, screen(here, here.model, path, effects, common, common.mean)


@pytest.mark.quick("gravity_tilt*")
@pytest.mark.parametrize(
    ("name", "value", "twin", "other"),
    [
        ("camera_latency", {"latency": 0.02}, "actuator_delay", "joint_stiffness.elbow"),
        ("gravity_tilt", {"angle": 0.1}, "camera_roll", "viscous_friction.elbow"),
    ],
)
def test_twins_change_it_alike_and_others_do_not(name, value, twin, other):
    """A camera that is late is a motor that is, a tilt of gravity a camera's roll, exactly."""
    here, found = screened(name, (), **value)
    ((one, same, share),) = overlaps(here, (name, twin), found)
    assert (one, same) == (name, twin)
    assert 0.97 < share <= 1 + 1e-9
    ((*_, share),) = overlaps(here, (name, other), found)
    assert share < 0.9


@pytest.mark.long
def test_what_the_body_could_do_is_taken_out():
    """Where lengths are known to 3 %, a camera's scale is what they do not explain: that gravity does not scale."""
    unsure = replace(ARM, uncertainty={"length": 0.03})
    sizes = []
    for body in (ARM, unsure):
        here = diagnosis_problem(recording_of(EFFECTS["camera_scale"](), ARM, rows=100, scale=1.05), body)
        path, common = data_path(here)[0], unknowns(here, ())
        scaled = [EFFECTS["camera_scale"]().bound(body)]
        (found,) = (s for s in screen(here, here.model, path, scaled, common, common.mean) if s.effect)
        sizes.append(float(np.square(change(here, found)).sum()))
    assert 0.1 * sizes[0] < sizes[1] < 0.8 * sizes[0]


def test_every_two_that_were_screened_are_compared():
    here, found = screened("camera_latency", (), latency=0.02)
    rivals = ("camera_latency", "actuator_delay", "payload+camera_roll", "viscous_friction.elbow")
    told = overlaps(here, rivals, found)
    assert [pair[:2] for pair in told] == [
        ("camera_latency", "actuator_delay"),
        ("camera_latency", "viscous_friction.elbow"),
        ("actuator_delay", "viscous_friction.elbow"),
    ]
    assert all(0 <= share <= 1 + 1e-9 for *_, share in told)
    assert np.isclose(told[1][2], overlaps(here, rivals[3::-3], found)[0][2])
    assert overlaps(here, (), found) == ()

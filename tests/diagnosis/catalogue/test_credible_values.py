"""Parameters that an effect could have been fitted with, and would not be called by its name for."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.diagnosis.problem.unknowns import prior_sd
from invdyn.models import ArmModel, Link, planar_body
from invdyn.models.effects import EFFECTS

ARM = planar_body("arm", [Link(f"link{k}", f"joint{k}", f"tip{k}", 0.3, 1.5 - k) for k in range(2)])


@pytest.fixture
def arm():
    def make(joints):
        return ArmModel(ARM, 0.01 * np.arange(12), command=np.ones((12, joints)))

    return make


SURE = 1e-3
"""Of a parameter's value: its standard deviation."""


def credible(arm, name, where, within=None, sd=SURE, **mean):
    """``mean`` may be functions of the scale; ``within`` are angles, rad, that the joints have been seen between."""
    model = arm(2)
    effect = EFFECTS[name](*where).bound(model.body)
    scale = model.scale
    if within is not None:
        scale = replace(scale, range=torch.tensor([within, within], dtype=torch.float64))
    mean = {key: value(scale) if callable(value) else value for key, value in mean.items()}
    return CATALOGUE.of(effect).credible(effect, mean, {key: sd * abs(value) for key, value in mean.items()}, scale)


@pytest.mark.parametrize(("rest", "expected"), [(3.0, True), (-6.0, True), (7.0, False), (-1000.0, False)])
def test_a_spring_rests_within_a_turn(rest, expected, arm):
    assert credible(arm, "joint_stiffness", ["joint1"], stiffness=0.2, torque=0.2 * rest) is expected


def test_a_spring_that_is_hardly_known_may_rest_anywhere(arm):
    assert credible(arm, "joint_stiffness", ["joint1"], sd=1.0, stiffness=0.01, torque=0.3)


@pytest.mark.parametrize(("ratio", "expected"), [(0.1, True), (1.0, True), (2.9, True), (3.5, False), (100.0, False)])
def test_a_stop_pushes_back(ratio, expected, arm):
    """By its damping ratio d / 2√(k I)."""
    damping = lambda scale: ratio * 2 * (50.0 * scale.inertia[0]) ** 0.5  # noqa: E731
    assert credible(arm, "joint_limit", ["joint0", "upper"], angle=0.5, stiffness=50.0, damping=damping) is expected


@pytest.mark.parametrize(
    ("side", "angle", "expected"),
    [
        *(("upper", 0.9, True), ("upper", 0.1, True), ("upper", -0.1, False), ("upper", -1.1, False)),
        *(("lower", -0.9, True), ("lower", -0.1, True), ("lower", 0.1, False), ("lower", 1.1, False)),
    ],
)
def test_a_joint_is_seen_free_of_its_stop(side, angle, expected, arm):
    """In half of the 2 rad that it has been seen in: one that mostly presses is a spring."""
    values = {"angle": angle, "stiffness": 50.0, "damping": 0.1}
    assert credible(arm, "joint_limit", ["joint0", side], within=(-1.0, 1.0), **values) is expected


@pytest.mark.parametrize(
    ("lower", "upper", "expected"),
    [(-0.8, 0.9, True), (-0.1, 0.2, True), (-0.1, 0.05, False), (0.061, 0.0607, False), (0.5, -0.5, False)],
)
def test_two_stops_of_a_joint_leave_it_room(lower, upper, expected, arm):
    """A tenth of the 2 rad that it has been seen in; of a joint with one stop, and of two joints, nothing is asked."""
    model = arm(2)
    scale = replace(model.scale, range=torch.tensor([[-1.0, 1.0]] * 2, dtype=torch.float64))
    low, high, other = (
        EFFECTS["joint_limit"](*where).bound(model.body)
        for where in (("joint0", "lower"), ("joint0", "upper"), ("joint1", "upper"))
    )
    low, high, other = ((e, {"angle": angle}) for e, angle in ((low, lower), (high, upper), (other, upper)))
    have_room = CATALOGUE["joint_limit"].credible_together
    assert have_room([low, high], scale) is expected
    assert have_room([low, high, other], scale) is expected
    assert have_room([low, high], model.scale) is (lower < upper)
    assert have_room([low, other], scale)
    assert have_room([], scale)


@pytest.mark.parametrize(
    ("ratio", "sd", "expected"),
    [
        (0.5, 0.0, True),
        (-0.5, 0.0, True),
        (0.09, 0.0, False),
        (-0.004, 0.0, False),
        (0.004, 0.01, False),
        (0.0, 0.1, True),
    ],
)
def test_a_coupling_minds_both_joints(ratio, sd, expected, arm):
    model = arm(2)
    coupling = EFFECTS["joint_coupling"]("joint0", "joint1").bound(model.body)
    spread = {"stiffness": 0.1, "ratio": sd, "torque": 0.1}
    for torque, slack in ((0.5, True), (100.0, False)):
        mean = {"stiffness": 1.0, "ratio": ratio, "torque": torque}
        assert CATALOGUE["joint_coupling"].credible(coupling, mean, spread, model.scale) is (expected and slack)


@pytest.mark.parametrize(("static", "expected"), [(0.3, True), (0.2, True), (0.19, False), (0.01, False)])
def test_stribeck_friction_falls_with_speed(static, expected, arm):
    assert credible(arm, "stribeck_friction", ["joint0"], coulomb=0.2, static=static, velocity=1.0) is expected


@pytest.mark.parametrize(("periods", "expected"), [(6.0, True), (3.0, True), (2.0, False), (1.25, False)])
def test_a_motor_ripples_several_times_a_turn(periods, expected, arm):
    assert credible(arm, "torque_ripple", ["joint0"], sine=0.1, cosine=0.1, periods=periods) is expected


@pytest.mark.parametrize("name", EFFECTS)
def test_typical_sizes_are_credible(name, arm):
    model = arm(2)
    for effect in EFFECTS[name].everywhere(model.body, model.body.keypoint_names):
        effect = effect.bound(model.body)
        parameters = effect.parameters(model.scale)
        values = {p.name: p.grid[len(p.grid) // 2] if p.grid else 0.3 * prior_sd(p) for p in parameters}
        sd = {key: 0.1 * abs(value) for key, value in values.items()}
        assert CATALOGUE[name].credible(effect, values, sd, model.scale)


@pytest.mark.parametrize(
    ("frames", "rate", "expected"), [(1.0, 0.3, True), (3.0, 1.0, True), (9.0, 1.0, False), (2.0, 0.02, False)]
)
def test_a_frame_is_mistimed_by_a_few_frames(frames, rate, expected, arm):
    """By more, where it is one of few that are."""
    model = arm(2)
    mean = {"rate": rate, "sd": frames * model.scale.time.diff().median().item()}
    effect = EFFECTS["timestamp_jitter"]().bound(model.body)
    sd = {name: SURE * value for name, value in mean.items()}
    assert CATALOGUE.of(effect).credible(effect, mean, sd, model.scale) is expected

"""Forces and inertias against closed forms, written out here in numpy."""

import math

import numpy as np
import pytest
import torch
from rod import F64, INERTIA, rod, rolled, torque_of

from invdyn.diagnosis.catalogue import CATALOGUE
from invdyn.models import ArmModel, Link, planar_body
from invdyn.models.effects import (
    Armature,
    BaseMotion,
    ExternalPush,
    GravityTilt,
    InertialError,
    JointCoupling,
    JointLimit,
    JointStiffness,
    Payload,
    TorqueRipple,
)


# -- springs, stops, ripple ------------------------------------------------------------------------
def test_a_spring_swings(having):
    q, _ = rolled(having(rod(), JointStiffness("hinge"), stiffness=2.0, torque=1.0), [0.8], [0.0])
    time = 0.005 * np.arange(101)
    assert q[:, 0] == pytest.approx(0.5 + 0.3 * np.cos(math.sqrt(2.0 / INERTIA) * time), abs=1e-7)


def test_coupling_is_the_slope_of_its_potential(arm, having, states):
    ideal = arm(3)
    model = having(ideal, JointCoupling("joint1", "joint2"), stiffness=0.7, ratio=-0.6, torque=0.7 * 0.4)
    x = states(ideal, 10)
    q = x[:, 3:6].clone().requires_grad_()
    potential = 0.35 * (q[:, 2] + 0.6 * q[:, 1] - 0.4) ** 2
    expected = -torch.autograd.grad(potential.sum(), q)[0]
    torch.testing.assert_close(torque_of(model, ideal, x), expected)


@pytest.mark.parametrize(("side", "sign"), [("upper", 1.0), ("lower", -1.0)])
def test_a_stop_pushes_and_never_pulls(side, sign, having):
    ideal = rod()
    model = having(ideal, JointLimit("hinge", side), angle=sign * 0.5, stiffness=20.0, damping=1.0)
    for depth, speed in ((-0.1, 3.0), (0.1, 0.0), (0.1, 2.0), (0.1, -1.0), (0.1, -3.0)):
        x = torch.tensor([0.0, sign * (0.5 + depth), sign * speed], dtype=F64)
        expected = -sign * max(0.0, 20.0 * depth + speed) if depth > 0 else 0.0
        assert torque_of(model, ideal, x).item() == pytest.approx(expected)
    effect = model.effects.effects[0]
    ones = {key: torch.ones(1) for key in ("angle", "stiffness", "damping")}
    assert CATALOGUE.of(effect).reported(effect, ones)["side"][0] == sign
    with pytest.raises(ValueError, match="side among upper, lower"):
        JointLimit("hinge", "left")


def test_a_stops_damper_begins_anywhere_within_a_step(having):
    """Wherever the joint comes to its stop, speed afterwards is within a two-thousandth of that of steps a fiftieth as
    long. Were the damper on at stages past the angle and off at those before it, it would be a sixtieth off."""
    afterwards = {}
    for parts in (1, 50):
        model = having(rod(rows=11, substeps=parts), JointLimit("hinge"), stiffness=5.0, damping=0.5, angle=0.6)
        starts = torch.linspace(0.0, 0.04, 25, dtype=F64)
        arrived = torch.stack([torch.zeros_like(starts), 0.5 + starts, torch.full_like(starts, 8.0)], -1)
        for row in range(1, 6):
            arrived = model.transition_mean(arrived, row)
        afterwards[parts] = arrived[:, 2]
    assert (afterwards[50] < 7.0).all()
    torch.testing.assert_close(afterwards[1], afterwards[50], rtol=0, atol=0.004)


@pytest.mark.parametrize(("side", "sign", "farthest"), [("upper", 1.0, 0.7), ("lower", -1.0, -1.3)])
def test_a_stop_is_looked_for_short_of_the_farthest_angle(side, sign, farthest):
    """And the closer to it the denser: no stop gives way much."""
    ideal = rod()
    stop = JointLimit("hinge", side).bound(ideal.body)
    seen = ideal.with_observed_range(torch.tensor([-1.3], dtype=F64), torch.tensor([0.7], dtype=F64))
    (angle,) = (p for p in stop.parameters(seen.scale) if p.name == "angle")
    depth = sign * (farthest - np.array(angle.grid))
    assert depth.min() == pytest.approx(0.01)
    assert depth.max() == pytest.approx(1.5)
    assert (np.diff(np.diff(np.sort(depth))) > 0).all()
    (blind,) = (p for p in stop.parameters(ideal.scale) if p.name == "angle")
    assert len(blind.grid) == len(angle.grid)


def test_ripple_is_a_sine_of_the_angle(having, states, arm):
    ideal = arm(2)
    A, N, phase = 0.2, 8, 2.1
    parts = {"sine": A * math.cos(phase), "cosine": A * math.sin(phase), "periods": float(N)}
    model = having(ideal, TorqueRipple("joint1"), **parts)
    x = states(ideal, 10)
    assert torque_of(model, ideal, x)[:, 1].numpy() == pytest.approx(A * np.sin(N * x[:, 3].numpy() + phase))
    effect = model.effects.effects[0]
    told = CATALOGUE.of(effect).reported(effect, {key: torch.tensor([value]) for key, value in parts.items()})
    assert [told[key][0].item() for key in ("amplitude", "phase", "periods")] == pytest.approx([A, phase, N])


# -- the body --------------------------------------------------------------------------------------
def arm_of(links, gravity=(0.0, -9.81)):
    return ArmModel(planar_body("arm", links, gravity=gravity), 0.01 * np.arange(5))


def test_a_payload_is_a_heavier_link(arm, having, states):
    ideal = arm(2, command=None)
    model = having(ideal, Payload(), mass=0.4)
    com = (1.0 * 0.125 + 0.4 * 0.25) / 1.4
    inertia = 1.0 * 0.25**2 / 12 + 1.0 * (com - 0.125) ** 2 + 0.4 * (0.25 - com) ** 2
    heavy = Link("fore", "joint1", "tip1", length=0.25, mass=1.4, com=com, inertia=inertia)
    x = states(ideal, 10)
    expected = arm_of([ideal.body.links[0], heavy]).transition_mean(x, 3)
    torch.testing.assert_close(model.transition_mean(x, 3), expected)


def test_inertial_error_is_another_link(arm, having, states):
    ideal = arm(2, command=None)
    model = having(ideal, InertialError("link0"), mass=-0.2, com=0.03, inertia=0.002)
    other = Link("link0", "joint0", "tip0", length=0.3, mass=1.3, com=0.18, inertia=1.5 * 0.3**2 / 12 + 0.002)
    x = states(ideal, 10)
    torch.testing.assert_close(model.transition_mean(x, 3), arm_of([other, ideal.body.links[1]]).transition_mean(x, 3))


def test_tilt_turns_gravity_counterclockwise(arm, having, states):
    ideal = arm(2, command=None)
    model = having(ideal, GravityTilt(), angle=0.2)
    x = states(ideal, 10)
    tilted = arm_of(ideal.body.links, gravity=(9.81 * math.sin(0.2), -9.81 * math.cos(0.2)))
    torch.testing.assert_close(model.transition_mean(x, 3), tilted.transition_mean(x, 3))
    weightless = planar_body("arm", ideal.body.links, gravity=(0.0, 0.0))
    assert GravityTilt.everywhere(weightless, weightless.keypoint_names) == []


def test_armature_slows_a_swing(having):
    """ω² = m g l/2 / (I + I_a) for small swings about hanging; statics do not change."""
    ideal = rod(gravity=(0.0, -9.81))
    model = having(ideal, Armature("hinge"), inertia=0.03)
    q, _ = rolled(model, [-math.pi / 2 + 1e-4], [0.0])
    omega = math.sqrt(1.5 * 9.81 * 0.15 / (INERTIA + 0.03))
    assert q[:, 0] + math.pi / 2 == pytest.approx(1e-4 * np.cos(omega * 0.005 * np.arange(101)), abs=1e-10)


# -- from outside ----------------------------------------------------------------------------------
@pytest.mark.parametrize(("start", "stop"), [(0.1, 0.2), (0.1013, 0.1987), (0.1511, 0.1621)])
def test_a_push_gives_its_impulse(start, stop, having):
    """A free rod gets l F (t₁ − t₀)/I across it, whatever the edges and however short; none before, none after."""
    lasts = stop - start
    push = {"impulse_x": 0.0, "impulse_y": 0.02 * lasts, "moment": (start + stop) / 2, "duration": lasts}
    model = having(rod(), ExternalPush("tip"), **push)
    _, qd = rolled(model, [0.0], [0.0])
    assert qd[-1, 0] == pytest.approx(0.3 * 0.02 * (stop - start) / INERTIA, rel=1e-5)
    assert np.abs(qd[: int(start / 0.005)]).max() == 0.0
    assert np.ptp(qd[int(stop / 0.005) + 2 :]) == 0.0


def test_a_push_is_reported_as_a_force_between_two_moments():
    values = {"impulse_x": 0.6, "impulse_y": -0.3, "moment": 1.0, "duration": 0.2}
    given = {name: torch.tensor([value], dtype=F64) for name, value in values.items()}
    told = CATALOGUE["external_push"].reported(ExternalPush("tip"), given)
    expected = {"force_x": (3.0, "N"), "force_y": (-1.5, "N"), "start": (0.9, "s"), "stop": (1.1, "s")}
    assert {name: (pytest.approx(value.item()), unit) for name, (value, unit) in told.items()} == expected


def test_a_push_acts_through_the_jacobian(arm, having, states):
    ideal = arm(3)
    model = having(ideal, ExternalPush("tip1"), impulse_x=18.0, impulse_y=-9.0, moment=4.5, duration=9.0)
    x = states(ideal, 6)
    q = x[:, 3:6].clone().requires_grad_()
    tip = ideal.dynamics.keypoints(q, ideal.body_parameters())[:, 1]
    expected = torch.autograd.grad((tip @ torch.tensor([2.0, -1.0], dtype=F64)).sum(), q)[0]
    torch.testing.assert_close(torque_of(model, ideal, x), expected)


def test_a_shaken_base(arm, having, states):
    """Tips move by b(t), and the arm feels gravity g − b̈, b̈ by differences of b."""
    ideal = arm(2, command=None, rows=40)
    parts = {"sine_x": 0.01, "cosine_x": 0.004, "sine_y": -0.006, "cosine_y": 0.003, "frequency": 2.0}
    model = having(ideal, BaseMotion(), **parts)

    def shift(t):
        sine, cosine = np.sin(4 * np.pi * t), np.cos(4 * np.pi * t)
        return np.array([0.01 * sine + 0.004 * cosine, -0.006 * sine + 0.003 * cosine])

    x, t = states(ideal, 5), 17
    elapsed, h = 0.01 * t, 1e-4
    seen = (model.emission(x, t).mean - ideal.emission(x, t).mean)[:, :4].reshape(5, 2, 2)
    assert seen.numpy() == pytest.approx(np.broadcast_to(shift(elapsed), (5, 2, 2)), abs=1e-12)
    bent = (shift(elapsed + h) - 2 * shift(elapsed) + shift(elapsed - h)) / h**2
    body = ideal.body_parameters()
    load = [
        ideal.dynamics.gravity_load(x[:, 2:4], body._replace(gravity=torch.tensor(gravity)))
        for gravity in (np.array([0.0, -9.81]) - bent, np.array([0.0, -9.81]))
    ]
    torch.testing.assert_close(torque_of(model, ideal, x, t), load[1] - load[0], rtol=1e-5, atol=1e-7)


def test_a_shaken_base_is_reported_as_amplitude_and_phase():
    for phase in (0.4, -2.8, 3.0):
        amplitude = np.array([0.02, -0.006])
        values = {}
        for axis, a in zip("xy", amplitude, strict=True):
            values[f"sine_{axis}"] = torch.tensor([a * math.cos(phase)])
            values[f"cosine_{axis}"] = torch.tensor([a * math.sin(phase)])
        told = CATALOGUE["base_motion"].reported(BaseMotion(), values | {"frequency": torch.tensor([2.0])})
        found = [told[key][0].item() for key in ("amplitude_x", "amplitude_y", "phase", "frequency")]
        assert found == pytest.approx([0.02, -0.006, phase, 2.0], abs=1e-6)

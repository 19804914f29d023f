"""Forms that only the second generator has: each does what its law says, in the body's own angles."""

import inspect

import numpy as np
import pytest

from invdyn.blindcheck.effects import EFFECTS
from invdyn.blindcheck.engine import MUJOCO, PINOCCHIO
from invdyn.blindcheck.motion import random_plan
from invdyn.blindcheck.scene import scene
from invdyn.models import Link, planar_body

pytest.importorskip("mujoco")  # yardsticks of the names test
pytest.importorskip("pinocchio")
ARM = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.3, 1.5, 0.14, 0.012), Link("fore", "elbow", "wrist", 0.27, 1.0)],
)
ROWS = np.arange(101) * 0.02
START = ([-1.2, 0.7], [0.5, -1.0])


def swing(row, t, q, qd):
    return np.array([1.5 * np.sin(5 * t) + 1.0, 0.3 * np.cos(7 * t)])


def needed(install):
    """The motion, the times where θ̈ is known, and the torque (N, K) there that it needed beyond the command."""
    world, ideal = PINOCCHIO.world(ARM), PINOCCHIO.world(ARM)
    install(world)
    world.resolve(lambda mobility: 1000.0)  # steps of .2 ms
    real = world.run(ROWS, swing, *START)
    step, per_row = real.time[1] - real.time[0], (len(real.time) - 1) // (len(ROWS) - 1)
    inside = np.arange(1, len(real.time) - 1)
    inside = inside[inside % per_row != 0]
    qdd = (real.qd[inside + 1] - real.qd[inside - 1]) / (2 * step)
    given = real.command[inside // per_row]
    return real, inside, ideal.inverse(real.q[inside], real.qd[inside], qdd) - given, given


def with_effect(name, *where, **parameters):
    return needed(lambda world: PINOCCHIO.effects[name].install(world, *where, **parameters))


def close(torque, expected, rtol=2e-3):
    assert np.abs(expected).max() > 0
    np.testing.assert_allclose(torque, expected, atol=rtol * np.abs(expected).max())


def stribeck(q, v, t):
    return -(0.1 + 0.15 / (1 + (v / 0.7) ** 2)) * np.tanh(v / 0.3)


def stop(q, v, t):
    depth = np.maximum(q - 0.6, 0.0)
    return -np.maximum(30 * depth * (1 + 1.5 * 0.1 * v), 0.0)


LAWS = {
    "stribeck_friction": ({"coulomb": 0.1, "static": 0.25, "half_speed": 0.7, "creep": 0.3}, stribeck),
    "joint_limit": ({"angle": 0.6, "stiffness": 30.0, "side": 1.0, "loss": 0.1}, stop),
    "drifting_friction": (
        {"first": 0.1, "rise": 0.2, "time_constant": 0.7},
        lambda q, v, t: -(0.1 - 0.2 * np.expm1(-t / 0.7)) * v,
    ),
}


@pytest.mark.parametrize(
    ("name", "joint"),
    [("stribeck_friction", 0), ("stribeck_friction", 1), ("joint_limit", 1), ("drifting_friction", 0)],
)
def test_a_torque_at_one_joint(name, joint):
    parameters, law = LAWS[name]
    real, inside, torque, _ = with_effect(name, joint, **parameters)
    expected = np.zeros_like(torque)
    expected[:, joint] = law(real.q[inside, joint], real.qd[inside, joint], real.time[inside])
    close(torque, expected, 0.01)  # friction is constant over a step, also where it changes sign; a stop has an edge


def test_hard_friction_holds_at_rest_and_does_not_creep():
    level = planar_body("arm", ARM.links, gravity=(0, 0))
    world = PINOCCHIO.world(level)
    for joint in (0, 1):
        PINOCCHIO.effects["coulomb_friction"].install(world, joint, 0.5)
    real = world.run(ROWS[:16], lambda *_: np.array([0.4, -0.4]), [0.0, 0.0], [0.0, 0.0])
    assert np.abs(real.q).max() < 1e-9  # free, it would have rotated by radians


@pytest.mark.parametrize(
    ("name", "parameters", "law"),
    [
        (
            "actuator_saturation",
            {"limit": 0.2, "sharpness": 12.0},
            lambda u: u / (1 + (np.abs(u) / 0.2) ** 12) ** (1 / 12),
        ),
        ("actuator_deadzone", {"width": 0.1, "soft": 1.0}, lambda u: u - 0.1 * np.tanh(u / 0.1)),
    ],
)
def test_soft_corners_of_a_drive(name, parameters, law):
    _, _, torque, u = with_effect(name, 1, **parameters)
    close(torque, np.stack([0 * u[:, 1], law(u[:, 1]) - u[:, 1]], axis=-1))


def test_a_delay_between_rows_is_interpolated():
    real, inside, torque, u = with_effect("actuator_delay", 1, delay=0.05)  # of two rows and a half
    row = inside // ((len(real.time) - 1) // (len(ROWS) - 1))
    late = [real.command[np.maximum(row - back, 0), 1] for back in (2, 3)]
    close(torque[:, 1], (late[0] + late[1]) / 2 - u[:, 1])


def test_a_half_wave_has_the_impulse_of_a_constant_force():
    """On an arm that hardly moves meanwhile."""
    ends = []
    peak = np.pi / 2 * np.array([2.0, -3.0])
    for force in ({"force_x": 2.0, "force_y": -3.0}, {"peak_x": peak[0], "peak_y": peak[1]}):
        world = PINOCCHIO.world(planar_body("arm", ARM.links, gravity=(0, 0)))
        PINOCCHIO.effects["external_push"].install(world, 1, start=0.5013, stop=0.5113, **force)
        ends.append(world.run(ROWS[:31], lambda *_: np.zeros(2), [0.3, 0.4], [0.0, 0.0]).qd[-1])
    np.testing.assert_allclose(ends[0], ends[1], rtol=2e-3)
    assert np.abs(ends[0]).min() > 0.01


def test_backlash_is_slack_and_then_springs():
    world = PINOCCHIO.world(ARM)
    PINOCCHIO.effects["backlash"].install(world, 1, 0.02, rotor_share=0.4, gear_stiffness=400.0, gear_damping=0.1)
    seen = []
    world.begin(lambda t, h, q, v, at: seen.append(q[at[1] + 1]))
    real = world.run(ROWS, swing, *START)
    gap = np.array(seen)
    assert gap.max() > 0.0099
    assert gap.min() < -0.0099
    assert np.abs(gap).max() < 0.02
    free = np.abs(gap) < 0.009
    assert 0.02 < free.mean() < 0.9
    elbow = real.heading[:-1, 1] - real.heading[:-1, 0]
    np.testing.assert_allclose(elbow - real.q[:-1, 1], gap, atol=1e-9)  # the link is where its motor is, and the gap


@pytest.mark.parametrize("ends", [[0.0, 0.45, 1.0], [0.0, 1 / 3, 2 / 3, 1.0]])
@pytest.mark.parametrize("inertia", [0.9 * 0.3**2 / 12, 0.3 * 0.9 * 0.3**2 / 12])
def test_a_link_that_is_cut_is_the_link_while_straight(ends, inertia):
    body = planar_body("arm", [Link("upper", "shoulder", "elbow", 0.3, 0.9, 0.13, inertia), ARM.links[1]])
    world = PINOCCHIO.world(body)
    pieces, carried = world.cut_link(0, ends), world.links[1]
    starts = np.cumsum([piece.position[0] for piece in pieces])
    masses = np.array([piece.mass for piece in pieces])
    centres = starts + [piece.com[0] for piece in pieces]
    assert starts[-1] + pieces[-1].tip[0] == pytest.approx(0.3)
    assert starts[-1] + carried.position[0] == pytest.approx(0.3)
    np.testing.assert_allclose(starts, 0.3 * np.array(ends[:-1]))
    assert masses.sum() == pytest.approx(0.9)
    assert (masses * centres).sum() == pytest.approx(0.9 * 0.13)
    about = sum(piece.inertia[2, 2] for piece in pieces) + (masses * (centres - 0.13) ** 2).sum()
    assert about == pytest.approx(inertia)
    assert all(piece.inertia[2, 2] > 0 for piece in pieces)
    assert [(piece.joint, piece.actuated) for piece in pieces] == [(0, True), *[(None, False)] * (len(pieces) - 1)]
    assert world.pieces == [*pieces, carried]


OUTSIDE = {
    "hardening_spring": lambda p, q, v, t: (0 * t, -p["stiffness"] * (q[:, 1] - p["rest_angle"]) ** 3),
    "one_way_friction": lambda p, q, v, t: (0 * t, -p["damping"] * np.where(v[:, 1] * p["side"] > 0, v[:, 1], 0)),
    "cross_viscosity": lambda p, q, v, t: (-p["damping"] * v[:, 1], -p["damping"] * v[:, 0]),
    "alternating_field": lambda p, q, v, t: (
        0 * t,
        p["amplitude"] * np.sin(2 * np.pi * p["frequency"] * t + p["phase"]),
    ),
}
"""In the body's angles, of the elbow."""


@pytest.mark.parametrize("name", PINOCCHIO.unlisted)
def test_what_lies_outside_does_what_its_law_says(name):
    plan = random_plan(np.random.default_rng(3), ARM, False, PINOCCHIO.world)
    plain = PINOCCHIO.world(ARM).run(ROWS, swing, *START)
    about, drawn = scene(ARM, plan, plain, PINOCCHIO.world), {}
    if name not in OUTSIDE:
        world = PINOCCHIO.world(ARM)
        drawn = PINOCCHIO.unlisted[name](world, np.random.default_rng(3), about, 1)
        real = world.run(ROWS, swing, *START)
        per_row = [(len(each.time) - 1) // (len(ROWS) - 1) for each in (real, plain)]
        assert np.abs(real.points[:: per_row[0]] - plain.points[:: per_row[1]]).max() > 1e-4
    else:
        real, inside, torque, _ = needed(
            lambda world: drawn.update(PINOCCHIO.unlisted[name](world, np.random.default_rng(3), about, 1))
        )
        p = {key: value for key, (value, _) in drawn.items()}
        law = OUTSIDE[name](p, real.q[inside], real.qd[inside], real.time[inside])
        close(torque, np.stack(law, axis=-1))
    assert all(np.isfinite(value) and unit for value, unit in drawn.values())


@pytest.mark.parametrize("name", EFFECTS)
def test_draws_are_what_a_form_takes(name):
    plan = random_plan(np.random.default_rng(3), ARM, False, PINOCCHIO.world)
    about = scene(ARM, plan, MUJOCO.world(ARM).run(ROWS, swing, *START), PINOCCHIO.world)
    for seed in range(8):
        drawn = PINOCCHIO.effects[name].size(np.random.default_rng(seed), about, 1, 1.0)
        assert all(isinstance(value, float) and np.isfinite(value) for value in drawn.values())
        if PINOCCHIO.effects[name].install is not None:
            install = PINOCCHIO.effects[name].install
            where = () if EFFECTS[name].site == "arm" else (1,)
            inspect.signature(install).bind(None, *where, **drawn)

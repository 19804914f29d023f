"""Each mechanism does what its equation says, by MuJoCo's inverse dynamics of a body without it.

What a motion needed less what was commanded is the effect's torque; θ̈ is a central difference of θ̇ between two
commands, in error by δ²/6 times a third derivative, some 1e-6 of the torque.
"""

import inspect

import numpy as np
import pytest
import torch

from invdyn.blindcheck.effects import EFFECTS as INJECTED
from invdyn.blindcheck.effects import IN_SPACE
from invdyn.blindcheck.simulator import World
from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body
from invdyn.models.effects import EFFECTS, Backlash

pytest.importorskip("mujoco")
MECHANISMS = {name: effect.install for name, effect in INJECTED.items() if effect.install is not None}
pytestmark = pytest.mark.usefixtures("fine_steps")
ARM = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.3, 1.5, 0.14, 0.012), Link("fore", "elbow", "wrist", 0.27, 1.0)],
)
ROWS = np.arange(101) * 0.02
START = ([-1.2, 0.7], [0.5, -1.0])


def swing(row, t, q, qd):
    return np.array([1.5 * np.sin(5 * t) + 1.0, 0.3 * np.cos(7 * t)])


def moved(*effect, body=ARM):
    """A world with one effect, its motion, and the torque that the motion needed beyond the command."""
    world = World(body)
    name, *where, parameters = effect
    MECHANISMS[name](world, *where, **parameters)
    real = world.run(ROWS, swing, *START)
    return world, real, *residual(real, World(body))


def residual(real, ideal):
    """(steps used, torque beyond the command there (N, K), θ̈ there)."""
    step, per_row = real.time[1] - real.time[0], (len(real.time) - 1) // (len(ROWS) - 1)
    inside = np.arange(1, len(real.time) - 1)
    inside = inside[(inside % per_row != 0)]
    qdd = (real.qd[inside + 1] - real.qd[inside - 1]) / (2 * step)
    return inside, ideal.inverse(real.q[inside], real.qd[inside], qdd) - real.command[inside // per_row], qdd


def close(torque, expected, rtol=1e-3):
    """Equal to rtol of the largest, in every joint."""
    np.testing.assert_allclose(torque, expected, atol=rtol * np.abs(expected).max())


ONE = {
    "viscous_friction": ({"damping": 0.2}, lambda q, v, t: -0.2 * v),
    "quadratic_drag": ({"drag": 0.1}, lambda q, v, t: -0.1 * v * np.abs(v)),
    "joint_stiffness": ({"stiffness": 0.8, "rest_angle": 0.3}, lambda q, v, t: -0.8 * (q - 0.3)),
    "torque_ripple": ({"amplitude": 0.2, "periods": 6, "phase": 0.4}, lambda q, v, t: 0.2 * np.sin(6 * q + 0.4)),
    "drifting_friction": ({"damping": 0.1, "slope": 0.1}, lambda q, v, t: -(0.1 + 0.1 * t) * v),
}


@pytest.mark.parametrize("joint", [0, 1])
@pytest.mark.parametrize("name", ONE)
def test_a_torque_at_one_joint(name, joint):
    parameters, equation = ONE[name]
    _, real, inside, torque, _ = moved(name, joint, parameters)
    expected = np.zeros_like(torque)
    expected[:, joint] = equation(real.q[inside, joint], real.qd[inside, joint], real.time[inside])
    close(torque, expected)


@pytest.mark.parametrize("name", ["coulomb_friction", "stribeck_friction", "load_friction"])
def test_dry_friction_when_it_slides(name):
    parameters = {
        "coulomb_friction": {"torque": 0.15},
        "stribeck_friction": {"coulomb": 0.1, "static": 0.25, "velocity": 0.8},
        "load_friction": {"coefficient": 0.2},
    }[name]
    _, real, inside, torque, _ = moved(name, 1, parameters)
    v, still = real.qd[inside, 1], np.zeros((len(inside), 2))
    command = real.command[inside // ((len(real.time) - 1) // (len(ROWS) - 1))][:, 1]
    load = command + World(ARM).inverse(real.q[inside], real.qd[inside], still)[:, 1]
    size = {
        "coulomb_friction": 0.15,
        "stribeck_friction": 0.1 + 0.15 * np.exp(-((v / 0.8) ** 2)),
        "load_friction": 0.2 * np.abs(load),
    }[name]
    slides = (np.abs(v) > 0.1) & (inside > 1)  # the first step knows no load yet
    assert slides.mean() > 0.5
    close(torque[slides, 1], (-size * np.sign(v))[slides], 0.02)
    assert np.abs(torque[slides, 0]).max() < 2e-3


def test_dry_friction_holds_at_rest():
    level = planar_body("arm", ARM.links, gravity=(0, 0))
    world = World(level)
    MECHANISMS["coulomb_friction"](world, 0, 0.5)
    MECHANISMS["coulomb_friction"](world, 1, 0.5)
    real = world.run(ROWS, lambda *_: np.array([0.4, -0.4]), [0.0, 0.0], [0.0, 0.0])
    assert np.abs(real.q[-1]).max() < 1e-3  # free, it would have rotated by radians


def test_dry_friction_turns_around_with_the_motion():
    """A rod thrown against a torque: MuJoCo's friction creeps through the turn for no more than two steps."""
    inertia, level, push = 1.0 * 0.3**2 / 3, 0.3, -0.6
    world = World(planar_body("rod", [Link("rod", "hinge", "tip", 0.3, 1.0)], gravity=(0, 0)))
    MECHANISMS["coulomb_friction"](world, 0, level)
    real = world.run(ROWS, lambda *_: np.array([push]), [0.0], [6.0])
    stop = 6.0 * inertia / (level - push)
    after = (push + level) / inertia * (real.time - stop)
    late = real.time > 1.1 * stop
    assert late.sum() > 1000
    loss = 2 * 2e-4 * level / inertia
    np.testing.assert_allclose(real.qd[late, 0], after[late], atol=loss)


def test_coupling_pulls_on_both():
    _, real, inside, torque, _ = moved("joint_coupling", 1, {"stiffness": 0.5, "ratio": 0.7, "rest_angle": 0.4})
    pull = -0.5 * (real.q[inside, 1] - 0.7 * real.q[inside, 0] - 0.4)
    close(torque, np.stack([-0.7 * pull, pull], axis=-1))


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_limit_pushes_and_never_pulls(side):
    parameters = {"angle": 0.6, "stiffness": 30.0, "damping": 0.3, "side": side}
    _, real, inside, torque, _ = moved("joint_limit", 1, parameters)
    depth = side * (real.q[inside, 1] - 0.6)
    push = -side * np.maximum(0.0, 30.0 * depth + 0.3 * side * real.qd[inside, 1]) * (depth > 0)
    smooth = np.abs(depth) > 0.02  # a difference across the edge is neither here nor there
    assert (push[smooth] != 0).any()
    close(torque[smooth, 1], push[smooth], 0.01)


def test_armature_resists_its_own_acceleration():
    _, _, _, torque, qdd = moved("armature", 1, {"inertia": 0.02})
    close(torque, np.stack([np.zeros(len(qdd)), -0.02 * qdd[:, 1]], axis=-1), 0.01)


def test_gain_saturation_and_deadzone():
    for name, parameters, equation in (
        ("actuator_gain", {"gain": -0.2}, lambda u: 0.8 * u),
        ("actuator_saturation", {"limit": 0.2}, lambda u: np.clip(u, -0.2, 0.2)),
        ("actuator_deadzone", {"width": 0.1}, lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.1, 0.0)),
    ):
        _, real, inside, torque, _ = moved(name, 1, parameters)
        u = real.command[inside // ((len(real.time) - 1) // (len(ROWS) - 1))][:, 1]
        close(torque, np.stack([0 * u, equation(u) - u], axis=-1))


def given(name, parameters):
    """Torque that the elbow's motor gave, by time."""
    world = World(ARM)
    MECHANISMS[name](world, 1, **parameters)
    seen = []
    world.on_step(lambda t, model, data: seen.append((t, data.qfrc_actuator[1])))
    real = world.run(ROWS, swing, *START)
    t, force = np.array(seen).T
    return real, t[1:] - (t[1] - t[0]), force[1:]  # what a step finds is the force of the one before


def test_delay_shifts_the_command():
    real, t, force = given("actuator_delay", {"delay": 0.0333})
    row = np.clip(np.floor((t - 0.0333) / 0.02 + 1e-9).astype(int), 0, None)
    steady = np.abs(((t - 0.0333) / 0.02) % 1 - 0.5) < 0.45  # not where the step lies across a change
    np.testing.assert_allclose(force[steady], real.command[row[steady], 1], atol=1e-12)


def test_lag_filters_the_command():
    real, t, force = given("actuator_lag", {"time_constant": 0.05})
    dt, u, expected = t[1] - t[0], real.command[0, 1], []
    for time in t:
        expected.append(u)
        u += (real.command[int(time / 0.02 + 1e-6), 1] - u) * -np.expm1(-dt / 0.05)
    assert np.abs(force - expected).max() < 0.02 * np.abs(force).max()  # RK4's last stage is a step ahead


def test_lag_has_the_time_constant_that_it_was_given():
    world = World(ARM)
    MECHANISMS["actuator_lag"](world, 1, 0.05)
    world.run(ROWS[:6], lambda row, t, q, qd: np.array([0.0, float(row > 0)]), *START)
    np.testing.assert_allclose(world.data.act, [-np.expm1(-0.08 / 0.05)], rtol=1e-9)  # filtered for four rows


def test_inertial_changes_are_those_of_another_body():
    loaded, _, _, _, _ = moved("payload", {"mass": 0.3})
    com = (1.0 * 0.135 + 0.3 * 0.27) / 1.3
    inertia = 0.27**2 / 12 + (com - 0.135) ** 2 + 0.3 * (0.27 - com) ** 2
    heavy = ARM.with_values(mass=[1.5, 1.3], com=[0.14, com], inertia=[0.012, inertia])
    q = np.array([0.3, -0.8])
    np.testing.assert_allclose(loaded.inertia(q), World(heavy).inertia(q), rtol=1e-9)
    _, real, *_ = moved("inertial_error", 0, {"mass": 0.2, "com": -0.02, "inertia": 0.001})
    other = ARM.with_values(mass=[1.7, 1.0], com=[0.12, 0.135], inertia=[0.013, 0.27**2 / 12])
    np.testing.assert_allclose(real.q, World(other).run(ROWS, swing, *START).q, atol=1e-9)


def test_tilt_turns_gravity():
    _, real, *_ = moved("gravity_tilt", {"angle": 0.1})
    tilted = planar_body("arm", ARM.links, gravity=(9.81 * np.sin(0.1), -9.81 * np.cos(0.1)))
    np.testing.assert_allclose(real.q, World(tilted).run(ROWS, swing, *START).q, atol=1e-9)


def test_a_push_is_a_force_at_a_tip():
    push = {"force_x": 2.0, "force_y": -3.0, "start": 0.5, "stop": 0.9}
    for tip in (0, 1):
        _, real, inside, torque, _ = moved("external_push", tip, push)
        arm = real.points[inside, tip + 1, None] - real.points[inside, : tip + 1]
        expected = np.zeros_like(torque)
        expected[:, : tip + 1] = arm[..., 0] * -3.0 - arm[..., 1] * 2.0
        on = (real.time[inside] > 0.502) & (real.time[inside] < 0.898)
        off = (real.time[inside] < 0.498) | (real.time[inside] > 0.902)
        close(torque[on], expected[on], 2e-3)
        assert np.abs(torque[off]).max() < 1e-3


def test_a_moving_base_drags_the_arm_along():
    parameters = {"amplitude_x": 0.02, "amplitude_y": 0.01, "frequency": 2.0, "phase": 0.3}
    _, real, inside, torque, _ = moved("base_motion", parameters)
    swings = np.sin(4 * np.pi * real.time + 0.3)
    np.testing.assert_allclose(real.points[:, 0], swings[:, None] * [0.02, 0.01], atol=1e-12)
    # −Σ m (∂r/∂θ)·a_b: gravity's load per unit of g, along x and y, times −a_b
    expected = 0.0
    for axis, size in ((0, 0.02), (1, 0.01)):
        g = np.eye(2)[axis]
        still = np.zeros((len(inside), 2))
        pull = -World(planar_body("arm", ARM.links, gravity=tuple(g))).inverse(real.q[inside], still, still)
        expected = expected + pull * (size * (4 * np.pi) ** 2 * swings[inside])[:, None]
    close(torque, expected, 3e-3)


def hinges(world):
    """Angle and velocity of every hinge, hidden ones too, at every step of a run that is to come."""
    seen = []
    world.on_step(lambda t, model, data: seen.append(np.concatenate([data.qpos, data.qvel])))
    return seen


@pytest.mark.parametrize("link", [0, 1])
def test_a_flexible_link_is_two_halves_and_a_spring(link):
    world, halves = World(ARM), World(ARM)
    MECHANISMS["link_flexibility"](world, link, 20.0, 0.05)
    MECHANISMS["link_flexibility"](halves, link, 0.0, 0.0)
    straight = halves.inertia(np.array([0.3, 0.0, -0.8]) if link == 0 else np.array([0.3, -0.8, 0.0]))
    driven = [0, 2] if link == 0 else [0, 1]
    np.testing.assert_allclose(straight[np.ix_(driven, driven)], World(ARM).inertia(np.array([0.3, -0.8])), rtol=1e-9)
    seen = hinges(world)
    real = world.run(ROWS, swing, *START)
    q, qd = np.split(np.array(seen), 2, axis=1)
    step, bend = real.time[1] - real.time[0], link + 1
    inside = np.arange(1, len(q) - 1)
    inside = inside[inside % ((len(real.time) - 1) // (len(ROWS) - 1)) != 0]
    torque = halves.inverse(q[inside], qd[inside], (qd[inside + 1] - qd[inside - 1]) / (2 * step))
    close(torque[:, bend], -20.0 * q[inside, bend] - 0.05 * qd[inside, bend], 0.01)


def test_backlash_lets_the_link_move_by_its_width():
    world = World(ARM)
    MECHANISMS["backlash"](world, 1, 0.02)
    seen = hinges(world)
    world.run(ROWS, swing, *START)
    gap = np.array(seen)[:, 2]
    assert np.abs(gap).max() < 0.012  # stops are stiff, not rigid
    assert gap.min() < -0.0095
    assert gap.max() > 0.0095
    tight = World(ARM)
    MECHANISMS["backlash"](tight, 1, 1e-5)
    ideal = World(ARM).run(ROWS, swing, *START)
    assert np.abs(tight.run(ROWS, swing, *START).q - ideal.q).max() < 2e-3


OWN = {
    "nothing": ((), {}, 1e-3),
    "joint_stiffness": ((1,), {"stiffness": 3.0, "rest_angle": 0.3}, 1e-3),
    "joint_limit": ((1,), {"angle": 0.6, "stiffness": 10.0, "damping": 0.02, "side": 1.0}, 2e-3),
    "torque_ripple": ((1,), {"amplitude": 0.5, "periods": 8.0, "phase": 0.0}, 1e-3),
    "armature": ((1,), {"inertia": 0.01}, 2e-3),
    "viscous_friction": ((1,), {"damping": 0.05}, 0.01),
    "external_push": ((1,), {"force_x": 4.0, "force_y": 6.0, "start": 0.1, "stop": 0.3}, 1e-3),
}
"""Effects combined with backlash: where, parameters, and the tolerance of the model against MuJoCo in .5 s, rad."""
STATED = {
    "joint_stiffness": (("elbow",), {"stiffness": 3.0, "torque": 0.9}),
    "joint_limit": (("elbow", "upper"), {"angle": 0.6, "stiffness": 10.0, "damping": 0.02}),
    "torque_ripple": (("elbow",), {"sine": 0.5, "cosine": 0.0, "periods": 8.0}),
    "external_push": (("wrist",), {"impulse_x": 0.8, "impulse_y": 1.2, "moment": 0.2, "duration": 0.2}),
}
"""The same as effects of the model have them, where that is something else."""


@pytest.mark.quick("nothing", "joint_limit", "viscous_friction")
@pytest.mark.parametrize("name", OWN)
def test_effects_of_a_joint_are_on_the_motors_side_of_its_backlash(name):
    """There it turns the rotor, and the rotor's angle is what it knows of; what pulls at the link does neither."""
    where, parameters, apart = OWN[name]
    rows, width = 0.005 * np.arange(101), 0.06
    commands = np.stack([1.5 * np.sin(5 * rows) + 1, 1.5 * np.cos(9 * rows)], axis=-1)
    world, rigid = World(ARM), World(ARM)
    model = ArmModel(ARM, rows, observation=Observation(Keypoints(range(2))), command=commands)
    given = {Backlash("elbow"): {"width": width}}
    if name != "nothing":
        MECHANISMS[name](world, *where, **parameters)
        MECHANISMS[name](rigid, *where, **parameters)
        at, values = STATED.get(name, (("elbow",), parameters))
        given[EFFECTS[name](*at)] = values
    MECHANISMS["backlash"](world, 1, width)
    real, ideal = (each.run(rows, lambda row, *_: commands[row], *START) for each in (world, rigid))
    values = {f"effect.{effect.key}.{key}": [v] for effect, own in given.items() for key, v in own.items()}
    model = model.with_effects(*given)
    model = model.replace(**{key: torch.tensor(v, dtype=model.dtype) for key, v in values.items()})
    path = [torch.tensor([*np.zeros(4), *START[0], *START[1]], dtype=model.dtype)]
    for row in range(1, len(rows)):
        path.append(model.transition_mean(path[-1], row))
    seen, rigid = (np.diff(each.heading, axis=1, prepend=0.0)[:: (len(each.time) - 1) // 100] for each in (real, ideal))
    assert np.abs(torch.stack(path)[:, 4:6].numpy() - seen).max() < apart
    assert np.abs(seen - rigid).max() > 3 * apart


def test_every_effect_has_units_and_sizes():
    assert all(effect.units and effect.size for effect in INJECTED.values())
    for name, function in MECHANISMS.items():
        parameters = [
            p for p in inspect.signature(function).parameters if p not in ("world", "joint", "link", "keypoint")
        ]
        known = INJECTED[name].units | (IN_SPACE[name].units if name in IN_SPACE else {})
        assert sorted(parameters) == sorted([*known, *OTHER_FORMS.get(name, ())])


OTHER_FORMS = {"actuator_deadzone": ["soft"], "joint_limit": ["loss"]}
"""Parameters of forms that the second generator draws; no answer has them among the catalogue's."""

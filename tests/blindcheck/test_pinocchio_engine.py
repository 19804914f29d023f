"""The second generator of reality against the first: no effect, and each effect that both simulate in the same form."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from invdyn.blindcheck.effects import EFFECTS
from invdyn.blindcheck.engine import MUJOCO, PINOCCHIO
from invdyn.blindcheck.motion import random_body, random_plan, simulated
from invdyn.blindcheck.pinocchio import simulator
from invdyn.models import Link, planar_body

pytest.importorskip("mujoco")
pytest.importorskip("pinocchio")
ARM = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.3, 1.5, 0.14, 0.012), Link("fore", "elbow", "wrist", 0.27, 1.0)],
    base=(0.1, -0.2),
)
ROWS = np.arange(76) * 0.02
START = ([-1.2, 0.7], [0.5, -1.0])


def swing(row, t, q, qd):
    return np.array([1.5 * np.sin(5 * t) + 1.0, 0.3 * np.cos(7 * t)])


def moved(engine, *effect, body=ARM):
    """Where an arm with one effect went, on the rows of the command."""
    world = engine.world(body)
    if effect:
        name, *where, parameters = effect
        engine.effects[name].install(world, *where, **parameters)
    real = world.run(ROWS, swing, *START)
    return real, real.points[:: (len(real.time) - 1) // (len(ROWS) - 1)]


@pytest.mark.parametrize(
    ("joints", "horizontal", "passive"), [(1, False, False), (2, True, False), (3, False, False), (3, False, True)]
)
def test_without_an_effect_both_go_the_same_way(joints, horizontal, passive):
    body = random_body(np.random.default_rng([1, joints]), joints, horizontal)
    plans = [random_plan(np.random.default_rng(2), body, passive, engine.world) for engine in (MUJOCO, PINOCCHIO)]
    np.testing.assert_allclose(plans[0].stiffness, plans[1].stiffness, rtol=1e-9)
    plan = replace(plans[0], duration=3.0)
    paths = [simulated(engine.world(body), engine.world(body), plan) for engine in (MUJOCO, PINOCCHIO)]
    rows = len(paths[0].command) - 1
    one, other = (path.points[:: (len(path.time) - 1) // rows] for path in paths)
    reach = sum(link.length for link in body.links)
    # a freely falling chain magnifies round-off and the steps' errors; noise is 1e-3 of the reach and more
    assert np.abs(one - other).max() < (1e-5 if passive else 1e-7) * reach
    np.testing.assert_allclose(paths[0].command, paths[1].command, rtol=0, atol=1e-5 * np.abs(paths[0].command).max())


def test_energy_stays_where_nothing_takes_it():
    rng = np.random.default_rng(3)
    body = random_body(rng, 3, False)
    world = PINOCCHIO.world(body)
    real = simulated(world, PINOCCHIO.world(body), replace(random_plan(rng, body, True, PINOCCHIO.world), duration=4.0))
    pin, of = world.pin, (world.model, world.data)
    kinetic = np.array([pin.computeKineticEnergy(*of, *row) for row in zip(real.q, real.qd, strict=True)])
    energy = kinetic + [pin.computePotentialEnergy(*of, row) for row in real.q]
    assert np.abs(energy - energy[0]).max() < 1e-6 * np.ptp(kinetic)  # RK4 loses a little with every step


def test_the_error_falls_with_the_fourth_power_of_the_step(monkeypatch):
    ends = []
    for step in (4e-3, 2e-3, 1e-3):
        monkeypatch.setattr(simulator, "MAX_STEP", step)
        monkeypatch.setattr(simulator, "MAX_SWING_FRACTION", 1.0)
        ends.append(moved(PINOCCHIO)[1])
    coarse, fine = (np.abs(each - ends[2]).max() for each in ends[:2])
    # errors e, e/16, e/256 leave differences of 255 and 15 parts
    assert coarse / fine == pytest.approx(17, rel=0.3)


SAME_FORM = {
    "viscous_friction": ((1,), {"damping": 0.2}),
    "coulomb_friction": ((1,), {"torque": 0.15}),
    "stribeck_friction": ((0,), {"coulomb": 0.1, "static": 0.25, "velocity": 0.8}),
    "load_friction": ((1,), {"coefficient": 0.2}),
    "quadratic_drag": ((0,), {"drag": 0.1}),
    "joint_stiffness": ((1,), {"stiffness": 0.8, "rest_angle": 0.3}),
    "joint_coupling": ((1,), {"stiffness": 0.5, "ratio": -0.7, "rest_angle": 0.4}),
    "joint_limit": ((1,), {"angle": 0.6, "stiffness": 30.0, "damping": 0.3, "side": 1.0}),
    "torque_ripple": ((1,), {"amplitude": 0.2, "periods": 6.0, "phase": 0.4}),
    "drifting_friction": ((0,), {"damping": 0.1, "slope": 0.1}),
    "payload": ((), {"mass": 0.3}),
    "inertial_error": ((0,), {"mass": 0.2, "com": -0.02, "inertia": 0.001}),
    "gravity_tilt": ((), {"angle": 0.1}),
    "armature": ((1,), {"inertia": 0.02}),
    "actuator_gain": ((1,), {"gain": -0.2}),
    "actuator_delay": ((1,), {"delay": 0.04}),
    "actuator_lag": ((1,), {"time_constant": 0.05}),
    "actuator_saturation": ((0,), {"limit": 1.5}),
    "actuator_deadzone": ((1,), {"width": 0.1}),
    "external_push": ((1,), {"force_x": 2.0, "force_y": -3.0, "start": 0.5034, "stop": 0.8012}),
    "base_motion": ((), {"amplitude_x": 0.02, "amplitude_y": 0.01, "frequency": 2.0, "phase": 0.3}),
    "link_flexibility": ((0,), {"stiffness": 20.0, "damping": 0.05}),
}
"""Effects of the dynamics but backlash, whose teeth are rigid in one engine and springs in the other."""
COARSE = {"coulomb_friction", "stribeck_friction", "load_friction", "joint_limit", "external_push", "base_motion"}
"""Whose force MuJoCo holds over a step of .2 ms, or turns around in one: first order in the step."""


@pytest.mark.usefixtures("fine_steps")
@pytest.mark.parametrize("name", SAME_FORM)
def test_an_effect_of_the_same_form_does_the_same(name):
    where, parameters = SAME_FORM[name]
    _, plain = moved(PINOCCHIO)
    one, other = (moved(engine, name, *where, parameters)[1] for engine in (MUJOCO, PINOCCHIO))
    changed = np.abs(other - plain).max()
    assert changed > 1e-3
    assert np.abs(other - one).max() < (0.01 if name in COARSE else 1e-3) * changed


def test_every_effect_of_the_dynamics_has_a_form():
    installed = [{name for name, each in engine.effects.items() if each.install} for engine in (PINOCCHIO, MUJOCO)]
    assert installed == 2 * [{*SAME_FORM, "backlash"}]
    assert set(PINOCCHIO.unlisted) == set(MUJOCO.unlisted)
    assert set(EFFECTS) >= installed[0]


def test_a_run_that_diverges_is_nan_and_no_more():
    time = np.arange(100) * 0.01
    real = PINOCCHIO.world(ARM).run(time, lambda row, t, q, qd: 1e4 * np.ones(2), [0.0, 0.0], [0.0, 0.0])
    assert np.isfinite(real.q[0]).all()
    assert np.isnan(real.q[-1]).all()


def test_without_pinocchio_it_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    with pytest.raises(ImportError, match=r"invdyn\[robots\]"):
        PINOCCHIO.world(ARM)

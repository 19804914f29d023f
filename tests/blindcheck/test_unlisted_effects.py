"""What lies outside the catalogue is simulated by the laws that its docstrings state."""

import numpy as np
import pytest
from pendulum import ARM

from invdyn.blindcheck.motion import random_plan, simulated
from invdyn.blindcheck.scene import scene
from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.unlisted_effects import UNLISTED

pytest.importorskip("mujoco")


def simulation(name):
    """The parameters that were drawn, the arm's motion without the effect, and with it."""
    rng = np.random.default_rng(3)
    plan = random_plan(rng, ARM, False)
    ideal = simulated(World(ARM), World(ARM), plan)
    world = World(ARM)
    drawn = UNLISTED[name](world, rng, scene(ARM, plan, ideal), 1)
    return drawn, ideal, simulated(world, World(ARM), plan)


@pytest.mark.quick("detent", "hardening_spring", "one_way_friction")
@pytest.mark.parametrize("name", UNLISTED)
def test_what_lies_outside_moves_the_arm(name):
    drawn, ideal, real = simulation(name)
    assert all(np.isfinite(value) and unit for value, unit in drawn.values())
    assert np.isfinite(real.q).all()
    assert np.abs(real.points - ideal.points).max() > 1e-4


def detent(p, q, v, t):
    x = (q[:, 1] - p["angle"]) / p["width"]
    return 0 * x, -p["amplitude"] * x * np.exp(0.5 - x**2 / 2)


LAWS = {
    "hardening_spring": lambda p, q, v, t: (0 * t, -p["stiffness"] * (q[:, 1] - p["rest_angle"]) ** 3),
    "detent": detent,
    "alternating_field": lambda p, q, v, t: (
        0 * t,
        p["amplitude"] * np.sin(2 * np.pi * p["frequency"] * t + p["phase"]),
    ),
    "cross_viscosity": lambda p, q, v, t: (-p["damping"] * v[:, 1], -p["damping"] * v[:, 0]),
    "one_way_friction": lambda p, q, v, t: (0 * t, -p["damping"] * np.where(v[:, 1] * p["side"] > 0, v[:, 1], 0)),
    "cable": lambda p, q, v, t: (0 * t, p["amplitude"] * np.sin(2 * q[:, 0] + p["phase"])),
}


@pytest.mark.parametrize("name", LAWS)
def test_it_does_what_its_law_says(name):
    """The torque that the motion needed beyond the command, θ̈ a central difference between two commands."""
    drawn, _, real = simulation(name)
    inside, per_row = np.arange(1, len(real.time) - 1), (len(real.time) - 1) // (len(real.command) - 1)
    inside = inside[inside % per_row != 0]
    q, qd, step = real.q[inside], real.qd[inside], real.time[1] - real.time[0]
    qdd = (real.qd[inside + 1] - real.qd[inside - 1]) / (2 * step)
    torque = World(ARM).inverse(q, qd, qdd) - real.command[inside // per_row]
    expected = np.stack(LAWS[name]({k: v for k, (v, _) in drawn.items()}, q, qd, real.time[inside]), -1)
    np.testing.assert_allclose(torque, expected, atol=1e-3 * np.abs(expected).max())

"""The non-ideal mechanisms of reality against ODE solvers."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from invdyn.blindcheck.effects.joints import stribeck_friction
from invdyn.blindcheck.simulator import World
from invdyn.models import Link, planar_body

pytest.importorskip("mujoco")
pytestmark = pytest.mark.usefixtures("fine_steps")
ROWS = np.arange(101) * 0.02


def test_friction_through_bristles_is_the_law_of_lugre():
    """A rod that turns around twice a second, and an ODE solver's LuGre; the force is constant over steps of .2 ms."""
    inertia, law = 1.0 * 0.3**2 / 3, {"coulomb": 0.1, "static": 0.25, "velocity": 0.8}
    stiff, damping = 120.0, 0.8
    world = World(planar_body("rod", [Link("rod", "hinge", "tip", 0.3, 1.0)], gravity=(0, 0)))
    stribeck_friction(world, 0, **law, bristle_stiffness=stiff, bristle_damping=damping)
    real = world.run(ROWS, lambda row, t, q, qd: np.array([0.4 * np.sin(6 * t)]), [0.0], [0.0])

    def slope(t, x):
        level = 0.1 + 0.15 * np.exp(-((x[1] / 0.8) ** 2))
        bending = x[1] - stiff * abs(x[1]) / level * x[2]
        row = min(int(t / 0.02 + 1e-9), 99)
        return [x[1], (0.4 * np.sin(6 * ROWS[row]) - stiff * x[2] - damping * bending) / inertia, bending]

    x, q = np.zeros(3), [0.0]
    for start, end in zip(ROWS[:-1], ROWS[1:] - 1e-12, strict=True):
        x = solve_ivp(slope, (start, end), x, method="LSODA", rtol=1e-9, atol=1e-12).y[:, -1]
        q.append(x[0])
    np.testing.assert_allclose(real.q[:: (len(real.q) - 1) // 100, 0], q, atol=2e-4)
    again = world.run(ROWS, lambda row, t, q, qd: np.array([0.4 * np.sin(6 * t)]), [0.0], [0.0])
    np.testing.assert_array_equal(again.q, real.q)  # bristles begin unbent

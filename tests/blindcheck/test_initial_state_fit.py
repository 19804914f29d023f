"""The best states to start from: another start of the same world is found, another world is not."""

import numpy as np
import pytest

from invdyn.blindcheck.effects.disturbances import external_push
from invdyn.blindcheck.initial_state_fit import unlike_any_start
from invdyn.blindcheck.simulator import World
from invdyn.models import Link, planar_body

pytest.importorskip("mujoco")
NOISE = 1e-3
LINKS = [Link("upper", "shoulder", "elbow", 0.3, 1.0), Link("lower", "elbow", "wrist", 0.25, 0.6)]
ARM = planar_body("arm", LINKS, gravity=(0.0, -9.81))
TIME = np.arange(401) * 0.01
FRAMES = TIME[10:]


def run(world):
    """Let go almost upright: it falls, and whirls as only a double pendulum does."""
    return world.run(TIME, lambda row, t, q, qd: np.zeros(2), [1.4, 0.3], [0.0, 0.5])


def film(trajectory):
    rows = np.searchsorted(trajectory.time, FRAMES - 1e-9)
    return trajectory.points[rows, 1:]


def unlike(real, stated):
    return unlike_any_start(stated, ARM, lambda: World(ARM), film, film(real), FRAMES, NOISE)


@pytest.mark.quick("0.02")
@pytest.mark.parametrize("off", [0.02, 0.1])
def test_another_start_of_the_same_world_is_found(off):
    real = run(World(ARM))
    rng = np.random.default_rng(1)
    stated = real._replace(q=real.q + off * rng.standard_normal(2), qd=real.qd + 5 * off * rng.standard_normal(2))
    assert np.abs(unlike(real, stated)).max() < 0.3


@pytest.mark.long
def test_another_world_is_not():
    pushed = World(ARM)
    external_push(pushed, 1, 3.0, 0.0, 2.5, 2.8)
    real = run(pushed)
    left = unlike(real, real)
    during = (FRAMES > 2.5) & (FRAMES < 3.2)
    assert np.abs(left[during]).max() > 5
    assert np.abs(left[FRAMES < 1.2]).max() < 0.3

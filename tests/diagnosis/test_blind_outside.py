"""What lies outside the catalogue is played, and seen."""

import numpy as np
import pytest
from pendulum import ARM

from invdyn.diagnosis.blind.motion import play, random_plan
from invdyn.diagnosis.blind.outside import OUTSIDE
from invdyn.diagnosis.blind.reality import World
from invdyn.diagnosis.blind.sizes import scene

pytest.importorskip("mujoco")


@pytest.mark.parametrize("name", OUTSIDE)
def test_what_lies_outside_moves_the_arm(name):
    rng = np.random.default_rng(3)
    plan = random_plan(rng, ARM, False)
    ideal = play(World(ARM), World(ARM), plan)
    world = World(ARM)
    drawn = OUTSIDE[name](world, rng, scene(ARM, plan, ideal), 1)
    assert all(np.isfinite(value) and unit for value, unit in drawn.values())
    real = play(world, World(ARM), plan)
    assert np.isfinite(real.q).all()
    assert np.abs(real.points - ideal.points).max() > 1e-4

"""Parts of a `World` that mechanisms set: hinges, motors, applied torques. Joints count from 0 at the base."""

from collections.abc import Callable
from typing import Any

import numpy as np

from invdyn.blindcheck.simulator import World, set_part


def set_joint(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of the hinge that a joint's motor drives, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.joint(world.pieces[world.hinge(joint)].hinge), attributes))


def set_motor(world: World, joint: int, **attributes: Any) -> None:
    """Set attributes of a joint's motor, as mjSpec calls them."""
    world.on_spec(lambda spec: set_part(spec.actuator(world.pieces[world.hinge(joint)].hinge), attributes))


def applied(world: World, joint: int, torque: Callable[[float, np.ndarray, np.ndarray], float]) -> None:
    """Apply `torque(t, q, qd)`, N·m, at a joint; q and qd are those of the chain's joints (K,)."""

    def act(t: float, model: Any, data: Any) -> None:
        driven = [world.hinge(k) for k in range(world.num_joints)]
        # the force is constant over the step, so it is taken at the middle, from the last acceleration
        half = model.opt.timestep / 2
        q, qd = data.qpos[driven] + half * data.qvel[driven], data.qvel[driven] + half * data.qacc[driven]
        data.qfrc_applied[driven[joint]] += torque(t + half, q, qd)

    world.on_step(act)

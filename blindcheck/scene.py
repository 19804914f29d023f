"""How large an effect is: drawn around the typical values of the catalogue, scaled to a body and its motion.

A joint's yardsticks are the root mean square of its torque τ and of its velocity ω in the motion without the
effect; a mouse's limb and an industrial arm then meet the same share of friction. `strength` 1 is typical, 0.25 weak:
what the effect does to the recording grows in proportion, at least to begin with.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from invdyn.blindcheck.motion import Plan
from invdyn.blindcheck.simulator import World
from invdyn.blindcheck.stretched import pendulum_frequency, reach
from invdyn.blindcheck.world import Trajectory
from invdyn.models import Body

NONIDEAL_FRACTION = 0.4
"""Share of friction, tissue and lenses that are not ideal."""


@dataclass(frozen=True)
class Scene:
    """A body, planar or a tree, its motion without the effect, and the yardsticks that follow; (K,) by joint.

    `torque`, `peak`: rms and largest torque, N·m; `speed` rad/s; `inertia` kg·m² of the joint with what it carries.
    """

    body: Any
    plan: Plan
    motion: Trajectory
    torque: np.ndarray
    peak: np.ndarray
    speed: np.ndarray
    inertia: np.ndarray

    @property
    def reach(self) -> float:
        """Length of the outstretched body, m."""
        return reach(self.body)


def scene(body: Body, plan: Plan, motion: Trajectory, made: Callable[[Any], Any] = World) -> Scene:
    """The yardsticks of a motion; a passive one's torque is the load of gravity."""
    some = slice(None, None, max(1, len(motion.time) // 500))
    still = np.zeros_like(motion.q[some])
    torque = made(body).inverse(motion.q[some], still, still) if plan.passive else motor_torque(body, motion)
    return Scene(
        body=body,
        plan=plan,
        motion=motion,
        torque=np.sqrt((torque**2).mean(axis=0)),
        peak=np.abs(torque).max(axis=0),
        speed=np.sqrt((motion.qd**2).mean(axis=0)),
        inertia=made(body).inertia(plan.centre).diagonal(),
    )


def motor_torque(body: Body, motion: Trajectory) -> np.ndarray:
    """What motors give in a motion, N·m (C, K): their commands, less what servos answer to angles and velocities."""
    torque, each = motion.command, (len(motion.time) - 1) // (len(motion.command) - 1)
    for k, parts in enumerate(body.joint_parts):
        if (servo := parts.servo) is not None:
            torque = torque.copy()
            torque[:, k] -= servo.stiffness * motion.q[::each, k] + servo.damping * motion.qd[::each, k]
    return torque


def sign(rng: np.random.Generator) -> float:
    """−1 or 1."""
    return float(rng.choice([-1.0, 1.0]))


def natural_hz(s: Scene) -> float:
    """A pendulum's frequency of the scene's body, Hz."""
    return pendulum_frequency(s.body)

"""The log of a two-link arm that MuJoCo moves: encoders and torques at 500 rows/s, a camera at 60 frames/s."""

import mujoco
import numpy as np

from invdyn.models import Link, planar_body
from invdyn.recordings import Recording

LENGTHS, MASSES = np.array([0.3, 0.25]), np.array([1.5, 1.0])
JOINTS = ("shoulder", "elbow")
ARM = planar_body(
    "arm",
    [Link("upper", "shoulder", "elbow", 0.3, 1.5), Link("fore", "elbow", "wrist", 0.25, 1.0)],
    gravity=(0.0, -9.81),
)
STEP = 0.002  # s, MuJoCo's usual one, of its usual integrator
Pair = tuple[float, float]
AMPLITUDES, FREQUENCIES = np.array([[0.5, 0.3], [0.6, 0.3]]), np.pi * np.array([[0.5, 0.9], [0.7, 1.1]])


def _world(damping: Pair, friction: Pair, armature: Pair) -> mujoco.MjModel:
    links = [
        f'<joint type="hinge" axis="0 0 1" name="{joint}" damping="{viscous}" frictionloss="{dry}" armature="{rotor}"/>'
        f'<inertial pos="{length / 2} 0 0" mass="{mass}" diaginertia="1e-6 {mass * length**2 / 12} '
        f'{mass * length**2 / 12}"/>'
        for joint, length, mass, viscous, dry, rotor in zip(
            JOINTS, LENGTHS, MASSES, damping, friction, armature, strict=True
        )
    ]
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><option timestep="{STEP}" gravity="0 -9.81 0"/><worldbody><body>{links[0]}'
        f'<body pos="{LENGTHS[0]} 0 0">{links[1]}</body></body></worldbody>'
        '<actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>'
    )


def robot_log(
    seconds: float,
    damping: Pair = (0.0, 0.0),
    seed: int = 0,
    camera: bool = True,
    *,
    friction: Pair = (0.0, 0.0),
    armature: Pair = (0.0, 0.0),
    delay: float = 0.0,
) -> Recording:
    """The arm follows two sines a joint, as a controller has it.

    By joint: ``damping`` N·m·s/rad, dry ``friction`` N·m and ``armature`` kg·m²; ``delay`` s from torque that is logged
    to torque that acts.
    """
    world, rng, late = _world(damping, friction, armature), np.random.default_rng(seed), round(delay / STEP)
    state, rows = mujoco.MjData(world), round(seconds / STEP)
    time, angles, torques = np.arange(rows) * STEP, np.zeros((rows, 2)), np.zeros((rows, 2))
    begin = np.array([-1.0, 0.3])
    state.qpos[:] = begin
    state.qvel[:] = (AMPLITUDES * FREQUENCIES).sum(1)
    for row, t in enumerate(time):
        angles[row] = state.qpos
        wanted = begin + (AMPLITUDES * np.sin(FREQUENCIES * t)).sum(1)
        speed = (AMPLITUDES * FREQUENCIES * np.cos(FREQUENCIES * t)).sum(1)
        mujoco.mj_forward(world, state)
        torques[row] = state.qfrc_bias + [12, 5] * (wanted - state.qpos) + [1.2, 0.4] * (speed - state.qvel)
        state.ctrl[:] = torques[max(row - late, 0)]
        mujoco.mj_step(world, state)
    turned = angles.cumsum(1)
    tips = (LENGTHS[:, None] * np.stack([np.cos(turned), np.sin(turned)], -1)).cumsum(1)
    tips += rng.normal(0, 0.001, tips.shape)
    frames = np.unique(np.round(np.arange(0, seconds - STEP, 1 / 60) / STEP).astype(int))
    tips[np.setdiff1d(np.arange(rows), frames)] = np.nan
    return Recording(
        time,
        tips if camera else np.zeros((rows, 0, 2)),
        ("elbow", "wrist") if camera else (),
        angles=angles + rng.normal(0, 2e-4, angles.shape),
        torques=torques,
        joint_names=JOINTS,
        name="robot log",
    )

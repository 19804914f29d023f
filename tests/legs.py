"""A leg on a rail whose foot strikes the floor, simulated by MuJoCo itself: drop, hop, stance, and a slip on ice."""

from dataclasses import dataclass

import mujoco
import numpy as np

LEG = """<mujoco model="leg">
  <option timestep="0.001" integrator="implicitfast"/>
  <default><geom solref=".01 1"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="5 5 .1" friction="{friction}"/>
    <body name="trunk" pos="0 0 .55">{rail}
      <joint name="height" type="slide" axis="0 0 1"/>
      <geom name="trunk" type="box" size=".1 .05 .06" mass="3"/>
      <site name="back" pos="-.1 0 .05"/><site name="hip" pos=".1 0 0"/>
      <body name="thigh">
        <joint name="hip" axis="0 1 0" damping=".05" armature=".005"/>
        <geom name="thigh" type="capsule" fromto="0 0 0 0 0 -.25" size=".02" mass=".5"/>
        <body name="shank" pos="0 0 -.25">
          <joint name="knee" axis="0 1 0" damping=".05" armature=".005"/>
          <site name="knee"/>
          <geom name="shank" type="capsule" fromto="0 0 0 0 0 -.25" size=".015" mass=".3"/>
          <site name="foot" pos="0 0 -.25"/>
          <geom name="foot" type="sphere" pos="0 0 -.25" size=".025" friction="{friction}"/>
        </body>
      </body>
    </body>
  </worldbody>
</mujoco>"""
KINDS = ("drop", "hop", "stance", "slip")
SITES = ("back", "hip", "knee", "foot")
INTERVAL = 0.01


@dataclass(frozen=True)
class Leg:
    """A recording of the leg: its file, rows (T, 8) of x and z of four sites, m, and the truth.

    Torques (T, 2) N·m of hip and knee, held from each row on; ground force (T, 3) N, the mean up to the next row.
    """

    text: str
    time: np.ndarray
    rows: np.ndarray
    states: np.ndarray
    torque: np.ndarray
    ground_force: np.ndarray


def leg_file(kind: str) -> str:
    """MJCF; on ice the trunk slides along x too."""
    rail = '<joint name="along" type="slide" axis="1 0 0" damping="2"/>' if kind == "slip" else ""
    return LEG.format(rail=rail, friction=0.1 if kind == "slip" else 1.0)


def leg_recording(kind: str, seed: int, rows: int = 120, noise: float = 0.002) -> Leg:
    """Servos that follow a sine make the torques, 20 N·m at most; keypoints at 100 Hz with noise."""
    text, rng = leg_file(kind), np.random.default_rng([KINDS.index(kind), seed])
    model = mujoco.MjModel.from_xml_string(text)
    data, legs = mujoco.MjData(model), slice(model.nv - 2, model.nv)
    bend = 0.6 + 0.1 * rng.normal()
    data.qpos[legs] = [-bend, 2 * bend]
    above = {"drop": 0.10 + 0.05 * rng.random(), "hop": 0.02, "stance": 0.0, "slip": 0.01}[kind]
    data.qpos[model.nv - 3] = 0.5 * np.cos(bend) + 0.025 - 0.55 + above
    pace = {"drop": 0.0, "hop": 2.2, "stance": 1.0, "slip": 1.2}[kind] * (1 + 0.1 * rng.normal())
    swing = {"drop": 0.0, "hop": 0.35, "stance": 0.15, "slip": 0.2}[kind]
    phase = 0.0 if kind == "hop" else rng.uniform(0, 2 * np.pi)
    sites = [model.site(name).id for name in SITES]
    seen, states, torques, forces = [], [], [], []
    for t in range(rows):
        angle = 2 * np.pi * pace * t * INTERVAL + phase
        target = np.array([-bend - swing * np.sin(angle), 2 * bend + 2 * swing * np.sin(angle)])
        torque = np.clip(60 * (target - data.qpos[legs]) - data.qvel[legs], -20, 20)
        mujoco.mj_kinematics(model, data)
        seen.append(data.site_xpos[sites][:, [0, 2]].ravel() + noise * rng.normal(size=8))
        states.append(np.concatenate([torque, data.qpos, data.qvel]))
        force, steps = np.zeros(3), round(INTERVAL / model.opt.timestep)
        for _ in range(steps):
            data.qfrc_applied[legs] = torque
            mujoco.mj_step(model, data)
            force += ground_force(model, data) / steps
        torques.append(torque)
        forces.append(force)
    time = np.arange(rows) * INTERVAL
    return Leg(text, time, *map(np.array, (seen, states, torques, forces)))


def ground_force(model, data):
    """What the world's fixed shapes push the others with, (3,) N in the world's frame."""
    total, own = np.zeros(3), np.zeros(6)
    for c in range(data.ncon):
        mujoco.mj_contactForce(model, data, c, own)
        fixed = [model.body_weldid[model.geom_bodyid[g]] == 0 for g in data.contact.geom[c]]
        if any(fixed):
            total += (1 if fixed[0] else -1) * data.contact.frame[c].reshape(3, 3).T @ own[:3]
    return total

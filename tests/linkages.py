"""A gripper with a tendon and mirrored fingers, and a four-bar whose loop an equality closes; MuJoCo plays them."""

import mujoco
import numpy as np

from invdyn.recordings import Recording

GRIPPER = """<mujoco model="gripper"><option timestep="0.002" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/><joint damping="2"/></default><worldbody>
  <body name="left" pos="-.03 0 0"><joint name="left" type="slide" axis="1 0 0" range="-.02 .02"/>
    <geom name="left_pad" type="box" size=".005 .01 .03" mass=".1" contype="1" conaffinity="2"/>
    <site name="left_tip" pos="0 0 -.03"/></body>
  <body name="right" pos=".03 0 0"><joint name="right" type="slide" axis="-1 0 0" range="-.02 .02"/>
    <geom name="right_pad" type="box" size=".005 .01 .03" mass=".1" contype="1" conaffinity="2"/>
    <site name="right_tip" pos="0 0 -.03"/></body>
  <body name="ball"><joint name="ball" type="slide" axis="1 0 0"/>
    <geom name="ball" type="sphere" size=".015" mass=".05" contype="2" conaffinity="1"/><site name="ball"/></body>
</worldbody>
<tendon><fixed name="pull" stiffness="40" springlength="0"><joint joint="left" coef=".5"/>
  <joint joint="right" coef=".5"/></fixed></tendon>
<equality><joint name="mirror" joint1="right" joint2="left" solref=".005 1"/></equality>
<actuator><motor name="grip" tendon="pull" ctrllimited="false"/></actuator></mujoco>"""
FOUR_BAR = """<mujoco model="four_bar"><option timestep="0.002" integrator="implicitfast"/>
<default><geom type="capsule" size=".01" contype="0" conaffinity="0"/><joint axis="0 1 0" damping=".02"/></default>
<worldbody>
  <body name="crank"><joint name="crank"/><geom fromto="0 0 0 0 0 .1" mass=".3"/><site name="a" pos="0 0 .1"/>
    <body name="coupler" pos="0 0 .1"><joint name="coupler"/><geom fromto="0 0 0 .2 0 0" mass=".3"/>
      <site name="b" pos=".2 0 0"/></body></body>
  <body name="rocker" pos=".2 0 0"><joint name="rocker"/><geom fromto="0 0 0 0 0 .1" mass=".3"/>
    <site name="c" pos="0 0 .1"/></body>
</worldbody>
<equality><connect name="loop" body1="coupler" body2="rocker" anchor=".2 0 0" solref=".005 1"/></equality></mujoco>"""


def play(text, rows, force, seed=0, interval=0.01, noise=0.0005):
    """Sites as x and z that inputs of a function (model, data, t) move; and what it did, a row each."""
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    data, steps = mujoco.MjData(model), round(interval / model.opt.timestep)
    seen, made = [], []
    for t in range(rows):
        made.append(force(model, data, t * interval))
        mujoco.mj_kinematics(model, data)
        seen.append(data.site_xpos[:, [0, 2]] + noise * rng.normal(size=(model.nsite, 2)))
        for _ in range(steps):
            mujoco.mj_step(model, data)
    names = tuple(model.site(s).name for s in range(model.nsite))
    time = np.arange(rows) * interval
    return Recording(
        time=time, keypoints=np.array(seen), keypoint_names=names, name=model.names[:7].decode()
    ), np.array(made)


def grip(model, data, t):
    """Close on the ball: a force on the tendon that grows."""
    data.ctrl[0] = 1.0 + 2.0 * np.sin(2 * np.pi * t)
    return data.ctrl.copy()


def crank(model, data, t):
    """A torque at the crank alone."""
    data.qfrc_applied[0] = 0.3 * np.sin(2 * np.pi * t)
    return data.qfrc_applied[:1].copy()


HOLDING = """<mujoco model="holding"><option timestep="0.002" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0" solref=".004 1"/><joint damping="6"/></default><worldbody>
  <body name="left" pos="-.026 0 0"><joint name="left" type="slide" axis="1 0 0"/>
    <geom name="left_pad" type="box" size=".005 .01 .3" mass=".1" contype="1" conaffinity="2" friction=".6"/></body>
  <body name="right" pos=".026 0 0"><joint name="right" type="slide" axis="-1 0 0"/>
    <geom name="right_pad" type="box" size=".005 .01 .3" mass=".1" contype="1" conaffinity="2" friction=".6"/></body>
  <body name="block"><joint name="lift" type="slide" axis="0 0 1" damping=".5" stiffness="20"/>
    <geom name="block" type="sphere" size=".02" mass=".1" contype="2" conaffinity="1" friction=".6"/>
    <site name="block"/></body>
</worldbody>
<tendon><fixed name="pull" stiffness="60" springlength="-.012" damping="1"><joint joint="left" coef=".5"/>
  <joint joint="right" coef=".5"/></fixed></tendon>
<equality><joint name="mirror" joint1="right" joint2="left" solref=".005 1"/></equality>
<actuator><motor name="grip" tendon="pull"/><motor name="pulled" joint="lift"/></actuator></mujoco>"""
"""A gripper whose pads let a block slip, which a motor pulls up and down."""
RUBBING = """<mujoco model="rubbing"><option timestep="0.002" integrator="implicitfast" gravity="0 0 0"/>
<default><geom type="capsule" size=".01" contype="0" conaffinity="0"/><joint axis="0 1 0" damping=".02"/></default>
<worldbody>
  <geom name="rail" type="box" size=".5 .1 .01" pos="0 0 .13" contype="1" conaffinity="2" friction=".4"/>
  <body name="crank"><joint name="crank"/><geom fromto="0 0 0 0 0 .1" mass=".3"/><site name="a" pos="0 0 .1"/>
    <body name="coupler" pos="0 0 .1"><joint name="coupler"/><geom fromto="0 0 0 .2 0 0" mass=".3"/>
      <site name="b" pos=".2 0 0"/></body></body>
  <body name="rocker" pos=".2 0 0"><joint name="rocker"/><geom fromto="0 0 0 0 0 .1" mass=".3"/>
    <body name="shoe" pos="0 0 .1"><joint name="shoe" type="slide" axis="0 0 1" damping="5"/>
      <geom name="shoe" type="sphere" size=".01" mass=".05" contype="2" conaffinity="1" friction=".4"/></body></body>
</worldbody>
<tendon><fixed name="band" stiffness=".5" springlength=".4"><joint joint="crank" coef="1"/></fixed></tendon>
<equality><connect name="loop" body1="coupler" body2="rocker" anchor=".2 0 0" solref=".005 1"/></equality>
<actuator><motor name="crank" joint="crank"/><motor name="press" joint="shoe"/></actuator></mujoco>"""
"""A four-bar with a band at its crank, whose rocker rubs on a rail with a shoe that a motor presses on it."""


def grasp(t):
    """Controls of HOLDING."""
    return np.array([2.6 + 2.4 * np.sin(2 * np.pi * 0.7 * t), 2.4 * np.sin(2 * np.pi * 1.3 * t) + np.sin(7.3 * t)])


def rub(t):
    """Controls of RUBBING."""
    return np.array([0.45 * np.sin(2 * np.pi * 0.9 * t) + 0.15 * np.sin(9.1 * t), 2.0 + 1.2 * np.sin(5.0 * t)])


def log_of(model, control, rows=250, interval=0.01, noise=1e-4, seed=0, name="log"):
    """A log of all joints' encoders, rad or m, and of the controls that a function of time commanded."""
    rng, data = np.random.default_rng(seed), mujoco.MjData(model)
    seen, made = np.zeros((rows, model.nq)), np.zeros((rows, model.nu))
    for t in range(rows):
        made[t] = data.ctrl[:] = control(t * interval)
        seen[t] = data.qpos + noise * rng.normal(size=model.nq)
        for _ in range(round(interval / model.opt.timestep)):
            mujoco.mj_step(model, data)
    joints = [model.joint(j).name for j in range(model.njnt)]
    motors = [model.actuator(a).name for a in range(model.nu)]
    names = tuple(dict.fromkeys([*joints, *motors]))
    angles, torques = np.full((rows, len(names)), np.nan), np.full((rows, len(names)), np.nan)
    angles[:, [names.index(n) for n in joints]] = seen
    torques[:, [names.index(n) for n in motors]] = made
    return Recording(
        time=np.arange(rows) * interval, keypoints=np.zeros((rows, 0, 3)), keypoint_names=(), angles=angles,
        torques=torques, joint_names=names, name=name,
    )  # fmt: skip

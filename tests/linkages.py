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

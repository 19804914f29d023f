"""One joint with a position servo in MuJoCo, and the log that an encoder and the servo's targets make of it."""

from collections.abc import Callable

import mujoco
import numpy as np

from invdyn.models import Body
from invdyn.models.articulated.as_filed import servo_torque
from invdyn.recordings import Recording

NOISE = 2e-4  # rad
TEXT = """<mujoco><compiler angle="radian"/><option timestep="0.001" integrator="{integrator}"/><worldbody>
<body name="fore" pos="0 0 1"><joint name="elbow" axis="0 1 0" damping="{damping}" armature="0.005"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.25" size="0.015" mass="0.5" contype="0" conaffinity="0"/>
<site name="tip" pos="0 0 -0.25"/></body></worldbody>
<actuator><position joint="elbow" kp="{kp}" kv="{kv}"/></actuator></mujoco>"""


def servo_mjcf(integrator: str, damping: float, kp: float, kv: float) -> str:
    """The file of a robot, or of the simulation of it."""
    return TEXT.format(integrator=integrator, damping=damping, kp=kp, kv=kv)


def servo_log(
    reality: str, body: Body, target: Callable[[np.ndarray], np.ndarray], rate: float, rows: int
) -> Recording:
    """What ``reality``, an MJCF, does with targets (T,) rad held from row to row, in the terms of ``body``."""
    model = mujoco.MjModel.from_xml_string(reality)
    data, time = mujoco.MjData(model), np.arange(rows) / rate
    told, angles = target(time), np.zeros((rows, 1))
    for row in range(rows):
        angles[row], data.ctrl[:] = data.qpos, told[row]
        for _ in range(round(1 / rate / model.opt.timestep)):
            mujoco.mj_step(model, data)
    own = body.joint_parts[0]
    torques = servo_torque(own.servo, own.zero + own.sign * told)[:, None]
    angles = own.zero + own.sign * angles + np.random.default_rng(0).normal(0, NOISE, angles.shape)
    return Recording(time, np.empty((rows, 0, 2)), (), angles=angles, torques=torques, joint_names=("elbow",))

"""An arm with position servos whose file has gains, friction and a mass far from the true ones, and its logs."""

import mujoco
import numpy as np

from invdyn.models.articulated.as_filed import servo_torque
from invdyn.recordings import Recording

FILE = """<mujoco><compiler angle="radian"/><option timestep="0.004"/><worldbody>
<body name="upper" pos="0 0 1"><joint name="shoulder" axis="0 1 0" damping="{damping}" frictionloss="{friction}"
 armature="0.02" {soft}/><inertial pos="0 0 -0.12" mass="{mass}" diaginertia="0.004 0.004 0.0005"/>
<body name="fore" pos="0 0 -0.25"><joint name="elbow" axis="1 0 0" damping="{damping}" frictionloss="{friction}"
 armature="0.02" {soft}/><inertial pos="0 0.01 -0.1" mass="0.4" diaginertia="0.002 0.002 0.0003"/>
<site name="tip" pos="0 0 -0.25"/></body></body></worldbody>
<actuator><position joint="shoulder" kp="{kp}" kv="1"/><position joint="elbow" kp="{kp}" kv="1"/></actuator></mujoco>"""
STATED = {"kp": 300, "damping": 0.4, "friction": 0.05, "mass": 0.6, "soft": ""}
TRUE = {"kp": 12, "damping": 0.1, "friction": 0.3, "mass": 0.8, "soft": 'solimpfriction="0.999 0.999 0.001"'}
NOISE = 1e-3  # rad


def log(body, rows, seed, slew=np.inf):
    """What the true arm does at 50 rows/s under steps of its targets, and waves for half of the time.

    In every other window of 8 s its servos follow no faster than ``slew``, rad/s, which no file says.
    """
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(FILE.format(**TRUE))
    data, time = mujoco.MjData(model), np.arange(rows) / 50
    steps = rng.uniform(-0.8, 0.8, (rows // 60 + 1, 2)).repeat(60, 0)[:rows]
    target = steps + 0.3 * np.sin(time[:, None] * [2.1, 2.9]) * (time[:, None] % 8 < 4)
    followed, angle = target.copy(), np.empty((rows, 2))
    for row in range(1, rows):
        most = slew / 50 if time[row] % 16 >= 8 else np.inf
        followed[row] = followed[row - 1] + np.clip(target[row] - followed[row - 1], -most, most)
    for row in range(rows):
        angle[row], data.ctrl[:] = data.qpos, followed[row]
        mujoco.mj_step(model, data, 5)
    torque = [servo_torque(p.servo, p.zero + p.sign * u) for p, u in zip(body.joint_parts, target.T, strict=True)]
    shown = angle + rng.normal(0, NOISE, angle.shape)
    return Recording(time, np.empty((rows, 0, 3)), (), None, shown, np.stack(torque, -1), body.joint_names)

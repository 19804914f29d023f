"""A robot as an engineer has it: an MJCF with friction, rotors, a spring, a geared motor and a servo, and its logs."""

import mujoco
import numpy as np

from invdyn.recordings import Recording

ROBOT = """<mujoco model="robot">
  <!-- a user's own words -->
  <compiler angle="{unit}"/>
  <option timestep="0.002" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="upper" pos="0 0 1">
      <joint name="shoulder" axis="0 1 0" damping="0.3" armature="0.02"/>
      <geom type="capsule" fromto="0 0 0 0 0 -0.3" size="0.02" mass="1.2" contype="0" conaffinity="0"/>
      <body name="fore" pos="0 0 -0.3">
        <joint name="elbow" axis="0 1 0" damping="0.1" stiffness="0.8" springref="{rest}"/>
        <inertial pos="0 0 -0.12" mass="0.8" diaginertia="0.005 0.005 0.0002"/>
        <site name="tip" pos="0 0 -0.25"/>
      </body>
    </body>
  </worldbody>
  <actuator>{shoulder}
    <motor name="e" joint="elbow" gear="10"/>
  </actuator>
</mujoco>
"""
MOTOR = '<motor name="s" joint="shoulder"/>'
SERVO = '<position name="s" joint="shoulder" kp="40" kv="3" forcerange="-15 15"/>'
RATE = 100.0


def robot(rest: float = 0.4, degrees: bool = False, servo: bool = False) -> str:
    """The file's text; ``rest`` rad of the elbow's spring, in the compiler's unit."""
    unit = "degree" if degrees else "radian"
    said = f"{np.degrees(rest) if degrees else rest:.12g}"
    return ROBOT.format(unit=unit, rest=said, shoulder=SERVO if servo else MOTOR)


def play(text: str, seconds: float = 4.0, seed: int = 0, servo: bool = False, late: float = 0.0) -> Recording:
    """A log of the robot of a text: encoders and commands, both in the body's own angles (clockwise hinges).

    ``late`` s: the motors act so much later than they are told.
    """
    model = mujoco.MjModel.from_xml_string(text)
    data, rng = mujoco.MjData(model), np.random.default_rng(seed)
    rows, per = round(seconds * RATE), round(1 / RATE / model.opt.timestep)
    time = np.arange(rows) / RATE
    w = 2 * np.pi * np.array([[0.4, 0.9], [0.6, 1.3]])
    phase = rng.uniform(0, 2 * np.pi, (2, 2))
    waves = np.sin(time[:, None, None] * w + phase).sum(-1)
    size = [0.5, 0.08] if servo else [2.0, 0.08]
    control = waves * size
    angles = np.zeros((rows, 2))
    for row in range(rows):
        angles[row] = data.qpos[:2]
        for step in range(per):
            before = row - round((late - step * model.opt.timestep) * RATE + 0.499) if late else row
            data.ctrl[:] = control[max(before, 0)]
            mujoco.mj_step(model, data)
    zero = np.array([-np.pi / 2, 0.0])
    angles = zero - angles + rng.normal(0, 2e-4, angles.shape)
    given = -control * [1.0, 10.0]
    if servo:
        given[:, 0] = 40.0 * (zero[0] - control[:, 0])
    return Recording(time, np.empty((rows, 0, 2)), (), angles=angles, torques=given, joint_names=("shoulder", "elbow"))


class Older:
    """A model of MuJoCo 3.3, which knows no delay of an actuator."""

    def __init__(self, model):
        self._model = model

    def __getattr__(self, name):
        if name == "actuator_delay":
            raise AttributeError(name)
        return getattr(self._model, name)

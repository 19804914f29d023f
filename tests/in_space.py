"""Robots in space that MuJoCo plays, with what their files do not say: logs of encoders, keypoints and torques."""

import mujoco
import numpy as np

from invdyn.recordings import Recording

ARM = """<mujoco model="arm">
  <compiler angle="radian"/>
  <option timestep="0.001" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="turret" pos="0 0 0.3">
      <joint name="pan" axis="0 0 1" damping="0.05" armature="0.02"/>
      <inertial pos="0 0 0.05" mass="1.5" diaginertia="0.01 0.01 0.01"/>
      <body name="upper" pos="0.05 0 0.1">
        <joint name="lift" axis="0 1 0" damping="0.1"/>
        <inertial pos="0.15 0 0.01" mass="1.2" diaginertia="0.002 0.012 0.012"/>
        <site name="elbow" pos="0.3 0 0"/>
        <body name="fore" pos="0.3 0 0">
          <joint name="bend" axis="0 1 0"/>
          <inertial pos="0.11 0 0" mass="0.7" diaginertia="0.0005 0.004 0.004"/>
          <site name="tip" pos="0.25 0 0.02"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <motor name="m1" joint="pan"/><motor name="m2" joint="lift"/><motor name="m3" joint="bend"/>
  </actuator>
</mujoco>
"""
"""A turret, an upper arm and a forearm: three hinges about two axes."""
RATE = 100


def play(
    text: str,
    seconds: float = 5.0,
    seed: int = 0,
    middle: tuple[float, ...] = (0.0, -0.5, 0.9),
    *,
    damping: dict[str, float] | None = None,
    friction: dict[str, float] | None = None,
    armature: dict[str, float] | None = None,
    payload: float = 0.0,
    carried_by: tuple[str, str] = ("fore", "tip"),
    late: float = 0.0,
    encoders: float | None = 2e-4,
    cameras: float | None = None,
) -> Recording:
    """What MuJoCo makes of a robot of a file's ``text`` under torques held within rows, by Runge–Kutta in 1 ms steps.

    Its Euler steps would err by what friction and clocks of some tenths of a per cent do, and these would be named.

    They follow sums of sines about ``middle``, by bias torques and a weak controller. By joint: more ``damping``
    N·m·s/rad, ``friction`` N·m and ``armature`` kg·m²; ``payload`` kg at a site of a body; motors ``late`` by s.
    ``encoders`` rad and ``cameras`` m are sds of noise; None for no such columns.
    """
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.integrator, model.opt.timestep = mujoco.mjtIntegrator.mjINT_RK4, 1e-3
    for values, array in ((damping, model.dof_damping), (friction, model.dof_frictionloss)):
        for joint, more in (values or {}).items():
            array[model.joint(joint).dofadr[0]] += more
    for joint, more in (armature or {}).items():
        model.dof_armature[model.joint(joint).dofadr[0]] += more
    plain = mujoco.MjModel.from_xml_string(text)
    if payload:
        _load(model, *carried_by, payload)
    data, ideal, rng = mujoco.MjData(model), mujoco.MjData(plain), np.random.default_rng(seed)
    K, rows, per = model.nv, round(seconds * RATE), round(1 / RATE / model.opt.timestep)
    time = np.arange(rows) / RATE
    w = 2 * np.pi * rng.uniform(0.25, 1.2, (K, 3))
    size, phase = rng.uniform(0.1, 0.3, (K, 3)), rng.uniform(0, 2 * np.pi, (K, 3))
    waves = np.stack(
        [(size * w**n * np.sin(time[:, None, None] * w + phase + n * np.pi / 2)).sum(-1) for n in range(3)]
    )
    waves[0] += np.array(middle)
    data.qpos[:], data.qvel[:] = waves[0, 0], waves[1, 0]
    q, torque, points = np.zeros((rows, K)), np.zeros((rows, K)), np.zeros((rows, model.nsite, 3))
    for row in range(rows):
        mujoco.mj_kinematics(model, data)
        q[row], points[row] = data.qpos, data.site_xpos
        ideal.qpos[:], ideal.qvel[:] = data.qpos, data.qvel
        ideal.qacc[:] = waves[2, row] + 60 * (waves[0, row] - data.qpos) + 10 * (waves[1, row] - data.qvel)
        mujoco.mj_inverse(plain, ideal)
        torque[row] = ideal.qfrc_inverse
        for step in range(per):
            told = row - int(np.ceil((late - step * model.opt.timestep) * RATE - 1e-9)) if late else row
            data.qfrc_applied[:] = torque[max(min(told, row), 0)]
            mujoco.mj_step(model, data)
    angles = None if encoders is None else q + rng.normal(0, encoders, q.shape)
    seen = points[:, :0] if cameras is None else points + rng.normal(0, cameras, points.shape)
    names = () if cameras is None else tuple(model.site(s).name for s in range(model.nsite))
    joints = tuple(model.joint(j).name for j in range(model.njnt))
    return Recording(time, seen, names, angles=angles, torques=torque, joint_names=joints, name="robot log")


def _load(model: mujoco.MjModel, body: str, site: str, mass: float) -> None:
    """A point mass at a site of a body: the compiled body's own numbers are changed."""
    b, at = model.body(body).id, model.site(site).pos.copy()
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.body_iquat[b])
    turn = turn.reshape(3, 3)
    tensor = turn @ np.diag(model.body_inertia[b]) @ turn.T
    own, com = model.body_mass[b], model.body_ipos[b].copy()
    d = at - com
    tensor += own * mass / (own + mass) * (d @ d * np.eye(3) - np.outer(d, d))
    moments, axes = np.linalg.eigh(tensor)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    model.body_mass[b], model.body_ipos[b] = own + mass, (own * com + mass * at) / (own + mass)
    model.body_inertia[b] = moments
    mujoco.mju_mat2Quat(model.body_iquat[b], axes.ravel())
    mujoco.mj_setConst(model, mujoco.MjData(model))

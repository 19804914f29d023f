"""Robots for `benchmarks/check.py --robots`: small MJCF files, and logs of them that MuJoCo plays, right or spoilt.

A robot's file is what a log is checked against; the one that plays has other friction, rotors and masses, as a
simulation has that lacks something. Each log is a CSV with a map, read as a user's is.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.check.check import Check, check
from invdyn.inputs import load_body, read_logs
from invdyn.recordings import write_table

STEP = 0.002  # s of MuJoCo


@dataclass(frozen=True)
class Robot:
    """A serial arm: axes and lengths by joint, masses, and how it is driven and logged.

    `servo` is kp N·m/rad, 0 for torques; `every` steps lie between rows; `control` steps between commands; `passive`
    joints have no motor; `couple`: the last two motors add and subtract, as a differential wrist's.
    """

    name: str
    axes: tuple[str, ...]
    lengths: tuple[float, ...]
    masses: tuple[float, ...]
    servo: float = 0.0
    every: int = 5
    control: int = 5
    passive: tuple[int, ...] = ()
    couple: bool = False
    slide: bool = False
    speed: float = 1.0
    hold: int = 1

    @property
    def joints(self) -> tuple[str, ...]:
        return tuple(f"j{k}" for k in range(len(self.axes)))

    @property
    def turning(self) -> np.ndarray:
        """(K,) whether a joint is a hinge."""
        return np.array([not (self.slide and k == 0) for k in range(len(self.axes))])

    @property
    def heavy(self) -> tuple[int, ...]:
        """Joints that gravity tells the zero of, and that have a motor."""
        return tuple(
            k
            for k, axis in enumerate(self.axes)
            if axis == "y" and k not in self.passive and not (self.slide and not k)
        )

    def mjcf(self, rng: np.random.Generator | None = None, gain: float = 1.0) -> str:
        """The file, or with ``rng`` the robot that plays."""
        body, end = "", ""
        for k, (axis, length, mass) in enumerate(zip(self.axes, self.lengths, self.masses, strict=True)):
            by, extra = 1.0, ""
            if rng is not None:
                by = float(rng.uniform(0.9, 1.1))
                viscous, dry = rng.uniform(0, 0.02, 2) * mass * 9.81 * length + 1e-4
                extra = f' damping="{viscous:.4g}" frictionloss="{dry:.4g}"'
            at = "0 0 0" if not k else f"0 0 {self.lengths[k - 1]}"
            vector = {"x": "1 0 0", "y": "0 1 0", "z": "0 0 1"}[axis]
            kind = "slide" if self.slide and not k else "hinge"
            body += f'<body name="b{k}" pos="{at}"><joint name="j{k}" type="{kind}" axis="{vector}"{extra}/>'
            across = mass * by * (length**2 / 12 + 0.02**2)
            body += (
                f'<inertial pos="0.01 0 {length / 2}" mass="{mass * by:.5g}" '
                f'diaginertia="{across:.6g} {across:.6g} {mass * by * 0.03**2:.6g}"/>'
            )
            body += f'<site name="tip" pos="0 0 {length}"/>' if k == len(self.axes) - 1 else ""
            end += "</body>"
        kp = self.servo * gain
        motors = "".join(
            f'<position name="m{k}" joint="j{k}" kp="{kp * self.share(k):.6g}" kv="{kp * self.share(k) / 30:.6g}"/>'
            if self.servo
            else f'<motor name="m{k}" joint="j{k}"/>'
            for k in range(len(self.axes))
            if k not in self.passive and not (self.couple and k >= len(self.axes) - 2)
        )
        tendons = ""
        if self.couple:
            one, other = self.joints[-2:]
            tendons = "".join(
                f'<fixed name="t{way}"><joint joint="{one}" coef="1"/><joint joint="{other}" coef="{way}"/></fixed>'
                for way in (1, -1)
            )
            tendons = f"<tendon>{tendons}</tendon>"
            motors += '<motor name="t1" tendon="t1"/><motor name="t-1" tendon="t-1"/>' if rng is not None else ""
        return (
            f'<mujoco model="{self.name}"><compiler angle="radian"/>'
            f'<option timestep="{STEP}" integrator="implicitfast"/>'
            f"<worldbody>{body}{end}</worldbody>{tendons if rng is not None else ''}"
            f"<actuator>{motors}</actuator></mujoco>"
        )

    def share(self, k: int) -> float:
        """Of the first joint's kp: what lies behind a joint weighs less."""
        load = [sum(self.masses[j] * sum(self.lengths[k : j + 1]) for j in range(k, len(self.axes))) for k in (0, k)]
        return max(load[1] / load[0], 0.05)


YZ = "zyyzyzy"
ROBOTS = (
    Robot("planar2", ("y", "y"), (0.3, 0.25), (1.5, 1.0)),
    Robot("planar3", ("y", "y", "y"), (0.4, 0.3, 0.2), (3, 2, 1), every=2, control=2),
    Robot("arm4", tuple("zyyy"), (0.2, 0.35, 0.3, 0.15), (2, 2, 1.5, 0.6)),
    Robot(
        "arm6", tuple("zyyyzy"), (0.15, 0.42, 0.39, 0.1, 0.09, 0.08), (3.7, 8, 2.3, 1.2, 1.2, 0.5), every=4, control=4
    ),
    Robot("arm7", tuple(YZ), (0.16, 0.2, 0.2, 0.2, 0.2, 0.1, 0.1), (4, 4, 3, 2.7, 1.7, 1.8, 0.4)),
    Robot("servo5", tuple("zyyyz"), (0.06, 0.11, 0.13, 0.06, 0.1), (0.1, 0.11, 0.1, 0.08, 0.09), servo=18.0, every=10),
    Robot("servo3", tuple("yyy"), (0.2, 0.2, 0.1), (0.5, 0.4, 0.2), servo=40.0, hold=4),
    Robot("pendubot", ("y", "y"), (0.3, 0.3), (0.6, 0.6), passive=(1,)),
    Robot("cartpole", ("x", "y"), (0.1, 0.5), (1.0, 0.3), passive=(1,), slide=True),
    Robot("aliased", tuple("yyy"), (0.35, 0.3, 0.2), (2, 1.5, 0.7), every=20, control=1, speed=1.5),
    Robot("coupled", tuple("zyyyx"), (0.2, 0.3, 0.3, 0.05, 0.15), (2, 2, 1.5, 0.4, 0.5), couple=True),
)


@dataclass(frozen=True)
class Log:
    """Times (T,), angles and commands (T, K) of a log, the file's text, and what the map says of a column."""

    time: np.ndarray
    angle: np.ndarray
    command: np.ndarray
    file: str
    source: str = '"{track}"'


def played(robot: Robot, seed: int, seconds: float = 12.0) -> Log:
    """What a robot logs of a motion of three sines a joint, with encoders of .2 to 1 mrad."""
    rng = np.random.default_rng([seed, *map(ord, robot.name)])
    model = mujoco.MjModel.from_xml_string(robot.mjcf(rng))
    own = mujoco.MjModel.from_xml_string(robot.mjcf())
    data, copy, K = mujoco.MjData(model), mujoco.MjData(own), len(robot.axes)
    frequency = rng.uniform(0.15, 0.7, (3, K)) * robot.speed
    size = rng.uniform(0.15, 0.4, (3, K)) * (0.3 if robot.slide else 1.0)
    phase, begin = rng.uniform(0, 6.28, (3, K)), rng.uniform(-0.5, 0.5, K) * (not robot.slide)
    rate = np.pi * 2 * frequency

    def wanted(t: float, order: int) -> np.ndarray:
        turn = rate * t + phase
        value = (np.sin(turn), rate * np.cos(turn), -(rate**2) * np.sin(turn))[order]
        return (size * value).sum(0) + (begin if order == 0 else 0)

    active = [k for k in range(K) if k not in robot.passive]
    data.qpos[:], data.qvel[:] = wanted(0, 0), wanted(0, 1)
    if robot.passive:
        data.qpos[list(robot.passive)] = 3.0 if not robot.slide else 2.6
        data.qvel[list(robot.passive)] = 0
    rows, torque, target = [], np.zeros(K), wanted(0, 0)
    for n in range(round(seconds / STEP)):
        t = n * STEP
        if n % robot.control == 0 and not robot.servo:
            copy.qpos[:], copy.qvel[:] = data.qpos, data.qvel
            copy.qacc[:] = wanted(t, 2) + 200 * (wanted(t, 0) - data.qpos) + 25 * (wanted(t, 1) - data.qvel)
            copy.qacc[list(robot.passive)] = data.qacc[list(robot.passive)]
            mujoco.mj_inverse(own, copy)
            torque = np.where(np.isin(np.arange(K), active), copy.qfrc_inverse, 0.0)
        if n % (robot.every * robot.hold) == 0:
            target = wanted(t, 0)
        if n % robot.every == 0:
            rows.append((t, data.qpos.copy(), (target if robot.servo else torque).copy()))
        if robot.servo:
            data.ctrl[:] = target[active]
        else:
            data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    time, angle, command = (np.array(each) for each in zip(*rows, strict=True))
    noise = np.exp(rng.uniform(np.log(2e-4), np.log(1e-3)))
    return Log(time, angle + noise * rng.standard_normal(angle.shape), command, robot.mjcf())


def checked(robot: Robot, log: Log, folder: Path) -> Check:
    """What `invdyn check` says of a log, as files."""
    kind = "target" if robot.servo else "torque"
    columns: dict[str, Any] = {"time": log.time}
    lines = ""
    for k, joint in enumerate(robot.joints):
        columns |= {f"q{k}": log.angle[:, k], f"u{k}": log.command[:, k]}
        of = log.source if robot.turning[k] else Log.source
        given = (of if robot.servo else Log.source).format(track=f"u{k}", k=k)
        lines += f"[joints.{joint}]\nangle = {of.format(track=f'q{k}', k=k)}\n{kind} = {given}\n"
    (folder / "robot.xml").write_text(log.file)
    (folder / "map.toml").write_text(lines)
    write_table(columns, folder / "log.csv")
    body = load_body(str(folder / "robot.xml"), filmed=False)
    (reading,) = read_logs(str(folder / "log.csv"), body, str(folder / "map.toml"))
    return check(reading, body, effects=False)

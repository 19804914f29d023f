"""Robots for `benchmarks/check.py --robots`: small MJCF files, and logs of them that MuJoCo plays, right or spoilt.

A robot's file is what a log is checked against; the one that plays has other friction, rotors and masses, as a
simulation has that lacks something. Each log is a CSV with a map, read as a user's is.
"""

import tempfile
import time as clock
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from invdyn.diagnosis.check.check import Check, check
from invdyn.inputs import load_body, read_logs
from invdyn.recordings import InputError, write_table

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


DEGREES = '{{track = "{track}", unit = "deg"}}'
COUNTS = '{{track = "{track}", range = [0, 6.283185307], ends = [0, 4096]}}'
Spoilt = tuple[Log, tuple[int, ...] | None]
"""A log with a mistake, and the joints that have it; None where any will do."""


def _column(log: Log, k: int, angle: Any = None, command: Any = None) -> Log:
    a, c = np.array(log.angle), np.array(log.command)
    if angle is not None:
        a[:, k] = angle(a[:, k])
    if command is not None:
        c[:, k] = command(c[:, k])
    return replace(log, angle=a, command=c)


def _torque_sign(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k = int(rng.choice(robot.heavy))
    return _column(log, k, command=np.negative), (k,)


def _direction(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k = int(rng.choice(robot.heavy))
    return _column(log, k, np.negative, np.negative), (k,)


def _zero(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k, off = int(rng.choice(robot.heavy)), np.radians(rng.uniform(20, 160)) * rng.choice([-1, 1])
    shift = (lambda v: v + off) if robot.servo else None
    return _column(log, k, lambda v: v + off, shift), (k,)


def _in_unit(robot: Robot, log: Log, unit: float, source: str = Log.source) -> Log:
    """Numbers of hinges, and of their servos' targets, in another unit."""
    factor = np.where(robot.turning, unit, 1.0)
    command = factor * log.command if robot.servo else log.command
    return replace(log, angle=factor * log.angle, command=command, source=source)


def _degrees(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    return _in_unit(robot, log, 180 / np.pi), None


def _radians(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    return replace(log, source=DEGREES), None


def _percent(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    seen = np.concatenate([log.angle, log.command]) if robot.servo else log.angle
    room = np.ptp(seen, axis=0) * rng.uniform(0.01, 0.4, (2, len(robot.axes)))
    low, high = seen.min(0) - room[0], seen.max(0) + room[1]
    angle, command = (-100 + 200 * (each - low) / (high - low) for each in (log.angle, log.command))
    return replace(log, angle=angle, command=command if robot.servo else log.command), None


def _time_unit(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    return replace(log, time=log.time * float(rng.choice([1e3, 1e6, 1e9]))), None


def _first_stamp(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    return replace(log, time=np.append(0.0, 1.7e9 + log.time[1:])), None


def _two_clocks(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    rows = np.arange(len(log.time)) >= rng.integers(10, len(log.time) - 10)
    return replace(log, time=log.time + 1.7e9 * rows), None


def _exchanged(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    one, other = sorted(rng.choice(robot.heavy, 2, replace=False).tolist())
    order = np.arange(len(robot.axes))
    order[[one, other]] = other, one
    return replace(log, angle=log.angle[:, order], command=log.command[:, order]), (one, other)


def _columns(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    whole, joints = _exchanged(rng, robot, log)
    return (replace(whole, angle=log.angle) if rng.random() < 0.5 else replace(whole, command=log.command)), joints


def _angle_sign(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k = int(rng.choice(robot.heavy))
    return _column(log, k, np.negative), (k,)


def _gear(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k, by = int(rng.choice(robot.heavy)), np.exp(rng.uniform(np.log(5), np.log(160)))
    return _column(log, k, command=lambda v: v / by), (k,)


def _torque_unit(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    return replace(log, command=log.command * float(rng.choice([1e3, 1 / 0.0980665]))), None


def _target_gear(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k, gear = int(rng.integers(len(robot.axes))), float(rng.choice([-3, -1, 2, 5]))
    spec = mujoco.MjSpec.from_string(log.file)
    motor = spec.actuator(f"m{k}")
    motor.gear[0], motor.gainprm, motor.biasprm = gear, motor.gainprm / gear**2, motor.biasprm / gear**2
    spec.compile()
    return replace(_column(log, k, command=lambda v: gear * v), file=spec.to_xml()), (k,)


def _thinned(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    period = int(rng.integers(4, 9)) * robot.hold
    return replace(log, command=log.command[np.arange(len(log.time)) // period * period]), None


def _offset(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k = int(rng.choice(robot.heavy))
    off = np.sqrt((log.command[:, k] ** 2).mean()) * rng.uniform(0.4, 1.0) * rng.choice([-1, 1])
    return _column(log, k, command=lambda v: v + off), (k,)


def _delay(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    by = float(rng.choice([rng.uniform(0.15, 0.6), -rng.uniform(0.06, 0.6)]))
    at = np.searchsorted(log.time, log.time + by).clip(0, len(log.time) - 1)
    return replace(log, command=log.command[at]), None


def _drift(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    late = rng.uniform(0.02, 0.05) * rng.choice([-1, 1]) * log.time
    at = np.searchsorted(log.time, log.time + late).clip(0, len(log.time) - 1)
    return replace(log, command=log.command[at]), None


def _stray(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    rows = rng.random(len(log.time)) < rng.uniform(0.02, 0.3)
    angle = np.array(log.angle)
    angle[rows] = float(rng.choice([0.0, 2.5, -1.0]))
    return replace(log, angle=angle), None


def _wrapped(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    k = int(rng.choice(robot.heavy))
    modulus, source = ((2 * np.pi, Log.source), (360.0, DEGREES), (4096.0, COUNTS))[rng.integers(3)]
    log = _in_unit(robot, log, modulus / (2 * np.pi), source)
    middle = float(rng.uniform(*np.quantile(log.angle[:, k], [0.3, 0.7])))
    return _column(log, k, lambda v: (v - middle) % modulus + middle), (k,)


def _held(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    period = int(rng.integers(2, 6))
    return replace(log, angle=log.angle[np.arange(len(log.time)) // period * period]), None


def _gain(rng: np.random.Generator, robot: Robot, log: Log) -> Spoilt:
    by = float(np.exp(rng.uniform(np.log(4), np.log(100)) * rng.choice([-1, 1])))
    return replace(log, file=robot.mjcf(gain=by)), None


MISTAKES: dict[str, tuple[str, Callable[[np.random.Generator, Robot, Log], Spoilt]]] = {
    "torque sign": ("torque sign", _torque_sign),
    "direction": ("direction", _direction),
    "zero": ("zero", _zero),
    "degrees": ("degrees", _degrees),
    "radians": ("radians", _radians),
    "percent": ("percent", _percent),
    "unit of time": ("time", _time_unit),
    "first stamp": ("clocks", _first_stamp),
    "two clocks": ("clocks", _two_clocks),
    "exchanged": ("exchanged", _exchanged),
    "half exchanged": ("exchanged", _columns),
    "angle sign": ("angle sign", _angle_sign),
    "gear": ("scale", _gear),
    "unit of torque": ("scale", _torque_unit),
    "target's gear": ("gear", _target_gear),
    "thinned targets": ("rare", _thinned),
    "offset": ("offset", _offset),
    "delay": ("delay", _delay),
    "drift": ("drift", _drift),
    "stray": ("stray", _stray),
    "wrapped": ("wrapped", _wrapped),
    "held": ("held", _held),
    "servo gain": ("gain", _gain),
}
"""What is done to a log, and what `check` calls it."""
ONLY: dict[str, Callable[[Robot], bool]] = {
    "exchanged": lambda robot: len(robot.heavy) > 1,
    "half exchanged": lambda robot: len(robot.heavy) > 1,
    "servo gain": lambda robot: robot.servo > 0,
    "target's gear": lambda robot: robot.servo > 0,
    "thinned targets": lambda robot: robot.servo > 0,
    "zero": lambda robot: bool(robot.heavy) and not robot.servo,
    "torque sign": lambda robot: bool(robot.heavy) and not robot.servo,
    "gear": lambda robot: bool(robot.heavy) and not robot.servo,
    "offset": lambda robot: bool(robot.heavy) and not robot.servo,
    "unit of torque": lambda robot: not robot.servo,
    "angle sign": lambda robot: bool(robot.heavy),
    "direction": lambda robot: bool(robot.heavy),
    "wrapped": lambda robot: bool(robot.heavy),
}
"""Of which robots a mistake can be told."""


def answered(seed: int, kind: str, number: int) -> dict[str, Any]:
    """What is found first in a log with a mistake of a kind, or "none": "right", or what else; and seconds of CPU."""
    robots = [robot for robot in ROBOTS if ONLY.get(kind, lambda _: True)(robot)]
    robot = robots[number % len(robots)]
    log, called, joints = played(robot, seed + number), "none", None
    if kind != "none":
        called, spoil = MISTAKES[kind]
        log, joints = spoil(np.random.default_rng([seed, number]), robot, log)
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        start = clock.process_time()
        try:
            found = checked(robot, log, Path(folder))
        except InputError as error:
            return {
                "answer": "right" if called == "clocks" and "one clock" in str(error) else f"{error} of {robot.name}",
                "joints": len(robot.axes),
                "seconds": clock.process_time() - start,
            }
        seconds = clock.process_time() - start
    first = found.mistakes[0] if found.mistakes else None
    said = "none" if first is None else first.kind
    # numbers within a hundred are said to be degrees or shares of a range, unless torques tell which
    twin = called == "degrees" and first is not None and said == "percent" and "degrees" in first.sentence
    said = "degrees" if twin else said
    right = said == called and (
        joints is None or first is None or first.joints == tuple(robot.joints[k] for k in joints)
    )
    answer = "right" if right else f"{said}{' (unclear)' * found.unclear} of {robot.name}"
    return {"answer": answer, "joints": len(robot.axes), "seconds": seconds}

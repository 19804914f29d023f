"""Mistakes in robots' logs for `benchmarks/check.py --robots`, as users report them, and what each is to be called."""

import tempfile
import time as clock
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from check_robots import ROBOTS, Log, Robot, checked, played

from invdyn.recordings import InputError

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

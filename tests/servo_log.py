"""A log of MuJoCo's arm as a robot writes it, with a servo at the shoulder, that a mapping reads in any units."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from robot_log import ARM, robot_log

from invdyn.models.bodies.joint_parts import JointParts, Motor
from invdyn.recordings import write_table

GAIN, DAMPING, ZERO = 40.0, 3.0, -np.pi / 2
SERVO = Motor("position", gain=GAIN, stiffness=GAIN, damping=DAMPING)
SERVO_ARM = replace(ARM, links=(replace(ARM.links[0], parts=JointParts(motor=SERVO).turned(1, ZERO)), ARM.links[1]))
"""Its robot counts the shoulder from hanging down."""


def write_servo_log(path: Path) -> None:
    """Columns t in ms; q1, q2 and target1 in degrees; tau2 in N·m."""
    log = robot_log(2.0, camera=False).at(slice(None, None, 4))
    assert log.angles is not None
    assert log.torques is not None
    own = log.angles - [ZERO, 0]
    speed = np.gradient(own[:, 0], log.time)
    target = own[:, 0] + (log.torques[:, 0] + DAMPING * speed) / GAIN
    shown = {"q1": own[:, 0], "q2": own[:, 1], "target1": target}
    angles = {name: np.degrees(values) for name, values in shown.items()}
    write_table({"t": 1e3 * log.time, **angles, "tau2": log.torques[:, 1]}, path)


def write_mapping(
    path: Path,
    time: str = 'time_unit = "ms"',
    angle: str = "deg",
    target: str = "deg",
    columns: tuple[str, str] = ("q1", "q2"),
) -> None:
    """A mapping of that log; no unit at all where one is empty. ``columns`` are the shoulder's and the elbow's."""

    def track(name: str, unit: str) -> str:
        return f'{{track = "{name}", unit = "{unit}"}}' if unit else f'"{name}"'

    path.write_text(
        f'time = "t"\n{time}\n'
        f"[joints.shoulder]\nangle = {track(columns[0], angle)}\ntarget = {track('target1', target)}\n"
        f'[joints.elbow]\nangle = {track(columns[1], angle)}\ntorque = "tau2"\n'
    )

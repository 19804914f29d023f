"""A motor's range from the calibration that LeRobot keeps of a robot: a .json file.

    {"elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 12, "range_min": 900, "range_max": 3100}, …}

Feetech's STS and Dynamixel's X motors, which its arms have, count 4096 ticks a revolution. LeRobot scales a tick t
between `range_min` and `range_max` to −100 … 100, of a gripper to 0 … 100, and takes both the other way round where
`drive_mode` is 1 (`lerobot/motors/motors_bus.py`, `_normalize`). The middle of the range is its zero. So the range is

    ± π (range_max − range_min)/4096 rad,     low > high where drive_mode is 1.
"""

import json
from math import pi
from pathlib import Path
from typing import Any

from ..budget import read_document
from ..errors import InputError
from ..limits import LIMITS

TICKS = 4096  # of a revolution


def calibrated_range(path: Path, track: str, where: str) -> tuple[float, float]:
    """Range, rad about its middle, of the motor in the name of ``track``: "observation.state.elbow_flex.pos".

    Raises InputError for another file, or a track whose name has none of its motors' or several; OSError where it
    cannot be read.
    """
    motors = _motors(path, where)
    named = [motor for motor in motors if motor in track.split(".")]
    if len(named) != 1:
        raise InputError(
            f"{where}: expected the name of one motor of {path.name} in the track {track!r}, "
            f"got {len(named)}; it has {', '.join(list(motors)[:12])}: write range = [low, high]"
        )
    own = motors[named[0]]
    first, last = (own.get(key) if isinstance(own, dict) else None for key in ("range_min", "range_max"))
    if not (isinstance(first, int) and isinstance(last, int) and 0 < abs(last - first) <= TICKS * TICKS):
        raise InputError(
            f"{where}: {path.name}: {named[0]}: expected range_min and range_max in ticks, got {first!r:.40} and "
            f"{last!r:.40}"
        )
    half = pi * (last - first) / TICKS * (-1 if own.get("drive_mode") else 1)
    return -half, half


def _motors(path: Path, where: str) -> dict[str, Any]:
    """Table of each motor in a calibration."""
    if not path.is_file():
        raise InputError(f"{where}: no calibration {path}: expected LeRobot's .json, or range = [low, high]")
    text = read_document(path, LIMITS.yaml)
    try:
        motors = json.loads(text)
    except (ValueError, RecursionError):
        motors = None
    if not isinstance(motors, dict) or not motors:
        raise InputError(f"{where}: {path}: expected LeRobot's calibration, a table of motors in JSON")
    return motors

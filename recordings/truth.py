"""True (simulated) or measured joint angles, velocities and torques, to score an inference against.

CSV: `time` in s, then `<joint>_torque` N·m, `<joint>_angle` rad, `<joint>_velocity` rad/s. An empty cell is unknown,
and so is a missing column: torques alone are enough.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from .errors import InputError, about
from .recording import check_range, check_time
from .tables import read_table, write_table

QUANTITIES = ("torque", "angle", "velocity")


@dataclass(frozen=True, eq=False)
class Truth:
    """Joint trajectories, T times and K joints.

    Attributes:
        time: (T,) s, strictly increasing.
        angle, velocity, torque: (T, K) rad (Denavit–Hartenberg), rad/s, N·m; NaN = unknown.
        joint_names: K names.

    Raises:
        InputError: shapes that do not fit, times that are not finite and increasing, or infinite values.
    """

    time: np.ndarray
    angle: np.ndarray
    velocity: np.ndarray
    torque: np.ndarray
    joint_names: tuple[str, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        for field in ("time", "angle", "velocity", "torque"):
            object.__setattr__(self, field, np.array(getattr(self, field), dtype=np.float64))
        check_time(self.time)
        shape = (len(self.time), len(self.joint_names))
        for field in ("angle", "velocity", "torque"):
            if getattr(self, field).shape != shape:
                raise InputError(f"truth: {field} must have shape {shape}, got {getattr(self, field).shape}")
            # A simulation that diverged is allowed; a file of such numbers is damaged.
            check_range(f"truth: {field}", getattr(self, field), "frame {}".format, float(np.finfo(float).max))

    def at(self, time: np.ndarray) -> "Truth":
        """Linear interpolation at `time` (T',) s; NaN outside the record, never extrapolated."""

        def resample(values: np.ndarray) -> np.ndarray:
            columns = [np.interp(time, self.time, column, left=np.nan, right=np.nan) for column in values.T]
            return np.stack(columns, axis=-1)

        moved: dict[str, Any] = {each: resample(getattr(self, each)) for each in QUANTITIES}
        return replace(self, time=time, **moved)


def write_truth(truth: Truth, path: str | Path) -> None:
    """Write the CSV above, whole or not at all. Raises OSError when `path` cannot be written."""
    columns = {"time": truth.time}
    for quantity in QUANTITIES:
        for k, joint in enumerate(truth.joint_names):
            columns[f"{joint}_{quantity}"] = getattr(truth, quantity)[:, k]
    write_table(columns, path)


def read_truth(path: str | Path) -> Truth:
    """Read the CSV above.

    Raises InputError if it is not such a table or has values beyond 10⁷, OSError if it cannot be read.
    """
    columns, where = read_table(path)
    with about(path):
        if "time" not in columns:
            raise InputError(f"no column 'time'; it has {', '.join(columns)}")
        check_time(columns["time"], where)
        named = {c: c.rpartition("_") for c in columns if c != "time"}
        odd = [c for c, (joint, _, quantity) in named.items() if not joint or quantity not in QUANTITIES]
        if odd or not named:
            raise InputError(
                "a truth file has columns <joint>_torque, <joint>_angle or <joint>_velocity; "
                f"odd: {', '.join(odd) or 'no joint at all'}"
            )
        joints = tuple(dict.fromkeys(joint for joint, _, _ in named.values()))
        unknown = np.full_like(columns["time"], np.nan)
        values = {}
        for quantity in QUANTITIES:
            values[quantity] = np.stack([columns.get(f"{joint}_{quantity}", unknown) for joint in joints], axis=-1)
            check_range(f"truth: {quantity}", values[quantity], "frame {}".format)
        return Truth(columns["time"], **values, joint_names=joints)

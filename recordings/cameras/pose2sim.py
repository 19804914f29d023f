"""Calibrations of Pose2Sim and Sports2D: `camera_tables` in metres, Brown's k1, k2, p1, p2 alone.

Layout: Pose2Sim, calibration.py, `toml_write`. Its file is known by `fisheye` in every table, false throughout, and by
four `distortions`; aniposelib writes `fisheye` for fisheye lenses only.
"""

from pathlib import Path
from typing import Any

from ..errors import about
from ..toml_tables import read_toml
from .camera import Calibration
from .camera_tables import calibration_of, camera_tables


def is_pose2sim(tables: dict[str, Any]) -> bool:
    """Whether tables of cameras are in this program's layout."""
    found = camera_tables(tables).values()
    return bool(found) and all(
        table.get("fisheye") is False and isinstance(given := table.get("distortions"), list) and len(given) == 4
        for table in found
    )


def read_pose2sim(path: str | Path) -> Calibration:
    """Read such a file. Raises InputError for another kind, OSError if it cannot be opened."""
    tables = read_toml(path, "a calibration")
    with about(path):
        return calibration_of(tables, metric=True)

"""Our own calibration file: `camera_tables` whose [metadata] says the unit; other programs' readers take it, too."""

from pathlib import Path

from ..errors import InputError, about
from .camera import Calibration
from .camera_tables import calibration_of, read_toml

UNITS = {"m": True, "unknown": False}


def read_calibration_toml(path: str | Path) -> Calibration:
    """Read a file that `write_calibration` wrote. Raises InputError for another, OSError if it cannot be opened."""
    tables = read_toml(Path(path))
    with about(path):
        unit = tables.get("metadata", {}).get("unit")
        if unit not in UNITS:
            raise InputError(f"[metadata] unit must be 'm' or 'unknown', got {unit!r}")
        return calibration_of(tables, metric=UNITS[unit])

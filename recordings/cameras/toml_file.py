"""Our own calibration file: `camera_tables` whose [metadata] says the unit; other programs' readers take it, too."""

from pathlib import Path

from ..errors import InputError, about
from ..toml_tables import read_toml
from .camera import Calibration
from .camera_tables import calibration_of

UNITS = {"m": True, "unknown": False}


def read_calibration_toml(path: str | Path) -> Calibration:
    """Read a file that `write_calibration` wrote. Raises InputError for another, OSError if it cannot be opened."""
    tables = read_toml(path, "a calibration")
    with about(path):
        metadata = tables.get("metadata")
        unit = metadata.get("unit") if isinstance(metadata, dict) else None
        if not isinstance(unit, str) or unit not in UNITS:
            got = repr(unit[:40]) if isinstance(unit, str) else "no text"
            raise InputError(f"[metadata] unit must be 'm' or 'unknown', got {got}")
        return calibration_of(tables, metric=UNITS[unit])

"""Calibrations of aniposelib (Anipose): `camera_tables` in the unit of the user's board, which the file does not say.

Layout: aniposelib, cameras.py, `CameraGroup.dump`. Its squares are usually stated in mm, but nothing holds anybody to
it, so the unit is asked for; without one the set is not metric.
"""

from pathlib import Path

from ..errors import about
from ..toml_tables import read_toml
from ..units import METRES
from .camera import Calibration
from .camera_tables import calibration_of


def read_aniposelib(path: str | Path, unit: str | None = None) -> Calibration:
    """Read such a file; `unit` is m, cm or mm, or None when it is not known.

    Raises InputError for another kind of file, OSError if it cannot be opened.
    """
    tables = read_toml(path, "a calibration")
    with about(path):
        calibration = calibration_of(tables, metric=False)
        return calibration if unit is None else calibration.scaled(METRES[unit])

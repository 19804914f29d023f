"""A set of cameras as TOML tables, the layout that aniposelib began and that Pose2Sim and we write, too.

    [cam_0]
    name = "left"
    size = [1920, 1080]                         # px, width and height
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    distortions = [k1, k2, p1, p2, k3]          # of a fisheye lens k1 … k4
    rotation = [rx, ry, rz]                     # rad, axis times angle, scene to camera
    translation = [tx, ty, tz]
    fisheye = false                             # optional
    [metadata]
    error = 0.4                                 # RMS px
    unit = "m"                                  # ours: what lengths are in, or "unknown"

Who wrote the file decides what a length is: see `aniposelib`, `pose2sim` and `toml_file`.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..atomic import write_text
from ..errors import InputError
from .camera import Calibration, Camera

NEEDED = ("matrix", "distortions", "rotation", "translation")


def camera_tables(tables: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The tables that describe a camera, in the file's order."""
    return {key: table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}


def calibration_of(tables: dict[str, Any], metric: bool) -> Calibration:
    """Cameras from such tables.

    Raises InputError when no table describes a camera, a key is missing, or its values make no camera.
    """
    found = camera_tables(tables)
    if not found:
        raise InputError("no camera in it: expected one table each, with matrix, distortions, rotation, translation")
    metadata = tables.get("metadata", {})
    error = metadata.get("error") if isinstance(metadata, dict) else None
    cameras = tuple(_camera(key, table) for key, table in found.items())
    try:
        return Calibration(cameras, metric, float(error) if isinstance(error, int | float) else None)
    except OverflowError:
        raise InputError("[metadata] error must be in px, got an integer that no number holds") from None


def _camera(key: str, table: dict[str, Any]) -> Camera:
    try:
        name = str(table.get("name", key))
    except ValueError:  # hexadecimal digits are read, but not written, in any number
        raise InputError(f"camera {key!r}: expected a text for its name, got an integer too long to be one") from None
    if missing := [each for each in NEEDED if each not in table]:
        raise InputError(f"camera {name!r}: {missing[0]!r} is missing; expected {', '.join(NEEDED)}")
    return Camera(
        name=name,
        matrix=table["matrix"],
        distortion=table["distortions"],
        rotation=rotation_matrix(name, table["rotation"]),
        translation=table["translation"],
        size=table.get("size"),
        fisheye=bool(table.get("fisheye", False)),
    )


def rotation_matrix(name: str, vector: Any) -> np.ndarray:
    """(3,) axis times angle, or a matrix (3, 3) as it is. Raises InputError for other shapes or what is no number."""
    try:
        values = np.array(vector, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"camera {name!r}: rotation must be numbers") from None
    if values.shape == (3, 3) or values.size != 3 or not np.isfinite(values).all():
        return values  # `Camera` says what is wrong with it, if anything is
    return Rotation.from_rotvec(values.ravel()).as_matrix()


def write_calibration(calibration: Calibration, path: str | Path) -> None:
    """Write such tables, whole or not at all; they read back exactly but for the last digits of a rotation.

    Raises OSError when `path` cannot be written.
    """
    lines: list[str] = []
    for number, camera in enumerate(calibration):
        lines += [f"[cam_{number}]", f"name = {_text(camera.name)}"]
        if camera.size is not None:
            lines += [f"size = {list(camera.size)}"]
        lines += [
            f"matrix = {camera.matrix.tolist()}",
            f"distortions = {camera.distortion.tolist()}",
            f"rotation = {Rotation.from_matrix(camera.rotation).as_rotvec().tolist()}",
            f"translation = {camera.translation.tolist()}",
            f"fisheye = {str(camera.fisheye).lower()}",
            "",
        ]
    lines += ["[metadata]", f'unit = "{"m" if calibration.metric else "unknown"}"']
    if calibration.error is not None:
        lines += [f"error = {float(calibration.error)!r}"]
    write_text(path, "\n".join(lines) + "\n")


def _text(value: str) -> str:
    """A TOML string: JSON's escapes are a part of TOML's."""
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")

"""Calibrations in TOML: the layout that aniposelib began, and that Pose2Sim and this package write as well.

    [cam_0]
    name = "left"
    size = [1920, 1080]                         # px, width and height
    matrix = [[fx, 0, cx], [0, fy, cy], [0, 0, 1]]
    distortions = [k1, k2, p1, p2, k3]          # k1 … k4 of a fisheye lens
    rotation = [rx, ry, rz]                     # rad, axis times angle, scene to camera
    translation = [tx, ty, tz]
    fisheye = false                             # optional
    [metadata]
    error = 0.4                                 # RMS px
    unit = "m"                                  # this package alone: unit of lengths, or "unknown"

Three programs are distinguished, since each has its own unit of length:

    this package   [metadata] has a unit
    Pose2Sim       metres; `fisheye = false` and four `distortions` in every table (calibration.py, `toml_write`)
    aniposelib     the unit of the user's board, which the file does not state (cameras.py, `CameraGroup.dump`)
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ..atomic import write_text
from ..budget import read_toml
from ..errors import InputError, about
from ..units import METRES
from .camera import Calibration, Camera

KEYS = ("matrix", "distortions", "rotation", "translation")
"""That every camera needs."""


def read_toml_cameras(path: str | Path, unit: str | None = None) -> Calibration:
    """Read a calibration in TOML.

    Args:
        path: the file.
        unit: of lengths in a file that states none, m, cm or mm; without it such a set is not metric.

    Raises:
        InputError: no table describes a camera, a key is missing, values that make no camera, or a unit given for a
            file that states its own.
        OSError: a file that cannot be opened.
    """
    tables = read_toml(path, "a calibration")
    with about(path):
        metadata = tables.get("metadata")
        metadata = metadata if isinstance(metadata, dict) else {}
        ours = "unit" in metadata
        if ours and metadata["unit"] not in ("m", "unknown"):
            got = repr(metadata["unit"][:40]) if isinstance(metadata["unit"], str) else "no text"
            raise InputError(f"[metadata] unit must be 'm' or 'unknown', got {got}")
        found = {key: table for key, table in tables.items() if isinstance(table, dict) and "matrix" in table}
        if not found:
            raise InputError(
                "no camera in it: expected one table each, with matrix, distortions, rotation, translation"
            )
        pose2sim = not ours and all(map(_is_pose2sim, found.values()))
        if unit is not None and (ours or pose2sim):
            raise InputError(f"this calibration says its own unit: leave {unit!r} out")
        cameras = tuple(_camera(key, table) for key, table in found.items())
        metric = metadata["unit"] == "m" if ours else pose2sim
        calibration = Calibration(cameras, metric, _error(metadata))
        return calibration if unit is None else calibration.scaled(METRES[unit])


def _is_pose2sim(table: dict[str, Any]) -> bool:
    given = table.get("distortions")
    return table.get("fisheye") is False and isinstance(given, list) and len(given) == 4


def _error(metadata: dict[str, Any]) -> float | None:
    error = metadata.get("error")
    try:
        return float(error) if isinstance(error, int | float) else None
    except OverflowError:
        raise InputError("[metadata] error must be in px, got an integer that no number holds") from None


def _camera(key: str, table: dict[str, Any]) -> Camera:
    try:
        name = str(table.get("name", key))
    except ValueError:  # Python reads hexadecimal integers of any length, but writes no long ones
        raise InputError(f"camera {key!r}: expected a text for its name, got an integer too long to be one") from None
    if missing := [each for each in KEYS if each not in table]:
        raise InputError(f"camera {name!r}: {missing[0]!r} is missing; expected {', '.join(KEYS)}")
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
    """(3, 3) of a vector (3,), axis times angle; a matrix (3, 3) is returned as it is.

    Raises InputError for values that are no numbers.
    """
    try:
        values = np.array(vector, dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"camera {name!r}: rotation must be numbers") from None
    if values.shape == (3, 3) or values.size != 3 or not np.isfinite(values).all():
        return values  # `Camera` refuses other shapes
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

"""Calibrations that OpenCV's programs save (YAML, JSON): one camera, or two of a stereo pair.

    one     camera_matrix, distortion_coefficients[, image_width, image_height][, R or rvec, T or tvec]
    stereo  M1, D1, M2, D2, R, T: camera 2 against camera 1, x₂ = R x₁ + T; the scene's frame is camera 1's

ROS's camera_info files have the first layout, and a `distortion_model` by name (sensor_msgs/distortion_models.hpp).

Names of keys: OpenCV's samples calibration.cpp and stereo_calib.cpp, whose second file, with R and T, is joined by
giving both. The unit is that of the board's squares, which the files do not state.

A matrix is `camera_matrix: !!opencv-matrix` with rows, cols, dt and data. PyYAML reads it: in OpenCV's own FileStorage
deeply nested lists crash the process (5.0.0), and ROS's files, which lack the first line, are refused.
"""

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ..budget import read_document
from ..errors import InputError, about, first_line
from ..limits import LIMITS
from ..units import METRES
from .camera import Calibration, Camera
from .toml_cameras import rotation_matrix

MATRIX = ("camera_matrix", "cameraMatrix", "Camera_Matrix", "K", "mtx")
DISTORTION = ("distortion_coefficients", "dist_coeffs", "distCoeffs", "Distortion_Coefficients", "D", "dist")
PAIR = {
    1: (("M1", "K1", "cameraMatrix1"), ("D1", "distCoeffs1")),
    2: (("M2", "K2", "cameraMatrix2"), ("D2", "distCoeffs2")),
}
MODELS = {"plumb_bob": False, "rational_polynomial": False, "equidistant": True, "fisheye": True}
"""Whether a lens is a fisheye's, by the names of ROS; a rational polynomial without denominators is Brown's law."""
ROTATION, TRANSLATION = ("R", "rvec", "rotation"), ("T", "tvec", "translation", "t")


def read_opencv(paths: str | Path | Sequence[str | Path], unit: str | None = None) -> Calibration:
    """Read one file, or several: one a camera, or the two of a stereo pair.

    A single camera without a pose is placed at the origin. Of several, each needs its own pose.

    Args:
        paths: the files; a camera has its file's name.
        unit: of T, m, cm or mm; None when it is not known.

    Raises:
        InputError: no matrix in it, several cameras without poses, or values that make no camera.
        OSError: a file that cannot be opened.
    """
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    trees = {path: read_storage(path) for path in files}
    merged = {key: value for tree in trees.values() for key, value in tree.items()}
    if _find(merged, PAIR[1][0]) is not None:
        cameras = _stereo(merged, files)
    else:
        cameras = [_single(tree, path, single=len(files) == 1) for path, tree in trees.items()]
    calibration = Calibration(tuple(cameras), metric=False)
    return calibration if unit is None else calibration.scaled(METRES[unit])


def _find(tree: dict[str, Any], keys: Sequence[str]) -> Any:
    return next((tree[key] for key in keys if key in tree), None)


def _size(tree: dict[str, Any]) -> tuple[int, int] | None:
    if "image_width" in tree and "image_height" in tree:
        return tree["image_width"], tree["image_height"]  # `Camera` checks them
    size = _flat(_find(tree, ("image_size", "imageSize", "Image_Size")))
    if not isinstance(size, np.ndarray) or size.size != 2:
        return None
    width, height = size
    return width, height


def _flat(value: Any) -> Any:
    """All numbers in a row; lists of unequal lengths are returned as they are, and `Camera` refuses them."""
    try:
        return np.ravel(value)
    except ValueError:
        return value


def _single(tree: dict[str, Any], path: Path, single: bool) -> Camera:
    matrix, distortion = _find(tree, MATRIX), _find(tree, DISTORTION)
    if matrix is None or distortion is None:
        raise InputError(f"{path}: no camera in it: expected camera_matrix and distortion_coefficients")
    rotation, translation = _find(tree, ROTATION), _find(tree, TRANSLATION)
    if rotation is None or translation is None:
        if not single:
            raise InputError(
                f"{path}: it has no pose of the camera (R, T); several cameras need one each: "
                "invdyn calibrate finds it from films of one board"
            )
        rotation, translation = np.eye(3), np.zeros(3)
    return Camera(
        name=path.stem,
        matrix=matrix,
        distortion=distortion,
        rotation=rotation_matrix(path.stem, rotation),
        translation=_flat(translation),
        size=_size(tree),
        fisheye=_is_fisheye(tree, path),
    )


def _is_fisheye(tree: dict[str, Any], path: Path) -> bool:
    """By ROS's name of the model, or OpenCV's flag. Raises InputError for another name."""
    named = tree.get("distortion_model", "")
    if isinstance(named, str) and not named:
        return np.array_equal(tree.get("fisheye_model", 0), 1)
    if not isinstance(named, str) or named not in MODELS:
        raise InputError(f"{path}: expected distortion_model as one of {', '.join(MODELS)}, got {named!r}")
    return MODELS[named]


def _stereo(tree: dict[str, Any], files: Sequence[Path]) -> list[Camera]:
    where = ", ".join(str(path) for path in files)
    rotation, translation = _find(tree, ROTATION), _find(tree, TRANSLATION)
    if rotation is None or translation is None:
        raise InputError(f"{where}: a stereo pair without R and T: give the file of the extrinsics, too")
    poses = {1: (np.eye(3), np.zeros(3)), 2: (rotation_matrix("camera_2", rotation), _flat(translation))}
    cameras = []
    for number, (matrices, distortions) in PAIR.items():
        matrix, distortion = _find(tree, matrices), _find(tree, distortions)
        if matrix is None or distortion is None:
            raise InputError(f"{where}: a stereo pair without {matrices[0]} and {distortions[0]}")
        cameras.append(Camera(f"camera_{number}", matrix, distortion, *poses[number], size=_size(tree)))
    return cameras


SPECIAL = re.compile(r"(?<=\.)(?:nan|inf)\b", re.IGNORECASE)
"""OpenCV's .Nan is YAML's .nan."""


class _Loader(yaml.SafeLoader):
    """YAML with OpenCV's matrices, and without any other tag or an alias, which could stand for more than fits."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        """A node; raises YAMLError for an alias."""
        if self.check_event(yaml.AliasEvent):
            mark = self.peek_event().start_mark
            raise yaml.MarkedYAMLError(problem="an alias, which OpenCV does not write", problem_mark=mark)
        return super().compose_node(parent, index)


for _kind in ("matrix", "nd-matrix"):
    _Loader.add_constructor(f"tag:yaml.org,2002:opencv-{_kind}", _Loader.construct_mapping)


def read_storage(path: str | Path) -> dict[str, Any]:
    """Contents of such a file, its matrices as arrays (rows, cols).

    Raises InputError for another kind of file or a long one, OSError if it cannot be opened.
    """
    try:
        text = read_document(path, LIMITS.yaml).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: expected OpenCV's YAML or JSON ({first_line(error)})") from None
    with about(path):
        is_json = text.lstrip().startswith("{")
        try:
            # OpenCV's first line, %YAML:1.0, is none of YAML's
            tree = (
                json.loads(text) if is_json else yaml.load(SPECIAL.sub(_lower, re.sub("^%YAML.*", "", text)), _Loader)
            )
        except yaml.MarkedYAMLError as error:
            line = error.problem_mark.line + 1 if error.problem_mark else 1
            raise InputError(f"line {line}: expected 'key: value' as OpenCV writes it, got {error.problem}") from None
        except (yaml.YAMLError, ValueError, RecursionError, TypeError) as error:
            raise InputError(f"broken {'JSON' if is_json else 'YAML'}: {first_line(error)}") from None
        if not isinstance(tree, dict):
            raise InputError("line 1: expected 'key: value' as OpenCV writes it, got something else")
        return {key: _matrix(key, value) for key, value in tree.items()}


def _lower(found: re.Match[str]) -> str:
    return found[0].lower()


def _matrix(key: str, value: Any) -> Any:
    """An array where a table is a matrix; lists of equal lengths are matrices, too."""
    if isinstance(value, dict) and "data" in value:
        try:
            rows, cols = int(value["rows"]), int(value["cols"])
            return np.array(value["data"], dtype=np.float64).reshape(rows, cols)
        except (KeyError, TypeError, ValueError, OverflowError):
            raise InputError(f"{key!r} is no matrix: expected rows, cols and as many data") from None
    if isinstance(value, list):
        try:
            return np.array(value, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            return value
    return value

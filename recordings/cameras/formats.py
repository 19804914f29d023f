"""The kinds of calibration file, recognised by suffix: one call reads any of them."""

from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError, about
from ..paths import check_readable
from ..units import METRES
from .camera import Calibration
from .opencv import read_opencv
from .qualisys import read_qualisys
from .toml_cameras import read_toml_cameras


def read_calibration(paths: str | Path | Sequence[str | Path], unit: str | None = None) -> Calibration:
    """Read a calibration of any known kind.

    Args:
        paths: a file; several for OpenCV's, one per camera or the two of a stereo pair.
        unit: of the file's lengths, m, cm or mm, for a kind that does not state it (aniposelib, OpenCV).

    Raises:
        InputError: a file of another kind, an unknown unit, or one for a file that states its own.
        OSError: a file that cannot be opened, or is no ordinary one.
    """
    if unit is not None and unit not in METRES:
        raise InputError(f"unknown unit {unit!r} of a calibration: known are {', '.join(METRES)}")
    files = [Path(paths)] if isinstance(paths, str | Path) else [Path(path) for path in paths]
    for path in files:
        check_readable(path)
    suffixes = {path.suffix.lower() for path in files}
    if suffixes <= {".yml", ".yaml", ".json"}:
        return read_opencv(files, unit)
    if len(files) > 1:
        raise InputError(f"expected one calibration of all cameras, got {len(files)}: only OpenCV's come one a camera")
    (path,) = files
    if suffixes == {".toml"}:
        return read_toml_cameras(path, unit)
    with about(path):
        if not suffixes <= {".txt", ".qca", ".xml"}:
            raise InputError(
                f"cannot tell the kind of calibration from the suffix {path.suffix!r}; expected .toml (ours, "
                "aniposelib, Pose2Sim), .qca.txt (Qualisys), .yml or .json (OpenCV)"
            )
        if unit is not None:
            raise InputError(f"this calibration says its own unit: leave {unit!r} out")
    return read_qualisys(path)

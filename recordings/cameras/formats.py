"""The kinds of calibration file, and how one is recognised: by its suffix, then by what is in it."""

from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError
from ..paths import check_readable
from ..toml_tables import read_toml
from ..units import METRES
from .aniposelib import read_aniposelib
from .camera import Calibration
from .opencv import read_opencv
from .pose2sim import is_pose2sim, read_pose2sim
from .qualisys import read_qualisys
from .toml_file import read_calibration_toml


def read_calibration(paths: str | Path | Sequence[str | Path], unit: str | None = None) -> Calibration:
    """Read a calibration of any known kind.

    Args:
        paths: a file; several for OpenCV's, one a camera or the two of a stereo pair.
        unit: what the file's lengths are in, m, cm or mm, for a kind that does not say (aniposelib, OpenCV).

    Raises:
        InputError: a file of another kind, a unit that is not known, or one for a file that says its own.
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
    kind = _kind(path)
    if kind in OWN_UNIT:
        if unit is not None:
            raise InputError(f"{path}: this calibration says its own unit: leave {unit!r} out")
        return OWN_UNIT[kind](path)
    return read_aniposelib(path, unit)


OWN_UNIT = {"ours": read_calibration_toml, "pose2sim": read_pose2sim, "qualisys": read_qualisys}


def _kind(path: Path) -> str:
    """A key of `OWN_UNIT`, or aniposelib. Raises InputError when the file looks like none."""
    suffix = path.suffix.lower()
    if suffix == ".toml":
        tables = read_toml(path, "a calibration")
        metadata = tables.get("metadata")
        if isinstance(metadata, dict) and "unit" in metadata:
            return "ours"
        return "pose2sim" if is_pose2sim(tables) else "aniposelib"
    if suffix in (".txt", ".qca", ".xml"):
        return "qualisys"
    raise InputError(
        f"{path}: cannot tell the kind of calibration from the suffix {path.suffix!r}; expected .toml (ours, "
        "aniposelib, Pose2Sim), .qca.txt (Qualisys), .yml or .json (OpenCV)"
    )

"""The registry of file formats, and how a file is recognised: by its suffix, then by what is in it.

A new format is a new entry of `FORMATS`.
"""

import difflib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError, readable
from ..paths import check_readable, is_film
from ..plane import OURS, Axes
from ..recording import Recording
from ..tables import read_header
from .c3d import read_c3d
from .deeplabcut import read_deeplabcut_csv, read_deeplabcut_h5
from .movement_package import FIRST, read_sleap_csv, read_with_movement
from .nexus_csv import is_nexus, read_nexus_csv
from .nwb_pose import read_nwb_pose
from .opensim import TRC_AXES, motion_unit, read_motion, read_trc


@dataclass(frozen=True)
class Format:
    """How to read one kind of file.

    Attributes:
        title: for messages.
        read: (path, frames a second, individual or None) → Recording, numbers as in the file; the rate is None where
            the file carries its times; `load` makes sure of it elsewhere.
        own_times: the file carries its times; otherwise the frame rate must be given.
        own_units: the file carries its units or is SI by contract; otherwise they must be given.
        animals: the file can hold several animals.
        axes: where its axes lie in a Recording (:mod:`..plane`).
        angle_unit: what a file says that its angles are in, a key of `units.RADIANS`, or None.
    """

    title: str
    read: Callable[[Path, Any, str | None], Recording] | None
    own_times: bool = False
    own_units: bool = False
    animals: bool = True
    axes: Axes = field(default_factory=lambda: OURS)
    angle_unit: Callable[[Path], str | None] = lambda path: None


def _by_movement(software: str) -> Callable[[Path, float, str | None], Recording]:
    return lambda path, fps, individual: read_with_movement(path, software, fps, individual)


def _read_deeplabcut(path: Path, fps: float, individual: str | None) -> Recording:
    read = read_deeplabcut_h5 if path.suffix.lower() in (".h5", ".hdf5") else read_deeplabcut_csv
    return read(path, fps, individual)


def _read_sleap(path: Path, fps: float, individual: str | None) -> Recording:
    if path.suffix.lower() == ".csv":
        return read_sleap_csv(path, fps, individual)
    return read_with_movement(path, "sleap", fps, individual)


FORMATS: dict[str, Format] = {
    # the contract's own reader also takes names from a body: `load` calls it by itself
    "csv": Format("keypoint CSV", None, own_times=True, own_units=True, animals=False),
    "deeplabcut": Format("DeepLabCut", _read_deeplabcut),
    "lightningpose": Format("Lightning Pose", _by_movement("lightningpose")),
    "sleap": Format("SLEAP", _read_sleap),
    "anipose": Format("Anipose", _by_movement("anipose")),
    "nwb": Format("NWB", lambda path, fps, individual: read_nwb_pose(path, individual), own_times=True),
    "nexus": Format(
        "Vicon Nexus",
        lambda path, fps, individual: read_nexus_csv(path, individual),
        own_times=True,
        own_units=True,
    ),
    "c3d": Format("C3D", lambda path, fps, individual: read_c3d(path, individual), own_times=True, own_units=True),
    "trc": Format(
        "OpenSim .trc",
        lambda path, fps, individual: read_trc(path),
        own_times=True,
        own_units=True,
        animals=False,
        axes=TRC_AXES,
    ),
    "mot": Format(
        "OpenSim .mot",
        lambda path, fps, individual: read_motion(path),
        own_times=True,
        own_units=True,
        animals=False,
        angle_unit=motion_unit,
    ),
}


def recognise(path: Path, name: str | None = None) -> str:
    """A key of `FORMATS`: the one that is given, or the one that the file looks like.

    Raises:
        InputError: an unknown format, or a file that looks like none.
        OSError: a file that cannot be opened, or is no ordinary one.
    """
    if name is not None:
        if name not in FORMATS:
            near = difflib.get_close_matches(name, FORMATS, 1, cutoff=0.0)[0]
            raise InputError(f"unknown format {name!r}: known are {', '.join(FORMATS)} (closest: {near})")
        return name
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return _recognise_csv(path)
    if suffix in (".h5", ".hdf5"):
        return _recognise_h5(path)
    by_suffix = {".slp": "sleap", ".nwb": "nwb", ".c3d": "c3d", ".trc": "trc", ".mot": "mot", ".sto": "mot"}
    if suffix not in by_suffix:
        check_readable(path)
        if is_film(path):
            raise InputError(
                f"{path}: a film has no keypoints yet: run `invdyn track`, or `invdyn infer`, which does both"
            )
        raise InputError(
            f"{path}: cannot tell the format from the suffix {suffix!r}; expected .csv, .h5, .slp, .nwb, "
            f".c3d, .trc, .mot or .sto (or say it: --set format={'|'.join(FORMATS)})"
        )
    return by_suffix[suffix]


def _recognise_csv(path: Path) -> str:
    header = read_header(path)
    if header[:1] == ["scorer"]:
        return "deeplabcut"
    if tuple(header[: len(FIRST)]) == FIRST:
        return "sleap"
    if is_nexus(header):
        return "nexus"
    return "anipose" if {"fnum", "M_00", "center_0"} <= set(header) else "csv"


def _recognise_h5(path: Path) -> str:
    import h5py

    check_readable(path)
    with open(path, "rb") as file, readable(path, "an HDF5 file"), h5py.File(file, "r") as store:
        keys = set(store)
        shape = getattr(store.get("tracks"), "shape", ())
    if "tracks" in keys and "node_names" not in keys:
        raise InputError(f"{path}: {_UNNAMED_IN_SPACE if shape[-1:] == (3,) else _UNNAMED}")
    return "sleap" if "tracks" in keys else "deeplabcut"


_UNNAMED = (
    "a SLEAP analysis file without node_names, as early versions wrote it, does not name its keypoints: export "
    "it again with a later SLEAP, or give the .slp file"
)
_UNNAMED_IN_SPACE = (
    "a file of SLEAP-Anipose does not say which keypoint is which: write its tracks as a table with columns time and "
    "<keypoint>_x, _y, _z in metres"
)

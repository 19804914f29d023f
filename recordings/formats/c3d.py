"""Motion capture in C3D files, the format that laboratories exchange, through the package `ezc3d` (extra `tracks`).

    POINT:LABELS, LABELS2 …    names of the P trajectories, "subject:marker" where subjects are named
    POINT:UNITS                m, cm or mm
    POINT:RATE                 frames/s; the first frame, by its number F from 0 on, is at F / rate
    POINT:Y_SCREEN             "+Y" or "+Z", the axis that points up on the screen; z where it is missing
    residual of a point        negative where a marker is not seen
    POINT:ANGLES, FORCES …     labels of what is computed by a body model, and no marker

Where y is up, (x, y, z) ↦ (x, −z, y), as of a .trc. Analog channels (force plates, EMG) are left out.
https://www.c3d.org/HTML/default.htm
"""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import InputError, readable
from ..limits import LIMITS
from ..naming import choose_individual
from ..paths import check_readable
from ..recording import Recording
from ..units import METRES

COMPUTED = ("ANGLES", "FORCES", "MOMENTS", "POWERS", "SCALARS", "MODELED_MARKERS")
"""Parameters that list trajectories which no camera saw."""
MIPS = bytes([86])
"""The processor whose numbers begin with the largest byte."""
MANY = ("", *map(str, range(2, 40)))
"""A parameter holds 255 labels: LABELS, LABELS2, and so on."""


def read_c3d(path: str | Path, individual: str | None = None) -> Recording:
    """Markers (T, P, 3), m, with z up; `individual` is a subject, needed where there are several.

    Unlabelled trajectories, which begin with a star, are left out.

    Raises:
        InputError: `ezc3d` is not installed, a file that it cannot read, that was cut off, is too large, has no markers
            or another unit, or a subject that was not chosen.
        OSError: a file that cannot be opened.
    """
    check_readable(path)
    try:
        import ezc3d
    except ImportError:
        raise InputError(f"{path}: reading C3D needs the package ezc3d: pip install 'invdyn[tracks]'") from None
    if (size := Path(path).stat().st_size) > LIMITS.memory:
        raise InputError(f"{path}: expected at most {LIMITS.memory / 2**30:g} GiB, got {size / 2**30:.3g}")
    with readable(path, "a C3D file"):
        file = ezc3d.c3d(str(path))
        return _recording(file, individual, Path(path))


def _recording(file: Any, individual: str | None, path: Path) -> Recording:
    point, header = file["parameters"]["POINT"], file["header"]["points"]
    labels = _labels(point, "LABELS")
    computed = {label for kind in COMPUTED for label in _labels(point, kind)}
    seen = [k for k, label in enumerate(labels) if label and label not in computed and not label.startswith("*")]
    if not seen:
        raise InputError("expected labelled markers, got none: label the trajectories and export them again")
    subjects = [labels[k].rpartition(":")[0] for k in seen]
    named = list(dict.fromkeys(subjects))
    chosen = choose_individual(named, individual if any(named) else "")
    own = [k for k, subject in zip(seen, subjects, strict=True) if subject == chosen]

    unit, rate = _text(point, "UNITS"), float(header["frame_rate"])
    if unit not in METRES:
        raise InputError(f"POINT:UNITS is {unit!r}: expected m, cm or mm")
    if not rate > 0:
        raise InputError(f"POINT:RATE is {rate:g}: expected frames a second")
    points = np.array(file["data"]["points"][:3, own], dtype=np.float64)
    if (stated := _stated_frames(path)) > points.shape[-1]:
        raise InputError(f"the header says {stated} frames, and {points.shape[-1]} are there: the file was cut off")
    residuals = np.asarray(file["data"]["meta_points"]["residuals"])[0][own]
    points[:, residuals < 0] = np.nan
    x, y, z = points.transpose(0, 2, 1) * METRES[unit]
    if y_up := _text(point, "Y_SCREEN").upper().endswith("Y"):
        warnings.warn(f"{path}: y is up in this file, z is up here: (x, y, z) is read as (x, -z, y)", stacklevel=2)
    return Recording(
        time=(int(header["first_frame"]) + np.arange(len(x))) / rate,
        keypoints=np.stack([x, -z, y] if y_up else [x, y, z], axis=-1),
        keypoint_names=tuple(labels[k].rpartition(":")[2] for k in own),
        name=path.stem,
    )


def _stated_frames(path: Path) -> int:
    """By the header's words 4 and 5, which `ezc3d` sets to what is there; a long file's do not hold its number."""
    with open(path, "rb") as file:
        head = file.read(10)
        file.seek((head[0] - 1) * 512 + 3)
        order: Literal["big", "little"] = "big" if file.read(1) == MIPS else "little"
    first, last = (int.from_bytes(head[at : at + 2], order) for at in (6, 8))
    return last - first + 1 if last < 2**16 - 1 else 0


def _labels(point: Mapping[str, Any], name: str) -> list[str]:
    """Of all parameters of that name, without blanks."""
    return [label.strip() for number in MANY for label in point.get(name + number, {}).get("value", ())]


def _text(point: Mapping[str, Any], name: str) -> str:
    """A parameter that is a word; empty where it is missing."""
    return next(iter(_labels(point, name)), "")

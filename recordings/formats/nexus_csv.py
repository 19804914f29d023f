"""Vicon Nexus's tables (ASCII export, .csv): the section of marker trajectories, with its own rate and unit.

    Trajectories
    100                                     rows a second
    ,,Ada:LELB,,,Ada:LWRI,,                 subject and marker over the first of its columns
    Frame,Sub Frame,X,Y,Z,X,Y,Z
    ,,mm,mm,mm,mm,mm,mm
    1,0,-391.888,-618.1,173.43,,,           empty where a marker is not seen; the section ends with an empty line

Other sections (devices, model outputs, joints …) may come before and after, and are left out. Cells are separated by
commas, semicolons or tabs. Axes are those of the capture volume, z up. https://help.vicon.com (Nexus, export to ASCII)
"""

import re
from collections.abc import Sequence
from pathlib import Path

from ..errors import InputError, about
from ..naming import choose_individual
from ..recording import Recording
from ..tables import read_lines, read_numbers
from ..units import METRES

SECTION = "Trajectories"
SECTIONS = (SECTION, "Devices", "Joints", "Model Outputs", "Segments", "Events")
"""Names that may stand in a file's first cell."""
AXES = ("X", "Y", "Z")


def is_nexus(header: Sequence[str]) -> bool:
    """Whether a file's first line, split at commas, is the name of one of Nexus's sections, and no more."""
    return "".join(header).strip("; \t") in SECTIONS


def read_nexus_csv(path: str | Path, individual: str | None = None) -> Recording:
    """Markers (T, P, 3), m, at (frame − 1)/rate; `individual` is a subject, needed where there are several.

    Raises:
        InputError: no section of trajectories, an invalid rate or unit, cells that are no numbers, or a subject
            that was not chosen.
        OSError: a file that cannot be opened.
    """
    lines = read_lines(path)
    with about(path):
        start = next((i for i, line in enumerate(lines) if re.match(rf'"?{SECTION}\b', line)), None)
        if start is None or len(lines) < start + 6:
            raise InputError(f"a table of Vicon Nexus without the section {SECTION}: export the trajectories, too")
        mark = next((each for each in ";\t," if each in lines[start + 3]), ",")
        rows = [(n, [cell.strip() for cell in line.split(mark)]) for n, line in enumerate(lines, 1)]
        ((rate, *_), markers, axes, units) = (cells for _, cells in rows[start + 1 : start + 5])
        end = next((i for i in range(start + 5, len(rows)) if not any(rows[i][1])), len(rows))
        places = _places(markers, axes)
        names, columns = _of_one(places, individual)
        own = [(n, [cells[i] if i < len(cells) else "" for i in (0, *columns)]) for n, cells in rows[start + 5 : end]]
        labels = ["Frame", *(f"{name} {axis}" for name in names for axis in AXES)]
        numbers, _ = read_numbers(own, labels)
        used = {units[i] if i < len(units) else "" for i in columns}
        if len(used) > 1 or not used <= set(METRES):
            raise InputError(f"units of markers are {', '.join(sorted(used))}: expected m, cm or mm, one for all")
        return Recording(
            time=(numbers[:, 0] - 1) / _rate(rate),
            keypoints=numbers[:, 1:].reshape(len(numbers), len(names), 3) * METRES[used.pop()],
            keypoint_names=names,
            name=Path(path).stem,
        )


def _rate(cell: str) -> float:
    try:
        rate = float(cell)
    except ValueError:
        rate = 0.0
    if not rate > 0:
        raise InputError(f"expected rows a second in the line below {SECTION}, got {cell!r}")
    return rate


def _places(markers: list[str], axes: list[str]) -> dict[str, tuple[int, ...]]:
    """Columns of x, y and z by "subject:marker"; other columns of a marker, such as its velocities, are left out."""
    starts = [i for i, name in enumerate(markers) if i > 1 and name]
    if not starts:
        raise InputError("no marker is named in the line above Frame")
    found: dict[str, tuple[int, ...]] = {}
    for start, stop in zip(starts, [*starts[1:], len(axes)], strict=True):
        own = {axes[i].upper(): i for i in range(start, min(stop, len(axes)))}
        if not set(AXES) <= set(own):
            raise InputError(f"marker {markers[start]!r} has columns {', '.join(own)}: expected X, Y and Z")
        found[markers[start]] = tuple(own[axis] for axis in AXES)
    return found


def _of_one(places: dict[str, tuple[int, ...]], individual: str | None) -> tuple[tuple[str, ...], list[int]]:
    """Names of one subject's markers, and their columns, one after the other."""
    subjects = [name.rpartition(":")[0] for name in places]
    named = list(dict.fromkeys(subjects))
    chosen = choose_individual(named, individual if any(named) else "")
    own = {name.rpartition(":")[2]: at for name, at in places.items() if name.rpartition(":")[0] == chosen}
    return tuple(own), [i for at in own.values() for i in at]

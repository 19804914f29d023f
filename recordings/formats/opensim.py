"""OpenSim's tables: joint moments (.sto) and motions (.mot) out, marker tracks (.trc) and motions in.

A .sto is a name, version, nRows, nColumns, inDegrees, `endheader`, a line of labels, then rows, all separated
by tabs; files saved by a spreadsheet are separated by commas, and are read as well. OpenSim's ground has y up and z to
the right; ours has z up, so (x, y, z) ↦ (x, −z, y).
https://opensimconfluence.atlassian.net/wiki/spaces/OpenSim/pages/53089619
"""

import warnings
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..atomic import write_text
from ..errors import InputError, about
from ..recording import Recording
from ..tables import read_lines, read_numbers
from ..units import METRES

TRC_AXES = {"x": (0, 1.0), "y": (2, 1.0), "z": (1, -1.0)}
"""Where a .trc's own axes lie in what :func:`read_trc` returns (:mod:`..plane`)."""
ANGLES = {"yes": "deg", "no": "rad"}
"""The unit of rotating joints by the header's inDegrees; distances are in m in both cases."""


def write_sto(columns: Mapping[str, np.ndarray], path: str | Path, name: str = "Inverse Dynamics") -> None:
    """Write columns (T,) by label, `time` first, NaN as `nan`. Raises InputError if time is not first."""
    if next(iter(columns), None) != "time":
        raise InputError(f"the first column of a .sto file must be time, got {next(iter(columns), None)!r}")
    rows = np.stack(list(columns.values()), axis=-1)
    lines = [name, "version=1", f"nRows={len(rows)}", f"nColumns={len(columns)}", "inDegrees=no", "endheader"]
    lines.append("\t".join(columns))
    lines += ["\t".join(f"{value:.10g}" for value in row) for row in rows]
    write_text(path, "\n".join(lines) + "\n")


def write_moments(
    path: str | Path,
    time: np.ndarray,
    moment: np.ndarray,
    q05: np.ndarray,
    q95: np.ndarray,
    coordinates: Sequence[str],
    shifting: Collection[str] = (),
    more: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Write joint torques with their 90 % band as `<coordinate>_moment` (or `_force`), `_q05` and `_q95`.

    Args:
        path: the .sto file.
        time: (T,) s.
        moment: (T, K) N·m, the central value.
        q05: (T, K) its 5 % quantile.
        q95: (T, K) its 95 % quantile.
        coordinates: K names of OpenSim coordinates.
        shifting: those of them that shift, m and N.
        more: further columns (T,) by label, such as forces.

    Raises:
        InputError: shapes that do not fit.
        OSError: `path` cannot be written.
    """
    shape = (len(time), len(coordinates))
    columns = {"time": np.asarray(time)}
    for suffix, values in (("moment", moment), ("q05", q05), ("q95", q95)):
        if np.shape(values) != shape:
            raise InputError(f"{suffix} must have shape {shape}, got {np.shape(values)}")
        for k, name in enumerate(coordinates):
            own = "force" if suffix == "moment" and name in shifting else suffix
            columns[f"{name}_{own}"] = np.asarray(values)[:, k]
    write_sto({**columns, **(more or {})}, path)


def write_motion(path: str | Path, time: np.ndarray, angles: np.ndarray, coordinates: Sequence[str]) -> None:
    """Write a motion (.mot): angles (T, K), rad, by OpenSim coordinate, at `time` (T,) s. Raises as `write_sto`."""
    write_sto({"time": time, **dict(zip(coordinates, np.asarray(angles).T, strict=True))}, path, "Coordinates")


def read_motion(path: str | Path) -> Recording:
    """Coordinates of a motion (.mot), as inverse kinematics writes it: numbers as in the file (:func:`motion_unit`).

    Raises InputError as `read_sto`, and where there is no column of time first.
    """
    columns = read_sto(path)
    with about(path):
        if next(iter(columns), None) != "time" or len(columns) < 2:
            raise InputError("not a motion: expected time and then a column for each coordinate")
        time = columns.pop("time")
        return Recording(
            time=time,
            keypoints=np.empty((len(time), 0, 3)),
            keypoint_names=(),
            angles=np.stack(list(columns.values()), axis=-1),
            joint_names=tuple(columns),
            name=Path(path).stem,
        )


def motion_unit(path: str | Path) -> str | None:
    """What the angles of a motion are in, deg or rad; None where its header does not state it.

    Raises InputError for another kind of file, and an inDegrees that is neither yes nor no.
    """
    lines = read_lines(path)
    with about(path):
        given = _header(lines[: _end(lines)]).get("indegrees", "")
        if given and given.lower() not in ANGLES:
            raise InputError(f"the header says inDegrees={given}: expected yes or no")
        return ANGLES.get(given.lower())


def read_sto(path: str | Path) -> dict[str, np.ndarray]:
    """Columns by label of a .sto or .mot file, as they stand (radians or degrees).

    A count of rows that is not the header's is a warning (UserWarning), as of a file that someone shortened. Raises
    InputError for another kind of file or a count of columns that is not the header's.
    """
    lines = read_lines(path)
    with about(path):
        end = _end(lines)
        mark = "," if "," in lines[end + 1] else None  # None: any white space
        labels = _cells(lines[end + 1], mark)
        rows = [(n, _cells(line, mark)) for n, line in enumerate(lines, 1) if n > end + 2 and line.strip(" \t,")]
        numbers, _ = read_numbers(rows, labels)
        header = _header(lines[:end])
        if (stated := header.get("ncolumns", str(len(labels)))) != str(len(labels)):
            raise InputError(f"the header says nColumns={stated}, but there are {len(labels)}")
        if (stated := header.get("nrows", str(len(rows)))) != str(len(rows)):
            words = f"{path}: the header says nRows={stated}, and there are {len(rows)}: was the file cut off?"
            warnings.warn(words, stacklevel=2)
        return dict(zip(labels, numbers.T, strict=True))


def _end(lines: Sequence[str]) -> int:
    """Index of the line 'endheader'. Raises InputError where there is none with labels below it."""
    end = next((i for i, line in enumerate(lines) if line.strip(" \t,") == "endheader"), None)
    if end is None or len(lines) < end + 2:
        raise InputError("not an OpenSim .sto file: no line 'endheader' with labels below it")
    return end


def _header(lines: Sequence[str]) -> dict[str, str]:
    """Values by key, whose case counts for nothing."""
    pairs = (line.strip(" \t,").split("=", 1) for line in lines if "=" in line)
    return {key.strip().lower(): value.strip() for key, value in pairs}


def _cells(line: str, mark: str | None) -> list[str]:
    return [cell.strip() for cell in line.strip().strip(mark).split(mark)]


def read_trc(path: str | Path) -> Recording:
    """Marker tracks, m, with z up; the file states its units and times.

    Raises InputError for another kind of file, or a unit that is not m, cm or mm.
    """
    lines = read_lines(path)
    with about(path):
        if len(lines) < 6 or not lines[0].startswith("PathFileType"):
            raise InputError("not an OpenSim .trc file: it must begin with PathFileType and hold five header lines")
        mark = "\t" if "\t" in lines[3] else ","
        # some programs write several tabs between two values
        keys, given = ([cell.strip() for cell in line.split(mark) if cell.strip()] for line in lines[1:3])
        unit = dict(zip(keys, given, strict=False)).get("Units", "")
        if unit not in METRES:
            raise InputError(f"Units is {unit!r}; expected m, cm or mm")
        markers = tuple(cell.strip() for cell in lines[3].split(mark)[2:] if cell.strip())
        width = 2 + 3 * len(markers)
        rows = [
            (n, [cell.strip() for cell in line.split(mark)[:width]])
            for n, line in enumerate(lines, 1)
            if n > 5 and line.strip(" \t,")
        ]
        rows = [(n, cells + [""] * (width - len(cells))) for n, cells in rows]  # a trailing gap has no tabs
        labels = ["frame", "time", *(f"{m} {axis}" for m in markers for axis in "XYZ")]
        numbers, _ = read_numbers(rows, labels)
        x, y, z = np.moveaxis(numbers[:, 2:].reshape(len(rows), -1, 3), -1, 0)
        return Recording(
            time=numbers[:, 1],
            keypoints=np.stack([x, -z, y], axis=-1) * METRES[unit],
            keypoint_names=markers,
            name=Path(path).stem,
        )

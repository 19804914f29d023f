"""DeepLabCut's tracks, single- and multi-animal, as csv or h5; Lightning Pose writes the same csv.

The csv has three or four header lines, each with its name in the first cell: scorer, [individuals,]
bodyparts, coords (x, y, likelihood); below, the first cell is the frame's number. The h5 is a table of pandas
with the same levels, in the same order, as its column labels. Numbers stay as in the file: pixels, y down.
Points that are unique in a film, such as a fixed base, stand under the individual `single` in a multi-animal file:
they belong to every animal.
"""

from pathlib import Path

import numpy as np

from ..errors import InputError, about
from ..recording import Recording
from ..tables import read_numbers, read_rows
from .individuals import choose_individual
from .pandas_h5 import read_pandas_h5

LEVELS = ("scorer", "individuals", "bodyparts", "coords")
SINGLE = "single"
"""The individual of points that are unique."""
TABLE = "df_with_missing"  # the key under which DeepLabCut keeps its table


def read_deeplabcut_csv(path: str | Path, fps: float, individual: str | None = None) -> Recording:
    """Read a csv; `individual` chooses among several animals.

    Raises:
        InputError: another header, rows that are no numbered frames, or an animal that was not chosen.
        OSError: a file that cannot be opened.
    """
    rows = read_rows(path)
    with about(path):
        header = {cells[0]: cells[1:] for _, cells in rows[:4] if cells[0] in LEVELS}
        if not {"bodyparts", "coords"} <= set(header):
            raise InputError("not a DeepLabCut csv: its header lines start with scorer, bodyparts, coords")
        if len({len(cells) for cells in header.values()}) > 1:
            raise InputError("the header lines have different numbers of cells")
        body = rows[len(header) :]
        labels = [" ".join(parts) for parts in zip(header["bodyparts"], header["coords"], strict=True)]
        if body and not body[0][1][0].lstrip("-").replace(".", "", 1).isdigit():
            raise InputError(f"rows must begin with a frame number, got {body[0][1][0]!r}: labelled images are no film")
        numbers, _ = read_numbers(body, ["frame", *labels])
        columns = list(zip(*(header[level] for level in LEVELS[1:] if level in header), strict=True))
        return _assemble(columns, numbers[:, 1:], numbers[:, 0], fps, individual, Path(path).stem)


def read_deeplabcut_h5(path: str | Path, fps: float, individual: str | None = None) -> Recording:
    """Read an h5, as above, and nothing in it but arrays and labels: it cannot run code (:mod:`.pandas_h5`)."""
    columns, frames, numbers = read_pandas_h5(path, TABLE)
    with about(path):
        if not all(len(label) in (3, 4) for label in columns) or not {"x", "y"} <= {label[-1] for label in columns}:
            raise InputError("not a DeepLabCut .h5 file: its table has no levels bodyparts and coords")
        columns = [label[1:] for label in columns]
        return _assemble(columns, numbers, frames, fps, individual, Path(path).stem)


def assembled(
    columns: list[tuple[str, ...]], numbers: np.ndarray, individual: str | None
) -> tuple[tuple[str, ...], dict[str, np.ndarray]]:
    """Body parts of one animal, and (T, P) of each coordinate, from columns ([individual,] bodypart, coordinate).

    Unique points follow the animal's own, which win where a name is in both.

    Raises InputError for an animal that was not chosen, and a body part without one of the coordinates.
    """
    owners = [column[0] if len(column) == 3 else "" for column in columns]
    names = list(dict.fromkeys(owners))
    animals = [name for name in names if name != SINGLE]
    known = names if individual == SINGLE or not animals else animals
    owner = choose_individual(known, individual if any(owners) else "")
    own, shared = (
        {column[-2:]: i for i, column in enumerate(columns) if owners[i] == name} for name in (owner, SINGLE)
    )
    place = own | {label: i for label, i in shared.items() if label[0] not in {point for point, _ in own}}
    points = tuple(dict.fromkeys(point for point, _ in place))
    present = {coordinate for _, coordinate in place}
    tracks = {}
    for coordinate in ("x", "y", *sorted(present & {"z", "likelihood"})):
        if missing := [point for point in points if (point, coordinate) not in place]:
            raise InputError(f"{missing[0]} has no column {coordinate!r}")
        tracks[coordinate] = numbers[:, [place[point, coordinate] for point in points]]
    return points, tracks


def _assemble(
    columns: list[tuple[str, ...]],
    numbers: np.ndarray,
    frames: np.ndarray,
    fps: float,
    individual: str | None,
    name: str,
) -> Recording:
    points, tracks = assembled(columns, numbers, individual)
    axes = "xyz" if "z" in tracks else "xy"  # a triangulated file has z and no likelihood
    return Recording(
        time=frames / fps,
        keypoints=np.stack([tracks[axis] for axis in axes], axis=-1),
        keypoint_names=points,
        confidence=tracks.get("likelihood"),
        name=name,
        length_unit="px",
    )

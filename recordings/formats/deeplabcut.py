"""DeepLabCut's tracks, single- and multi-animal, as csv or h5; Lightning Pose writes the same csv.

The csv has three or four header lines, each with its name in the first cell: scorer, [individuals,]
bodyparts, coords (x, y, likelihood); below, the first cell is the frame's number. The h5 is a table of pandas
with the same levels, in the same order, as its column labels. Numbers stay as in the file: pixels, y down.
Points that are unique in a film, such as a fixed base, stand under the individual `single` in a multi-animal file:
they belong to every animal.

Nothing in an h5 is run. pandas reads such files through PyTables, which unpickles a node's attributes as it opens
them, so that a file can run any command. Here h5py reads the arrays. Column labels of pandas' "table" layout are
stored pickled; they are unpickled with every class and function refused
(https://docs.python.org/3/library/pickle.html#restricting-globals), which leaves lists, tuples, numbers and text.

    fixed   axis0_level<i>, axis0_label<i>   column labels (levels and codes); axis1 rows;
            block<b>_items_…, block<b>_values (T, C_b)
    table   table: index, values_block_<b> (T, C_b); attributes non_index_axes, values_block_<b>_kind
"""

import io
import pickle
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from ..budget import check_hdf5, memory_limit
from ..errors import InputError, about, readable
from ..naming import choose_individual
from ..recording import Recording
from ..tables import read_numbers, read_rows

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
    """Read an h5, as above, and nothing in it but arrays and labels: it cannot run code."""
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


Label = tuple[str, ...]


def read_pandas_h5(path: str | Path, key: str) -> tuple[list[Label], np.ndarray, np.ndarray]:
    """Column labels (C), the rows' numbers (T,) and values (T, C) of the table at `key`, or the file's first.

    Raises InputError for a file that is not whole, is beyond its budget or holds no such table, for labels or values
    that are pickled objects, and rows without numbers; OSError for a file that cannot be opened.
    """
    check_hdf5(path)
    with open(path, "rb") as file, readable(path, "a table of pandas"):
        with h5py.File(file, "r") as store:
            group = store[key if key in store else next(iter(store))]
            read = {b"frame": _fixed, b"frame_table": _appendable}.get(bytes(group.attrs.get("pandas_type", b"")))
            if read is None:
                raise InputError(f"{group.name} is no table of pandas, frame or frame_table")
            columns, rows, blocks = read(group)
        size = f"{len(rows)} × {len(columns)} numbers"
        if 8 * len(rows) * len(columns) > (limit := memory_limit(Path(path).stat().st_size)):
            raise InputError(f"its table has {size}, expected at most {limit / 2**30:.3g} GiB")
        values = np.full((len(rows), len(columns)), np.nan)
        place = {label: i for i, label in enumerate(columns)}
        for labels, block in blocks:
            if block.shape != (len(rows), len(labels)) or not set(labels) <= set(place):
                raise InputError(f"expected blocks that fit a table of {size}, got one of shape {block.shape}")
            values[:, [place[label] for label in labels]] = block
    return columns, rows, values


def _fixed(group: h5py.Group) -> tuple[list[Label], np.ndarray, list[tuple[list[Label], np.ndarray]]]:
    blocks = []
    for number in range(int(group.attrs["nblocks"])):
        stored = group[f"block{number}_values"]
        values = _numbers(stored)
        blocks.append((_labels(group, f"block{number}_items"), values if stored.attrs.get("transposed") else values.T))
    return _labels(group, "axis0"), _numbers(group["axis1"]), blocks


def _labels(group: h5py.Group, axis: str) -> list[Label]:
    if bytes(group.attrs[f"{axis}_variety"]) != b"multi":
        return [(str(each),) for each in _texts(group[axis])]
    levels = []
    for level in range(int(group.attrs[f"{axis}_nlevels"])):
        texts, codes = _texts(group[f"{axis}_level{level}"]), _numbers(group[f"{axis}_label{level}"])
        levels.append(["" if code < 0 else texts[int(code)] for code in codes])
    return list(zip(*levels, strict=True))


def _appendable(group: h5py.Group) -> tuple[list[Label], np.ndarray, list[tuple[list[Label], np.ndarray]]]:
    table = group["table"]
    ((_, columns),) = _plain(group.attrs["non_index_axes"])
    rows = table[:]
    names = [name for name in rows.dtype.names if name.startswith("values_block_")]
    blocks = [(_tuples(_plain(table.attrs[f"{name}_kind"])), rows[name]) for name in names]
    if not all(np.issubdtype(rows[name].dtype, np.number) for name in ("index", *names)):
        raise InputError("rows must have frame numbers and values be numbers: labelled images are no film")
    return _tuples(columns), rows["index"].astype(float), blocks


def _tuples(labels: list) -> list[Label]:
    return [tuple(map(str, label)) if isinstance(label, tuple) else (str(label),) for label in labels]


def _numbers(stored: h5py.Dataset) -> np.ndarray:
    if not np.issubdtype(stored.dtype, np.number) or stored.dtype.metadata:
        raise InputError(f"{stored.name} holds no numbers but text or pickled objects: labelled images are no film")
    return stored[()].astype(float)


def _texts(stored: h5py.Dataset) -> list[str]:
    if stored.dtype.kind != "S":
        return [str(number) for number in _numbers(stored)]
    return [text.decode() for text in stored[()]]


class _Plain(pickle.Unpickler):
    def find_class(self, module: str, name: str) -> Any:
        raise InputError(
            f"its labels hold a pickled {module}.{name}, which is not read: it could run code; export a .csv"
        )

    def persistent_load(self, pid: Any) -> Any:
        raise InputError("its labels hold a pickled reference, which is not read; export a .csv")


def _plain(pickled: bytes) -> Any:
    try:
        return _Plain(io.BytesIO(bytes(pickled)), encoding="latin-1").load()
    except (pickle.UnpicklingError, EOFError, UnicodeDecodeError, MemoryError, OverflowError) as error:
        raise InputError(f"its labels cannot be read ({type(error).__name__})") from None

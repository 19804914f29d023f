"""A table that pandas wrote to HDF5, read as data: nothing in the file is run.

pandas reads such files through PyTables, which unpickles a node's attributes as it opens them, so that a file can run
any command. Here h5py reads the arrays. Column labels of pandas' "table" layout are stored pickled; they
are unpickled with every class and function refused (https://docs.python.org/3/library/pickle.html#restricting-globals),
which leaves lists, tuples, numbers and text.

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

from ..budget import memory_limit
from ..errors import InputError, readable
from ..hdf5_size import check_hdf5

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

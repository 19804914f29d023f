"""Data sets of parquet files that unpack to much."""

import os
from pathlib import Path

import log_files
import numpy as np

from .kit import BOMB, READ, good, hostile


def parquet(folder: Path, columns: dict, times: int = 1) -> Path:
    """A data set's file of these columns, over and over."""
    import pyarrow
    import pyarrow.parquet

    table, path = pyarrow.table(columns), folder / "log.parquet"
    with pyarrow.parquet.ParquetWriter(path, table.schema, compression="zstd") as writer:
        for _ in range(times):
            writer.write_table(table)
    return path


def state(rows: int) -> dict:
    """Columns of the features that the mapping needs."""
    from pyarrow import ListArray, array

    columns = {"episode_index": np.zeros(rows, int), "timestamp": np.arange(rows) * 0.02}
    flat = np.zeros(2 * rows)
    for name in ("observation.state", "action"):
        offsets = np.arange(rows + 1, dtype=np.int32) * 2
        columns[name] = ListArray.from_arrays(array(offsets), array(flat))
    return columns


def needs(folder: Path) -> None:
    """A mapping of entries by their numbers, as the file alone has them."""
    lines = [
        f'[joints.{joint}]\nangle = "observation.state.{k}"\ntarget = "action.{k}"\n'
        for k, joint in enumerate(log_files.JOINTS)
    ]
    (folder / "map.toml").write_text("".join(lines))


@hostile(BOMB)
def a_parquet_of_many_rows(folder, rng):
    needs(folder)
    return parquet(folder, state(2**18), rng.randint(24, 40))


@hostile(BOMB, costly=True)
def a_list_of_many_numbers(folder, rng):
    from pyarrow import ListArray, array

    needs(folder)
    columns = state(1)
    flat = np.zeros(2**25 + rng.randint(1, 2**20), np.int8)
    columns["observation.state"] = ListArray.from_arrays(array([0, len(flat)], "int32"), array(flat))
    return parquet(folder, columns)


@hostile(BOMB, must=READ, column=("words", "numbers"))
def a_column_that_is_not_needed(folder, rng, column):
    import pyarrow

    needs(folder)
    rows = 2**15
    if column == "words":
        junk = pyarrow.DictionaryArray.from_arrays(np.zeros(rows, np.int32), ["x" * rng.randint(50_000, 100_000)])
    else:
        offsets = np.arange(rows + 1, dtype=np.int32) * 1000
        junk = pyarrow.ListArray.from_arrays(pyarrow.array(offsets), pyarrow.array(np.zeros(1000 * rows, np.int8)))
    return parquet(folder, state(rows) | {"junk": junk})


@hostile(BOMB, name=("info.json", "map.toml"))
def a_giant_text_with_a_data_set(folder, rng, name):
    """5 GiB that take no place on a disk; without its names a data set has no such tracks."""
    path = good(folder, "set")
    os.truncate(_touched(path / "meta" / name if name == "info.json" else folder / name), 5 * 2**30)
    return path


def _touched(path: Path) -> Path:
    path.touch()
    return path

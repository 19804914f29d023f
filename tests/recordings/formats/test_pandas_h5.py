"""A file of pandas is data: both of its layouts are read, and nothing that is pickled in it is run."""

import pickle
import subprocess
import sys
import warnings

import h5py
import numpy as np
import pandas as pd
import pytest

from invdyn.recordings import InputError, load
from invdyn.recordings.formats.deeplabcut import read_pandas_h5
from invdyn.recordings.limits import Limits

tables = pytest.importorskip("tables")
KEY = "df_with_missing"
POINTS, FRAMES = ("shoulder", "wrist"), 5


class Touch:
    """Unpickled, it makes a file, as it could run any command."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


def save(path, animals=(), layout="table", split=False):
    levels = [["net"], *([animals] if animals else []), POINTS, ["x", "y", "likelihood"]]
    columns = pd.MultiIndex.from_product(levels)
    frame = pd.DataFrame(np.random.default_rng(4).uniform(20, 90, (FRAMES, len(columns))), columns=columns)
    frame.iloc[2, 0] = np.nan
    if split:  # a second block, of another type
        frame[columns[2]] = np.arange(FRAMES)
        frame[columns[-1]] = np.arange(FRAMES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyTables' remarks about names
        frame.to_hdf(path, key=KEY, mode="w", format=layout)
    return frame


@pytest.mark.parametrize("layout", ["fixed", "table"])
@pytest.mark.parametrize("animals", [(), ("ada", "bob")])
@pytest.mark.parametrize("split", [False, True])
def test_reads_what_pandas_writes(tmp_path, layout, animals, split):
    frame = save(tmp_path / "rec.h5", animals, layout, split)
    columns, rows, values = read_pandas_h5(tmp_path / "rec.h5", KEY)
    assert columns == list(frame.columns)
    np.testing.assert_array_equal(rows, frame.index)
    np.testing.assert_array_equal(values, frame.to_numpy(dtype=float))


def old_path(path) -> None:
    """As the file was opened before, in a process of its own."""
    code = (
        f"import warnings; warnings.simplefilter('ignore'); import pandas; pandas.HDFStore({str(path)!r}, 'r')[{KEY!r}]"
    )
    subprocess.run([sys.executable, "-c", code], capture_output=True, check=False)


@pytest.mark.parametrize("attribute", ["info", "non_index_axes"])
def test_a_file_made_to_run_code_does_not(tmp_path, attribute):
    path, mark = tmp_path / "rec.h5", tmp_path / "ran"
    save(path)
    with h5py.File(path, "a") as store:
        store[KEY].attrs[attribute] = np.bytes_(pickle.dumps(Touch(mark), 0))
    old_path(path)
    assert mark.exists()  # the file is what it is meant to be
    mark.unlink()
    if attribute == "info":  # not read at all
        assert load(path, units="px", fps=25).keypoint_names == POINTS
    else:
        with pytest.raises(InputError, match=r"pickled \S*open, .* could run code"):
            load(path, units="px", fps=25)
    assert not mark.exists()


def test_values_that_are_objects_are_refused(tmp_path):
    path, mark = tmp_path / "rec.h5", tmp_path / "ran"
    with tables.open_file(str(path), "w") as store:
        group = store.create_group("/", KEY)
        group._v_attrs.pandas_type, group._v_attrs.nblocks = "frame", 1
        group._v_attrs.axis0_variety = group._v_attrs.block0_items_variety = "regular"
        for name in ("axis0", "axis1", "block0_items", "block0_values"):
            store.create_vlarray(group, name, tables.ObjectAtom()).append(Touch(mark))
    with pytest.raises(InputError, match="text or pickled objects"):
        load(path, units="px", fps=25)
    assert not mark.exists()


def test_a_table_of_two_long_axes_is_one_line(tmp_path, monkeypatch):
    """Each axis is small, all cells are not: a file declares them with nothing stored."""
    monkeypatch.setattr("invdyn.recordings.budget.LIMITS", Limits(memory=2**20))  # else it takes seconds
    save(tmp_path / "rec.h5", layout="fixed")
    with h5py.File(tmp_path / "rec.h5", "a") as store:
        del store[KEY]["axis1"]
        store[KEY].create_dataset("axis1", (2**16,), "i8", chunks=(1000,))
    with pytest.raises(InputError, match=r"65536 × 6 numbers, expected at most .* GiB"):
        read_pandas_h5(tmp_path / "rec.h5", KEY)


def test_huge_labels_are_one_line(tmp_path):
    save(tmp_path / "rec.h5", layout="fixed")
    with h5py.File(tmp_path / "rec.h5", "a") as store:
        del store[KEY]["axis0_level0"]
        store[KEY].create_dataset("axis0_level0", (2**20,), "S4096", chunks=(1,))
    with pytest.raises(InputError, match=r"declare 4\.29e\+09 of numbers, expected at most"):
        read_pandas_h5(tmp_path / "rec.h5", KEY)


def test_labelled_images_and_huge_sizes_are_one_line(tmp_path):
    frame = save(tmp_path / "rec.h5")
    frame.index = [f"img{i}.png" for i in range(FRAMES)]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame.to_hdf(tmp_path / "images.h5", key=KEY, mode="w", format="fixed")
    with pytest.raises(InputError, match="labelled images"):
        load(tmp_path / "images.h5", units="px", fps=25)
    save(tmp_path / "huge.h5", layout="fixed")
    with h5py.File(tmp_path / "huge.h5", "a") as store:
        del store[KEY]["block0_values"]
        store[KEY].create_dataset("block0_values", (10**9, 10**6), "f8", chunks=True)
    with pytest.raises(InputError, match="of numbers, expected at most"):
        load(tmp_path / "huge.h5", units="px", fps=25)

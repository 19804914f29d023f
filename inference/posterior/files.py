"""A posterior as a file, netCDF, and as bytes that workers and checkpoints share.

A file is written whole or not at all. What is read is checked once: its size, its layout (:mod:`.layout`), and the
version that wrote it.
"""

import tempfile
from pathlib import Path

import arviz as az
import h5py
import numpy as np
import torch

from invdyn.inference.execution.distribute import Tensors
from invdyn.inference.execution.seeds import seeded
from invdyn.inference.posterior.layout import check_layout
from invdyn.inference.posterior.posterior import equally_weighted, joined_chains
from invdyn.inference.posterior.problem import DRAWS
from invdyn.recordings import InputError, atomic_path, resolved
from invdyn.recordings.budget import check_hdf5
from invdyn.recordings.errors import about, first_line

COMPRESSED = 32e6
"""Bytes up to which a posterior is compressed."""


def save_posterior(idata: az.InferenceData, path: str | Path) -> None:
    """Write netCDF, whole or not at all. Raises OSError when ``path`` cannot be written.

    What is large is not compressed: draws are noise in all but their first digits, and it takes longer than the draws.
    """
    size = sum(idata[group].nbytes for group in idata.groups())
    with atomic_path(path) as temporary:
        idata.to_netcdf(str(temporary), engine="h5netcdf", compress=size < COMPRESSED)


def load_posterior(path: str | Path) -> az.InferenceData:
    """Read what :func:`save_posterior` wrote.

    Raises FileNotFoundError, or InputError when the file is damaged or is not a posterior of ours, with which of its
    variables is not as :mod:`.layout` has it.
    """
    if not resolved(path).exists():
        raise FileNotFoundError(2, "no such posterior", str(path))
    check_hdf5(path)  # first: where this fails, h5netcdf complains once more when it is dropped
    try:
        with h5py.File(path) as store:
            dict(store.attrs)
        idata = az.from_netcdf(str(path), engine="h5netcdf")
        for group in idata.groups():  # in place; InferenceData's own method would load a copy
            idata[group].load()
        if idata.attrs.get("method") is not None and "draws" not in idata.attrs:
            idata = _of_version_02(idata)
    except InputError:
        raise
    except Exception as error:  # a broken file fails anywhere inside HDF5, xarray or ArviZ
        raise InputError(f"{path} is damaged or not netCDF: {first_line(error)}") from error
    with about(path):
        check_layout(idata)
    return idata


def _of_version_02(idata: az.InferenceData) -> az.InferenceData:
    """A file of version 0.2 or before, as it is laid out now: a chain was a filter, and had a weight."""
    if missing := {"posterior", "posterior_predictive", "sample_stats"} - set(idata.groups()):
        raise InputError(f"no posterior of invdyn: it lacks {', '.join(sorted(missing))}")
    idata = idata.map(lambda data: data.rename(chain="filter"), groups="sample_stats")
    sizes = [idata["posterior"].sizes[dim] for dim in DRAWS]
    weights = torch.as_tensor(idata["sample_stats"]["log_weight"].values).repeat_interleave(sizes[1])
    with seeded(int(idata.attrs.get("seed", 0))):
        return equally_weighted(idata, weights, joined_chains(*sizes))


def packed(idata: az.InferenceData) -> Tensors:
    """A posterior as the bytes of its file, the one form of it that workers and checkpoints share."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "posterior.nc"
        save_posterior(idata, file)
        return {"file": torch.from_numpy(np.fromfile(file, np.uint8))}


def unpacked(part: Tensors) -> az.InferenceData:
    """The posterior of which :func:`packed` are the bytes."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "posterior.nc"
        part["file"].numpy().tofile(file)
        return load_posterior(file)

"""Whether an HDF5 file (netCDF 4, NWB, DeepLabCut, SLEAP) is one file within its budget; no data set is read.

A file may declare any size and store nothing; one chunk, which is unpacked whole for any of its numbers, may be as
large. Data may lie in other files too: by external links, external storage and virtual data sets, which are refused.
"""

from pathlib import Path

import h5py
import numpy as np

from .budget import memory_limit
from .errors import InputError, readable
from .limits import LIMITS
from .paths import check_readable


def check_hdf5(path: str | Path) -> None:
    """Raise InputError for a file that is not whole, needs another or declares more than its budget (:mod:`.budget`).

    Raises OSError for a file that cannot be opened or is no ordinary one.
    """
    size = check_readable(path).stat().st_size
    with open(path, "rb"):  # not permitted: the system's own words are the clearest
        pass
    with readable(path, "an HDF5 file"), h5py.File(path, "r") as store:
        declared = _declared(store)

    if declared > (limit := memory_limit(size)):
        raise InputError(
            f"{path}: its {size} bytes declare {declared:.3g} of numbers, expected at most {limit:.3g}: it is damaged, "
            "or export a shorter part"
        )


def _declared(store: h5py.File) -> int:
    """Bytes of all its data sets in memory."""
    declared = 0
    links: list[tuple[str, object]] = []
    store.visititems_links(lambda name, link: links.append((name, link)))

    for name, link in links:
        if isinstance(link, h5py.ExternalLink):
            raise InputError(f"{name:.100} lies in another file, {link.filename!r:.100}, which is not read")
        if not isinstance(link, h5py.HardLink) or not isinstance(node := store[name], h5py.Dataset):
            continue
        declared += bytes_of(node)
    return declared


def bytes_of(data: h5py.Dataset) -> int:
    """Bytes of a data set in memory. Raises InputError where it lies in another file or its chunks are too large."""
    if data.external or data.is_virtual:
        raise InputError(f"{data.name:.100} lies in another file, which is not read")
    item = max(8, data.dtype.itemsize)  # all numbers become float64
    chunk = item * int(np.prod(data.chunks or (0,), dtype=object))
    if chunk > LIMITS.chunk:
        raise InputError(
            f"{data.name:.100} has chunks of {chunk:.3g} bytes, expected at most {LIMITS.chunk / 2**20:g} MiB"
        )
    return item * int(data.size or 0)

"""The budget of a file that is read, how much of :class:`.limits.Limits` is left; texts, TOML and HDF5 within it.

An HDF5 file (netCDF 4, NWB, DeepLabCut, SLEAP) may declare any size and store nothing; one chunk, which is unpacked
whole for any of its numbers, may be as large. Data may lie in other files too: by external links, external storage and
virtual data sets, which are refused.
"""

import shutil
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO

import h5py
import numpy as np

from .errors import InputError, first_line, readable
from .limits import LIMITS
from .paths import check_readable


def memory_limit(size: int) -> int:
    """Bytes of arrays that a file of `size` bytes may take."""
    return max(LIMITS.memory, LIMITS.memory_ratio * size)


def read_document(path: str | Path, limit: int = LIMITS.document) -> bytes:
    """All of a text file.

    Raises InputError beyond `limit` bytes, OSError for a path that cannot be opened or is no ordinary file.
    """
    with check_readable(path).open("rb") as file:
        content = file.read(limit + 1)

    if len(content) > limit:
        raise InputError(f"{path}: expected a text of at most {limit / 2**20:g} MiB, this one has more")
    return content


@dataclass
class Budget:
    """What is left for a log of `size` bytes. Each method raises InputError where it takes more than there is."""

    size: int
    _bytes: int = field(init=False)
    _records: int = field(init=False)
    _numbers: int = field(init=False)

    def __post_init__(self) -> None:
        self.unpacked = max(LIMITS.memory, LIMITS.unpacked_ratio * self.size)
        self.records = max(LIMITS.records, self.size // LIMITS.record_bytes)
        self._bytes, self._records, self._numbers = self.unpacked, self.records, LIMITS.numbers

    def unpack(self, size: int, what: str) -> None:
        """Take `size` bytes that `what` unpacks to."""
        self._bytes -= size
        if self._bytes < 0:
            raise InputError(
                f"{what} unpacks to more than {self.unpacked / 2**30:.3g} GiB, the limit for "
                f"{self.size} bytes: export what is needed alone"
            )

    def record(self) -> None:
        """Take one record."""
        self._records -= 1
        if self._records < 0:
            raise InputError(f"it has more than {self.records} records: export what is needed alone")

    def piece(self, size: int, what: str, limit: int = LIMITS.chunk) -> None:
        """Check the size of a part that is in memory as a whole."""
        if not 0 <= size <= limit:
            raise InputError(f"{what} claims {size} bytes, expected at most {limit / 2**20:g} MiB")

    def count(self, numbers: int) -> None:
        """Take so many numbers of a log."""
        self._numbers -= numbers
        if self._numbers < 0:
            raise InputError(f"it has more than {LIMITS.numbers} numbers: export fewer tracks or a shorter part")

    def copy(self, source: BinaryIO, target: BinaryIO, folder: Path, what: str) -> None:
        """Write a stream that unpacks `source` into `target`, a file in `folder`."""
        room = shutil.disk_usage(folder).free // 2

        while piece := source.read(2**20):
            self.unpack(len(piece), what)
            room -= len(piece)
            if room < 0:
                raise InputError(f"{what} unpacks to more than half of the free space in {folder}")
            target.write(piece)


def read_toml(path: str | Path, what: str) -> dict[str, Any]:
    """Tables of a file that should be ``what``, such as "a calibration".

    Raises InputError for what is no TOML or too long for one, OSError for a file that cannot be opened.
    """
    content = read_document(path)
    try:
        return tomllib.loads(content.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: expected {what} in TOML ({first_line(error)})") from None
    except RecursionError:
        raise InputError(f"{path}: expected {what}, got TOML nested too deep for one") from None
    except ValueError:  # Python turns no more than 4,300 digits into an integer
        raise InputError(f"{path}: expected {what}, got TOML with an integer too long to be read") from None


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

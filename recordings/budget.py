"""What a file of others may cost to read: one budget, checked before anything is unpacked.

A file's own bytes are its sender's cost, so limits grow with them; a small file gets a fixed share:

    arrays in memory     max(1 GiB,  10 × the file's bytes)
    unpacked in a stream max(1 GiB, 100 × the file's bytes), one piece of 256 MiB after the other
    unpacked to disk     the same, and half of what is free there at most
    records of a log     max(2²³, file's bytes / 64)
    numbers of a log     2²⁵, in 10,000 tracks; a message counts for 16 or more
    texts parsed whole   16 MiB; 1 MiB of YAML, whose parser takes a second for 100 kB
    a message            16 MiB
    steps of a query     5·10⁸ of SQLite's virtual machine, about 5 s
"""

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from .errors import InputError
from .paths import check_readable

MEMORY = 2**30
"""Bytes that a small file may take."""
PIECE = 2**28
"""Bytes of one compressed chunk, unpacked."""
DOCUMENT, YAML = 2**24, 2**20
"""Bytes of a text that is parsed whole."""
MESSAGE = 2**24
"""Bytes of a message."""
NUMBERS, TRACKS = 2**25, 10_000
"""Numbers of a log, and its tracks."""
RECORDS, RECORD = 2**23, 64
"""Records of a small log, and bytes of a record of a large one: passing one over takes a microsecond."""
STEPS = 500_000_000
"""Steps of a database's query."""
ARRAYS, STREAMED = 10, 100
"""Bytes of memory, and of a stream, for each byte of a file."""


def memory_limit(size: int) -> int:
    """Bytes of arrays that a file of `size` bytes may take."""
    return max(MEMORY, ARRAYS * size)


def read_document(path: str | Path, limit: int = DOCUMENT) -> bytes:
    """All of a text file.

    Raises InputError beyond `limit` bytes, OSError for what cannot be opened or is no ordinary file.
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
    _numbers: int = field(init=False, default=NUMBERS)

    def __post_init__(self) -> None:
        self._bytes = max(MEMORY, STREAMED * self.size)
        self._records = max(RECORDS, self.size // RECORD)

    def unpack(self, size: int, what: str) -> None:
        """Take `size` bytes that `what` unpacks to."""
        self._bytes -= size
        if self._bytes < 0:
            raise InputError(
                f"{what} unpacks to more than {max(MEMORY, STREAMED * self.size) / 2**30:.3g} GiB, the limit for "
                f"{self.size} bytes: export what is needed alone"
            )

    def record(self) -> None:
        """Take one record."""
        self._records -= 1
        if self._records < 0:
            raise InputError(
                f"it has more than {max(RECORDS, self.size // RECORD)} records: export what is needed alone"
            )

    def piece(self, size: int, what: str, limit: int = PIECE) -> None:
        """Check the size of what is in memory at once."""
        if not 0 <= size <= limit:
            raise InputError(f"{what} claims {size} bytes, expected at most {limit / 2**20:g} MiB")

    def count(self, numbers: int) -> None:
        """Take so many numbers of a log."""
        self._numbers -= numbers
        if self._numbers < 0:
            raise InputError(f"it has more than {NUMBERS} numbers: export fewer tracks or a shorter part")

    def copy(self, source: BinaryIO, target: BinaryIO, folder: Path, what: str) -> None:
        """Write a stream that unpacks `source` into `target`, a file in `folder`."""
        room = shutil.disk_usage(folder).free // 2

        for piece in pieces(source):
            self.unpack(len(piece), what)
            room -= len(piece)
            if room < 0:
                raise InputError(f"{what} unpacks to more than half of the free space in {folder}")
            target.write(piece)


def pieces(source: BinaryIO, size: int = 2**20) -> Iterator[bytes]:
    """A stream's content, up to `size` bytes at a time."""
    while piece := source.read(size):
        yield piece

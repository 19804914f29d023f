"""Limits on what reading a file may cost; all are checked before anything is unpacked.

The sender pays for a file's own bytes, so limits grow with them; a small file gets a fixed share. `LIMITS` has the
numbers. They were chosen on a machine with 2 GiB of memory, on which no file may end the process, and such that
recordings of an hour are read.
"""

import shutil
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from .errors import InputError
from .paths import check_readable


@dataclass(frozen=True)
class Limits:
    """What a reader may take.

    Attributes:
        memory: bytes of arrays of a small file.
        memory_ratio: bytes of arrays for each byte of a larger file.
        unpacked_ratio: bytes that a compressed stream may unpack to, for each byte of the file; `memory` at least.
        chunk: bytes of one compressed chunk, unpacked; it is in memory as a whole.
        document: bytes of a text that is parsed as a whole.
        yaml: bytes of YAML, whose parser takes a second for 100 kB.
        message: bytes of a log's message.
        numbers: of a log, in all its tracks.
        tracks: of a log.
        records: of a small log.
        record_bytes: of a larger log, for each record; skipping one takes a microsecond.
        message_numbers: that a message counts for at least, since it takes as long to read.
        query_steps: of SQLite's virtual machine, in all queries; about 5 s.
    """

    memory: int = 2**30
    memory_ratio: int = 10
    unpacked_ratio: int = 100
    chunk: int = 2**28
    document: int = 2**24
    yaml: int = 2**20
    message: int = 2**24
    numbers: int = 2**25
    tracks: int = 10_000
    records: int = 2**23
    record_bytes: int = 64
    message_numbers: int = 16
    query_steps: int = 500_000_000


LIMITS = Limits()


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

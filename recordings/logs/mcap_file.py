"""MCAP files (mcap.dev/spec): messages of ROS 2 in CDR, of ROS 1, and JSON messages of the same fields.

A file is records, each an opcode (1 byte), a length (8 bytes) and so many bytes. They are walked from the first to the
last, and every length is compared with the bytes that are left before anything is read. Records that are not needed are
skipped. A chunk contains compressed records; it is unpacked up to its stated size.

As in a bag (:mod:`.ros_bag`), messages are read by the definitions that `rosbags` brings along, not by the file's own.
"""

import json
import struct
from collections.abc import Callable, Iterator
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO

from ..budget import Budget
from ..errors import InputError, readable
from ..limits import LIMITS
from ..paths import check_readable
from .messages import Collected, known
from .tracks import Episode, Needed, needed

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, MESSAGES, CHUNK, END = 3, 4, 5, 6, (2, 15)
"""Opcodes; behind the end of data is a summary of what came before."""


def read_mcap(path: Path, time: str | None = None, tracks: Needed | None = None) -> list[Episode]:
    """The tracks of a file's messages that are known (:mod:`.messages`).

    Raises InputError for another kind of file, one beyond the budget or without such messages; OSError where it cannot
    be read.
    """
    with open(check_readable(path), "rb"), readable(path, "an MCAP file"):
        found = Collected(tracks, Budget(path.stat().st_size))
        collect_mcap(path, found)
        return [found.episode()]


def collect_mcap(path: Path, found: Collected, packed: bool = False) -> None:
    """Add a file's messages; `packed` where each is compressed by zstd, as in a bag.

    Raises InputError, and the errors of `mcap` and `rosbags` for a broken file.
    """
    try:
        read = _Messages(found, packed)
    except ImportError as error:
        raise InputError(needed("mcap and rosbags", "MCAP")) from error

    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError("expected an MCAP file, its first bytes are others")
        read.records(file, path.stat().st_size, chunks=True)


class _Exact(BytesIO):
    """The content of a record: reading beyond its end raises an error."""

    def read(self, size: int | None = -1, /) -> bytes:
        if size is not None and size > (left := len(self.getbuffer()) - self.tell()):
            raise InputError(f"a field claims {size} bytes, its record has {left} left")
        return super().read(size)


class _Messages:
    """Reads records: schemas and channels so far, and messages."""

    def __init__(self, found: Collected, packed: bool) -> None:
        from mcap import data_stream, records

        self._found, self._packed, self._decode = found, packed, decoders()
        self._read: Callable[[Any, bytes], Any] = lambda kind, content: kind.read(
            data_stream.ReadDataStream(_Exact(content))
        )
        self._records = records
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, Any] = {}

    def records(self, file: BinaryIO, end: int, chunks: bool) -> None:
        """Take the records up to a place in a file or a chunk."""
        for opcode, size in _walk(file, end):
            self._found.budget.record()
            if opcode == SCHEMA:
                schema = self._read(self._records.Schema, _content(file, size, "a schema", LIMITS.document))
                self._schemas[schema.id] = schema.name
            elif opcode == CHANNEL:
                channel = self._read(self._records.Channel, _content(file, size, "a channel", LIMITS.document))
                self._channels[channel.id] = channel
            elif opcode == MESSAGES:
                self._message(file, size)
            elif opcode == CHUNK and chunks:
                self._chunk(file, size)
            elif opcode in END and chunks:
                return

    def _message(self, file: BinaryIO, size: int) -> None:
        if size < 22:
            raise InputError(f"a message has {size} bytes, expected at least 22")
        number, _, logged, _ = struct.unpack("<HIQQ", file.read(22))
        if (channel := self._channels.get(number)) is None:
            raise InputError(f"a message belongs to channel {number}, which the file does not describe")

        name = self._schemas.get(channel.schema_id, "")
        kind, decode = known(name, channel.message_encoding), self._decode.get(channel.message_encoding)
        if kind is None or decode is None:
            self._found.skip(name or "no type", channel.message_encoding)
        elif self._found.wants(channel.topic):
            content = _content(file, size - 22, f"a message of {channel.topic:.60}", LIMITS.message)
            content = plain(content, self._found) if self._packed else content
            self._found.add(channel.topic, kind, decode(content, kind), logged)

    def _chunk(self, file: BinaryIO, size: int) -> None:
        chunk = self._read(self._records.Chunk, _content(file, size, "a chunk", LIMITS.chunk))
        self._found.budget.piece(chunk.uncompressed_size, "a chunk")
        self._found.budget.unpack(chunk.uncompressed_size, "it")

        content = unpacked(chunk.data, chunk.compression, chunk.uncompressed_size)
        if len(content) != chunk.uncompressed_size:
            raise InputError(f"a chunk does not unpack to the {chunk.uncompressed_size} bytes that it claims")
        self.records(BytesIO(content), len(content), chunks=False)


def _walk(file: BinaryIO, end: int) -> Iterator[tuple[int, int]]:
    """Opcode and length of each record up to `end`, while the file is at its content."""
    place = file.tell()
    while place < end:
        head = file.read(9)
        if len(head) < 9:
            raise InputError(f"its last record, at byte {place}, is cut off")
        opcode, size = struct.unpack("<BQ", head)
        place += 9
        if size > end - place:
            raise InputError(f"the record at byte {place - 9} claims {size} bytes, {end - place} are left")
        yield opcode, size
        place += size
        file.seek(place)


def _content(file: BinaryIO, size: int, what: str, limit: int) -> bytes:
    if size > limit:
        raise InputError(f"{what} has {size} bytes, expected at most {limit / 2**20:g} MiB")
    return file.read(size)


def unpacked(data: bytes, compression: str, limit: int) -> bytes:
    """What compressed bytes unpack to, and at most one byte beyond `limit`. Raises InputError for another format."""
    if compression == "":
        return data[: limit + 1]
    if compression == "zstd":
        from zstandard import ZstdDecompressor

        with ZstdDecompressor().stream_reader(data) as stream:
            return stream.read(limit + 1)
    if compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        return LZ4FrameDecompressor().decompress(data, max_length=limit + 1)
    raise InputError(f"expected chunks compressed by zstd or lz4, got {compression!r:.40}")


def plain(content: bytes, found: Collected) -> bytes:
    """A message that is compressed by itself. Raises InputError beyond the budget."""
    message = unpacked(content, "zstd", LIMITS.message)
    found.budget.piece(len(message), "a message, unpacked,", LIMITS.message)
    found.budget.unpack(len(message), "it")
    return message


@cache
def decoders() -> dict[str, Callable[[bytes, str], Any]]:
    """Of each encoding, the function of a message's bytes and type. Raises ImportError without `rosbags`."""
    from rosbags.typesys import Stores, get_typestore

    own, old = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS1_NOETIC)
    return {
        "cdr": own.deserialize_cdr,
        "ros1": old.deserialize_ros1,
        "json": _from_json,
    }


def _from_json(content: bytes, kind: str) -> dict[str, Any]:
    message = json.loads(content)
    if not isinstance(message, dict):
        raise InputError(f"expected a {kind} as an object in JSON, got {message!r:.40}")
    return message

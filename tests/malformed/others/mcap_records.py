"""MCAP files written record by record: sizes that are claimed, and chunks that unpack to much."""

import json
import struct
from functools import lru_cache
from pathlib import Path

from .kit import BOMB, STATE, hostile


def record(opcode: int, content: bytes, size: int | None = None) -> bytes:
    """A record, which may claim another size."""
    return struct.pack("<BQ", opcode, len(content) if size is None else size) + content


def text(content: str, size: int | None = None) -> bytes:
    """A text, which may claim another size."""
    return struct.pack("<I", len(content) if size is None else size) + content.encode()


def chunk(content: bytes, compression: str, size: int) -> bytes:
    """A chunk of compressed content that claims to unpack to `size` bytes."""
    head = struct.pack("<QQQI", 0, 0, size, 0) + text(compression) + struct.pack("<Q", len(content))
    return record(6, head + content)


def written(folder: Path, *records: bytes, end: bool = True) -> Path:
    """An MCAP file of these records."""
    magic, path = b"\x89MCAP0\r\n", folder / "log.mcap"
    tail = record(15, bytes(4)) + record(2, bytes(20)) + magic if end else b""
    path.write_bytes(magic + record(1, text("ros2") + text("x")) + b"".join(records) + tail)
    return path


def channel(kind: str = STATE, encoding: str = "cdr", topic: str = "/joint_states") -> bytes:
    """A schema and a channel of it."""
    schema = record(3, struct.pack("<H", 1) + text(kind) + text("ros2msg") + text(""))
    return schema + record(4, struct.pack("<HH", 0, 1) + text(topic) + text(encoding) + text(""))


def message(content: bytes, time: int = 1, number: int = 0) -> bytes:
    """A message of that channel."""
    return record(5, struct.pack("<HIQQ", number, 0, time, time) + content)


@lru_cache
def zeros(codec: str, megabytes: int) -> bytes:
    """So many MiB of zeros in a few bytes."""
    piece = bytes(2**20)
    if codec == "zstd":
        from zstandard import ZstdCompressor

        packer = ZstdCompressor(level=1).compressobj()
        return b"".join(packer.compress(piece) for _ in range(megabytes)) + packer.flush()
    from lz4.frame import LZ4FrameCompressor

    with LZ4FrameCompressor() as packer:
        return packer.begin() + b"".join(packer.compress(piece) for _ in range(megabytes)) + packer.flush()


@hostile(BOMB, opcode=(1, 3, 4, 5, 6, 9, 200))
def a_record_that_claims_more_than_there_is(folder, rng, opcode):
    return written(folder, channel(), record(opcode, bytes(100), 2 ** rng.randint(10, 63)))


@hostile(BOMB, opcode=(3, 4))
def a_text_that_claims_more_than_its_record(folder, rng, opcode):
    head = struct.pack("<H", 1) if opcode == 3 else struct.pack("<HH", 0, 0)
    return written(folder, record(opcode, head + text("name", rng.choice([2**32 - 1, 2**31, 1000])) + bytes(8)))


@hostile(BOMB, codec=("zstd", "lz4"))
def a_chunk_of_zeros(folder, rng, codec):
    size = rng.choice([300, 1000, 4000] if codec == "zstd" else [300, 1000])
    claimed = rng.choice([size * 2**20, 0, 1000, 2**20, 2**40, 2**63])
    return written(folder, channel(), chunk(zeros(codec, size), codec, claimed))


@hostile(BOMB, costly=True)
def many_chunks_of_zeros(folder, rng):
    """Records of a kind that is passed over, of 200 MiB each."""
    size = 200
    skipped = record(200, b"", size * 2**20 - 9)
    from zstandard import ZstdCompressor

    packer = ZstdCompressor(level=1).compressobj()
    content = packer.compress(skipped) + b"".join(packer.compress(bytes(2**20)) for _ in range(size))
    one = chunk(content[:0] + content + packer.flush(), "zstd", len(skipped) + size * 2**20)
    return written(folder, *[one] * rng.randint(7, 12))


@hostile(BOMB, costly=True)
def many_records(folder, rng):
    """Empty records of a kind that is passed over."""
    from zstandard import ZstdCompressor

    data = record(200, b"") * (10**7 + rng.randrange(10**6))
    return written(folder, chunk(ZstdCompressor(level=1).compress(data), "zstd", len(data)))


@hostile(BOMB, costly=True)
def many_small_messages(folder, rng):
    from zstandard import ZstdCompressor

    data = channel(encoding="json") + message(b"{}") * 500_000
    packed = chunk(ZstdCompressor(level=1).compress(data), "zstd", len(data))
    return written(folder, *[packed] * rng.randint(5, 9))


@hostile(BOMB)
def many_tracks(folder, rng):
    names = {"name": [f"j{k}" for k in range(20_000)], "position": [0] * 20_000}
    return written(folder, channel(encoding="json"), message(json.dumps(names).encode()))


@hostile(BOMB)
def many_numbers(folder, rng):
    """Compressed messages of 2²⁰ numbers each."""
    from zstandard import ZstdCompressor

    content = b"\0\1\0\0" + struct.pack("<IIII", 0, 0, 2**13, 0) + bytes(8 * 2**13)
    data = channel("std_msgs/msg/Float64MultiArray") + message(content) * 600
    packed = chunk(ZstdCompressor().compress(data), "zstd", len(data))
    return written(folder, *[packed] * rng.randint(8, 10))

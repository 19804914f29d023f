"""Files of others that cost more than they should: bombs, ways out of a bag's folder, hangs and odd types.

Each input is made by a function of an empty folder and a random generator, which draws its sizes and values, and says
what must come of it: a refusal, a reading (of an honest file that looks odd), or either (of random damage).
"""

import json
import os
import random
import shutil
import sqlite3
import struct
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import h5py
import log_files
import numpy as np

BOMB, PATH, ODD = "memory bombs", "paths out of a bag", "hangs and odd types"
REFUSE, READ, EITHER = "refuse", "read", "either"
STATE = log_files.STATE


@dataclass(frozen=True)
class Hostile:
    """An input: its kind, its reader (:mod:`.reader`), what must come of it, if it takes seconds, how to make it."""

    kind: str
    what: str
    reader: str
    must: str
    costly: bool
    make: Callable[[Path, random.Random], Path]


ALL: list[Hostile] = []


def hostile(kind: str, /, reader: str = "log", must: str = REFUSE, costly: bool = False, **each: tuple) -> Callable:
    """Register a function as an input; or as several, by the values of its one keyword."""

    def register(make: Callable) -> Callable:
        name = make.__name__.replace("_", " ")
        for key, values in each.items():
            for value in values:
                ALL.append(Hostile(kind, f"{name}: {value}", reader, must, costly, partial(make, **{key: value})))
        if not each:
            ALL.append(Hostile(kind, name, reader, must, costly, make))
        return make

    return register


def good(folder: Path, kind: str) -> Path:
    """A copy of a good log, which is made once for a run."""
    source = _good(folder.parent / "good", kind)
    path = folder / source.name
    (shutil.copytree if source.is_dir() else shutil.copy)(source, path)
    return path


@lru_cache
def _good(folder: Path, kind: str) -> Path:
    folder.mkdir(exist_ok=True)
    make = {"mcap": log_files.mcap, "set": log_files.lerobot, "bag": log_files.bag}
    make["mcapbag"] = partial(log_files.bag, storage="mcap")
    return make[kind](folder / {"mcap": "log.mcap"}.get(kind, kind))


def edit(folder: Path, change: Callable[[sqlite3.Connection], None]) -> Path:
    """A good bag whose database is changed."""
    path = good(folder, "bag")
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as database:
        change(database)
        database.commit()
    return path


def metadata(path: Path, **entries: object) -> Path:
    """A bag whose metadata has other entries."""
    from ruamel.yaml import YAML

    file, parser = path / "metadata.yaml", YAML(typ="safe")
    whole = parser.load(file.read_text())
    whole["rosbag2_bagfile_information"] |= entries
    with file.open("w") as stream:
        parser.dump(whole, stream)
    return path


def renamed(path: Path, name: str) -> Path:
    """A bag whose database is called otherwise."""
    next(path.glob("*.db3")).rename(path / name)
    return metadata(path, relative_file_paths=[name])


# -- MCAP, record by record ------------------------------------------------------------------------------------


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


# -- parquet ---------------------------------------------------------------------------------------------------


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


# -- bags ------------------------------------------------------------------------------------------------------


@hostile(BOMB, costly=True)
def a_packed_bag_of_zeros(folder, rng):
    path = good(folder, "bag")
    file = next(path.glob("*.db3"))
    file.with_suffix(".db3.zstd").write_bytes(zeros("zstd", 1000) * rng.randint(2, 5))
    file.unlink()
    name = file.name + ".zstd"
    return metadata(path, compression_format="zstd", compression_mode="FILE", relative_file_paths=[name])


@hostile(BOMB)
def packed_messages_of_zeros(folder, rng):
    blob = zeros("zstd", rng.choice([100, 1000]))
    path = edit(folder, lambda database: database.execute("UPDATE messages SET data = ?", (blob,)))
    return metadata(path, compression_format="zstd", compression_mode="MESSAGE")


@hostile(BOMB)
def a_message_that_is_too_long(folder, rng):
    size = rng.randint(2**24 + 1, 2**26)
    return edit(folder, lambda database: database.execute("UPDATE messages SET data = zeroblob(?)", (size,)))


@hostile(BOMB, must=READ)
def a_long_message_of_another_topic(folder, rng):
    def change(database):
        database.execute("INSERT INTO topics SELECT 99, '/image', 'sensor_msgs/msg/Image', 'cdr', '', '' FROM topics")
        database.execute("INSERT INTO messages VALUES (999, 99, 5, zeroblob(?))", (rng.randint(2**24, 2**26),))

    return edit(folder, change)


def replaced(table: str, select: str) -> Callable[[sqlite3.Connection], None]:
    """A view in the place of a table."""

    def change(database: sqlite3.Connection) -> None:
        database.execute(f"ALTER TABLE {table} RENAME TO own_{table}")
        database.execute(f"CREATE VIEW {table} AS {select}")

    return change


@hostile(BOMB, size=(2**28, 2 * 10**9))
def a_view_of_giant_messages(folder, rng, size):
    return edit(
        folder, replaced("messages", f"SELECT id, topic_id, timestamp, zeroblob({size}) AS data FROM own_messages")
    )


@hostile(BOMB)
def a_generated_column(folder, rng):
    def change(database):
        database.execute("ALTER TABLE messages RENAME TO own")
        columns = "id INTEGER, topic_id INTEGER, timestamp INTEGER"
        database.execute(f"CREATE TABLE messages ({columns}, data BLOB AS (zeroblob({2 ** rng.randint(20, 29)})))")
        database.execute("INSERT INTO messages SELECT id, topic_id, timestamp FROM own")

    return edit(folder, change)


@hostile(BOMB)
def a_giant_metadata(folder, rng):
    path = good(folder, "bag")
    os.truncate(path / "metadata.yaml", rng.choice([2 * 2**20, 5 * 2**30]))
    return path


@hostile(BOMB)
def aliases_that_multiply(folder, rng):
    path = good(folder, "bag")
    lines = ["a0: &a0 [x, x]"] + [f"a{k}: &a{k} [*a{k - 1}, *a{k - 1}]" for k in range(1, rng.randint(30, 60))]
    (path / "metadata.yaml").write_text("\n".join(lines) + "\n")
    return path


# -- bodies, networks, HDF5 ------------------------------------------------------------------------------------

MJCF = '<mujoco>{}<worldbody><body name="a"><joint name="j"/><geom size=".1"/></body></worldbody></mujoco>'


@hostile(BOMB, reader="body")
def many_includes(folder, rng):
    count = rng.randint(20, 190)
    for k in range(count):
        padding = f"<custom>{' ' * 2**20}</custom>" if rng.random() < 0.5 else "<custom/>" * 50_000
        (folder / f"p{k}.xml").write_text(f"<mujocoinclude>{padding}</mujocoinclude>")
    (folder / "arm.xml").write_text(MJCF.format("".join(f'<include file="p{k}.xml"/>' for k in range(count))))
    return folder / "arm.xml"


@hostile(BOMB, reader="body", element=('<geom size=".1"/>', "<site/>", "<body/>"))
def many_elements(folder, rng, element):
    (folder / "arm.xml").write_text(
        f"<mujoco><worldbody>{element * rng.randint(50_001, 2**23 // len(element))}</worldbody></mujoco>"
    )
    return folder / "arm.xml"


@lru_cache
def _network(widths: tuple[int, ...]) -> tuple[dict, dict]:
    import tempfile

    from invdyn.recordings.tracking.heatmap import HeatmapTracker, read_safetensors
    from invdyn.recordings.tracking.unet import UNet

    with tempfile.NamedTemporaryFile() as file:
        HeatmapTracker(UNet(2, widths), ("a", "b"), (20, 20), [9.0] * 3, [9.0] * 3, widths=widths).save(file.name)
        tensors, described = read_safetensors(file.name)
    return tensors, json.loads(described)


def network(folder: Path, widths: tuple[int, ...] = (16, 24, 32, 48, 64), **claims: object) -> Path:
    """A network whose text says something else."""
    from safetensors.torch import save

    tensors, described = _network(widths)
    (folder / "n.safetensors").write_bytes(save(tensors, {"invdyn": json.dumps(described | claims)}))
    return folder / "n.safetensors"


@hostile(BOMB, reader="network")
def large_pictures(folder, rng):
    return network(folder, picture_size=[rng.randint(3000, 4096), rng.randint(3000, 4096)])


@hostile(BOMB, reader="network")
def wide_networks(folder, rng):
    return network(folder, (rng.choice([300, 600]),), picture_size=[rng.randint(1500, 4096)] * 2)


@hostile(ODD, reader="network", key=("calibration", "mean", "deviation", "tolerance"))
def a_network_of_no_numbers(folder, rng, key):
    wrong = rng.choice([float("nan"), float("inf"), -float("inf")])
    return network(folder, (8,), **{key: {"calibration": [1.0, wrong], "tolerance": wrong}.get(key, [9.0, wrong, 9.0])})


def pose(folder: Path) -> Path:
    """DeepLabCut's table in HDF5."""
    with h5py.File(folder / "rec.h5", "w") as store:
        group = store.create_group("df_with_missing")
        group.attrs["pandas_type"], group.attrs["nblocks"] = np.bytes_("frame"), 1
        for axis in ("axis0", "block0_items"):
            group.attrs[f"{axis}_variety"], group.attrs[f"{axis}_nlevels"] = np.bytes_("multi"), 3
            for level, names in enumerate(([b"net"], [b"wrist"], [b"x", b"y", b"likelihood"])):
                group[f"{axis}_level{level}"] = np.array(names)
                group[f"{axis}_label{level}"] = np.arange(3) if level == 2 else np.zeros(3, int)
        group["axis1"], group["block0_values"] = np.arange(6), np.ones((3, 6))
    return folder / "rec.h5"


@hostile(BOMB, reader="recording", must=READ)
def a_pose_table(folder, rng):
    return pose(folder)


@hostile(BOMB, reader="recording", how=("declared", "chunk", "external", "link", "virtual"))
def a_pose_table_beyond_its_file(folder, rng, how):
    path, rows = pose(folder), 2 ** rng.randint(27, 40)
    (folder / "secret").write_bytes(np.ones(18).tobytes())
    with h5py.File(folder / "other.h5", "w") as other:
        other["values"] = np.ones((3, 6))
    with h5py.File(path, "a") as store:
        group = store["df_with_missing"]
        del group["block0_values"]
        if how == "declared":
            group.create_dataset("block0_values", (3, rows), "f8", chunks=(3, 1000))
        elif how == "chunk":
            size = 2 ** rng.randint(25, 28)
            group.create_dataset("block0_values", (3, 6), "f8", chunks=(3, size), maxshape=(3, None))
        elif how == "external":
            group.create_dataset("block0_values", (3, 6), "f8", external=[(str(folder / "secret"), 0, 144)])
        elif how == "link":
            group["block0_values"] = h5py.ExternalLink(str(folder / "other.h5"), "/values")
        else:
            layout = h5py.VirtualLayout((3, 6), "f8")
            layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "values", (3, 6))
            group.create_virtual_dataset("block0_values", layout)
    return path


@hostile(BOMB, reader="posterior")
def a_posterior_that_declares_much(folder, rng):
    with h5py.File(folder / "p.nc", "w") as store:
        rows = 2 ** rng.randint(27, 40)
        store.create_dataset("posterior/torque", (rows,), "f8", chunks=(1000,), compression="gzip")
    return folder / "p.nc"


# -- paths out of a bag ----------------------------------------------------------------------------------------


@hostile(PATH, must=READ, name=("a#b.db3", "a?b.db3", "50%25.db3", "%2F.db3", "a b.db3", "ü.db3", "a%00.db3"))
def an_honest_name(folder, rng, name):
    return renamed(good(folder, "bag"), name)


@hostile(PATH, must=READ, name=("a#b", "a?b", "50%25", "a b", "ü"))
def an_honest_folder(folder, rng, name):
    path = good(folder, "bag")
    return path.rename(folder / f"{name}{rng.randint(0, 99)}")


@hostile(PATH, must=READ)
def the_bags_own_name_in_front(folder, rng):
    path = good(folder, "bag")
    return metadata(path, relative_file_paths=[f"bag/{next(path.glob('*.db3')).name}"])


@hostile(PATH, how=("decoded", "above", "absolute", "linked", "folder linked", "metadata linked"))
def a_database_elsewhere(folder, rng, how):
    path = good(folder, "bag")
    secret, own = folder / "secret", next(path.glob("*.db3"))
    secret.mkdir()
    other = own.rename(secret / "s.db3")
    if how == "decoded":
        slash = rng.choice(["%2F", "%2f", "%252F"])
        # a library that decodes names finds the secret; the name itself must exist for it to look
        name = f"..{slash}secret{slash}s.db3"
        (path / name).write_bytes(b"")
    elif how == "linked":
        name = "s.db3"
        (path / name).symlink_to(rng.choice([other, "../secret/s.db3"]))
    elif how == "metadata linked":
        name = "s.db3"
        shutil.copy(other, path / name)
    else:
        name = {"above": "../secret/s.db3", "absolute": str(other)}.get(how, "inside/s.db3")
        if how == "folder linked":
            (path / "inside").symlink_to(secret)
    metadata(path, relative_file_paths=[name])
    if how == "metadata linked":
        shutil.move(path / "metadata.yaml", secret / "metadata.yaml")
        (path / "metadata.yaml").symlink_to(secret / "metadata.yaml")
    return path


@hostile(PATH, must=EITHER)
def a_name_of_any_kind(folder, rng):
    path = good(folder, "bag")
    letters = "ab/.%#?\\\0\n 2Ff~é$*"
    return metadata(path, relative_file_paths=["".join(rng.choices(letters, k=rng.randint(0, 12)))])


# -- hangs and odd types ---------------------------------------------------------------------------------------


@hostile(ODD, name=("bag.db3", "metadata.yaml", "log.mcap", "log.parquet", "file-000.parquet"))
def a_pipe(folder, rng, name):
    if name in ("log.mcap", "log.parquet"):
        os.mkfifo(folder / name)
        return folder / name
    path = good(folder, "set" if name.endswith("parquet") else "bag")
    file = next(path.rglob("*.db3" if name == "bag.db3" else name))
    file.unlink()
    os.mkfifo(file)
    return path if rng.random() < 0.5 or name != "bag.db3" else file


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) "


@hostile(ODD, must=READ)
def an_endless_view_called_schema(folder, rng):
    def change(database):
        database.execute("DROP TABLE schema")
        database.execute(f"CREATE VIEW schema AS {ENDLESS} SELECT x AS schema_version FROM n WHERE x < 0")

    return edit(folder, change)


@hostile(ODD, table=("topics", "messages"))
def an_endless_view(folder, rng, table):
    columns = {
        "topics": "x AS id, '' AS name, '' AS type, 'cdr' AS serialization_format, '' AS offered_qos_profiles, "
        "'' AS type_description_hash",
        "messages": f"x AS id, 1 AS topic_id, x AS timestamp, zeroblob({rng.randint(0, 9)}) AS data",
    }[table]
    return edit(folder, replaced(table, f"{ENDLESS} SELECT {columns} FROM n WHERE x {rng.choice(['< 0', '> 0'])}"))


@hostile(ODD)
def a_virtual_table(folder, rng):
    def change(database):
        database.execute("ALTER TABLE messages RENAME TO own")
        database.execute("CREATE VIRTUAL TABLE messages USING fts5(topic_id, timestamp, data)")
        database.execute("INSERT INTO messages SELECT topic_id, timestamp, data FROM own")

    return edit(folder, change)


ODD_VALUES = ("'soon'", "x'00'", "1.5", "'12'", "''")


@hostile(ODD, column=("timestamp", "data"))
def a_message_of_other_types(folder, rng, column):
    value = rng.choice([each for each in ODD_VALUES if not (column == "data" and each.startswith("x"))])

    # a column of the other affinity keeps texts that look like numbers
    def change(database):
        database.execute("ALTER TABLE messages RENAME TO own")
        database.execute("CREATE TABLE messages (id INTEGER, topic_id INTEGER, timestamp BLOB, data BLOB)")
        database.execute("INSERT INTO messages SELECT id, topic_id, timestamp, data FROM own")
        database.execute(f"UPDATE messages SET {column} = {value} WHERE id >= {rng.randint(1, 6)}")

    return edit(folder, change)


@hostile(ODD, column=("name", "type"))
def a_topic_of_other_types(folder, rng, column):
    value = rng.choice(["x'ff'", "x'41'"])
    return edit(folder, lambda database: database.execute(f"UPDATE topics SET {column} = {value}"))


@hostile(ODD, column=("type", "serialization_format"))
def a_topic_that_is_not_known(folder, rng, column):
    value = rng.choice(["", "cbor", "sensor_msgs", "my_msgs/msg/JointState", "x" * 2000, "\n"])
    return edit(folder, lambda database: database.execute(f"UPDATE topics SET {column} = ?", (value,)))


QOS = ("5", "[1]", "- history: {}", "- depth: 1", "[[[[", "{a: 1}", "&a [*a]", "- " + "[" * 3000)


@hostile(ODD, must=READ)
def odd_qualities_of_service(folder, rng):
    value = rng.choice(QOS)
    return edit(folder, lambda database: database.execute("UPDATE topics SET offered_qos_profiles = ?", (value,)))


@hostile(ODD)
def odd_metadata(folder, rng):
    key = rng.choice(["relative_file_paths", "storage_identifier", "compression_mode"])
    value = rng.choice([None, 5, {"a": 1}, [[1]], [None], "x", [5], ["x"], True])
    if key == "compression_mode" and value is None:
        value = "zip"
    return metadata(good(folder, "bag"), **{key: value})


@hostile(ODD)
def metadata_of_another_form(folder, rng):
    path = good(folder, "bag")
    forms = ["", "5", "[]", "[" * rng.randint(100, 50_000), "{" * 900, "a: b: c", "!!python/object:os.system {}"]
    forms += ["rosbag2_bagfile_information: []", "\0", "? " * 1000, "2001-99-99", "!!binary 5", "1e999: [1]"]
    (path / "metadata.yaml").write_text(rng.choice(forms))
    return path


@hostile(ODD)
def json_of_other_types(folder, rng):
    odd = rng.choice([None, "soon", [], {}, True, 10**400, float("nan"), float("inf"), "[" * 10])
    header = rng.choice([{"stamp": {"sec": odd, "nanosec": 0}}, {"stamp": {"sec": 1, "nanosec": odd}}])
    body = {"header": header, "name": ["shoulder", "elbow"], "position": [0.0, 0.0]}
    if odd is None or odd is True or odd in ([], {}):  # no stamp, or 1 s
        body = {"name": rng.choice([5, [5, 6], [[]]]), "position": [1.0]}
    elif rng.random() < 0.5:
        body |= {"header": None, "position": [odd if isinstance(odd, str) else "x", 0.0]}
    return written(folder, channel(encoding="json"), message(json.dumps(body).encode()), message(b"{}"))


@hostile(ODD)
def json_that_is_none(folder, rng):
    content = rng.choice([b"", b"[" * 100_000, b"\xff", b"9" * 5000, b"nul", b'{"a":' * 50_000, b"5", b'"x"'])
    return written(folder, channel(encoding="json"), message(content))


@hostile(ODD)
def unknown_encodings(folder, rng):
    encoding = rng.choice(["cbor", "", "protobuf", "CDR", "x" * 1000])
    return written(folder, channel(encoding=encoding), message(bytes(40)))


@hostile(ODD)
def a_chunk_of_another_compression(folder, rng):
    return written(folder, channel(), chunk(rng.randbytes(100), rng.choice(["bz2", "zstd", "lz4", "none"]), 100))


@hostile(ODD)
def a_message_without_a_channel(folder, rng):
    return written(folder, channel(), message(bytes(40), number=rng.randint(1, 65535)))


@hostile(ODD)
def messages_that_are_none(folder, rng):
    kind = rng.choice([STATE, "trajectory_msgs/msg/JointTrajectory", "std_msgs/msg/Float64MultiArray"])
    head = rng.choice([b"", b"\0\1\0\0", b"\0\0\0\0", b"\0\1"])
    body = head + b"\xff" * rng.randint(1, 60)
    return written(folder, channel(kind, rng.choice(["cdr", "ros1"])), message(body))


@hostile(ODD)
def a_file_without_its_end(folder, rng):
    return written(folder, channel(), message(bytes(40))[: rng.randint(1, 70)], end=False)


@hostile(ODD, must=EITHER, kind=("bag", "mcapbag", "mcap", "set"))
def damage(folder, rng, kind):
    """Bytes of a good file flipped, cut or repeated."""
    path = good(folder, kind)
    files = [path] if path.is_file() else sorted(each for each in path.rglob("*") if each.is_file())
    file = rng.choice(files)
    content = bytearray(file.read_bytes())
    for _ in range(rng.randint(1, 8)):
        place = rng.randrange(len(content))
        content[place] = rng.choice([0, 255, content[place] ^ 1 << rng.randrange(8), rng.randrange(256)])
    if rng.random() < 0.3:
        content = content[: rng.randrange(len(content))]
    file.write_bytes(content)
    return path


@hostile(ODD)
def two_entries_of_one_name(folder, rng):
    path = good(folder, "set")
    features = {"observation.state": {"names": ["elbow.pos"] * 2}, "action": {"names": ["elbow.pos"] * 2}}
    (path / "meta" / "info.json").write_text(json.dumps({"features": features}))
    return path


@hostile(ODD)
def angles_of_true_and_false(folder, rng):
    from pyarrow import array

    needs(folder)
    truths = array([[rng.random() < 0.5] * 2 for _ in range(20)])
    return parquet(folder, state(20) | {"observation.state": truths})


@hostile(ODD, must=READ)
def an_empty_first_row(folder, rng):
    from pyarrow import array

    needs(folder)
    first = rng.choice([[], None, [1.0, 2.0, 3.0], [None, None]])
    return parquet(folder, state(20) | {"observation.state": array([first] + [[0.1 * k, 0.2] for k in range(19)])})

"""Inputs that never end, and files whose entries have other types than the format's."""

import json
import os

from .bags import replaced
from .kit import EITHER, ODD, READ, STATE, edit, good, hostile, metadata
from .mcap_records import channel, chunk, message, written
from .parquet_tables import needs, parquet, state


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

"""ROS 2 bags: packed, with long messages, views, and metadata that multiplies."""

import os
import sqlite3
from collections.abc import Callable

from .kit import BOMB, READ, edit, good, hostile, metadata
from .mcap_records import zeros


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

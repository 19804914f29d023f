"""The SQLite database of a ROS 2 bag (rosbag2_storage_sqlite3), read as data.

    topics    id, name, type, serialization_format
    messages  topic_id, timestamp (ns), data

A database may contain programs: views, virtual tables and generated columns compute what is read, possibly without end.
Ordinary tables alone are read. A value's size is checked before it is read, and the steps of all queries are limited.
"""

import os
import sqlite3
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from urllib.parse import quote

from ..errors import InputError
from ..limits import LIMITS
from .mcap_file import decoders, plain
from .messages import Collected, known
from .tracks import needed

TABLES = ("topics", "messages")
STEPS_BETWEEN_CHECKS = 1_000_000


def collect_database(path: Path, found: Collected, packed: bool) -> None:
    """Add the messages of a database; `packed` where each is compressed by zstd.

    Raises InputError for views in place of tables and values of other types, sqlite3.Error for a broken file.
    """
    try:
        decode = decoders()["cdr"]
    except ImportError as error:
        raise InputError(needed("rosbags", "a ROS 2 bag")) from error

    # quoted: a "?" or "#" in a name is no part of the address
    address = f"file:{quote(os.fsencode(path))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as database, _bounded(database):
        for table in TABLES:
            _check_ordinary(database, table)

        for topic, name, kind in _topics(database, found):
            rows = database.execute(
                "SELECT typeof(timestamp), timestamp, typeof(data), length(data), "
                f"CASE WHEN length(data) <= {LIMITS.message} THEN data END FROM messages WHERE topic_id = ?",
                (topic,),
            )
            for time_type, logged, data_type, size, data in rows:
                if (time_type, data_type) != ("integer", "blob"):
                    raise InputError(
                        f"expected time stamps as integers and data as blobs, a message of {name!r:.60} has "
                        f"{time_type} and {data_type}"
                    )
                found.budget.piece(size, f"a message of {name!r:.60}", LIMITS.message)
                if not found.wants(name):
                    break
                found.add(name, kind, decode(plain(data, found) if packed else data, kind), logged)


@contextmanager
def _bounded(database: sqlite3.Connection) -> Iterator[None]:
    """Bound the size of values and the steps of all queries together. Raises InputError where there are more."""
    steps = 0

    def count() -> bool:
        nonlocal steps
        steps += STEPS_BETWEEN_CHECKS
        return steps > LIMITS.query_steps  # true ends the query with "interrupted"

    database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LIMITS.memory)
    database.set_progress_handler(count, STEPS_BETWEEN_CHECKS)
    try:
        yield
    except sqlite3.OperationalError as error:
        if steps <= LIMITS.query_steps:
            raise
        raise InputError(f"its tables take more than {LIMITS.query_steps:.0e} steps to read: it is damaged") from error


def _check_ordinary(database: sqlite3.Connection, table: str) -> None:
    """Raise InputError unless the table is an ordinary one, without computed columns."""
    found = database.execute(
        "SELECT type, rootpage FROM sqlite_master WHERE lower(name) = ? AND type <> 'index'", (table,)
    ).fetchmany(2)
    if [kind for kind, _ in found] != ["table"] or not found[0][1]:
        raise InputError(f"expected an ordinary table {table!r}, got {found[0][0] if found else 'none'}")

    # the last column says whether another is generated
    if any(column[-1] for column in database.execute(f"PRAGMA table_xinfo({table})")):
        raise InputError(f"expected an ordinary table {table!r}, got one with generated columns")


def _topics(database: sqlite3.Connection, found: Collected) -> Iterator[tuple[int, str, str]]:
    """Number, name and type of the topics that are read."""
    longest = "max(length(name), length(type), length(serialization_format))"
    rows = database.execute(
        f"SELECT id, name, type, serialization_format FROM topics WHERE coalesce({longest}, 0) <= 1000"
    ).fetchmany(LIMITS.tracks + 1)
    if len(rows) > LIMITS.tracks:
        raise InputError(f"expected at most {LIMITS.tracks} topics, it has more")

    for number, *texts in rows:
        if not isinstance(number, int) or not all(isinstance(text, str) for text in texts):
            raise InputError("expected topics with a number, a name and a type, it has others")
        name, kind, encoding = texts
        if encoding == "cdr" and (own := known(kind, encoding)) is not None:
            yield number, name, own
        else:
            found.skip(kind, encoding)

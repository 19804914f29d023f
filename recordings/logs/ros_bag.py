"""ROS 2 bags: a folder with metadata.yaml and the SQLite or MCAP files that it names; no ROS is needed.

Only ordinary files in the folder itself are read: no link and no pipe. Messages
are read by the definitions that `rosbags` brings along. A bag's own would be compiled to Python and run.

The SQLite database of a ROS 2 bag (rosbag2_storage_sqlite3), read as data.

    topics    id, name, type, serialization_format
    messages  topic_id, timestamp (ns), data

A database may contain programs: views, virtual tables and generated columns compute what is read, possibly without end.
Ordinary tables alone are read. A value's size is checked before it is read, and the steps of all queries are limited.
"""

import os
import sqlite3
import stat
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path, PurePath
from typing import Any
from urllib.parse import quote

from ..budget import Budget, read_document
from ..errors import InputError, about, readable
from ..limits import LIMITS
from .mcap_file import collect_mcap, decoders, plain
from .messages import Collected, known
from .tracks import Episode, Needed, needed

METADATA = "metadata.yaml"


def read_bag(path: Path, time: str | None = None, tracks: Needed | None = None) -> list[Episode]:
    """The tracks of a bag's messages that are known (:mod:`.messages`).

    Raises InputError for another kind of folder, a file that is no ordinary one in it, and beyond the budget.
    """
    with readable(path, "a ROS 2 bag"):
        table = _metadata(path)
        files = [_inside(path, str(name)) for name in table["relative_file_paths"]]
        found = Collected(tracks, Budget(sum(file.stat().st_size for file in files)))

        packed = str(table.get("compression_mode") or "none").lower()
        if packed != "none" and table.get("compression_format") != "zstd":
            raise InputError(f"expected a bag compressed by zstd, got {table.get('compression_format')!r:.40}")
        collect = STORAGES[table["storage_identifier"]]

        for file in files:
            with _unpacked(file, packed == "file", found.budget) as stored, about(file.name):
                collect(stored, found, packed == "message")
        return [found.episode()]


def _metadata(path: Path) -> dict[str, Any]:
    """The table of a bag's metadata.yaml."""
    try:
        from ruamel.yaml import YAML as Parser  # as rosbags reads it
    except ImportError as error:
        raise InputError(needed("rosbags", "a ROS 2 bag")) from error

    whole = Parser(typ="safe", pure=True).load(read_document(_inside(path, METADATA), LIMITS.yaml).decode())
    table = whole.get("rosbag2_bagfile_information") if isinstance(whole, dict) else None
    files = table.get("relative_file_paths") if isinstance(table, dict) else None
    if not isinstance(table, dict) or not isinstance(files, list):
        raise InputError(f"expected rosbag2_bagfile_information with relative_file_paths in {METADATA}")
    if (storage := table.get("storage_identifier")) not in (*STORAGES,):
        raise InputError(f"expected storage_identifier {' or '.join(STORAGES)} in {METADATA}, got {storage!r:.40}")
    return table


def _inside(folder: Path, name: str) -> Path:
    """The ordinary file of that name in the folder; old bags put the folder's own name in front."""
    path = folder / PurePath(name).name
    if path.parent != folder or not path.name:
        raise InputError(f"expected a file's name in {METADATA}, got {name!r:.100}")
    try:
        mode = os.lstat(path).st_mode
    except FileNotFoundError:
        raise InputError(f"expected the file {path.name!r:.100} in the bag's folder, it has none") from None
    if not stat.S_ISREG(mode):
        raise InputError(f"expected {path.name!r:.100} as an ordinary file, got a link, a pipe or a folder")
    return path


@contextmanager
def _unpacked(path: Path, packed: bool, budget: Budget) -> Iterator[Path]:
    """The file, or for one that is compressed as a whole, a temporary file that it unpacks to."""
    if not packed:
        yield path
        return
    from zstandard import ZstdDecompressor

    with tempfile.TemporaryDirectory() as folder:
        plain = Path(folder) / "plain"
        with path.open("rb") as source, plain.open("wb") as target:
            budget.copy(
                ZstdDecompressor().stream_reader(source, read_across_frames=True), target, Path(folder), path.name
            )
        yield plain


TABLES = ("topics", "messages")
STEPS_BETWEEN_CHECKS = 1_000_000  # of SQLite's machine, some ms


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


STORAGES = {"sqlite3": collect_database, "mcap": collect_mcap}

"""ROS 2 bags: a folder with metadata.yaml and the SQLite or MCAP files that it names; no ROS is needed.

Only ordinary files in the folder itself are read: no link and no pipe. Messages
are read by the definitions that `rosbags` brings along. A bag's own would be compiled to Python and run.
"""

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path, PurePath
from typing import Any

from ..budget import Budget, read_document
from ..errors import InputError, about, readable
from ..limits import LIMITS
from .bag_database import collect_database
from .mcap_file import collect_mcap
from .messages import Collected
from .tracks import Episode, Needed, needed

STORAGES = {"sqlite3": collect_database, "mcap": collect_mcap}
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

"""What an input of others is, the list of all of them, and good logs to spoil."""

import random
import shutil
import sqlite3
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import log_files

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

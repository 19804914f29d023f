"""Write a text file whole or not at all: to a neighbour first, which then takes its place. Read one up to a bound."""

import os
import secrets
from pathlib import Path

from invdyn.models.bodies.scalars import BodyError


def write_whole(path: str | Path, text: str) -> None:
    """Write `text` to `path` in UTF-8; no reader and no interrupt ever meets half of it. Raises `OSError`."""
    path = Path(path)
    neighbour = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        neighbour.write_text(text, encoding="utf-8")
        os.replace(neighbour, path)
    except BaseException:
        neighbour.unlink(missing_ok=True)
        raise


def read_whole(path: str | Path, most: int) -> bytes:
    """All of a file, which may be a pipe or a device. Raises `BodyError` beyond `most` bytes, `OSError` as `open`."""
    with open(path, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise BodyError(f"{path}: expected a file of at most {most / 2**20:g} MiB, this one has more")
    return content

"""Write a text file whole or not at all: to a neighbour first, which then takes its place."""

import os
import secrets
from pathlib import Path


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

"""Tables: one row a sample, a column a track; the time's column is "time", unless a mapping says another."""

from pathlib import Path

from ..errors import InputError
from ..tables import read_table
from .tracks import Episode, Track


def read_csv(path: Path, time: str | None = None) -> list[Episode]:
    """The columns of a CSV file. Raises InputError for one without a column of times."""
    columns, _ = read_table(path)
    name = time or "time"
    if name not in columns:
        raise InputError(f"{path}: no column {name!r} for the time; it has {', '.join(list(columns)[:20])}")
    clock = columns[name]
    return [{column: Track.of(clock, values) for column, values in columns.items() if column != name}]

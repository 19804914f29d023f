"""Whether a body and a recording exist, answered before torch and ArviZ load."""

from contextlib import AbstractContextManager
from importlib.resources import as_file, files
from pathlib import Path


def body_file(name: str) -> AbstractContextManager[Path]:
    """The file of a body: one that is there, or one that comes with the package by its name.

    Raises FileNotFoundError for neither.
    """
    from invdyn.recordings import check_readable, resolved

    if resolved(name).exists():
        return as_file(check_readable(name))
    ours = {
        Path(file.name).stem: file for file in files("invdyn.models.bodies").iterdir() if file.name.endswith(".toml")
    }
    if name not in ours:
        raise FileNotFoundError(2, f"no such body file, nor one of ours ({', '.join(sorted(ours))})", name)
    return as_file(ours[name])


def check_recording(name: str) -> None:
    """Raise FileNotFoundError for what is no file and no known recording; nothing is read."""
    from invdyn.recordings.loader import check_exists

    check_exists(name)

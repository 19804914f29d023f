"""What a command is given: a body, and the recordings of it in files of any kind.

A kind of file is a source. It can be given those options that its reader takes, and no others.
"""

import inspect
import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from invdyn.models import Body
from invdyn.models import load_body as read_body
from invdyn.models.bodies.body_xml import is_xml
from invdyn.recordings import InputError, Truth, load, load_truth, names, read_truth, resolved
from invdyn.recordings.logs.read import kind_of
from invdyn.recordings.paths import is_film
from invdyn.recordings.plane import in_space
from invdyn.recordings.reading import Reading

from .camera_input import read_cameras
from .film_input import read_film
from .input_names import body_file
from .log_input import read_log_files
from .log_input import read_logs as read_logs
from .settings import spelled
from .table_input import load_recording as load_recording
from .table_input import read_table


@dataclass(frozen=True)
class Source:
    """A kind of file.

    Attributes:
        what: its name in a sentence.
        why: why it takes no other options.
        read: of files and a body, with options by keyword, all recordings in them.
    """

    what: str
    why: str
    read: Callable[..., list[Reading]]

    @cached_property
    def options(self) -> Collection[str]:
        """Names of the options that it takes."""
        return inspect.signature(self.read).parameters


TABLE = Source("a table of keypoints", "this is a table of one camera's keypoints", read_table)
FILM = Source("a film", "a film has pixels and its own times", read_film)
LOG = Source("a robot's log", "a robot's log carries its own times and names, and units in its mapping", read_log_files)
CAMERAS = Source(
    "tracks of several cameras (--calibration)",
    "tracks of several cameras are in pixels, and their calibration in metres",
    read_cameras,
)


def load_body(name: Any, *, filmed: bool = True, recording: str | None = None, **options: Any) -> Body:
    """A body file, or a body that comes with the package by its name; or a ``mujoco.MjSpec`` or ``MjModel``.

    A robot of parallel hinges is a body in space if its ``recording``, read with ``options``, has three coordinates
    of its file's sites; not of joints that only the chain in the plane calls keypoints.
    ``filmed``: whether keypoints in a plane may show it; see :func:`invdyn.models.load_body`.
    Raises BodyError or OSError.
    """
    if not isinstance(name, str | Path):
        return name if isinstance(name, Body) else read_body(name, filmed=filmed)
    with body_file(str(name)) as path:
        dimensions = None
        if recording is not None and is_xml(path.read_bytes()) and in_space(seen := load(recording, **options)):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what the files are read for says it
                flat, whole = (read_body(path, filmed=filmed, dimensions=d).keypoint_names for d in (None, 3))
            dimensions = 3 if {*seen.keypoint_names} & {*flat} <= {*whole} else None
        return read_body(path, filmed=filmed, dimensions=dimensions)


def load_known(name: str, body: Body) -> Truth:
    """A truth file, or what a known recording's own sensors measured. Raises InputError or OSError."""
    known = load_truth(name) if not resolved(name).exists() and name in names() else read_truth(name)
    if missing := [joint for joint in body.joint_names if joint not in known.joint_names]:
        raise InputError(f"{name}: joint '{missing[0]}' is missing; it has {', '.join(known.joint_names)}")
    return known


def source_of(files: Sequence[str], calibration: Sequence[Path] | None = None, mapping: str | None = None) -> Source:
    """The kind of the files, by their names and by what is given with them.

    Raises InputError for several files without a calibration.
    """
    if calibration:
        return CAMERAS
    if len(files) > 1:
        raise InputError(f"expected one recording, got {len(files)}: tracks of several cameras need --calibration")
    if is_film(files[0]):
        return FILM
    return LOG if mapping is not None or kind_of(Path(files[0])) not in (None, "csv") else TABLE


def check_options(name: str, sources: Sequence[Source], given: Mapping[str, Any], kind: type) -> None:
    """Raise InputError, about the file of that name, for an option that is given and that no source takes.

    ``given`` is option → value, by the names that readers have; ``kind`` is the dataclass that has these options.
    """
    for option, value in given.items():
        if value is None or any(option in source.options for source in sources):
            continue
        others = [source.what for source in (TABLE, FILM, LOG, CAMERAS) if option in source.options]
        left = spelled(kind, option)
        raise InputError(f"{name}: {sources[0].why}: leave {left} out, which is for {' or '.join(others)}")


def read_recordings(files: Sequence[str], body: Body, **options: Any) -> list[Reading]:
    """The recordings in one file, or in those of several cameras, checked against the body.

    ``options`` are those of the readers above; None, and what the files' reader does not take, is left out.
    Raises InputError or OSError as the reader does.
    """
    source = source_of(files, options.get("calibration"), options.get("mapping"))
    taken = {name: value for name, value in options.items() if name in source.options and value is not None}
    return source.read(files, body, **taken)

"""Outputs that are whole or absent: written beside their place, then moved there in one step.

An interrupted program must not leave half a file under the name that the next program reads.
`os.replace` is atomic within one file system, so the temporary file lies in the target's own folder.
"""

import errno
import os
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from .paths import resolved


def check_writable(path: str | Path) -> Path:
    """Return the resolved `path` if a file can be written there; call it before hours of work, not after.

    Raises:
        OSError: the folder is missing or not a folder, may not be written, or `path` is itself a folder or
            a device, or no path; `filename` and `strerror` say which.
    """
    target = resolved(path)
    folder = target.parent
    if not folder.exists():
        raise FileNotFoundError(errno.ENOENT, "cannot write: the folder does not exist; make it", str(path))
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, f"cannot write: {folder} is a file, not a folder", str(path))
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, "cannot write: this is a folder; name a file in it", str(path))
    if target.exists() and not target.is_file():
        raise OSError(errno.EINVAL, "cannot write: this is not an ordinary file", str(path))
    if not os.access(folder, os.W_OK | os.X_OK):
        raise PermissionError(errno.EACCES, f"cannot write: no permission in {folder}", str(path))
    return target


@contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path (same folder and suffix): on success it becomes `path`, on any failure it goes.

    Raises:
        OSError: as `check_writable`, before anything is written.
    """
    target = check_writable(path)
    temporary = target.with_name(f".{target.stem}.{uuid.uuid4().hex[:8]}{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:  # also after KeyboardInterrupt; already moved when all went well
        temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str) -> None:
    """Write `text` (UTF-8) to `path` atomically. Raises OSError as `check_writable`."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


@contextmanager
def exclusive(path: str | Path) -> Iterator[None]:
    """Let one process at a time read, change and write `path`: a lock on its folder, which leaves no file behind.

    Without effect where the system has no such lock (Windows, some network disks). Raises OSError for a folder that
    is not there.
    """
    try:
        import fcntl
    except ImportError:
        yield
        return
    descriptor = os.open(resolved(path).parent, os.O_RDONLY)
    try:
        with suppress(OSError):
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)  # which gives the lock up

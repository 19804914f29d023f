"""Outputs that are whole or absent: written next to their place, then moved there in one step.

An interrupted program must not leave half a file under the name that the next program reads, nor half of a set of
files (:func:`whole_set`). `os.replace` is atomic within one file system, so the temporary file lies in the target's own
folder.
"""

import errno
import os
import signal
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from threading import current_thread, main_thread

from .paths import resolved

_waiting: ContextVar[list[tuple[Path, Path]] | None] = ContextVar("_waiting", default=None)
"""(temporary, target) of the files of the set that is being written; None outside of one."""


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
    """Yield a temporary path (same folder and suffix): on success it becomes `path`, on any failure it is removed.

    Within :func:`whole_set` it becomes `path` at the end of the set.

    Raises:
        OSError: as `check_writable`, before anything is written.
    """
    target, waiting = check_writable(path), _waiting.get()
    temporary = target.with_name(f".{target.stem}.{uuid.uuid4().hex[:8]}{target.suffix}")
    done = False
    try:
        yield temporary
        if waiting is None:
            os.replace(temporary, target)
        else:
            waiting.append((temporary, target))
            done = True
    finally:  # also after KeyboardInterrupt; already moved when all went well
        if not done:
            temporary.unlink(missing_ok=True)


@contextmanager
def whole_set() -> Iterator[None]:
    """Let the files that are written within the block by :func:`atomic_path` appear together at its end, or none.

    None after an interrupt or a termination; these wait while the files are moved. After any other error the files
    that are whole appear: what took hours does not go with the figure that failed. Only a process that is killed
    outright between two moves leaves a part of the set.
    """
    if _waiting.get() is not None:  # part of a larger set
        yield
        return
    moves: list[tuple[Path, Path]] = []
    token = _waiting.set(moves)
    try:
        try:
            yield
        except Exception:
            _move(moves)
            raise
        _move(moves)
    finally:
        _waiting.reset(token)
        for temporary, _ in moves:
            temporary.unlink(missing_ok=True)


def _move(moves: list[tuple[Path, Path]]) -> None:
    with _signals_wait():
        for temporary, target in moves:
            os.replace(temporary, target)


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Hold Ctrl-C and termination back until the block is done."""
    if current_thread() is not main_thread():  # where signals do not arrive
        yield
        return
    arrived: list[int] = []
    numbers = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {each: signal.signal(each, lambda number, _: arrived.append(number)) for each in numbers}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, signal.SIG_DFL if handler is None else handler)
        for number in arrived:
            signal.raise_signal(number)


@contextmanager
def new_folder(path: str | Path) -> Iterator[None]:
    """Make the folder `path` and those above it where they are missing; a failure that leaves it empty removes it.

    Raises OSError where it cannot be made.
    """
    folder = Path(path)
    existed = folder.exists()
    folder.mkdir(parents=True, exist_ok=True)
    try:
        yield
    except BaseException:
        if not existed:
            with suppress(OSError):  # it is not empty
                folder.rmdir()
        raise


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

"""Validation of a user's paths before anything is opened; errors contain the path.

A loop of links and a NUL in a name are not an OSError in every Python. Reading a device without end or a pipe without a
writer would never finish.
"""

import errno
import os
import stat
from pathlib import Path

FILM_SUFFIXES = (".mp4", ".m4v", ".mov", ".avi", ".mkv", ".webm", ".mpg", ".mpeg", ".wmv", ".3gp", ".mts", ".ts")
"""By these a file is taken for a film where a recording may stand, too."""
POINTER = b"version https://git-lfs"
"""How a file begins that stands for one of Git's large files until it is fetched."""


def resolved(path: str | Path) -> Path:
    """The absolute `path`, links followed and ~ expanded; it need not be there.

    Raises OSError, with `filename` and `strerror`, for a loop of links, a NUL or what is no UTF-8, a name that is too
    long, the home of an unknown user, and a folder that may not be entered.
    """
    try:
        str(path).encode()  # else no file could name it in UTF-8
        whole = Path(path).expanduser()
        os.stat(whole)
        return whole.resolve()
    except ValueError:
        raise OSError(errno.EINVAL, "no path may hold such a character", str(path)) from None
    except RuntimeError:  # of `expanduser`
        raise OSError(errno.ENOENT, "no such user's home is known: write the path without ~", str(path)) from None
    except OSError as error:
        if error.errno in (errno.ENOENT, errno.ENOTDIR):
            return whole.resolve()
        what = "its links form a loop" if error.errno == errno.ELOOP else error.strerror
        raise OSError(error.errno, what, str(path)) from None


def check_readable(path: str | Path) -> Path:
    """Return `path` if an ordinary file is there. Raises OSError, with `filename` and `strerror`, if not."""
    resolved(path)
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, "expected a file, this is a folder", str(path))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "expected an ordinary file, this is a device or a pipe", str(path))
    with open(path, "rb") as file:
        if file.read(len(POINTER)) == POINTER:
            words = "its data were not fetched, this is Git's pointer to them: run git lfs pull where it lies"
            raise OSError(errno.ENODATA, words, str(path))
    return Path(path)


def is_film(path: str | Path) -> bool:
    """Whether a path's suffix is one of a film."""
    return Path(path).suffix.lower() in FILM_SUFFIXES

"""Where a foreign method runs: as another user, in a container of the kernel's namespaces, or else in the open.

another user   it reads what that user may; the memory, environment and files of this process it does not
container      bubblewrap (github.com/containers/bubblewrap): all of the disk, but read-only, without the run's
folder and the seed's file; no process but its own, no network, no devices. It has its case's folder,
and its own for the answer
open           this process forbids others to look into its memory (PR_SET_DUMPABLE, Linux), and no more: the method
can read the command line of this process, and every file that its caller can
"""

import os
import shutil
import subprocess
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from invdyn.blindcheck.commitment import run_apart
from invdyn.recordings import InputError

NAMESPACES = ("bwrap", "--die-with-parent", "--new-session", "--unshare-all", "--ro-bind", "/", "/")
OWN = ("--dev", "/dev", "--proc", "/proc", "--setenv", "TMPDIR", "/dev/shm")
PR_SET_DUMPABLE = 4  # Linux's prctl


@dataclass(frozen=True)
class Confined:
    """How a method is kept from what it must not know.

    Args:
        user: runs it, or None. Only a root process can choose one.
        container: whether to put it into one.
        hidden: the run's folder and the seed's file: a container lacks them, and the user must not read the file.
    """

    user: str | None = None
    container: bool = False
    hidden: tuple[Path, ...] = ()

    def check(self, folder: Path) -> None:
        """Raise InputError unless the user can be had, reaches the run's folder, and does not read the seed's file."""
        if self.user is None:
            return
        try:
            reached = self._can("-x", folder)
            read = [path for path in self.hidden if path.is_file() and self._can("-r", path)]
        except (LookupError, ValueError):
            raise InputError(f"method_user: expected a user of this machine, got {self.user!r}") from None
        except (OSError, subprocess.SubprocessError):
            raise InputError(f"method_user: only root can run a method as {self.user!r}, another user") from None
        if not reached:
            message = "does not reach this folder; give --out one that all may enter"
            raise InputError(f"{folder}: user {self.user!r} {message}")
        if read:
            raise InputError(f"{read[0]}: user {self.user!r} can read the seed's file; chmod 600 it")

    def _can(self, how: str, path: Path) -> bool:
        return subprocess.run(["test", how, str(path.resolve())], check=False, **self._identity()).returncode == 0

    def run(
        self,
        words: Sequence[str],
        case: Path,
        out: Path,
        on_start: Callable[[subprocess.Popen], None] | None = None,
    ) -> subprocess.CompletedProcess[str]:
        """Run a command on a case; `out` is the folder for its answer, `on_start` as that of `run_apart`.

        Raises OSError when it cannot be started.
        """
        if self.user is not None:
            identity = self._identity()
            os.chown(out, identity["user"], identity["group"])
            try:
                return run_apart(words, case, on_start, **identity)
            finally:
                os.chown(out, os.getuid(), os.getgid())
        if self.container:
            return run_apart([*self.container_command(case, out), *words], case, on_start)
        keep_memory_private()
        return run_apart(words, case, on_start)

    def described(self) -> str:
        """A sentence on what the method can read."""
        if self.user is not None:
            return f"the method runs as user {self.user!r}: it reads what that user may"
        if self.container:
            return "the method runs in a container: it sees its case and no other process"
        return (
            "the method runs in the open, as your own user, and can read what you can; "
            "for a run that counts give --set method_user=NAME, or install bubblewrap"
        )

    def _identity(self) -> dict[str, Any]:
        import pwd

        assert self.user is not None
        known = pwd.getpwnam(self.user)
        own = {"HOME": known.pw_dir, "USER": known.pw_name, "LOGNAME": known.pw_name}
        groups = os.getgrouplist(known.pw_name, known.pw_gid)
        return {"user": known.pw_uid, "group": known.pw_gid, "extra_groups": groups, "env": os.environ | own}

    def container_command(self, case: Path, out: Path) -> list[str]:
        """The words that put a command into a container with only this case and its answer's folder."""
        words = [*NAMESPACES, *OWN]
        for path in self.hidden:
            path = path.resolve()
            words += ["--tmpfs", str(path)] if path.is_dir() else ["--ro-bind", "/dev/null", str(path)]
        return [*words, "--ro-bind", str(case), str(case), "--bind", str(out), str(out), "--chdir", str(case), "--"]


def confined(user: str | None, wanted: bool, hidden: Sequence[Path]) -> Confined:
    """By the user, if one is given; else a container, if one is `wanted` and works here; else the open."""
    return Confined(user, user is None and wanted and _works(), tuple(hidden))


def keep_memory_private() -> None:
    """Forbid other processes of this user to read this one's memory, environment and open files, where Linux can."""
    import ctypes

    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(PR_SET_DUMPABLE, 0, 0, 0, 0)


def _works() -> bool:
    if shutil.which("bwrap") is None:
        return False
    tried = subprocess.run([*NAMESPACES, *OWN, "--", "true"], stdin=subprocess.DEVNULL, capture_output=True)
    return tried.returncode == 0

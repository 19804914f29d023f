"""Sealed answers: they cannot be changed afterwards, and the diagnosis cannot read them before the score.

Commit and reveal (Blum 1981). Before any diagnosis runs, the answers are written as canonical JSON (sorted keys, no
spaces), and

    commitment = SHA-256(nonce ‖ canonical JSON),     nonce = 32 random bytes

is printed and written. The answers and the nonce stay in the memory of the process that made them; the disk has the
commitment, and for a run that is resumed the answers under lock, xor SHAKE-256(nonce ‖ label). The nonce, where it is
random or follows from a secret seed, keeps them from being found by trying. The diagnosis runs as
another process, which is given a case's folder and nothing else. Its results are hashed as well before the answers are
opened: then `open_to` writes answers and nonce, and anybody can check that they are the ones that were promised.

That protects from a mistake and from a peep at the disk. It does not hide answers from a method that makes the
cases again from their seed: whoever enters a method keeps the seed from it.
"""

import hashlib
import json
import os
import pathlib
import re
import subprocess
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from invdyn.recordings import InputError, atomic_path, check_readable, write_text

TAG, SIZE = 32, 16384
"""Bytes that tell whether a locked answer was read with its key; and of any answer: its length is to tell nothing."""


def canonical(answers: Mapping) -> bytes:
    """The one JSON text of some answers, UTF-8. Raises ValueError for a number that is not finite."""
    return json.dumps(answers, sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False).encode()


class Sealed:
    """Answers that cannot be read until they are opened."""

    def __init__(self, answers: Mapping, nonce: bytes | None = None):
        self._answers = json.loads(canonical(answers))
        self._nonce = os.urandom(32) if nonce is None else nonce
        self.commitment = _commitment(self._nonce, self._answers)

    def __repr__(self) -> str:
        return f"Sealed({self.commitment})"

    def commit_to(self, path: str | pathlib.Path) -> str:
        """Write the commitment, and nothing that tells the answers; return it. Raises OSError for no place."""
        write_text(path, json.dumps({"sha256": self.commitment, "of": "nonce, then canonical JSON"}) + "\n")
        return self.commitment

    def open_to(self, path: str | pathlib.Path) -> dict:
        """Write answers and nonce for all to check; return the answers. Raises OSError for no place."""
        opened = {"sha256": self.commitment, "nonce": self._nonce.hex(), "answers": self._answers}
        write_text(path, json.dumps(opened, sort_keys=True, indent=1, ensure_ascii=False) + "\n")
        return self._answers


class Locked:
    """Answers on the disk that only ``key`` reads, a file for each case, all of one size."""

    def __init__(self, folder: str | pathlib.Path, key: bytes):
        self._folder, self._key = pathlib.Path(folder), key

    def put(self, name: str, label: str, answer: Mapping) -> None:
        """Lock the answer of case ``name``; ``label`` says what it belongs to. Raises ValueError for a long answer."""
        text = canonical(answer).ljust(SIZE)
        if len(text) > SIZE:
            raise ValueError(f"expected an answer of {SIZE} bytes at most, got {len(text)}")
        self._folder.mkdir(parents=True, exist_ok=True)
        with atomic_path(self._folder / name) as temporary:
            temporary.write_bytes(self._tag(label, text) + self._blurred(label, text))

    def get(self, name: str, label: str) -> dict | None:
        """The answer of case ``name``; None where none was put under this key and ``label``."""
        path = self._folder / name
        locked = path.read_bytes() if path.is_file() else b""
        text = self._blurred(label, locked[TAG:])
        return json.loads(text) if locked[:TAG] == self._tag(label, text) else None

    def _blurred(self, label: str, text: bytes) -> bytes:
        stream = hashlib.shake_256(self._key + label.encode()).digest(len(text))
        return bytes(a ^ b for a, b in zip(text, stream, strict=True))

    def _tag(self, label: str, text: bytes) -> bytes:
        return hashlib.blake2b(label.encode() + b"\0" + text, key=self._key, digest_size=TAG).digest()


def read_commitment(path: str | pathlib.Path) -> str:
    """The hash that :meth:`Sealed.commit_to` wrote. Raises InputError for another file, OSError for none."""
    try:
        found = json.loads(check_readable(path).read_text(encoding="utf-8"))["sha256"]
        if re.fullmatch("[0-9a-f]{64}", found):
            return found
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise InputError(
        f"{path}: expected the hash of sealed answers, as a blind run writes it; give --out another folder"
    )


def read_opened(path: str | pathlib.Path, commitment: str | None = None) -> dict:
    """Return opened answers after checking them against their hash, and against the one printed before, if given.

    Raises InputError when they are not what was sealed, or no such file; OSError when it cannot be read.
    """
    try:
        opened = json.loads(pathlib.Path(path).read_text(encoding="utf-8"))
        stated, nonce, answers = opened["sha256"], bytes.fromhex(opened["nonce"]), opened["answers"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(f"{path}: expected opened answers, with sha256, nonce and answers: {error!r}") from error
    if _commitment(nonce, answers) != stated or commitment not in (None, stated):
        raise InputError(f"{path}: these are not the answers that were sealed as {commitment or stated}")
    return answers


def run_apart(
    command: Sequence[str],
    folder: str | pathlib.Path,
    on_start: Callable[[subprocess.Popen], None] | None = None,
    **identity: Any,
) -> subprocess.CompletedProcess[str]:
    """Run a diagnosis as a process of its own inside `folder`, a case's; nothing is inherited but the environment.

    Neither memory nor open files pass to it, and its standard input is empty. `identity` is who runs it: user, group,
    extra_groups and env of `subprocess.Popen`. `on_start` is called with the process, which others may then end.
    Returns the finished process, with any exit code. Raises OSError when it cannot be started.
    """
    pipes: dict[str, Any] = dict.fromkeys(("stdout", "stderr"), subprocess.PIPE)
    pipes |= {"stdin": subprocess.DEVNULL, "text": True, "errors": "replace"}
    with subprocess.Popen(command, cwd=folder, close_fds=True, **pipes, **identity) as process:
        try:
            if on_start is not None:
                on_start(process)
            stdout, stderr = process.communicate()
        except BaseException:
            process.kill()
            raise
    return subprocess.CompletedProcess(command, process.returncode, stdout, stderr)


def digest(folder: str | pathlib.Path) -> str:
    """SHA-256 over the names and bytes of every file in a folder: what was diagnosed before the answers opened."""
    folder, total = pathlib.Path(folder), hashlib.sha256()
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        total.update(str(path.relative_to(folder)).encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def _commitment(nonce: bytes, answers: Mapping) -> str:
    return hashlib.sha256(nonce + canonical(answers)).hexdigest()

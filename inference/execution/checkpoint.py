"""Checkpoints: tensors in a folder, such that a program killed at any moment can go on from the last one.

Two files: ``tensors-<step>-<random>.safetensors`` and ``manifest.json``, which names it. Each is written beside its
place, flushed to the disk and moved there in one step; the manifest comes last, and the tensor file of the
checkpoint before is removed after that. Whoever reads meets the old checkpoint or the new one, never half of both.

    manifest    {"schema": 1, "step": …, "fingerprint": {…}, "state": {…}, "tensors": file name, "versions": {…}}

The fingerprint is what the run was started with (seed, sizes, a digest of the data): a checkpoint of another run is
refused, not continued. safetensors holds numbers only, so that loading runs no code.
"""

import hashlib
import json
import os
import re
import secrets
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from invdyn.recordings import InputError, atomic_path

SCHEMA = 1
MANIFEST = "manifest.json"
_TENSORS = re.compile(r"tensors-\d+-[0-9a-f]{8}\.safetensors")
_UNFINISHED = re.compile(r"\.(tensors-\d+-[0-9a-f]{8}|manifest)\.[0-9a-f]{8}\.(safetensors|json)")
"""What a program that was killed leaves of a file it was writing."""


class Checkpoint:
    """The checkpoint in ``folder`` of the run that ``fingerprint`` describes.

    Args:
        folder: made when missing; one run's only.
        fingerprint: values that JSON can hold, by name: all that a run must share to be continued.

    Raises InputError (a ValueError) when safetensors is not installed; OSError when the folder cannot be made.
    """

    def __init__(self, folder: str | Path, fingerprint: Mapping[str, Any] | None = None):
        _safetensors()
        self.folder = Path(folder).expanduser()
        self.folder.mkdir(parents=True, exist_ok=True)
        # As it comes back from the file: tuples as lists, keys as strings.
        self.fingerprint = json.loads(json.dumps(dict(fingerprint or {})))

    def save(self, tensors: Mapping[str, Tensor], *, step: int = 0, **state: Any) -> None:
        """Replace the checkpoint by these tensors, of any shapes and devices, and values that JSON can hold.

        Raises OSError when the folder cannot be written, TypeError for a state that is not JSON's; the checkpoint
        before then still stands.
        """
        # A name of its own each time: the manifest that names the old file stays true until it is replaced.
        name = f"tensors-{step}-{secrets.token_hex(4)}.safetensors"
        # Copies, for safetensors refuses tensors that share memory.
        whole = {
            key: value.detach().cpu().clone(memory_format=torch.contiguous_format) for key, value in tensors.items()
        }
        manifest = {
            "schema": SCHEMA,
            "step": step,
            "fingerprint": self.fingerprint,
            "state": state,
            "tensors": name,
            "versions": {package: version(package) for package in ("torch", "safetensors")},
        }
        text = json.dumps(manifest, indent=1).encode()  # first, for it fails where the state is not JSON's
        self._write(name, _safetensors().save(whole))
        self._write(MANIFEST, text)
        for file in self.folder.iterdir():
            if file.name != name and (_TENSORS.fullmatch(file.name) or _UNFINISHED.fullmatch(file.name)):
                file.unlink(missing_ok=True)

    def load(self, device: torch.device | str = "cpu") -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Tensors, and the state with its ``step``, as they were saved; None where there is no checkpoint yet.

        Raises InputError for the checkpoint of another run, and for files that are broken.
        """
        path = self.folder / MANIFEST
        try:
            manifest = json.loads(path.read_bytes())
        except FileNotFoundError:
            return None
        except ValueError:
            raise self._broken("is no JSON") from None
        if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
            schema = manifest.get("schema") if isinstance(manifest, dict) else None
            raise self._broken(f"expected schema {SCHEMA}, got {schema!r}")
        try:
            theirs, state, step, name = (manifest[key] for key in ("fingerprint", "state", "step", "tensors"))
        except KeyError as missing:
            raise self._broken(f"has no entry {missing}") from None
        fits = isinstance(theirs, dict) and isinstance(state, dict) and isinstance(step, int)
        if not fits or not _TENSORS.fullmatch(str(name)):
            raise self._broken("its entries are not what this program writes")
        self._same_run(theirs)
        try:
            tensors = _safetensors().load((self.folder / name).read_bytes())
        except FileNotFoundError:
            raise self._broken(f"names {name}, which is missing") from None
        except Exception as error:  # safetensors has its own class for files cut short
            reason = next(iter(str(error).splitlines()), "") or type(error).__name__
            raise self._broken(f"names {name}, which cannot be read ({reason})") from None
        return {key: value.to(device) for key, value in tensors.items()}, {**state, "step": step}

    def _same_run(self, theirs: dict[str, Any]) -> None:
        differs = [key for key in sorted(theirs | self.fingerprint) if theirs.get(key) != self.fingerprint.get(key)]
        if differs:
            what = ", ".join(f"{key} {theirs.get(key)!r} there, {self.fingerprint.get(key)!r} here" for key in differs)
            raise InputError(f"{self.folder}: the checkpoint of another run: {what}; name another folder or delete it")

    def _broken(self, what: str) -> InputError:
        return InputError(f"{self.folder / MANIFEST}: {what}; delete the folder to start again")

    def _write(self, name: str, content: bytes) -> None:
        with atomic_path(self.folder / name) as temporary, open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        _sync(self.folder)


def digest(*tensors: Tensor) -> str:
    """A short hexadecimal name of these tensors' shapes, types and values, for fingerprints."""
    hashed = hashlib.sha256()
    for tensor in tensors:
        hashed.update(f"{tuple(tensor.shape)} {tensor.dtype}".encode())
        hashed.update(tensor.detach().cpu().contiguous().numpy().tobytes())
    return hashed.hexdigest()[:16]


def random_state(device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """State of torch's generators, of the CPU's and of ``device``'s where that is CUDA's, as tensors to be saved."""
    state = {"random.cpu": torch.get_rng_state()}
    if torch.device(device).type == "cuda":
        state["random.device"] = torch.cuda.get_rng_state(device)
    return state


def restore_random_state(tensors: Mapping[str, Tensor], device: torch.device | str = "cpu") -> None:
    """Set torch's generators to what :func:`random_state` gave."""
    torch.set_rng_state(tensors["random.cpu"].cpu())
    if torch.device(device).type == "cuda" and "random.device" in tensors:
        torch.cuda.set_rng_state(tensors["random.device"].cpu(), device)


def _sync(folder: Path) -> None:
    """Flush the folder's entries, where the system can: else a moved file may be gone after a power cut."""
    try:
        descriptor = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(descriptor)
    except OSError:
        pass
    finally:
        os.close(descriptor)


def _safetensors() -> ModuleType:
    try:
        import safetensors.torch
    except ImportError:
        raise InputError("checkpoints need one more package: pip install 'invdyn[checkpoint]'") from None
    return safetensors.torch

"""Checkpoints: tensors in a folder, such that a program killed at any moment can go on from the last one.

Two files: ``tensors-<step>-<random>.safetensors`` and ``manifest.json``, which names it. Each is written next to its
place, flushed to the disk and moved there in one step; the manifest comes last, and the tensor file of the
checkpoint before is removed after that. A reader finds the old checkpoint or the new one, never half of both.

    manifest    {"schema": 3, "place": …, "step": …, "fingerprint": {…}, "state": {…}, "tensors": file name,
                 "sha256": of that file, "versions": {…}, "seal": SHA-256 of all entries before}

The fingerprint is what the run was started with (seed, sizes, a digest of the data): a checkpoint of another run is
refused, not continued, as is one in another part's place. What does not match its hash is refused too: a file that was
damaged, shortened, edited or exchanged would be continued to an answer that could not be distinguished from a right
one. The hashes tell accidents; who means harm can write new ones. safetensors holds numbers only, so that loading runs
no code.
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

from invdyn.recordings import InputError, atomic_path, check_readable, resolved
from invdyn.recordings.errors import first_line

SCHEMA = 3  # of the files
MANIFEST = "manifest.json"
_TENSORS = re.compile(r"tensors-\d+-[0-9a-f]{8}\.safetensors")
_UNFINISHED = re.compile(r"\.(tensors-\d+-[0-9a-f]{8}|manifest)\.[0-9a-f]{8}\.(safetensors|json)")
"""What a program that was killed leaves of a file it was writing."""


class Checkpoint:
    """The checkpoint in ``folder`` of the run that ``fingerprint`` describes.

    Args:
        folder: made when missing; one run's only.
        fingerprint: values that JSON can hold, by name: all that a run must share to be continued.
        place: name of the part of a run that this is.

    Raises InputError (a ValueError) when safetensors is not installed; OSError when the folder cannot be made.
    """

    def __init__(self, folder: str | Path, fingerprint: Mapping[str, Any] | None = None, place: str = ""):
        _safetensors()
        self.place = place
        resolved(folder)
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
        content = _safetensors().save(whole)
        manifest = {
            "schema": SCHEMA,
            "place": self.place,
            "step": step,
            "fingerprint": self.fingerprint,
            "state": state,
            "tensors": name,
            "sha256": hashlib.sha256(content).hexdigest(),
            "versions": {package: version(package) for package in ("torch", "safetensors")},
        }
        manifest = json.loads(json.dumps(manifest))  # first, for it fails where the state is not JSON's
        text = json.dumps(manifest | {"seal": _seal(manifest)}, indent=1).encode()
        self._write(name, content)
        self._write(MANIFEST, text)
        for file in self.folder.iterdir():
            if file.name != name and (_TENSORS.fullmatch(file.name) or _UNFINISHED.fullmatch(file.name)):
                file.unlink(missing_ok=True)

    def load(self, device: torch.device | str = "cpu") -> tuple[dict[str, Tensor], dict[str, Any]] | None:
        """Tensors, and the state with its ``step``, as they were saved; None where there is no checkpoint yet.

        Raises InputError for the checkpoint of another run, and for files that are broken.
        """
        manifest = self._manifest()
        if manifest is None:
            return None
        name = manifest["tensors"]
        try:
            content = check_readable(self.folder / name).read_bytes()
        except FileNotFoundError:
            raise self._broken(f"names {name}, which is missing") from None
        if hashlib.sha256(content).hexdigest() != manifest["sha256"]:
            raise self._broken(f"names {name}, which is not what was written")
        try:
            tensors = _safetensors().load(content)
        except Exception as error:  # safetensors has its own class for what it cannot read
            raise self._broken(f"names {name}, which cannot be read ({first_line(error)})") from None
        return {key: value.to(device) for key, value in tensors.items()}, {
            **manifest["state"],
            "step": manifest["step"],
        }

    def _manifest(self) -> dict[str, Any] | None:
        """The manifest, of this run and place, with the entries that this program wrote; None where there is none."""
        path = self.folder / MANIFEST
        if not path.exists():
            return None
        try:
            manifest = json.loads(check_readable(path).read_bytes())
        except FileNotFoundError:
            return None
        except (ValueError, RecursionError):
            raise self._broken("is no JSON") from None
        if not isinstance(manifest, dict) or manifest.get("schema") != SCHEMA:
            schema = manifest.get("schema") if isinstance(manifest, dict) else None
            raise self._broken(f"expected schema {SCHEMA}, got {schema!r:.60}")
        if isinstance(theirs := manifest.get("fingerprint"), dict):
            self._same_run(theirs)  # before the seal: what is most likely has its own words
        seal = manifest.pop("seal", None)
        kinds = {"place": str, "step": int, "fingerprint": dict, "state": dict, "tensors": str, "sha256": str}
        fits = all(isinstance(manifest.get(key), kind) for key, kind in kinds.items())
        if seal != _seal(manifest) or not fits or not _TENSORS.fullmatch(manifest["tensors"]):
            raise self._broken("its entries are not what this program wrote")
        if manifest["place"] != self.place:
            raise self._broken(f"is of the part {manifest['place']!r}, expected {self.place!r}")
        return manifest

    def _same_run(self, theirs: dict[str, Any]) -> None:
        differs = [key for key in sorted(theirs | self.fingerprint) if theirs.get(key) != self.fingerprint.get(key)]
        if differs:
            here = self.fingerprint
            what = ", ".join(f"{key} {theirs.get(key)!r:.200} there, {here.get(key)!r:.200} here" for key in differs)
            raise InputError(f"{self.folder}: the checkpoint of another run: {what}; name another folder or delete it")

    def _broken(self, what: str) -> InputError:
        return InputError(f"{self.folder / MANIFEST}: {what}; delete the folder to start again")

    def _write(self, name: str, content: bytes) -> None:
        with atomic_path(self.folder / name) as temporary, open(temporary, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        _sync(self.folder)


def _seal(manifest: Mapping[str, Any]) -> str:
    """Hash of a manifest's other entries, in one order."""
    return hashlib.sha256(json.dumps(manifest, sort_keys=True).encode()).hexdigest()


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

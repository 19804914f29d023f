"""Damaged stores: posteriors (netCDF), checkpoints, folders of a blind run."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import h5py
import numpy as np

from .case import BLIND, DRAW, HUGE, KEPT, MIXED, PLOT, Case

FILM = ("plot", "posterior.nc", "--out", "out.gif")
STO = ("plot", "posterior.nc", "--out", "out.sto")
GARBAGE = {
    "empty": b"",
    "zeros": bytes(1000),
    "a byte": b"\xff",
    "a number": b"3",
    "a list": b"[1, 2]",
    "null": b"null",
    "an empty table": b"{}",
    "deep": b"[" * 100_000,
    "deep tables": b'{"a":' * 100_000,
    "an integer": f'{{"sha256": {HUGE}}}'.encode(),
    "a number for a hash": b'{"sha256": 3}',
    "another hash": b'{"sha256": "00"}',
    "UTF-16": '{"sha256": "00"}'.encode("utf-16"),
    "NaN": b'{"sha256": NaN}',
}


def cases() -> Iterator[Case]:
    """Posteriors, checkpoints, blind runs."""
    yield from posteriors()
    yield from checkpoints()
    for what, content in GARBAGE.items():
        yield Case("blind folder", BLIND, touch=in_blind("sealed.json", content), what=f"sealed.json {what}")
    for what, content in {"a file": b"", "text": b"x"}.items():
        for name in ("cases", "diagnoses", ".locked", ".making"):
            yield Case("blind folder", BLIND, touch=in_blind(name, content), what=f"{name} is {what}")
    for name in ("cases/case-0000/case.json", "cases/strange", "sealed.json/x", "notes.txt"):
        yield Case("blind folder", BLIND, touch=in_blind(name, b"{}"), what=f"{name} is there")


def in_blind(name: str, content: bytes) -> Callable[[Path], None]:
    """A folder `out` with one file."""

    def touch(folder: Path) -> None:
        path = folder / "out" / name
        path.parent.mkdir(parents=True)
        path.write_bytes(content)

    return touch


# -- posteriors ----------------------------------------------------------------------------------------------

GROUPS = {
    "posterior": ("torque", "angle", "velocity", "position", "time", "joint", "keypoint", "chain", "draw"),
    "sample_stats": ("log_weight", "log_evidence", "ess", "resampled", "filter", "time"),
    "observed_data": ("position", "angle"),
    "constant_data": ("length", "truth_torque", "command"),
    "posterior_predictive": ("position", "angle"),
}
ATTRIBUTES = ("method", "log_evidence", "outer_ess", "length_unit")
NUMBERS = {"NaN": np.nan, "infinite": np.inf, "1e308": 1e308, "1e-320": 1e-320, "0": 0.0, "-1": -1.0}


def changed(change: Callable[[h5py.File], None]) -> Callable[[Path], None]:
    """The posterior after a change of its HDF5 objects."""

    def touch(folder: Path) -> None:
        with h5py.File(folder / "posterior.nc", "r+") as store:
            change(store)

    return touch


def set_to(path: str, value: float) -> Callable[[h5py.File], None]:
    """All of a variable is that number."""

    def change(store: h5py.File) -> None:
        if store[path].dtype.kind == "f":
            store[path][...] = value
        else:  # integers have no such number
            del store[path]

    return change


def delete(path: str) -> Callable[[h5py.File], None]:
    """A variable or group is not there."""

    def change(store: h5py.File) -> None:
        del store[path]

    return change


def replaced(path: str, value: object, **options: object) -> Callable[[h5py.File], None]:
    """Another dataset, without dimensions, under a variable's name."""

    def change(store: h5py.File) -> None:
        del store[path]
        store.create_dataset(path, data=value, **options)

    return change


def renamed(path: str, name: str) -> Callable[[h5py.File], None]:
    """The first of a coordinate's names is another."""

    def change(store: h5py.File) -> None:
        store[path][0] = name

    return change


def attribute(path: str, name: str, value: object) -> Callable[[h5py.File], None]:
    """Another value of an attribute, or none."""

    def change(store: h5py.File) -> None:
        del store[path].attrs[name]
        if value is not None:
            store[path].attrs[name] = value

    return change


def declared_huge(store: h5py.File) -> None:
    """A variable that says it has 10¹⁵ numbers, of which none is stored."""
    del store["posterior/torque"]
    store.create_dataset("posterior/torque", shape=(10**15,), chunks=(1000,), dtype="f8")


def posteriors() -> Iterator[Case]:
    """Missing and wrong variables, numbers, names, attributes; cut and flipped bytes."""
    changes: dict[str, Callable[[h5py.File], None]] = {"huge sizes declared": declared_huge}
    for group, names in GROUPS.items():
        changes[f"no {group}"] = delete(group)
        for name in names:
            path = f"{group}/{name}"
            changes[f"no {path}"] = delete(path)
            changes[f"{path} is text"] = replaced(path, "text")
            changes[f"{path} is a table"] = replaced(path, np.zeros((3, 2)))
            if name not in ("joint", "keypoint", "chain", "draw"):
                changes |= {f"{path} is {what}": set_to(path, value) for what, value in NUMBERS.items()}
    for name in ATTRIBUTES:
        for value in (None, np.nan, "", "$\\frac", np.zeros(3), 10**18):
            changes[f"attribute {name} {value!r}"] = attribute("/", name, value)
    for path in ("posterior/torque", "posterior/position", "posterior/time"):
        for value in (None, 3.0, "$\\frac", "a\nb"):
            changes[f"units of {path} {value!r}"] = attribute(path, "units", value)
    for name in ("$\\frac", "a\nb", "", "x" * 3000, "\x1b[31m", "<script>"):
        changes[f"joint {name[:20]!r}"] = renamed("posterior/joint", name)
        changes[f"keypoint {name[:20]!r}"] = renamed("posterior/keypoint", name)
    for what, change in changes.items():
        for call in (PLOT, DRAW) if "torque" in what or "$" in what or "observed" in what else (PLOT,):
            yield Case("posterior", call, touch=changed(change), what=what)
    for what in ("no observed_data/position", "posterior/position is NaN", "no constant_data", "joint '$\\\\frac'"):
        yield Case("posterior", FILM, touch=changed(changes[what]), what=f"film: {what}")
        yield Case("posterior", STO, touch=changed(changes[what]), what=f"sto: {what}")
    for number in range(100):
        yield Case("posterior", PLOT, touch=flipped("posterior.nc", number / 100), what=f"a byte flipped at {number} %")
    for number in range(0, 100, 10):
        yield Case("posterior", PLOT, touch=cut("posterior.nc", number / 100), what=f"cut at {number} %")


def flipped(name: str, share: float) -> Callable[[Path], None]:
    """A file with the byte at a share of its length turned over."""

    def touch(folder: Path) -> None:
        content = bytearray((folder / name).read_bytes())
        content[int(share * len(content))] ^= 0xFF
        (folder / name).write_bytes(content)

    return touch


def cut(name: str, share: float) -> Callable[[Path], None]:
    """A file's beginning."""

    def touch(folder: Path) -> None:
        content = (folder / name).read_bytes()
        (folder / name).write_bytes(content[: int(share * len(content))])

    return touch


# -- checkpoints ---------------------------------------------------------------------------------------------


def checkpoints() -> Iterator[Case]:
    """Every part damaged, missing, exchanged, or with other numbers in it."""
    for part in ("checkpoint", "checkpoint/smc/guide", "checkpoint/smc/part-0", "mixed", "mixed/smc-sets/part-0"):
        where, call = part, MIXED if part.startswith("mixed") else KEPT
        for what, content in GARBAGE.items():
            yield Case("checkpoint", call, {f"{where}/manifest.json": content}, what=f"{part} manifest {what}")
        for key in ("schema", "step", "fingerprint", "state", "tensors", "sha256"):
            for value in (None, 3, "x", [], {}, True, "../../rec.csv", 1e308):
                yield Case("checkpoint", call, touch=entry(where, key, value), what=f"{part} {key} = {value!r}")
        for what, touch in {
            "no tensors": without_tensors(where),
            "empty tensors": cut_tensors(where, 0),
            "half of the tensors": cut_tensors(where, 0.5),
            "a bit more": padded_tensors(where),
            "NaN": edited(where, lambda value: value * np.nan),
            "other numbers": edited(where, lambda value: value + 1e-3),
            "shorter": edited(where, lambda value: value[:-1] if value.ndim else value),
            "of another kind": edited(where, lambda value: value.astype("f4")),
            "a tensor less": dropped(where),
        }.items():
            yield Case("checkpoint", call, touch=touch, what=f"{part} {what}")
    yield Case("checkpoint", KEPT, touch=exchanged("checkpoint/smc/guide", "checkpoint/smc/part-0"), what="exchanged")
    yield Case("checkpoint", KEPT, touch=exchanged("checkpoint", "checkpoint/smc/guide"), what="exchanged")


def tensors_of(folder: Path) -> Path:
    """The file of tensors in a checkpoint's folder."""
    (path,) = folder.glob("tensors-*.safetensors")
    return path


def entry(where: str, key: str, value: object) -> Callable[[Path], None]:
    """The manifest with another entry; None: without it."""

    def touch(folder: Path) -> None:
        path = folder / where / "manifest.json"
        manifest = json.loads(path.read_text())
        manifest.pop(key, None)
        if value is not None:
            manifest[key] = value
        path.write_text(json.dumps(manifest))

    return touch


def without_tensors(where: str) -> Callable[[Path], None]:
    """The file that the manifest names is not there."""
    return lambda folder: tensors_of(folder / where).unlink()


def cut_tensors(where: str, share: float) -> Callable[[Path], None]:
    """Half of a file."""

    def touch(folder: Path) -> None:
        path = tensors_of(folder / where)
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])

    return touch


def padded_tensors(where: str) -> Callable[[Path], None]:
    """A file with more bytes than were written."""

    def touch(folder: Path) -> None:
        path = tensors_of(folder / where)
        path.write_bytes(path.read_bytes() + bytes(8))

    return touch


def edited(where: str, change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Path], None]:
    """A well-formed file whose numbers are others."""

    def touch(folder: Path) -> None:
        from safetensors.numpy import load, save

        path = tensors_of(folder / where)
        tensors = load(path.read_bytes())
        real = {key: np.asarray(change(value)) if value.dtype.kind == "f" else value for key, value in tensors.items()}
        path.write_bytes(save(real))

    return touch


def dropped(where: str) -> Callable[[Path], None]:
    """A well-formed file without its last tensor."""

    def touch(folder: Path) -> None:
        from safetensors.numpy import load, save

        path = tensors_of(folder / where)
        tensors = load(path.read_bytes())
        del tensors[max(tensors)]
        path.write_bytes(save(tensors))

    return touch


def exchanged(one: str, other: str) -> Callable[[Path], None]:
    """Two parts in each other's places, manifests and all."""

    def touch(folder: Path) -> None:
        first, second = folder / one, folder / other
        files = [(path.name, path.read_bytes()) for path in first.iterdir() if path.is_file()]
        for target, source in (
            (first, [(p.name, p.read_bytes()) for p in second.iterdir() if p.is_file()]),
            (second, files),
        ):
            for path in list(target.iterdir()):
                if path.is_file():
                    path.unlink()
            for name, content in source:
                (target / name).write_bytes(content)

    return touch

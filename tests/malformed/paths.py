"""Paths that lead nowhere, round in circles, without end, or to something of another kind."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from .case import (
    BLIND,
    COMPARE,
    DEMO,
    DIAGNOSE,
    DRAW,
    INFER,
    KEPT,
    PLOT,
    SIMULATE,
    Case,
    with_option,
)


def loop(name: str) -> Callable[[Path], None]:
    """A link that leads to itself, under that name."""

    def touch(folder: Path) -> None:
        (folder / name).symlink_to(name)

    return touch


def ring(name: str) -> Callable[[Path], None]:
    """Two links that lead to each other; the name lies within."""

    def touch(folder: Path) -> None:
        first, second = folder / Path(name).parts[0], folder / "other"
        first.symlink_to(second)
        second.symlink_to(first)

    return touch


def device(name: str, target: str) -> Callable[[Path], None]:
    """A link to a device."""

    def touch(folder: Path) -> None:
        (folder / name).symlink_to(target)

    return touch


def pipe(name: str) -> Callable[[Path], None]:
    """A pipe that nobody writes to."""

    def touch(folder: Path) -> None:
        os.mkfifo(folder / name)

    return touch


def directory(name: str) -> Callable[[Path], None]:
    """A folder where a file is expected."""

    def touch(folder: Path) -> None:
        (folder / name).mkdir()

    return touch


def in_latin(folder: Path) -> None:
    """A recording and a body whose names are no UTF-8, as old systems wrote them."""
    for name in ("rec.csv", "arm.toml"):
        os.rename(folder / name, os.fsencode(folder) + b"/\xe9" + name.encode())


READ = [
    ("rec", ".csv", lambda name: (INFER[0], name, *INFER[2:])),
    ("rec", ".h5", lambda name: ("infer", name, *INFER[2:], "--units", "px", "--fps", "30")),
    ("rec", ".trc", lambda name: ("infer", name, *INFER[2:])),
    ("rec", ".csv", lambda name: (DIAGNOSE[0], name, *DIAGNOSE[2:])),
    ("arm", ".toml", lambda name: with_option(INFER, "--body", name)),
    ("arm", ".xml", lambda name: with_option(SIMULATE, "--body", name)),
    ("arm", ".urdf", lambda name: with_option(SIMULATE, "--body", name)),
    ("truth", ".csv", lambda name: with_option(INFER, "--set truth", name)),
    ("also", ".csv", lambda name: with_option(DIAGNOSE, "--with", name)),
    ("held", ".csv", lambda name: with_option(DIAGNOSE, "--held-out", name)),
    ("post", ".nc", lambda name: (PLOT[0], name, *PLOT[2:])),
]
WRITTEN = [
    (".nc", lambda name: with_option(INFER, "--out", name)),
    (".svg", lambda name: (*INFER, "--out", name)),
    (".csv", lambda name: with_option(SIMULATE, "--out", name)),
    (".csv", lambda name: (*SIMULATE, "--truth", name)),
    (".csv", lambda name: with_option(PLOT, "--out", name)),
    (".svg", lambda name: with_option(DRAW, "--out", name)),
    ("", lambda name: with_option(COMPARE, "--out", name)),
    ("", lambda name: with_option(DIAGNOSE, "--out", name)),
    ("", lambda name: with_option(DEMO, "--out", name)),
    ("", lambda name: with_option(BLIND, "--out", name)),
    ("", lambda name: with_option(KEPT, "--checkpoint", name)),
]


def cases() -> Iterator[Case]:
    """Paths to read, then to write."""
    for stem, suffix, call in READ:
        name = f"new_{stem}{suffix}"
        for what, touch in {
            "a loop": loop(name),
            "nothing there": None,
            "a folder": directory(name),
            "zeros without end": device(name, "/dev/zero"),
            "a pipe": pipe(name),
            "a link to nothing": device(name, "/nowhere/at/all"),
            "null": device(name, "/dev/null"),
        }.items():
            yield Case("path to read", call(name), touch=touch, what=f"{name} {what}")
        inside = f"ring/{stem}{suffix}"
        yield Case("path to read", call(inside), touch=ring("ring/x"), what=f"{inside} in a ring")
        for odd in (f"a\0b{suffix}", "x" * 5000 + suffix, f"rec.csv/x{suffix}", "", f"\n{suffix}", f"\udcff{suffix}"):
            yield Case("path to read", call(odd), what=f"{stem} {odd[:20]!r}")
    latin = ("infer", "\udce9rec.csv", "--body", "\udce9arm.toml", "--out", "out.nc")
    yield Case("path to read", latin, touch=in_latin, what="names in Latin-1")
    yield Case("path to read", with_option(SIMULATE, "--body", "\udce9arm.toml"), touch=in_latin, what="Latin-1")
    for suffix, call in WRITTEN:
        yield Case("path to write", call(f"\udce9{suffix}"), what="a name in Latin-1")
        name = f"new{suffix}"
        yield Case("path to write", call(name), touch=loop(name), what="a loop")
        yield Case("path to write", call(f"ring/x{suffix}"), touch=ring("ring/x"), what="in a ring")
        yield Case("path to write", call(name), touch=device(name, "/nowhere/at/all"), what="a link to nothing")
        yield Case("path to write", call(name), touch=device(name, "/dev/full"), what="a full device")
        yield Case("path to write", call(f"rec.csv/x{suffix}"), what="in a file")
        for odd in (f"a\0b{suffix}", "x" * 5000 + suffix):
            yield Case("path to write", call(odd), what=f"{odd[:20]!r}")
        if suffix:
            yield Case("path to write", call(name), touch=directory(name), what="a folder")
            yield Case("path to write", call(f"nowhere/x{suffix}"), what="nowhere")
            yield Case("path to write", call(""), what="no name")
        else:
            yield Case("path to write", call("arm.toml"), what="a file")

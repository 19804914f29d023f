"""What is installed is the tree; versions in constraints.txt are complete, and within the ranges of pyproject.toml."""

import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from itertools import chain
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from invdyn import ROOMS

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
REQUIREMENTS = list(chain(PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()))


def pinned():
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [Requirement(line) for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(pin.name): pin for pin in pins}


@pytest.mark.parametrize("text", REQUIREMENTS)
def test_each_requirement_has_one_tested_version_in_its_range(text):
    requirement = Requirement(text)
    pin = pinned()[canonicalize_name(requirement.name)]
    (specifier,) = pin.specifier
    assert specifier.operator == "=="
    assert requirement.specifier.contains(specifier.version)


def test_constraints_are_plain_versions():
    assert all(pin.url is None and not pin.extras for pin in pinned().values())


# -- what a wheel holds -------------------------------------------------------------------------------------
def tree():
    """All files of the package by their place in it, the rooms' among them."""
    own = {path.name for path in (ROOT / "invdyn").iterdir() if path.is_file()}
    own |= {f"view_page/{path.name}" for path in (ROOT / "invdyn" / "view_page").iterdir()}
    rooms = {path.relative_to(ROOT).as_posix() for room in ROOMS for path in (ROOT / room).rglob("*") if path.is_file()}
    return {f"invdyn/{name}" for name in own | rooms if "__pycache__" not in name}


def build(what, folder):
    """Have setuptools make a "wheel" or an "sdist" of ``folder``; returns the file. Nothing is downloaded."""
    out = folder.parent / what
    code = f"from setuptools import build_meta; print(build_meta.build_{what}({str(out)!r}))"
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", code], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out / done.stdout.splitlines()[-1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """Unpacked: the wheel of the sdist of a checkout, links and all."""
    pytest.importorskip("setuptools", minversion="77", reason="the build backend is not installed: pip install .[dev]")
    folder = tmp_path_factory.mktemp("build")
    checkout = folder / "checkout"
    checkout.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, checkout)
    for name in ("invdyn", *ROOMS):
        shutil.copytree(ROOT / name, checkout / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    assert all((checkout / "invdyn" / room).is_symlink() for room in ROOMS)
    with tarfile.open(build("sdist", checkout)) as file:
        file.extractall(folder / "sdist-content", filter="data")
    (source,) = (folder / "sdist-content").iterdir()
    assert not [path for path in source.rglob("*") if path.is_symlink()]
    with zipfile.ZipFile(build("wheel", source)) as file:
        file.extractall(folder / "installed")
    return folder / "installed"


def test_a_wheel_of_an_sdist_holds_the_tree(wheel):
    found = {path.relative_to(wheel).as_posix() for path in (wheel / "invdyn").rglob("*") if path.is_file()}
    assert found == tree()
    assert len(found) > 250


def test_what_is_installed_runs(wheel):
    code = f"""
import sys
sys.path.insert(0, {str(wheel)!r})
import invdyn.inference.filters, invdyn.models, invdyn.recordings
from importlib import resources
with resources.as_file(resources.files("invdyn.models.bodies") / "paper_planar_arm.toml") as path:
    assert str(path).startswith({str(wheel)!r})
    print(invdyn.models.Body.load(path).name)
"""
    done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()


def test_a_checkout_without_links_says_so(tmp_path):
    """There they are text files that hold the path; in what is installed from one they are missing."""
    package = tmp_path / "invdyn"
    package.mkdir()
    shutil.copy(ROOT / "invdyn" / "__init__.py", package)
    for room in ROOMS[:-1]:
        (package / room).write_text(f"../{room}")
    code = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import invdyn"
    for room, kind in ((ROOMS[0], "text"), (ROOMS[-1], "missing")):
        done = subprocess.run([sys.executable, "-I", "-c", code], capture_output=True, text=True)
        assert done.returncode == 1, kind
        assert f"ImportError: invdyn/{room} should be a link to ../{room}" in done.stderr
        assert "core.symlinks" in done.stderr
        for room in ROOMS[:-1]:
            if (package / room).is_file():
                (package / room).unlink()
                (package / room).mkdir()

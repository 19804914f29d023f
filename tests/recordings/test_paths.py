"""Paths that cannot be one, or lead to what is no ordinary file, are an OSError with the path in it."""

import errno
import os

import pytest

from invdyn.recordings import check_readable, check_writable, resolved

NO_FILES = [
    ("loop", errno.ELOOP),
    ("loop/x", errno.ELOOP),
    ("a\0b", errno.EINVAL),
    ("\udce9", errno.EINVAL),
    ("x" * 5000, errno.ENAMETOOLONG),
    ("zeros", errno.EINVAL),
    ("pipe", errno.EINVAL),
    ("folder", errno.EISDIR),
    ("file/x", errno.ENOTDIR),
]
"""Names in the folder `here` that are neither read nor written, and what says so."""


@pytest.fixture
def here(tmp_path):
    """A folder with a file, a loop of links, a pipe, a device, and a folder."""
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "loop").symlink_to("back")
    (tmp_path / "back").symlink_to("loop")
    (tmp_path / "zeros").symlink_to("/dev/zero")
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    return tmp_path


def test_an_ordinary_file_is_readable(here):
    assert check_readable(here / "file").read_text() == "x"
    assert check_readable(here / "link").read_text() == "x"
    assert resolved(here / "link") == (here / "file").resolve()
    assert resolved(here / "not there" / "yet") == here.resolve() / "not there" / "yet"


@pytest.mark.parametrize(("name", "code"), [*NO_FILES, ("none", errno.ENOENT)])
def test_what_cannot_be_read_is_named(here, name, code):
    with pytest.raises(OSError) as caught:  # noqa: PT011  the number says which
        check_readable(here / name)
    assert caught.value.errno == code
    assert caught.value.filename in (str(here / name), here / name)


@pytest.mark.parametrize(("name", "code"), [*NO_FILES, ("none/x", errno.ENOENT)])
def test_what_cannot_be_written_is_named(here, name, code):
    before = sorted(os.listdir(here))
    with pytest.raises(OSError) as caught:  # noqa: PT011  the number says which
        check_writable(here / name)
    assert caught.value.errno == code
    assert caught.value.filename == str(here / name)
    assert sorted(os.listdir(here)) == before


def test_a_home_that_is_not_known_is_no_loop():
    with pytest.raises(FileNotFoundError, match="home is known") as caught:
        resolved("~no such user/x")
    assert caught.value.filename == "~no such user/x"


def test_a_loop_is_told_where_resolving_lets_it_pass(here, monkeypatch):
    """As Python 3.13 and later do."""
    monkeypatch.setattr(type(here), "resolve", lambda self, strict=False: self)
    with pytest.raises(OSError, match="links form a loop") as caught:
        resolved(here / "loop")
    assert caught.value.errno == errno.ELOOP


def test_a_pointer_of_git_lfs_is_told(tmp_path):
    path = tmp_path / "tracks.h5"
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n")
    with pytest.raises(OSError, match="run git lfs pull") as refusal:
        check_readable(path)
    assert refusal.value.filename == str(path)

import os

import pytest

from invdyn.recordings import atomic_path, check_writable, write_text


def test_writes_whole_and_leaves_nothing_else(tmp_path):
    target = tmp_path / "out.txt"
    target.write_text("old")
    with atomic_path(target) as temporary:
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".txt"
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert os.listdir(tmp_path) == ["out.txt"]


def write_half(target, failure):
    with atomic_path(target) as temporary:
        temporary.write_text("half")
        raise failure


@pytest.mark.parametrize("failure", [KeyboardInterrupt, RuntimeError])
def test_an_interrupt_in_the_middle_leaves_the_old_file(tmp_path, failure):
    target = tmp_path / "out.txt"
    target.write_text("old")
    with pytest.raises(failure):
        write_half(target, failure)
    assert target.read_text() == "old"
    assert os.listdir(tmp_path) == ["out.txt"]


def test_says_why_a_path_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    for path, words in [
        (tmp_path / "none" / "out.txt", "folder does not exist"),
        (tmp_path / "file" / "out.txt", "not a folder"),
        (tmp_path, "this is a folder"),
        ("/dev/null", "not an ordinary file"),
    ]:
        with pytest.raises(OSError, match=words) as caught:
            check_writable(path)
        assert len(str(caught.value).splitlines()) == 1
    with pytest.raises(OSError, match="folder does not exist"):
        write_text(tmp_path / "none" / "out.txt", "text")


def test_says_when_a_folder_may_not_be_written(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # chmod would not stop root
    with pytest.raises(PermissionError, match="no permission"):
        check_writable(tmp_path / "out.txt")

import os
import signal

import pytest

from invdyn.recordings import atomic_path, check_writable, new_folder, whole_set, write_text


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


@pytest.fixture
def set_of_two(tmp_path):
    """Function that writes two files as a set, and does something between and after them."""
    (tmp_path / "a.txt").write_text("old")

    def write(between=lambda: None, after=lambda: None):
        with whole_set():
            write_text(tmp_path / "a.txt", "new")
            between()
            with whole_set():  # part of the larger one
                write_text(tmp_path / "b.txt", "new")
            after()
            assert (tmp_path / "a.txt").read_text() == "old"
            assert not (tmp_path / "b.txt").exists()

    return write


def found(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}


def raising(failure):
    def fails():
        raise failure

    return fails


def test_a_set_appears_at_its_end(tmp_path, set_of_two):
    set_of_two()
    assert found(tmp_path) == {"a.txt": "new", "b.txt": "new"}


@pytest.mark.parametrize("failure", [KeyboardInterrupt, SystemExit(143)])
@pytest.mark.parametrize("moment", ["between", "after"])
def test_an_interrupt_leaves_none_of_a_set(tmp_path, set_of_two, failure, moment):
    with pytest.raises(type(failure) if isinstance(failure, SystemExit) else failure):
        set_of_two(**{moment: raising(failure)})
    assert found(tmp_path) == {"a.txt": "old"}


def test_an_error_leaves_what_was_whole_by_then(tmp_path, set_of_two):
    """The posterior of hours does not go with a figure that failed."""
    with pytest.raises(RuntimeError):
        set_of_two(between=raising(RuntimeError))
    assert found(tmp_path) == {"a.txt": "new"}


@pytest.mark.skipif(os.name == "nt", reason="sends a POSIX signal")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_while_a_set_is_moved(tmp_path, set_of_two, monkeypatch, number):
    class Ended(BaseException):
        pass

    def end(*_):
        raise Ended

    replace = os.replace

    def replace_and_signal(*paths):
        replace(*paths)
        signal.raise_signal(number)

    monkeypatch.setattr(os, "replace", replace_and_signal)
    before = signal.signal(number, end)
    try:
        with pytest.raises(Ended):
            set_of_two()
        assert signal.getsignal(number) is end
    finally:
        signal.signal(number, before)
    assert found(tmp_path) == {"a.txt": "new", "b.txt": "new"}


def test_a_new_folder_goes_if_it_stays_empty(tmp_path):
    with pytest.raises(KeyboardInterrupt), new_folder(tmp_path / "new"):
        raise KeyboardInterrupt
    (tmp_path / "old").mkdir()
    with pytest.raises(RuntimeError), new_folder(tmp_path / "old"):
        raise RuntimeError
    with new_folder(tmp_path / "kept"):
        pass
    assert sorted(os.listdir(tmp_path)) == ["kept", "old"]

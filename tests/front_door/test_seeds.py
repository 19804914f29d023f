"""A run's seed by a number, a file, or standard input; a slip in it is not printed."""

import io

import pytest

from invdyn.blind_commands import MAX_FIRST_SEED, secret_seed
from invdyn.recordings import InputError


def test_ways_to_give_a_seed(tmp_path, monkeypatch):
    (tmp_path / "seed.txt").write_text(" 80123456789 \n")
    assert secret_seed(None, None, 7) == (7, False)
    assert secret_seed("0", None, 7) == (0, False)
    assert secret_seed(str(MAX_FIRST_SEED), None, 7) == (MAX_FIRST_SEED, False)
    assert secret_seed(None, tmp_path / "seed.txt", 7) == (80123456789, True)
    monkeypatch.setattr("sys.stdin", io.StringIO("555\nand more"))
    assert secret_seed("-", None, 7) == (555, True)


@pytest.mark.parametrize("text", ["", "12 13", "-4", "1e6", "٣", str(MAX_FIRST_SEED + 1), "4812" * 2000, "s3cret\x00"])
def test_what_is_no_seed_is_not_repeated(text, tmp_path):
    (tmp_path / "seed.txt").write_text(text)
    with pytest.raises(InputError, match="expected a seed") as refusal:
        secret_seed(None, tmp_path / "seed.txt", 7)
    assert not text or text not in str(refusal.value).replace(str(tmp_path), "")


def test_a_seed_file_of_no_path_is_reported():
    with pytest.raises(OSError, match="no path may hold"):
        secret_seed(None, "a\0b", 7)


def test_an_endless_seed_file_ends():
    with pytest.raises(InputError, match="expected a seed"):
        secret_seed(None, "/dev/zero", 7)

"""Derived equations are kept on disk, and a broken file does not matter."""

import math

import pytest
from chains import random_case

from invdyn.models.dynamics import euler_lagrange


def evaluate(functions):
    """A number that every generated function takes part in."""
    p, q, qd, _ = random_case(2, 16)
    values = {"phi": q, "w": qd, **p._asdict()}
    total = 0.0
    for name, words in euler_lagrange.ARGUMENTS.items():
        moving, body = (
            [values[w].unbind(-1) for w in words if (w in euler_lagrange.MOVING) == m] for m in (True, False)
        )
        total += sum(float(x) for x in functions[name].values(*moving, functions[name].numbers(*body)))
    return total


def test_a_derivation_is_kept_and_read_back(tmp_path, monkeypatch):
    first = evaluate(euler_lagrange.torch_functions(2, tmp_path / "new" / "folder"))
    assert len(list((tmp_path / "new" / "folder").iterdir())) == 1

    def derived_again(num_joints):
        raise AssertionError("expected the cached derivation")

    monkeypatch.setattr(euler_lagrange, "generate", derived_again)
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path / "new" / "folder")) == first


@pytest.mark.parametrize(
    "damage",
    [
        lambda text: "",
        lambda text: text[: len(text) // 2],
        lambda text: text.replace("phi1", "phi2", 1),
        lambda text: "[1, 2]",
        lambda text: '{"sources": 3, "sha256": 4}',
        lambda text: "\x00\x01",
    ],
)
def test_a_broken_cache_file_is_derived_again_and_mended(tmp_path, damage):
    whole = evaluate(euler_lagrange.torch_functions(2, tmp_path))
    (file,) = tmp_path.iterdir()
    good = file.read_text(encoding="utf-8")
    file.write_text(damage(good), encoding="utf-8")
    assert evaluate(euler_lagrange.torch_functions(2, tmp_path)) == whole
    assert euler_lagrange._read_cache(file) is not None


def test_a_cache_folder_that_cannot_be_written_does_not_matter(tmp_path):
    (tmp_path / "file").write_text("in the way")
    assert math.isfinite(evaluate(euler_lagrange.torch_functions(2, tmp_path / "file")))

"""Results in a checkpoint: what comes back is what was kept, to the bit, and nothing else is made."""

from collections import namedtuple
from dataclasses import dataclass, field

import numpy as np
import pytest
import torch

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.records import Plain, keep, kept

pytest.importorskip("safetensors")


@dataclass
class Inner:
    values: np.ndarray
    name: str = "inner"


@dataclass
class Outer:
    inner: Inner | None
    pair: tuple[float, torch.Tensor]
    named: dict[str, list[int]] = field(default_factory=dict)


def test_a_value_comes_back_to_the_bit(tmp_path):
    half = np.arange(6, dtype=np.float32).reshape(2, 3).T  # columns lie apart
    value = Outer(Inner(half), (0.1 + 0.2, torch.tensor([True, False])), {"z": [1, 2], "a": []})
    keep(Checkpoint(tmp_path), value)
    found = kept(Checkpoint(tmp_path), Outer, Inner)
    assert found.inner.values.dtype == np.float32
    assert (found.inner.values == half).all()
    assert found.pair[0] == value.pair[0]
    assert torch.equal(found.pair[1], value.pair[1])
    assert list(found.named) == ["z", "a"]  # in the order in which they came
    assert found.named == value.named
    assert kept(Checkpoint(tmp_path / "other"), Outer) is None


def test_numbers_of_numpy_become_pythons_and_what_is_none_stays(tmp_path):
    keep(Checkpoint(tmp_path), [np.float64(0.1), np.bool_(True), np.int64(3), None, float("inf")])
    found = kept(Checkpoint(tmp_path))
    assert found == [0.1, True, 3, None, float("inf")]
    assert [type(each) for each in found[:3]] == [float, bool, int]


def test_a_named_tuple_comes_back_as_a_plain_one(tmp_path):
    keep(Checkpoint(tmp_path), namedtuple("Pair", "one two")(1, [2]))
    assert kept(Checkpoint(tmp_path)) == (1, [2])


def test_what_is_there_twice_is_kept_once():
    plain, array = Plain(), np.ones(5)
    plain.of([array, array.copy(), torch.ones(5, dtype=torch.float64)])
    assert len(plain.tensors) == 1


def test_other_values_and_other_records_are_refused(tmp_path):
    with pytest.raises(TypeError, match="got object"):
        Plain().of([object()])
    with pytest.raises(TypeError, match="got dict"):  # JSON would make texts of its keys
        Plain().of({1: 2.0})
    keep(Checkpoint(tmp_path), Inner(np.zeros(1)))
    with pytest.raises(KeyError, match="Inner"):
        kept(Checkpoint(tmp_path), Outer)

"""Checkpoints: what comes back, what is refused, and what a kill at any moment leaves."""

import json
import os
import subprocess
import sys
import time

import pytest
import torch

from invdyn.inference.execution import checkpoint as checkpoint_module
from invdyn.inference.execution.checkpoint import Checkpoint, digest, random_state, restore_random_state
from invdyn.inference.execution.distribute import inside
from invdyn.recordings import InputError

pytest.importorskip("safetensors")
from safetensors.torch import load_file, save_file

RUN = {"seed": 3, "particles": 100}


def test_tensors_and_state_come_back_as_they_were(tmp_path):
    checkpoint = Checkpoint(tmp_path / "new" / "folder", {**RUN, "shape": (2, 3)})
    assert checkpoint.load() is None
    whole = torch.randn(3, 4, dtype=torch.float64)
    tensors = {
        "x": whole,
        "view": whole[:, :2],
        "one": torch.tensor(True),
        "none": torch.empty(0, 3),
        "i": whole.mT.int(),
    }
    checkpoint.save(tensors, step=7, loss=[0.1, 2.0], name="ω")
    found, state = Checkpoint(tmp_path / "new" / "folder", {**RUN, "shape": (2, 3)}).load()
    assert state == {"step": 7, "loss": [0.1, 2.0], "name": "ω"}
    assert found.keys() == tensors.keys()
    for name, value in tensors.items():
        assert found[name].dtype == value.dtype
        assert torch.equal(found[name], value)


def test_one_checkpoint_is_kept(tmp_path):
    checkpoint = Checkpoint(tmp_path, RUN)
    for step in range(3):
        checkpoint.save({"x": torch.full((2,), float(step))}, step=step)
    (tmp_path / "notes.txt").write_text("mine")
    for left in (".tensors-2-0123abcd.89abcdef.safetensors", ".manifest.89abcdef.json"):  # of a killed program
        (tmp_path / left).write_text("half")
    checkpoint.save({"x": torch.ones(2)}, step=3)
    assert sorted(file.suffix for file in tmp_path.iterdir()) == [".json", ".safetensors", ".txt"]


def test_another_runs_checkpoint_is_refused_and_says_what_differs(tmp_path):
    Checkpoint(tmp_path, RUN).save({})
    with pytest.raises(ValueError, match=r"particles 100 there, 200 here.*another folder") as caught:
        Checkpoint(tmp_path, {**RUN, "particles": 200}).load()
    assert "\n" not in str(caught.value)
    assert "seed" not in str(caught.value)
    with pytest.raises(ValueError, match="device None there, 'cuda' here"):
        Checkpoint(tmp_path, {**RUN, "device": "cuda"}).load()


def _cut(folder):
    file = next(folder.glob("*.safetensors"))
    file.write_bytes(file.read_bytes()[:-5])


def _rewrite(folder, change):
    """Well-formed tensors, but others."""
    file = next(folder.glob("*.safetensors"))
    save_file({name: change(value) for name, value in load_file(file).items()}, file)


def _change(folder, **entries):
    path = folder / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "manifest.json").write_bytes(b'{"schema": 1, "st'), "is no JSON"),
        (lambda folder: (folder / "manifest.json").write_bytes(b"\xff\xfe"), "is no JSON"),
        (lambda folder: (folder / "manifest.json").write_bytes(b"[" * 100_000), "is no JSON"),
        (lambda folder: (folder / "manifest.json").write_text("[]"), "schema 3, got None"),
        (lambda folder: (folder / "manifest.json").write_text('{"schema": 3}'), "not what this program wrote"),
        (lambda folder: _change(folder, schema=2), "schema 3, got 2"),
        (lambda folder: _change(folder, step=4), "not what this program wrote"),
        (lambda folder: _change(folder, state={"loss": 3}), "not what this program wrote"),
        (lambda folder: _change(folder, seal=None), "not what this program wrote"),
        (lambda folder: _change(folder, tensors="../../other.safetensors"), "not what this program wrote"),
        (lambda folder: next(folder.glob("*.safetensors")).unlink(), "which is missing"),
        (_cut, "which is not what was written"),
        (lambda folder: _rewrite(folder, lambda x: x * torch.nan), "which is not what was written"),
        (lambda folder: _rewrite(folder, lambda x: x[:-1]), "which is not what was written"),
    ],
)
def test_broken_files_are_named_in_one_line(tmp_path, damage, message):
    checkpoint = Checkpoint(tmp_path, RUN)
    checkpoint.save({"x": torch.ones(100)})
    damage(tmp_path)
    with pytest.raises(InputError, match=message) as caught:
        checkpoint.load()
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_part_in_another_ones_place_is_refused(tmp_path):
    for name in ("part-0", "part-1"):
        inside(Checkpoint(tmp_path, RUN), name).save({"x": torch.ones(2)})
    (tmp_path / "part-0").rename(tmp_path / "aside")
    (tmp_path / "part-1").rename(tmp_path / "part-0")
    with pytest.raises(InputError, match="is of the part 'part-1', expected 'part-0'"):
        inside(Checkpoint(tmp_path, RUN), "part-0").load()


def test_a_manifest_of_another_save_is_refused(tmp_path):
    """As when a folder is put together from two copies of it."""
    checkpoint = Checkpoint(tmp_path, RUN)
    checkpoint.save({"x": torch.ones(2)}, step=1)
    earlier = next(tmp_path.glob("*.safetensors")).read_bytes()
    checkpoint.save({"x": torch.zeros(2)}, step=2)
    next(tmp_path.glob("*.safetensors")).write_bytes(earlier)
    with pytest.raises(InputError, match="not what was written"):
        checkpoint.load()


class NoMatch:
    """In the place of a pattern: fails as a disk that may not be cleaned."""

    def fullmatch(self, name):
        raise OSError("gone")


@pytest.mark.parametrize("moment", ["tensors", "manifest", "cleaning"])
def test_a_write_that_fails_leaves_an_entire_checkpoint(tmp_path, monkeypatch, moment):
    checkpoint = Checkpoint(tmp_path, RUN)
    checkpoint.save({"x": torch.zeros(2)}, step=0)
    replace, calls = os.replace, []

    def failing(source, target):
        calls.append(target)
        if len(calls) == {"tensors": 1, "manifest": 2}.get(moment):
            raise OSError("disk full")
        return replace(source, target)

    monkeypatch.setattr(os, "replace", failing)
    if moment == "cleaning":
        monkeypatch.setattr(checkpoint_module, "_TENSORS", NoMatch())
    with pytest.raises(OSError, match=r"disk full|gone"):
        checkpoint.save({"x": torch.ones(2)}, step=1)
    monkeypatch.undo()
    tensors, state = checkpoint.load()
    assert state["step"] == (1 if moment == "cleaning" else 0)
    assert tensors["x"].tolist() == [float(state["step"])] * 2
    checkpoint.save({"x": torch.ones(2)}, step=2)
    assert len(list(tmp_path.glob("tensors-*"))) == 1


WRITER = """
import sys, torch
from invdyn.inference.execution.checkpoint import Checkpoint
checkpoint = Checkpoint(sys.argv[1], {"seed": 3, "particles": 100})
step = 0
while True:
    checkpoint.save({"a": torch.full((1000,), float(step)), "b": torch.tensor(step)}, step=step, double=2 * step)
    print(step, flush=True)
    step += 1
"""


@pytest.mark.long
def test_a_kill_at_any_moment_leaves_an_entire_checkpoint(tmp_path):
    steps = []
    for wait in (0.0, 0.013):
        command = [sys.executable, "-W", "ignore", "-c", WRITER, str(tmp_path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as writer:
            assert writer.stdout.readline() == b"0\n"
            time.sleep(wait)  # whatever it then does
            writer.kill()
        tensors, state = Checkpoint(tmp_path, RUN).load()
        assert state["double"] == 2 * state["step"] == 2 * tensors["b"].item()
        assert (tensors["a"] == state["step"]).all()
        steps.append(state["step"])
    assert len(steps) == 2


def test_without_safetensors_the_extra_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "safetensors.torch", None)
    with pytest.raises(InputError, match=r"pip install 'invdyn\[checkpoint\]'"):
        Checkpoint(tmp_path)


def test_random_numbers_go_on_where_they_were(tmp_path):
    torch.manual_seed(3)
    torch.randn(5)
    checkpoint = Checkpoint(tmp_path)
    checkpoint.save(random_state())
    expected = torch.randn(5)
    torch.manual_seed(9)
    restore_random_state(checkpoint.load()[0])
    assert torch.equal(torch.randn(5), expected)


def test_digests_tell_shapes_types_and_values_apart():
    x = torch.arange(6.0)
    names = {digest(x), digest(x.double()), digest(x.reshape(2, 3)), digest(x + 1), digest(x[:3], x[3:])}
    assert len(names) == 5
    assert digest(x) == digest(x.clone())

"""Checkpoints: what comes back, what is refused, and what a kill at any moment leaves."""

import json
import os
import signal
import subprocess
import sys
import time

import pytest
import torch

from invdyn.inference.execution import checkpoint as checkpoint_module
from invdyn.inference.execution.checkpoint import Checkpoint, digest, random_state, restore_random_state
from invdyn.recordings import InputError

pytest.importorskip("safetensors")

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


def _change(folder, **entries):
    path = folder / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda folder: (folder / "manifest.json").write_bytes(b'{"schema": 1, "st'), "is no JSON"),
        (lambda folder: (folder / "manifest.json").write_bytes(b"\xff\xfe"), "is no JSON"),
        (lambda folder: (folder / "manifest.json").write_text("[]"), "schema 1, got None"),
        (lambda folder: (folder / "manifest.json").write_text('{"schema": 1}'), "no entry 'fingerprint'"),
        (lambda folder: _change(folder, schema=9), "schema 1, got 9"),
        (lambda folder: _change(folder, tensors="../../other.safetensors"), "not what this program writes"),
        (lambda folder: next(folder.glob("*.safetensors")).unlink(), "which is missing"),
        (_cut, "cannot be read"),
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
    step += 1
"""


def test_a_kill_at_any_moment_leaves_an_entire_checkpoint(tmp_path):
    steps = []
    for wait in (0.0, 0.013):
        writer = subprocess.Popen([sys.executable, "-W", "ignore", "-c", WRITER, str(tmp_path)])
        try:
            deadline = time.monotonic() + 60
            start = Checkpoint(tmp_path, RUN).load() if steps else None
            while time.monotonic() < deadline:
                try:
                    found = Checkpoint(tmp_path, RUN).load()
                except InputError:  # replaced between the reading of its two files
                    continue
                if found is not None and (start is None or found[1] != start[1]):
                    break
                time.sleep(0.01)
            time.sleep(wait)
        finally:
            writer.send_signal(signal.SIGKILL)
            writer.wait()
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

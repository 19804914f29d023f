"""Training that was interrupted ends where it would have ended."""

import inspect
import os
import signal
import subprocess
import sys

import pyro
import pytest
import torch
from pyro.infer import SVI
from pyro.optim import ClippedAdam

from invdyn.inference import VSMC_ELBO, Checkpoint
from invdyn.inference.variational.affine import Affine
from invdyn.inference.variational.training import train
from invdyn.models import LinearGaussian
from invdyn.recordings import InputError

pytest.importorskip("safetensors")


def trained(steps, folder=None, killed_at=None, seed=0):
    """All parameters after ``steps`` of 40 steps of VSMC; the process kills itself after the step ``killed_at``."""
    one = torch.eye(2, dtype=torch.float64)
    model = LinearGaussian(0.9 * one, one, one, 0.3 * one, 0 * one[0], one, 6)
    torch.manual_seed(1)
    y = torch.randn(6, 2, dtype=torch.float64)
    pyro.clear_param_store()
    torch.manual_seed(seed)
    adam = ClippedAdam({"lr": 0.05, "lrd": 0.1 ** (1 / 40)})
    svi = SVI(model.sequence, Affine(model), adam, loss=VSMC_ELBO(4, 3))
    checkpoint = None if folder is None else Checkpoint(folder, {"seed": seed})

    def report(done, _):
        if done == killed_at:
            os.kill(os.getpid(), signal.SIGKILL)

    train(svi, steps, y, checkpoint=checkpoint, every=5, report=report)
    return {name: value.detach().clone() for name, value in pyro.get_param_store().items()}


def assert_same(found, expected):
    assert set(found) == set(expected)
    for name, value in expected.items():
        assert torch.equal(found[name], value), name


@pytest.mark.quick("15")
@pytest.mark.parametrize("stop", [5, 15, 40])
def test_resumed_training_ends_as_one_that_was_never_stopped(tmp_path, stop):
    trained(stop, tmp_path)
    assert Checkpoint(tmp_path, {"seed": 0}).load()[1]["step"] == stop
    assert_same(trained(40, tmp_path), trained(40))


def test_training_moves(tmp_path):
    before, after = trained(0), trained(40)
    assert not before or any(not torch.equal(before[name], after[name]) for name in before)
    assert max(value.abs().max() for value in after.values()) > 0.1


def test_a_stop_between_checkpoints_continues_from_the_last_one(tmp_path):
    trained(13, tmp_path)
    assert Checkpoint(tmp_path, {"seed": 0}).load()[1]["step"] == 13  # the last step is always kept
    assert_same(trained(40, tmp_path), trained(40))


def test_another_runs_training_is_refused(tmp_path):
    trained(5, tmp_path)
    with pytest.raises(InputError, match="another run: seed 0 there, 3 here"):
        trained(5, tmp_path, seed=3)


PROGRAM = """
import os, signal, sys, pyro, torch
from pyro.infer import SVI
from pyro.optim import ClippedAdam
from invdyn.inference import VSMC_ELBO, Checkpoint
from invdyn.inference.variational.affine import Affine
from invdyn.inference.variational.training import train
from invdyn.models import LinearGaussian
"""


@pytest.mark.long
def test_killed_training_continues_to_the_same_answer(tmp_path):
    program = PROGRAM + inspect.getsource(trained) + "trained(40, sys.argv[1], killed_at=18)"
    killed = subprocess.run([sys.executable, "-W", "ignore", "-c", program, str(tmp_path)])
    assert killed.returncode == -signal.SIGKILL
    assert Checkpoint(tmp_path, {"seed": 0}).load()[1]["step"] == 15
    assert_same(trained(40, tmp_path), trained(40))

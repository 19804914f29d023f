"""A comparison that is killed anywhere goes on where it was, to the same table and posteriors."""

import dataclasses

import numpy as np
import pytest

from invdyn.inference import compare
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.models import Link, planar_body
from invdyn.recordings import InputError, Recording, Truth

pytest.importorskip("safetensors")

TIME = 0.03 * np.arange(14)
ARM = planar_body("arm", [Link("rod", "shoulder", "elbow", length=0.4, mass=1.2)])
KNOWN = {
    "torque.scale": 3.0,
    "torque.decay": 4.0,
    "emission.keypoint_scale": 0.01,
    "noise.angle": 0.003,
    "noise.velocity": 0.05,
}
ANGLE = -1.3 + 0.4 * np.sin(4 * TIME)
SWING = Recording(TIME, 0.4 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], -1)[:, None], ("elbow",), name="swing")
TRUTH = Truth(TIME, ANGLE[:, None], 1.6 * np.cos(4 * TIME)[:, None], np.ones((14, 1)), ("shoulder",))
SIZES = {"num_filters": 4, "num_particles": 30, "num_draws": 2, "filters_per_task": 2, "settings": KNOWN, "seed": 4}
METHODS = ("smc", "laplace")
MEASURED = ["seconds", "memory"]


class Killed(BaseException):
    """As a process that is killed: nothing catches it."""


@pytest.fixture
def killed_at_next_save(monkeypatch):
    """Function of a comparison -> its result, or None: it is killed as soon as it has kept anything new."""
    save = Checkpoint.save

    def dies(self, tensors, **state):
        save(self, tensors, **state)
        raise Killed

    def call(run):
        with monkeypatch.context() as patch:
            patch.setattr(Checkpoint, "save", dies)
            try:
                return run()
            except Killed:
                return None

    return call


def comparison(folder=None, body=ARM, **options):
    return compare(SWING, body, METHODS, truth=TRUTH, held_out=0.25, checkpoint=folder, **{**SIZES, **options})


def bits(found):
    """The table but for seconds and memory, and all numbers of the posteriors."""
    numbers = {
        (method, group, name): idata[group][name].values.tobytes()
        for method, idata in found.posteriors.items()
        for group in idata.groups()
        for name in idata[group].data_vars
    }
    table = found.table.drop(columns=MEASURED).to_csv(float_format="%r")
    attributes = {
        (method, name): str(value)  # a file has NumPy's own numbers
        for method, idata in found.posteriors.items()
        for name, value in idata.attrs.items()
        if name != "created_at"
    }
    return table, numbers, attributes, found.failures, found.notes, found.held_out


@pytest.mark.slow
def test_killed_after_everything_that_it_keeps(tmp_path, killed_at_next_save):
    expected, calls = bits(comparison()), 0
    while (found := killed_at_next_save(lambda: comparison(tmp_path))) is None:
        calls += 1
    assert bits(found) == expected
    # Of all rows and of the first ones: the fit, the parts and guide of smc, and each method's result.
    assert calls >= 2 * (1 + 2 + len(METHODS))
    again = comparison(tmp_path)
    assert again.table[MEASURED].equals(found.table[MEASURED])  # of when they ran
    assert bits(again) == expected
    for idata in again.posteriors.values():  # and nothing of them is left in a file that is gone
        assert all(variable.variable._in_memory for group in idata.groups() for variable in idata[group].values())


@pytest.mark.slow
def test_of_an_uncertain_body(tmp_path, killed_at_next_save):
    body = dataclasses.replace(ARM, uncertainty={"mass": 0.1})
    expected = bits(comparison(body=body))
    while (found := killed_at_next_save(lambda: comparison(tmp_path, body))) is None:
        pass
    assert bits(found) == expected


@pytest.mark.long
def test_a_method_that_failed_is_tried_again(tmp_path, monkeypatch):
    from invdyn.inference import METHODS as KNOWN_METHODS

    expected = bits(comparison())
    with monkeypatch.context() as patch:

        def fails(problem, **_):
            raise MemoryError("no room")

        patch.setitem(KNOWN_METHODS, "laplace", fails)
        found = comparison(tmp_path)
    assert found.failures == {"laplace": "MemoryError: no room"}
    assert bits(comparison(tmp_path)) == expected


def test_another_comparison_is_refused(tmp_path, killed_at_next_save):
    assert killed_at_next_save(lambda: comparison(tmp_path)) is None
    with pytest.raises(InputError, match="checkpoint of another run: seed 4 there, 5 here"):
        comparison(tmp_path, seed=5)

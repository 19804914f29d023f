"""Of several torque processes draws are in proportion to their evidence; that which made the torque is most probable.

And what it brings: a robot's torque, smooth with a little on it that is not, is known more narrowly by the sum.
"""

import importlib
import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.inference import SMCOptions, compare, infer, pooled, prepare
from invdyn.inference import fit_processes as fits_module
from invdyn.models import (
    SMOOTHNESS,
    TORQUE_PROCESSES,
    ArmModel,
    Encoders,
    Link,
    Matern52,
    Observation,
    OrnsteinUhlenbeck,
    SmoothAndRough,
    default_torques,
    planar_body,
)
from invdyn.recordings import Recording

ARM = planar_body("rod", [Link("rod", "hinge", "tip", length=0.5, mass=1.0)])
KNOWN = {"emission.angle_scale": 2e-5, "noise.angle": 1e-6, "noise.velocity": 1e-4, "initial.velocity_scale": 0.5}
TIME = 0.01 * np.arange(150)
SIZES = SMCOptions(num_filters=2, num_particles=20, num_draws=2)
BOTH = (OrnsteinUhlenbeck(), Matern52())


def moved_by(process, known=KNOWN, **scales):
    """Encoder angles of a rod that a torque of this process moves, and that torque (T,), N·m."""
    parameters = {**known, **{f"torque.{name}": value for name, value in scales.items()}}
    model = ArmModel(ARM, TIME, Observation(Encoders()), torque=process, parameters=parameters)
    torch.manual_seed(1)
    states, angles = model.simulate()
    recording = Recording(TIME, np.empty((len(TIME), 0, 2)), (), angles=angles.numpy(), joint_names=("hinge",))
    return recording, states[:, 0].numpy()


@pytest.fixture(scope="module")
def smooth():
    return moved_by(Matern52(), scale=2.0, lengthscale=0.3)[0]


@pytest.fixture(scope="module")
def rough():
    return moved_by(OrnsteinUhlenbeck(), scale=6.0, decay=5.0)[0]


@pytest.mark.quick("rough-OrnsteinUhlenbeck")
@pytest.mark.parametrize(("made", "name"), [("smooth", "Matern52"), ("rough", "OrnsteinUhlenbeck")])
def test_the_process_that_made_the_torque(made, name, request):
    reported = []
    recording = request.getfixturevalue(made)
    task = prepare(
        recording, ARM, options=SIZES, seed=0, settings=KNOWN, torque=BOTH, report=lambda *n: reported.append(n)
    )
    evidence = task.record["torque_evidence"]
    assert task.record["torque_process"] == type(task.problem.model.torque).__name__ == name
    assert max(evidence, key=evidence.get) == name
    assert abs(np.subtract(*evidence.values())) > 3  # nats: no draw
    (alone,) = (process for process in BOTH if type(process).__name__ == name)
    one = prepare(recording, ARM, options=SIZES, seed=0, settings=KNOWN, torque=alone)
    fitted, other = task.record["fitted"], one.record["fitted"]
    assert fitted.keys() == other.keys()
    for parameter, value in fitted.items():
        assert value == pytest.approx(other[parameter], rel=0.02)  # the second fit begins where the first one ended
    assert "torque_evidence" not in one.record
    assert all(done <= total for done, total in reported)
    assert [done for done, _ in reported] == sorted(done for done, _ in reported)


def test_a_choice_that_was_kept_is_not_made_again(smooth, tmp_path, monkeypatch):
    def again(torque):
        folder = tmp_path / "run"
        return prepare(smooth, ARM, options=SIZES, seed=0, settings=KNOWN, torque=torque, checkpoint=folder)

    first = again(BOTH)
    monkeypatch.setattr(fits_module, "fit_over_gaps", None)
    second = again(BOTH)
    assert second.record == first.record
    assert torch.equal(second.path, first.path)
    assert type(second.problem.model.torque) is Matern52


@pytest.mark.long
def test_a_comparison_holds_out_under_the_process_that_it_chose(rough, monkeypatch):
    bound = []

    def spied(recording, *args, torque, **options):
        bound.append(torque)
        return prepare(recording, *args, torque=torque, **options)

    monkeypatch.setattr(importlib.import_module("invdyn.inference.compare"), "prepare", spied)
    found = compare(rough, ARM, ["laplace"], settings=KNOWN, torque=BOTH, num_filters=2, num_draws=2)
    assert bound[0] == BOTH
    assert type(bound[1]) is OrnsteinUhlenbeck
    assert len(bound) == 2
    assert not found.failures


@pytest.mark.long
def test_a_robots_torque_is_known_more_narrowly_by_the_sum():
    """It is nearer than the default in narrower bands; 90 % is .9 to what 130 dependent rows allow."""
    coarse = {**KNOWN, "emission.angle_scale": 2e-4}
    robot = {"scale": 4.0, "lengthscale": 0.8, "rough_scale": 0.1, "rough_decay": 20.0}
    recording, true = moved_by(SmoothAndRough(), coarse, **robot)
    inner = slice(10, -10)
    found = {}
    for process in (OrnsteinUhlenbeck(), SmoothAndRough()):
        idata = infer(
            recording, ARM, torque=process, settings=coarse, method="laplace", num_filters=20, num_draws=10, substeps=1
        )
        draws = pooled(idata)["torque"].transpose("sample", "time", "joint").values[:, inner, 0]
        low, high = np.quantile(draws, [0.05, 0.95], axis=0)
        off = draws.mean(0) - true[inner]
        covers = ((low <= true[inner]) & (true[inner] <= high)).mean()
        name = json.loads(idata.attrs["settings"])["torque_process"]
        found[name] = np.sqrt((off**2).mean()), (high - low).mean(), covers
    rms, width, covers = found["SmoothAndRough"]
    assert rms < 0.9 * found["OrnsteinUhlenbeck"][0]
    assert width < found["OrnsteinUhlenbeck"][1]
    assert 0.8 < covers < 0.99


@pytest.mark.long
def test_draws_are_of_each_process_and_of_uncertain_parameters(smooth, tmp_path):
    """Its evidence is the mixture's, its band no narrower than that of the most probable process as it was fitted."""
    few = replace(smooth, time=TIME[:60], angles=smooth.angles[:60], keypoints=smooth.keypoints[:60])
    sizes = {"num_filters": 16, "num_particles": 30, "num_draws": 4}

    def found(torque, **options):
        return infer(few, ARM, method="laplace", torque=torque, settings=KNOWN, seed=1, **sizes, **options)

    mixed = found(BOTH, checkpoint=tmp_path / "run")
    settings = json.loads(mixed.attrs["settings"])
    evidence = settings["torque_evidence"]
    assert 1 < sum(settings["torque_sets"].values()) <= 16
    whole = np.logaddexp(*evidence.values()) - np.log(2)
    assert mixed.attrs["log_evidence"] == pytest.approx(whole, abs=0.7)  # Laplace's, to the error of some draws
    assert mixed["posterior"].sizes["chain"] * mixed["posterior"].sizes["draw"] == 64
    alone = found(next(each for each in BOTH if type(each).__name__ == settings["torque_process"]))
    sd, fitted = (float(pooled(each)["torque"].std("sample").mean()) for each in (mixed, alone))
    assert 0.9 * fitted < sd < 3 * fitted
    for again in (found(BOTH), found(BOTH, checkpoint=tmp_path / "run")):
        np.testing.assert_array_equal(again["posterior"]["torque"], mixed["posterior"]["torque"])


def test_of_settings_of_a_torque_the_process_follows():
    assert [type(each).__name__ for each in default_torques()] == [
        TORQUE_PROCESSES[name].__name__ for name in SMOOTHNESS
    ]
    assert type(default_torques(["emission.keypoint_scale", "torque.decay"])) is OrnsteinUhlenbeck


def test_by_default_the_torque_is_the_mixture(smooth):
    few = replace(smooth, time=TIME[:40], angles=smooth.angles[:40], keypoints=smooth.keypoints[:40])
    sizes = {"num_filters": 8, "num_draws": 2, "method": "laplace", "settings": KNOWN, "seed": 2}
    default, named = infer(few, ARM, **sizes), infer(few, ARM, torque=default_torques(), **sizes)
    np.testing.assert_array_equal(default["posterior"]["torque"], named["posterior"]["torque"])
    assert 1 < sum(json.loads(default.attrs["settings"])["torque_sets"].values()) <= 8
    stated = infer(few, ARM, **{**sizes, "settings": {**KNOWN, "torque.scale": 2.0}})
    assert json.loads(stated.attrs["settings"])["torque_process"] == "OrnsteinUhlenbeck"
    assert "torque_sets" not in json.loads(stated.attrs["settings"])

"""A diagnosis that is killed goes on where it was, and says the same to the bit."""

import json
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pendulum import DAMPING, PENDULUM, recorded
from variants import nonideal

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.kept_units import content_digest, kept_unit
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.models.divergence import Diverged
from invdyn.models.effects import EFFECTS
from invdyn.recordings import InputError

pytest.importorskip("safetensors")

FEW = {"viscous_friction", "camera_roll"}
OTHERS = tuple(name for name in EFFECTS if name not in FEW)


class Killed(BaseException):
    """As a process that is killed: nothing catches it."""


@pytest.fixture
def killed_after(monkeypatch):
    """Function of a number of saves and a diagnosis -> its result, or None where it was killed after so many.

    The first save of all marks the folder, and is no unit.
    """
    save = Checkpoint.save

    def call(count, run):
        left = count

        def dies(self, tensors, **state):
            nonlocal left
            save(self, tensors, **state)
            left -= 1
            if left == 0:
                raise Killed

        with monkeypatch.context() as patch:
            patch.setattr(Checkpoint, "save", dies)
            try:
                return run()
            except Killed:
                return None

    return call


def bits(diagnosis):
    """All that a diagnosis says, and its posterior."""
    posterior = diagnosis.posterior
    numbers = {
        (group, name): posterior[group][name].values.tobytes()
        for group in posterior.groups()
        for name in posterior[group].data_vars
    }
    return json.dumps(diagnosis.to_json()), numbers


def units(folder):
    return {path.parent.name for path in folder.glob("*/manifest.json")}


def diagnosis_of(folder=None, workers=1, without=OTHERS, **options):
    return diagnose(recorded(DAMPING), PENDULUM, without=without, workers=workers, checkpoint=folder, **options)


@pytest.fixture(scope="module")
def whole():
    """A diagnosis at one go, without a folder."""
    return bits(diagnosis_of())


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.long), 2])
def test_killed_in_the_middle_it_goes_on(tmp_path, whole, killed_after, workers):
    assert killed_after(4, lambda: diagnosis_of(tmp_path)) is None
    before = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*/manifest.json")}
    assert len(before) == 3
    assert bits(diagnosis_of(tmp_path, workers)) == whole
    assert {name.partition("-")[0] for name in units(tmp_path)} == {"screen", "refine", "confirm"}
    assert {path: path.stat().st_mtime_ns for path in before} == before  # these were not computed again


@pytest.mark.slow
def test_killed_after_every_unit_it_goes_on(tmp_path, whole, killed_after):
    """Each call adds one unit to what is kept, until one reaches the end."""
    count = 0
    while (result := killed_after(1, lambda: diagnosis_of(tmp_path))) is None:
        assert len(units(tmp_path)) == count
        count += 1
    assert count > 4
    assert bits(result) == whole


CASES = {
    "searched noise": {"viscous_friction", "outliers", "varying_noise"},
    "unknown torque": {"camera_roll", "camera_scale"},
    "held-out recording": {"viscous_friction"},
}
"""Effects of each catalogue."""


def strayed():
    """A pendulum with outliers among its detections."""
    recording, rng = recorded(DAMPING), np.random.default_rng(1)
    points, rows = recording.keypoints.copy(), rng.integers(len(recording.keypoints), size=8)
    points[rows, 0] += rng.normal(0, 0.3, (8, 2))
    return replace(recording, keypoints=points)


@pytest.mark.long
@pytest.mark.parametrize("case", CASES)
def test_every_kind_of_unit_comes_back_as_it_was(tmp_path, case):
    recording = strayed() if case == "searched noise" else recorded(DAMPING)
    if case == "unknown torque":
        recording = replace(recording, torques=None, joint_names=())
    options = {"without": tuple(name for name in EFFECTS if name not in CASES[case])}
    if case == "held-out recording":
        options["held_out"] = recorded(DAMPING, seed=1)
    expected = bits(diagnose(recording, PENDULUM, **options))
    assert bits(diagnose(recording, PENDULUM, workers=2, checkpoint=tmp_path, **options)) == expected
    names = units(tmp_path)
    if case == "searched noise":
        assert "search" in {name.partition("-")[0] for name in names}
    assert bits(diagnose(recording, PENDULUM, checkpoint=tmp_path, **options)) == expected
    assert units(tmp_path) == names  # nothing was computed again
    for name in sorted(names)[::2]:  # what a kill might have spared
        shutil.rmtree(tmp_path / name)
    assert bits(diagnose(recording, PENDULUM, workers=2, checkpoint=tmp_path, **options)) == expected
    assert units(tmp_path) <= names  # a search that is kept needs none of its own refinements


def test_another_diagnosis_is_refused(tmp_path, killed_after):
    assert killed_after(1, lambda: diagnosis_of(tmp_path)) is None
    with pytest.raises(InputError, match=r"checkpoint of another run: seed 0 there, 1 here"):
        diagnosis_of(tmp_path, seed=1)
    with pytest.raises(InputError, match=r"checkpoint of another run: recording"):
        diagnose(recorded(2 * DAMPING), PENDULUM, without=OTHERS, checkpoint=tmp_path)


# -- units --------------------------------------------------------------------------------------------------


def test_a_unit_leaves_its_work_and_its_failure(tmp_path):
    calls = []

    @kept_unit("unit")
    def unit(problem, fails):
        calls.append(fails)
        problem.budget.done += 0.1
        problem.budget.missed |= {"armature"}
        if fails:
            raise Diverged("no path")
        return 7.0

    for fails in (False, True):
        for _ in range(2):
            budget = SimpleNamespace(done=1.5, missed=frozenset({"payload"}))
            problem = SimpleNamespace(checkpoint=Checkpoint(tmp_path), budget=budget, content="", model=None)
            if fails:
                with pytest.raises(Diverged, match="no path"):
                    unit(problem, fails)
            else:
                assert unit(problem, fails) == 7.0
            assert budget.done == 1.5 + 0.1
            assert budget.missed == {"payload", "armature"}
    assert calls == [False, True]


def test_content_is_what_the_numbers_are():
    friction = EFFECTS["coulomb_friction"]("pivot")
    assert content_digest([1.0, {"a": 2.0}]) == content_digest([np.float64(1.0), {"a": np.float64(2.0)}])
    assert content_digest(np.arange(6.0).reshape(2, 3).T) == content_digest(np.arange(6.0).reshape(2, 3).T.copy())
    others = [1.0, 1, -0.0, 0.0, None, "1", [1.0], np.array([1.0]), np.array([[1.0]]), friction, nonideal(friction)]
    assert len({content_digest(each) for each in others}) == len(others)
    with pytest.raises(TypeError, match="expected numbers, texts, arrays and records of them, got object"):
        content_digest(object())

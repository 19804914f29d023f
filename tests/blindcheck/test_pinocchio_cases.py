"""Cases of the second generator: whole, of every kind, the same from the same seed, and said to be its own."""

import json

import numpy as np
import pytest

import invdyn.blindcheck.cases as cases
import invdyn.blindcheck.initial_state_fit as starts
from invdyn.blindcheck.cases import make_case
from invdyn.blindcheck.commitment import canonical
from invdyn.blindcheck.kinds import KINDS
from invdyn.blindcheck.run import BlindRun
from invdyn.blindcheck.tracker import LAWS
from invdyn.models import Body
from invdyn.recordings import InputError, read_keypoint_csv

pytest.importorskip("pinocchio")
ONE = {
    "commanded": "external_push",
    "passive": "soft_tissue",
    "none": None,
    "weak": "lens_distortion",
    "two": ("payload", "camera_roll"),
    "unknown_torque": "outliers",
    "outside": "hysteresis",
    "leave_one_out": "link_flexibility",
    "as_real": "actuator_gain",
}


@pytest.fixture(autouse=True)
def hasty(monkeypatch):
    """One draw a case, and d′ is soon settled."""
    monkeypatch.setattr(cases, "MAX_DRAWS", 1)
    monkeypatch.setattr(starts, "MAX_GAUSS_NEWTON_STEPS", 1)


@pytest.mark.quick("[!cta]*")
@pytest.mark.parametrize("kind", KINDS)
def test_a_case_is_whole(kind, tmp_path):
    case = make_case(11, kind, ONE[kind], "pinocchio")
    case.write(tmp_path)
    body = Body.from_toml(tmp_path / "body.toml")
    read = read_keypoint_csv(tmp_path / "recording.csv", joints=body.joint_names)
    assert read.keypoint_names[-len(body.keypoint_names) :] in ((), body.keypoint_names)
    assert (read.torques is not None) == (case.regime == "commanded")
    seen = read.angles if KINDS[kind].robot else read.keypoints.reshape(len(read.time), -1)
    assert np.isfinite(seen).any(1).sum() > 0.9 * 4 * 30
    canonical(case.answer)  # finite throughout, and plain JSON
    assert case.answer["engine"] == "pinocchio"
    assert case.answer["noise"]["law"] in LAWS
    assert "pinocchio" not in json.dumps(json.loads((tmp_path / "case.json").read_text()))
    for effect in case.answer["effects"]:
        assert effect["dprime"] >= 0
        # a push as a half wave has a peak, which the catalogue does not know, and no force
        assert effect["parameters"] or effect["form"]


def test_the_same_seed_is_the_same_case_to_the_byte(tmp_path):
    for folder in "ab":
        make_case(12, "passive", "label_swap", "pinocchio").write(tmp_path / folder)
    for name in ("recording.csv", "body.toml", "case.json"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_engines_simulate_the_same_effects_differently():
    pytest.importorskip("mujoco")
    answers = [make_case(12, "commanded", "soft_tissue", engine).answer for engine in ("mujoco", "pinocchio")]
    assert [answer["engine"] for answer in answers] == ["mujoco", "pinocchio"]
    assert answers[0]["body"] == answers[1]["body"]  # drawn before anything moves


def test_a_run_says_its_engine_and_knows_its_own(tmp_path):
    run = BlindRun(tmp_path / "run", {"none": 1}, 13, engine="pinocchio")
    run.check()
    sealed = run.make()
    assert BlindRun(tmp_path / "run", {"none": 1}, 13, engine="pinocchio").make() == sealed  # goes on
    with pytest.raises(InputError, match="another engine"):
        BlindRun(tmp_path / "run", {"none": 1}, 13).make()
    with pytest.raises(InputError, match="--engine: expected one of mujoco, pinocchio, mujoco-in-space, got 'bullet'"):
        BlindRun(tmp_path / "other", {"none": 1}, 13, engine="bullet").check()

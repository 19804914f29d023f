"""Cases: whole, readable, the same from the same seed to the byte, and nothing in them tells the answer."""

import ast
import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import invdyn.blindcheck.cases as cases
from invdyn.blindcheck.cases import effects_of, make_case, planned
from invdyn.blindcheck.commitment import canonical
from invdyn.blindcheck.engine import MUJOCO
from invdyn.blindcheck.injected_effects import CATALOGUE
from invdyn.blindcheck.kinds import KINDS
from invdyn.blindcheck.unlisted_effects import UNLISTED
from invdyn.models import Body
from invdyn.recordings import read_keypoint_csv

pytest.importorskip("mujoco")
QUICK = {
    "commanded": ["joint_coupling", "clock_rate"],
    "passive": ["payload"],
    "none": [None],
    "weak": ["actuator_lag"],
    "two": [("inertial_error", "keypoint_offset")],
    "unknown_torque": ["viscous_friction"],
    "outside": ["detent"],
    "leave_one_out": ["gravity_tilt"],
    "as_real": [("joint_stiffness",)],
}
"""Each kind of case once, by effects of all sorts; all effects of every kind are asked by the slow test below."""


def check(case, kind, folder):
    """What holds for every case."""
    case.write(folder)
    body = Body.from_toml(folder / "body.toml")
    read = read_keypoint_csv(folder / "recording.csv", joints=body.joint_names)
    assert read.keypoint_names[-len(body.keypoint_names) :] in ((), body.keypoint_names)
    public = json.loads((folder / "case.json").read_text())
    assert public["regime"] == case.regime
    assert (read.torques is not None) == (case.regime == "commanded")
    reach = sum(link.nominal("length") for link in body.links)
    assert 3.9 < read.duration < 10.1
    if KINDS[kind].robot:
        check_robot(case, read)
    else:
        frames = read.keypoints[np.isfinite(read.keypoints).any(axis=(1, 2))]
        assert len(frames) > 0.9 * 4 * 30
        assert np.median(np.linalg.norm(frames - np.array(body.base), axis=-1)) < 1.3 * reach
    assert public.get("robot", False) == KINDS[kind].robot
    assert (folder / "other.csv").exists() == (public["held_out"] is not None)
    canonical(case.answer)  # finite throughout, and plain JSON
    assert len(case.answer["effects"]) in KINDS[kind].numbers
    for effect in case.answer["effects"]:
        assert effect["side"] == ("observation" if effect["effect"] in cases.OBSERVATIONS else "dynamics")
        assert effect["effect"] in (UNLISTED if kind == "outside" else CATALOGUE)
        assert effect["parameters"]
        known = {"joint": body.joint_names, "keypoint": body.keypoint_names, "link": [e.name for e in body.links]}
        for site, names in known.items():
            assert site not in effect or effect[site] in names
        struck = [effect["effect"], *(["camera_roll"] if effect["effect"] == "gravity_tilt" else [])]
        assert public["without"] == (struck if kind == "leave_one_out" else [])
    return read


def check_robot(case, read):
    """Encoders alone, and friction, rotor and an error of the link at every joint."""
    assert not read.keypoints.size
    assert np.isfinite(read.angles).all(1).sum() > 0.9 * 4 * 30
    there = [(each["effect"], each.get("joint", each.get("link"))) for each in case.answer["everywhere"]]
    links = [link.name for link in case.body.links]
    places = {"inertial_error": links}
    assert there == [
        (name, place) for name in KINDS["as_real"].everywhere for place in places.get(name, case.body.joint_names)
    ]
    assert len(links) > 1
    assert all(each["parameters"] for each in case.answer["everywhere"])


@pytest.mark.parametrize(("kind", "effect"), [(kind, effect) for kind in KINDS for effect in QUICK[kind]])
def test_a_case_is_whole(kind, effect, tmp_path, hasty):
    check(make_case(7, kind, effect), kind, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in KINDS if 1 in KINDS[kind].numbers])
def test_every_effect_makes_every_kind_of_case(kind, tmp_path):
    for effect in effects_of(kind):
        for seed in (31, 32, 33):
            case = make_case(seed, kind, effect)
            check(case, kind, tmp_path / f"{effect}{seed}")


@pytest.mark.slow
def test_any_two_make_a_case(tmp_path):
    for seed in range(100):
        check(make_case(seed, "two"), "two", tmp_path / str(seed))


def test_the_same_seed_is_the_same_case_to_the_byte(tmp_path, hasty):
    answers = [{}, {}]
    for each, folder in zip(answers, "ab", strict=True):
        for name, *job in planned({"commanded": 2, "none": 1}, seed=4):
            case = make_case(*job)
            case.write(tmp_path / folder / name)
            each[name] = case.answer
    files = [sorted(p for p in (tmp_path / name).rglob("*") if p.is_file()) for name in "ab"]
    assert canonical(answers[0]) == canonical(answers[1])
    assert [p.relative_to(tmp_path / "a") for p in files[0]] == [p.relative_to(tmp_path / "b") for p in files[1]]
    assert all(a.read_bytes() == b.read_bytes() for a, b in zip(*files, strict=True))
    assert sorted(answers[0]) == [f"case-{number:04d}" for number in range(3)]
    first, second = (a["effects"][0]["effect"] for a in answers[0].values() if a["kind"] == "commanded")
    assert first != second  # effects take turns


def test_names_of_cases_tell_nothing():
    plan = planned({"commanded": 40, "none": 20, "two": 5}, seed=3)
    assert [name for name, *_ in plan] == [f"case-{number:04d}" for number in range(65)]
    kinds = [kind for _, _, kind, _ in plan]
    assert {kind: kinds.count(kind) for kind in set(kinds)} == {"commanded": 40, "none": 20, "two": 5}
    assert kinds != sorted(kinds)
    assert {effect for _, _, kind, effect in plan if kind == "commanded"} == set(CATALOGUE)  # all before any again
    assert planned({"commanded": 40, "none": 20, "two": 5}, seed=4) != plan


def test_commands_may_run_faster_than_the_camera(hasty):
    seen = set()
    for seed in range(8):
        recording = make_case(seed, "none").recording
        if recording.torques is None:
            continue
        assert np.isfinite(recording.torques).all()
        with_points = np.isfinite(recording.keypoints).any(axis=(1, 2)).mean()
        seen.add("faster" if with_points < 0.6 else "alike")
        if len(seen) == 2:
            break
    assert seen == {"faster", "alike"}


def test_a_recording_is_what_was_filmed_and_commanded(monkeypatch, hasty):
    filmed = []

    def spy(real, time, effects, noise, seed):
        filmed.append((real, time))
        return MUJOCO.film(real, time, effects, noise, seed)

    monkeypatch.setitem(cases.ENGINES, "mujoco", replace(MUJOCO, film=spy))
    case = make_case(3, "commanded", "viscous_friction")
    real, time = filmed[-1]
    seen = case.recording.keypoints[np.isin(case.recording.time, time)]
    tips = seen[:, -case.body.num_joints :]
    true = np.stack([np.interp(time, real.time, column) for column in real.points[:, 1:].reshape(len(real.time), -1).T])
    error = tips.reshape(len(time), -1) - true.T
    count = np.isfinite(error).sum()
    assert np.nanstd(error) == pytest.approx(case.answer["noise"]["keypoint_sd"], rel=5 / np.sqrt(2 * count))
    start = int(np.argmin(np.abs(real.command_time)))
    given = real.command[start : start + len(case.recording.time)]
    np.testing.assert_allclose(case.recording.torques, given, rtol=1e-6)


def test_the_visibility_of_an_effect_is_that_of_its_change(hasty):
    case = make_case(3, "commanded", "camera_scale")
    (effect,) = case.answer["effects"]
    off = abs(effect["parameters"]["scale"]["value"] - 1)
    keypoints = case.recording.keypoints[:, -case.body.num_joints :]
    frames = np.isfinite(keypoints).all(axis=(1, 2))
    scale = effect["parameters"]["scale"]["value"]
    rms = off * np.sqrt((keypoints[frames] ** 2).mean()) / scale / case.answer["noise"]["keypoint_sd"]
    assert effect["visibility_rms"] == pytest.approx(rms, rel=0.05)
    assert effect["dprime"] == pytest.approx(effect["visibility_rms"] * np.sqrt(keypoints[frames].size))


@pytest.mark.long
@pytest.mark.parametrize(("seed", "tries"), [(301, 1), (718, 2)])  # the second needs a damped search for its start
def test_backlash_that_is_never_crossed_is_not_visible(seed, tries, monkeypatch, coarse_steps):
    """A link that hangs on one side of its gear's backlash moves as it would without, from another angle."""
    monkeypatch.setattr(cases, "MAX_DRAWS", tries)
    (effect,) = make_case(seed, "commanded", "backlash").answer["effects"]
    assert effect["parameters"]["width"]["value"] > 0.005
    assert effect["dprime"] < 1


def test_what_cannot_be_is_refused():
    with pytest.raises(ValueError, match="kind of case among commanded"):
        make_case(1, "weird")
    with pytest.raises(ValueError, match="actuator_gain"):
        make_case(1, "passive", "actuator_gain")
    with pytest.raises(ValueError, match="has 2 of"):
        make_case(1, "two", "payload")
    with pytest.raises(ValueError, match="has 2 of"):
        make_case(1, "two", ("gravity_tilt", "camera_roll"))


def test_the_room_stays_independent():
    """Reality must not know the effects that the diagnosis looks for."""
    folder = Path(cases.__file__).parent
    scored = {"worker", "run", "score", "judge", "measures", "page", "methods", "answer_schema"}
    files = [file for file in folder.rglob("*.py") if file.stem not in scored]
    assert len(files) > 15
    for file in files:
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            source = getattr(node, "module", None) or ""
            names = [alias.name for alias in getattr(node, "names", [])] if hasattr(node, "names") else []
            imported = [source, *names] if isinstance(node, ast.Import | ast.ImportFrom) else []
            rooms = ("invdyn.models.effects", "invdyn.inference", "invdyn.diagnosis")
            assert not [each for each in imported if str(each).startswith(rooms)]


def test_a_body_that_cannot_be_is_drawn_again(monkeypatch, hasty):
    """A link whose change takes away more than its mass, which grown sizes may do."""
    monkeypatch.setitem(KINDS, "weak", replace(KINDS["weak"], strength=10.0))
    monkeypatch.setattr(cases, "MAX_DRAWS", 16)
    case = make_case(1, "weak", "inertial_error")
    (effect,) = case.answer["effects"]
    link = next(each for each in case.body.links if each.name == effect["link"])
    for name in ("mass", "inertia"):
        assert effect["parameters"][name]["value"] > -link.nominal(name)


@pytest.mark.parametrize(
    ("draws", "strengths"),
    [
        ([(5, 100)] * 10, [1, 1, 1, *(1.5**n for n in range(1, 6)), 1.5**5, 1.5**5]),  # met or not, up to the largest
        ([(5, 100)] * 5 + [None] * 3 + [(100, 100)], [1, 1, 1, 1.5, 2.25, *[1.5**3] * 4]),  # that whirl, say nothing
    ],
)
def test_only_what_is_hardly_met_is_made_larger(monkeypatch, draws, strengths):
    """What is combined with it has its usual size in all draws."""
    asked = []

    def attempted(_, kind, names, strength, engine):
        asked.append(tuple(strength))
        met = draws[len(asked) - 1] if len(asked) <= len(draws) else (100, 100)
        return met and SimpleNamespace(answer={"effects": [{"dprime": float(each)} for each in met]})

    monkeypatch.setattr(cases, "attempt_case", attempted)
    make_case(1, "two", ("backlash", "inertial_error"))
    assert [first for first, _ in asked[: len(draws)]] == pytest.approx(strengths)
    assert {other for _, other in asked} == {1.0}

"""Grippers, closed loops, feet and muscles whose simulation has one wrong number: it is named, estimated, written."""

import json
from types import SimpleNamespace

import legs
import linkages
import mujoco
import muscled_arms
import numpy as np
import pytest

from invdyn.diagnosis.engine import diagnose as DIAGNOSE
from invdyn.diagnosis.engine.diagnose import diagnose_engine
from invdyn.diagnosis.engine.write_back import copies, write_back
from invdyn.diagnosis.report.report import render
from invdyn.diagnosis.report.sentences import kind, verdict
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import Scene
from invdyn.models.divergence import Diverged
from invdyn.recordings import InputError, Recording

CASES = {"holding": (linkages.HOLDING, linkages.grasp), "rubbing": (linkages.RUBBING, linkages.rub)}


def stiffer(model):
    """The tendon."""
    model.tendon_stiffness[0] *= 1.4


def smoother(model):
    """All shapes that touch."""
    for geom in range(model.ngeom):
        if model.geom_contype[geom]:
            model.geom_friction[geom, 0] *= 0.7


def diagnosed(name, change=None, rows=110, seed=2, **options):
    text, control = CASES[name]
    model = mujoco.MjModel.from_xml_string(text)
    if change is not None:
        change(model)
    recording = linkages.log_of(model, control, rows=rows, seed=seed, name=name)
    return diagnose_engine(recording, Scene.of(text), **options), recording


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "name"),
    [
        (stiffer, "holding"),
        (smoother, "rubbing"),
        pytest.param(stiffer, "rubbing", marks=pytest.mark.slow),
        pytest.param(smoother, "holding", marks=pytest.mark.slow),
    ],
)
def test_a_changed_number_is_named_and_written_back(name, change, tmp_path):
    changed = mujoco.MjModel.from_xml_string(CASES[name][0])
    change(changed)
    other = linkages.log_of(changed, CASES[name][1], rows=60, seed=3, name="other") if change is stiffer else None
    found, recording = diagnosed(name, change, held_out=other)
    assert kind(found) == "cause", verdict(found)
    if name == "rubbing" and change is smoother:  # its shoe touches the rail in the first rows alone
        assert found.shrinkage.gap_closed is found.shrinkage.interval_90 is None
        assert "last third of the rows, in which no more than chance is missing" in found.method["held out"]
    else:
        assert found.method["held out"] == ("the last third of the rows" if other is None else "another recording")
        assert found.shrinkage.gap_closed > 0.9
    (finding,) = found.causes[0].effects
    if change is stiffer:
        assert finding.effect == "tendon_stiffness"
        truth, field = float(np.ravel(changed.tendon_stiffness)[0]), "tendon_stiffness"
    else:
        assert finding.effect == "contact_friction"
        truth, field = float(changed.geom_friction[changed.geom_contype > 0, 0].max()), "geom_friction"
    (number,) = finding.parameters.values()
    assert number.mean == pytest.approx(truth, rel=0.02)
    source, copy = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(CASES[name][0])
    written = write_back(found, source, Scene.of(source), copy, recording)
    off = written.written.rollout["total_rms_rad"]
    assert off["after"] < 0.8 * off["before"]
    own = mujoco.MjModel.from_xml_path(str(copy))
    assert getattr(own, field) == pytest.approx(getattr(changed, field), rel=0.02)
    assert "The corrected file" in render(written)
    members = [
        mujoco.MjModel.from_xml_string(text.decode()) for text, _, _ in copies(found, source, Scene.of(source), 9)
    ]
    moved = np.argmax(np.abs(getattr(own, field) - getattr(Scene.of(source).model, field)))
    drawn = np.array([np.ravel(getattr(each, field))[moved] for each in members])
    assert 0.2 * number.sd < drawn.std() < 5 * number.sd
    assert drawn.mean() == pytest.approx(number.mean, abs=3 * number.sd)
    assert json.loads(json.dumps(written.to_json()))["write_back"]["changes"][0]["effect"] == finding.key


@pytest.mark.long
@pytest.mark.parametrize("name", ["rubbing", pytest.param("holding", marks=pytest.mark.slow)])
def test_no_alarm_where_nothing_was_changed(name, tmp_path):
    found, recording = diagnosed(name)
    assert kind(found) == "none", verdict(found)
    assert not found.gap.detected
    source, copy = tmp_path / "robot.xml", tmp_path / "corrected.xml"
    source.write_text(CASES[name][0])
    assert write_back(found, source, Scene.of(source), copy, recording).written.nothing
    assert not copy.exists()


@pytest.mark.slow
def test_two_numbers_at_once_and_what_the_catalogue_lacks():
    """A stiffer tendon and smoother pads together, in two logs; and a push that no effect is, among few effects."""
    few = {"tendon_stiffness", "contact_friction", "actuator_gain"}
    without = [each.name for each in DIAGNOSE.EFFECTS if each.name not in few]

    def both(model):
        stiffer(model)
        smoother(model)

    text, control = CASES["holding"]
    model = mujoco.MjModel.from_xml_string(text)
    both(model)
    logs = [linkages.log_of(model, control, rows=75, seed=seed, name=f"log {seed}") for seed in (2, 3)]
    found = diagnose_engine(logs, Scene.of(text), most=2, without=without)
    assert found.recording == "log 2 + log 3"
    assert {each.effect for each in found.causes[0].effects} == {"tendon_stiffness", "contact_friction"}
    text, control = CASES["rubbing"]

    def pushed(t):
        return control(t) + np.array([0.1 * (0.6 < t < 0.8) - 0.12 * (1.1 < t < 1.2), 0.0])

    recording = linkages.log_of(mujoco.MjModel.from_xml_string(text), pushed, rows=125, name="pushed")
    torques = recording.torques.copy()
    torques[:, recording.joint_names.index("crank")] = [control(t)[0] for t in recording.time]
    unseen = recording.__class__(**{**vars(recording), "torques": torques})
    strange = diagnose_engine(unseen, Scene.of(text), most=1, without=without)
    assert strange.gap.detected
    assert strange.outside.probability > 0.5, verdict(strange)


@pytest.mark.long
def test_a_weaker_muscle_is_named():
    """Excitations are known, and encoders show the joint."""
    model = mujoco.MjModel.from_xml_string(muscled_arms.TWO)
    model.actuator_gainprm[0, 2] *= 0.8
    model.actuator_biasprm[0, 2] *= 0.8

    def excited(t):
        return np.clip([0.35 + 0.3 * np.sin(5 * t), 0.3 + 0.25 * np.sin(7 * t + 1)], 0, 1)

    recording = linkages.log_of(model, excited, rows=90)
    found = diagnose_engine(recording, Scene.of(muscled_arms.TWO))
    (finding,) = found.causes[0].effects
    assert finding.key == "muscle_strength.flexor", verdict(found)
    assert finding.parameters["factor"].mean == pytest.approx(0.8, abs=0.02)


def test_what_does_not_fit_is_refused():
    text, control = CASES["holding"]
    recording = linkages.log_of(mujoco.MjModel.from_xml_string(text), control, rows=30)
    scene = Scene.of(text)
    fields = vars(recording)
    without = recording.__class__(**{**fields, "torques": None})
    with pytest.raises(InputError, match="expected what was commanded, in columns <actuator>_torque"):
        diagnose_engine(without, scene)
    strange = recording.__class__(**{**fields, "joint_names": ("left", "right", "lift", "grip", "pull")})
    with pytest.raises(InputError, match="'pull' is no joint and no actuator of holding, which has left, right, lift"):
        diagnose_engine(strange, scene)
    gaps = recording.torques.copy()
    gaps[4] = np.nan
    with pytest.raises(InputError, match="grip_torque is missing in some rows"):
        diagnose_engine(recording.__class__(**{**fields, "torques": gaps}), scene)
    with pytest.raises(InputError, match="unknown effect 'payload': known are actuator_gain"):
        diagnose_engine(recording, scene, without=("payload",))
    short = diagnose_engine(recording.at(slice(0, 10)), scene)
    assert short.not_enough_data is not None
    assert "10 rows" in short.not_enough_data


def test_every_refused_recording_is_said():
    scene = Scene.of(linkages.HOLDING)
    time, shown = 0.01 * np.arange(400), 0.01 * np.sin(np.arange(400) * 0.02)[:, None]
    logs = []
    for value in (0.7, -0.8):  # another publisher's rows
        angles = shown.copy()
        angles[::9] = value
        logs.append(Recording(time, np.empty((400, 0, 3)), (), angles=angles, joint_names=("left",)))
    with pytest.warns(UserWarning, match="by --force"):
        said = DIAGNOSE._checked(logs, scene, True, DEFAULT)
    assert all(value in said[DIAGNOSE.REFUSED] for value in ("0.7", "-0.8"))


def test_a_held_out_log_that_the_simulation_cannot_follow_is_another_robots(monkeypatch):
    def runs_away(*_):
        raise Diverged("the simulation runs away")

    monkeypatch.setattr(DIAGNOSE, "filtered_with", runs_away)
    cause = SimpleNamespace(kappa=[1.0], effects=(), values=np.zeros(0))
    log, other = (
        SimpleNamespace(observations=np.zeros((3, 1)), recording=SimpleNamespace(name=name)) for name in ("a", "b")
    )
    with pytest.raises(InputError, match="b: the simulation runs away: it is not held-out data of the same robot"):
        DIAGNOSE._closed(log, cause, cause, 0, other)


@pytest.mark.long
def test_a_leg_that_slips_from_keypoints():
    """Torques of hip and knee are known; the ice, whose friction is .1, is more slippery than the file says."""
    leg = legs.leg_recording("slip", 0, rows=60, noise=5e-4)
    from invdyn.recordings import Recording

    names = ("hip", "knee")
    recording = Recording(
        time=leg.time, keypoints=leg.rows.reshape(60, -1, 2), keypoint_names=legs.SITES, torques=leg.torque,
        joint_names=names, name="slip",
    )  # fmt: skip
    text = leg.text.replace('friction="0.1"', 'friction="0.2"')
    found = diagnose_engine(recording, Scene.of(text, dimensions=2), most=1)
    finding = found.causes[0].effects[0]
    assert finding.key == "contact_friction.floor-foot", verdict(found)
    assert finding.parameters["friction"].mean == pytest.approx(0.1, rel=0.1)

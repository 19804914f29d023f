"""The sentences of a report: what they say of each kind of diagnosis, and what they may not claim."""

from dataclasses import replace

import numpy as np
import pytest
from reported import (
    ambiguous,
    diagnosis,
    empty,
    friction,
    hidden,
    latency,
    none,
    outside,
    seen,
    three,
    two,
)

from invdyn.diagnosis.assessment.closing_measures import Closing
from invdyn.diagnosis.assessment.result import Cause, Estimate, Finding, Part, Shrinkage, Written
from invdyn.diagnosis.regression.regress import Regression
from invdyn.diagnosis.regression.stated_numbers import Stated
from invdyn.diagnosis.regression.torque_closing import TorqueClosing
from invdyn.diagnosis.report import render, words
from invdyn.diagnosis.report.figures import maps
from invdyn.diagnosis.report.file_sentences import written
from invdyn.diagnosis.report.numbers import handy, percent
from invdyn.diagnosis.report.sentences import details, kind, left, verdict, where


@pytest.mark.parametrize(
    ("case", "answer", "says"),
    [
        (
            diagnosis,
            "cause",
            "leaves out viscous friction at the shoulder (97 % probable); adding it closes 96 % of the gap.",
        ),
        (two, "cause", "two effects: viscous friction at the shoulder and a payload on the forearm (81 % probable)"),
        (three, "cause", "three effects: "),
        (none, "none", "No gap: the simulation explains the recording down to its noise (probability of a gap 2 %)."),
        (empty, "not_enough_data", "Not enough data to say whether there is a gap: 3 rows"),
        (
            ambiguous,
            "ambiguous",
            "actuator delay at the shoulder or camera latency, which this recording cannot tell apart (together 95 % ",
        ),
        (
            outside,
            "outside",
            "There is a gap at the shoulder, and no effect in the catalogue explains it (93 % probable).",
        ),
        (hidden, "none", "the joint torques are unknown and could hide one"),
        (seen, "cause", "leaves out a keypoint offset at the wrist (90 % probable)"),
    ],
)
def test_verdict(case, answer, says):
    assert kind(case()) == answer
    sentence = verdict(case()).replace("\u00a0", " ")
    assert says in sentence
    assert sentence.count(". ") == 0


def test_where_something_is_left_what_explains_most_comes_first():
    """How far it closes the gap, how probable it is in part, and the rest in N·m, or that the rest is tolerated."""
    d = replace(outside(), causes=(replace(friction(probability=0.05), in_part=0.9),))
    limits = dict.fromkeys(d.gap.residual_torque_rms, 0.04)
    shrinkage = replace(d.shrinkage, gap_closed=0.97, residual_torque_rms_after=dict.fromkeys(limits, 0.05))
    d = replace(d, gap=replace(d.gap, tolerated_torque=limits), shrinkage=shrinkage)
    most = "There is a gap at the shoulder; most of it is viscous friction at the shoulder (90 % probable): "
    most += "adding it closes 97 % of the gap; "
    assert kind(d) == "outside"
    assert plainly(verdict(d)) == f"{most}no effect in the catalogue explains the rest, 0.050 N·m at the shoulder."
    small = replace(d, shrinkage=replace(shrinkage, residual_torque_rms_after=dict.fromkeys(limits, 0.03)))
    assert plainly(verdict(small)) == f"{most}the rest, 0.030 N·m at the shoulder, is less than is tolerated."
    assert "By force, it went on." in details(replace(d, method={"refused": "By force, it went on"}))
    assert "Of 9 rows 5 were looked at." in details(replace(d, method={"left out": "Of 9 rows 5 were looked at"}))
    stopped = replace(d, not_looked_at=7)
    assert "no effect that the search came to explains the rest" in verdict(stopped)
    assert "The search stopped at the budget; 7 candidates were not looked at (--budget gives more)." in details(
        stopped
    )
    little = replace(d, shrinkage=replace(shrinkage, gap_closed=0.2))
    assert "; a part of it is viscous friction" in verdict(little)


def test_under_a_regressions_verdict_nothing_of_the_search_is_told_as_the_answer():
    """Of the search, what it found and how little that explains: not its numbers, its rest, or its share."""
    before, after, joints = np.array([0.5, 0.2]), np.array([0.2, 0.1]), ("shoulder", "elbow")
    torque = TorqueClosing(before, after, 0.58, (0.3, 0.7))
    dry = Stated("coulomb_friction", joints, True, 90.0, dict.fromkeys(joints, 1.0))
    regression = Regression(joints, (dry,), (), torque, torque, 900, {}, None, (), {}, ())
    less = {"regression": torque, "search": TorqueClosing(before, before, 0.001, (-0.1, 0.1))}
    d = replace(outside(), causes=(replace(friction(probability=0.0), in_part=1.0),), regression=regression)
    d = replace(d, closing=Closing(joints, less, (), "regression"), outside=replace(d.outside, description="u"))
    assert plainly(verdict(d)) == (
        "There is a gap at the shoulder: Coulomb friction at all joints explains 58 % of the missing torque (30 % to "
        "70 % of another motion's); 0.20 N·m at the shoulder and 0.10 N·m at the elbow are left."
    )
    told = [plainly(s) for s in details(d)]
    instead = "The search explains less, and is not the answer: its best, viscous friction at the shoulder, explains "
    assert f"{instead}none of the missing torque." in told
    assert not any(s.startswith(("The share closed", "By regression", "What is left over", "Of viscous")) for s in told)
    every = tuple(f for joint in joints for f in friction(joint).effects)
    most = replace(d, causes=(replace(d.causes[0], effects=(*every, *latency().effects)),))
    assert "its best, viscous friction at all joints and camera latency, explains" in " ".join(details(most))
    shown = [plainly(s) for s in details(replace(d, closing=replace(d.closing, shown="search")))]
    assert not any(s.startswith(instead) for s in shown)
    assert any(s.startswith("By regression alone: ") for s in shown)
    assert any(s.startswith("What is left over") for s in shown)


def test_what_is_the_same_after_as_before_stays():
    d = diagnosis()
    rms = d.gap.residual_torque_rms
    same = replace(d, shrinkage=replace(d.shrinkage, residual_torque_rms_after=rms))
    told = f"left unexplained at the shoulder stays at {handy(rms['shoulder'], 'N·m')}"
    assert any(told in s for s in details(same))
    less = dict(rms, shoulder=rms["shoulder"] - 0.001)
    near = replace(d, shrinkage=replace(d.shrinkage, residual_torque_rms_after=less))
    assert any("changes from 0.310 N·m to 0.309 N·m" in s for s in details(near))


def test_another_unit_of_length_is_told():
    told = "Lengths are in body lengths: read that for m in every unit, of torques, too."
    assert told in details(replace(diagnosis(), length_unit="body length"))
    assert told not in details(diagnosis())
    assert replace(diagnosis(), length_unit="body length").to_json()["length_unit"] == "body length"


def test_what_was_written_is_named_not_counted():
    change = {"place": "elbow", "quantity": "damping", "from": 0.1, "to": 0.2, "interval_90": [0.2, 0.2], "unit": "u"}
    whole = change | {"place": "", "quantity": "gravity"}
    told = written(Written("out.xml", (change, whole), {}))
    assert told == ["The corrected simulation is out.xml: changed is damping of elbow and gravity."]
    assert written(Written("out.xml", (), {})) == [
        "out.xml is a plain copy of the simulation: nothing in it is changed."
    ]


@pytest.mark.parametrize(("after", "told"), [(0.02, True), (0.005, False)])
def test_a_corrected_file_that_is_no_nearer_is_not_recommended(after, told):
    change = {"place": "elbow", "quantity": "damping", "from": 0.1, "to": 0.2, "interval_90": [0.2, 0.2], "unit": "u"}
    off = {"before": 0.01, "after": after}
    tried = {"engine": "MuJoCo", "held_out": True, "window_s": 1.0, "angle_rms_rad": {"elbow": off}}
    tried |= {"total_rms_rad": off}
    sentences = written(Written("out.xml", (change,), {}, rollout=tried))
    assert ("The corrected file is no nearer to the recording: keep the original." in sentences) == told


def test_joints_that_slide_have_units_of_their_own():
    """N for N·m. A replay is off in rad, of those joints that turn; in m where none does."""
    d = diagnosis()
    sliding = replace(d, shifting=d.joint_names)
    assert any(" N·m " in plainly(each) for each in details(d))
    assert any(" N " in plainly(each) for each in details(sliding))
    assert not any("N·m" in each for each in details(replace(sliding, causes=())))
    assert [each["unit"] for each in maps(sliding)] == ["N"] * len(maps(d)) != []
    off = {name: {"before": 0.2, "after": 0.1 / (k + 1)} for k, name in enumerate(("rail", "hinge"))}
    tried = {"engine": "MuJoCo", "held_out": True, "window_s": 1.0, "total_rms_rad": {"before": 0.2, "after": 0.1}}
    for shifting, said in ((("rail",), "angles are off by 2.9°"), (tuple(off), "positions are off by 79 mm")):
        copy = Written("out.xml", (), {}, rollout=tried | {"angle_rms_rad": off})
        assert any(said in plainly(each) for each in written(copy, shifting))


def test_a_gap_that_does_not_matter_is_told_with_its_size():
    d = diagnosis()
    limits = {name: 10 * rms for name, rms in d.gap.residual_torque_rms.items()}
    d = replace(d, gap=replace(d.gap, detected=False, tolerated_torque=limits))
    assert kind(d) == "none"
    assert plainly(verdict(d)).startswith("No gap that matters: what the simulation lacks, ")
    assert "where " in verdict(d)
    assert any(s.startswith("The little that there is looks most like viscous friction") for s in details(d))


def plainly(sentence):
    return sentence.replace("\u00a0", " ")


def test_rivals_are_said_to_change_the_recording_as_much_alike_as_they_do():
    """Only of those of which that is known."""
    d = ambiguous()
    (sentence,) = left(d)
    assert sentence.endswith("all remain probable: this recording cannot tell them apart.")
    keys = d.ambiguity_set[0]
    (sentence,) = left(replace(d, overlaps=((*keys, 0.973), ("payload", "armature.elbow", 0.1))))
    assert "(the changes that they predict are 97\u00a0% correlated)" in sentence


def test_verdict_does_not_claim_what_was_not_reached():
    d = diagnosis(causes=(friction(probability=0.3), latency(0.2)))
    assert "at only 30\u00a0%" in verdict(d)
    assert "closes none of the gap" in verdict(replace(d, shrinkage=replace(d.shrinkage, gap_closed=-0.1)))
    assert "was not measured" in verdict(replace(d, shrinkage=Shrinkage(None, None, False, {})))
    assert kind(replace(d, causes=(Cause((), 0.9, 0.0, 0.1),))) == "unclear"


def test_the_torque_that_is_missing_is_that_of_the_joint_where_the_gap_lies():
    case = diagnosis()
    noisy = replace(case, gap=replace(case.gap, residual_torque_rms={"shoulder": 0.2, "elbow": 0.21}))
    after = {name: handy(value, "N·m") for name, value in case.shrinkage.residual_torque_rms_after.items()}
    said = f"left unexplained at the shoulder changes from {handy(0.2, 'N·m')} to {after['shoulder']}"
    assert said in render(noisy)
    nowhere = replace(noisy, where=replace(noisy.where, joints={}))
    said = f"left unexplained at the elbow changes from {handy(0.21, 'N·m')} to {after['elbow']}"
    assert said in render(nowhere)


def test_what_each_of_several_effects_closes_is_told():
    case = diagnosis()
    parts = {
        "viscous_friction.shoulder": Part(0.91, (0.88, 0.94)),
        "actuator_deadzone.elbow": Part(-0.02, (-0.05, 0.01)),
        "armature.elbow": Part(None, None),
    }
    page = render(replace(case, shrinkage=replace(case.shrinkage, by_effect=parts)))
    friction, deadzone = (words.key_words(name, case) for name in list(parts)[:2])
    told = f"Leaving out {friction} would reopen {percent(0.91)} of the gap and {deadzone} {percent(-0.02)}."
    assert told in page
    assert f"Data held out from the fit do not confirm {deadzone}." in page
    assert f"{percent(-0.02)} ({percent(-0.05)} to {percent(0.01)})" in page
    alone = {"viscous_friction.shoulder": Part(0.91, (0.88, 0.94))}
    for fewer in (render(replace(case, shrinkage=replace(case.shrinkage, by_effect=alone))), render(case)):
        assert "Leaving out" not in fewer
        assert "do not confirm" not in fewer


def test_what_a_replay_is_off_by_stands_beside_the_share():
    d = diagnosis()
    d = replace(d, gap=replace(d.gap, replay_rms_m={"nominal": 0.0634, "corrected": 0.0361}))
    said = plainly(" ".join(details(d)))
    assert "run for 0.5 s on its own, the simulation then errs by 36 mm, not 63 mm." in said
    same = replace(d, gap=replace(d.gap, replay_rms_m={"nominal": 0.0634, "corrected": 0.0634}))
    assert "on its own, the simulation errs by 63 mm." in plainly(" ".join(details(same)))
    assert "on its own" not in " ".join(details(replace(d, tracks=None)))


def test_a_tie_is_told_as_one():
    d = outside()
    d = replace(d, causes=(), where=replace(d.where, joints={"shoulder": 0.499, "elbow": 0.501}))
    assert "There is a gap at the shoulder and the elbow, and no effect" in verdict(d)
    assert "as much at the shoulder and the elbow (50 % each)" in plainly(where(d))
    rms = dict(d.gap.residual_torque_rms, shoulder=0.01, elbow=1.0)
    assert "left unexplained at the elbow" in " ".join(details(replace(d, gap=replace(d.gap, residual_torque_rms=rms))))
    near = replace(d, where=replace(d.where, joints={"shoulder": 0.48, "elbow": 0.52}))
    assert "There is a gap at the elbow, and no effect" in verdict(near)
    assert "mostly at the elbow (52 %)" in plainly(where(near))


@pytest.mark.parametrize(("rest", "told"), [(4 * np.pi, True), (1.2, False)])
def test_a_rest_angle_that_is_cut_is_told_as_cut(rest, told):
    values = {"stiffness": (0.04, "N·m/rad"), "rest_angle": (rest, "rad")}
    found = {name: Estimate(mean, 0.0, (mean, mean), unit) for name, (mean, unit) in values.items()}
    spring = Finding("joint_stiffness", "dynamics", {"joint": "elbow"}, found)
    lines = details(diagnosis(causes=(Cause((spring,), 0.97, 100.0, 0.1),)))
    assert any("may be 720° or more: such a spring is a constant torque" in plainly(line) for line in lines) == told

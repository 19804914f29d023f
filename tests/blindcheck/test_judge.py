"""What a diagnosis is worth, on answers and diagnoses written by hand."""

import math

import pytest
from answers import FOUND, FRICTION, RIGHT, answer, diagnosis, said, true

from invdyn.blindcheck.equivalence import equivalent, exactly_equivalent, in_group, paired, same
from invdyn.blindcheck.judge import FAILED, NONE, OUTSIDE, judge
from invdyn.blindcheck.score import score


def test_a_right_answer():
    v = judge("a", answer(FRICTION), RIGHT)
    assert (v.truth, v.answer) == ("viscous_friction", "viscous_friction")
    assert v.detected
    assert v.exact
    assert v.by_set
    assert v.some
    assert v.side
    assert v.joint
    assert not v.outside
    assert (v.fia, v.probability, v.set_size, v.closed) == (0.8, 0.8, 1, 0.97)
    assert v.covered == {"damping": True}
    assert v.keypoint is None
    assert v.interval is None


def test_another_joint_is_not_exact_and_its_parameters_do_not_count():
    found = diagnosis((0.6, said("viscous_friction", {"damping": (0, 1)}, joint="shoulder")), (0.3, FOUND))
    v = judge("a", answer(FRICTION), found)
    assert not v.exact
    assert not v.by_set
    assert not v.side  # no share at all is no answer
    assert not v.side_by_set
    assert v.fia == pytest.approx(0.3)
    assert v.covered == {}


@pytest.mark.parametrize(
    "groups",
    [
        [["viscous_friction.elbow", "armature.elbow"]],
        [["viscous_friction", "armature"]],
        [["x"], ["coulomb_friction.elbow", "armature.elbow", "viscous_friction.elbow"]],
    ],
)
def test_an_ambiguity_set_that_holds_both_is_right_by_set(groups):
    v = judge("a", answer(FRICTION), diagnosis((0.6, said("armature", joint="elbow")), (0.3, FOUND), groups=groups))
    assert not v.exact
    assert v.by_set
    assert v.set_size == len(groups[-1])


@pytest.mark.parametrize(
    "groups", [[], [["viscous_friction.elbow"], ["armature.elbow"]], [["viscous_friction.shoulder", "armature.elbow"]]]
)
def test_sets_that_do_not_hold_both_are_of_no_help(groups):
    v = judge("a", answer(FRICTION), diagnosis((0.6, said("armature", joint="elbow")), groups=groups))
    assert not v.by_set


def test_no_diagnosis_is_wrong_in_everything():
    v = judge("a", answer(FRICTION), None)
    assert v.failed
    assert v.answer == FAILED
    assert (v.detected, v.exact, v.by_set, v.side, v.joint, v.fia) == (False, False, False, False, False, 0.0)
    assert v.probability is None


@pytest.mark.parametrize("question", ["keypoint", "interval"])
def test_no_diagnosis_is_in_no_place_and_at_no_time(question):
    asked = {
        "keypoint": true("marker_offset", side="observation", keypoint="wrist"),
        "interval": {**true("external_push", link="forearm"), "interval": [1.0, 1.1]},
    }
    v = judge("a", answer(asked[question]), None)
    assert getattr(v, question) is False
    assert [v.joint, v.keypoint, v.interval].count(None) == 2


def test_not_enough_data_is_no_right_answer():
    nothing = diagnosis(outside=math.nan, detected=False, closed=math.nan)
    v = judge("a", answer(FRICTION), nothing)
    assert not v.exact
    assert v.closed is None
    assert not judge("b", answer(kind="outside"), nothing).exact
    assert judge("c", answer(kind="none"), nothing).fia == 0


def test_no_gap():
    v = judge("a", answer(kind="none"), diagnosis((0.97,), (0.03, FOUND), detected=False))
    assert v.truth == v.answer == NONE
    assert v.exact
    assert v.fia == 0.97
    assert v.side is None


def test_a_twin_on_the_other_side_has_the_right_side_by_set():
    late = true("actuator_delay")
    on_camera = diagnosis((0.6, said("camera_latency")), side={"observation": 0.6, "dynamics": 0.4})
    v = judge("a", answer(late), on_camera)
    assert (v.side, v.side_by_set, v.exact, v.by_set) == (False, True, False, True)


@pytest.mark.parametrize("kind", ["outside", "leave_one_out"])
def test_what_the_catalogue_lacks(kind):
    v = judge("a", answer(FRICTION, kind=kind), diagnosis((0.3, FOUND), outside=0.7))
    assert v.truth == v.answer == OUTSIDE
    assert v.exact
    assert v.outside
    assert v.fia == 0.7
    pinned = judge("a", answer(FRICTION, kind=kind), diagnosis((0.7, FOUND), outside=0.3))
    assert not pinned.exact  # even if it carries the right name: it had been struck
    assert not pinned.outside


def test_two_effects():
    payload = true("payload")
    both = answer(FRICTION, payload, kind="two")
    v = judge("a", both, diagnosis((0.6, said("payload", link="link2"), FOUND), (0.4, FOUND)))
    assert v.exact
    assert v.some
    assert v.fia == 0.6
    one = judge("a", both, diagnosis((0.6, FOUND), (0.4, said("payload"), FOUND)))
    assert not one.by_set
    assert one.some
    assert one.fia == 0.4
    swapped = diagnosis(
        (1.0, said("armature", joint="elbow"), said("payload")), groups=[["armature", "viscous_friction"]]
    )
    assert judge("a", both, swapped).by_set
    whole = [["armature.elbow+payload", "payload+viscous_friction.elbow"]]
    assert judge("a", both, diagnosis((1.0, said("armature", joint="elbow"), said("payload")), groups=whole)).by_set
    assert not judge("a", both, diagnosis((1.0, said("armature", joint="elbow"), said("camera_roll")))).some


def test_an_effect_may_act_together_with_one_that_the_catalogue_lacks():
    """One of two is said to be a part of what acts: then the first answer names none, but the report has it."""
    both = answer(FRICTION, true("payload"), kind="two")
    found = diagnosis((0.0, FOUND), (0.0, FOUND, said("camera_roll")), (0.1, said("armature")), outside=0.9)
    for cause, part in zip(found["causes"], (0.3, 0.25, 0.0), strict=True):
        cause["probability_in_part"] = part
    v = judge("a", both, found)
    assert v.at_work
    assert not v.some
    assert v.answer == OUTSIDE
    found["causes"][1]["probability_in_part"] = 0.15
    assert not judge("a", both, found).at_work
    assert judge("a", both, diagnosis((0.6, FOUND), (0.4, said("armature")))).at_work


def test_where_and_when():
    push = true("external_push", keypoint="wrist", interval=[1.0, 1.1])
    at = {"start": 0.95, "end": 1.15, "share": 0.8}
    found = diagnosis((1.0, said("external_push", keypoint="wrist")), side={"dynamics": 1.0}, keypoints={"wrist": 1.0})
    for intervals, right in (([at], True), ([at | {"share": 0.1}, {"start": 2, "end": 3, "share": 0.9}], False),
                             ([{"start": 0, "end": 6, "share": 1}], False), ([], False)):  # fmt: skip
        v = judge("a", answer(push), {**found, "where": {**found["where"], "intervals": intervals}})
        assert v.interval is right
        assert v.keypoint is None  # a force moves the arm; the picture is as it should be
    offset = true("keypoint_offset", side="observation", keypoint="wrist")
    sides = {"dynamics": 0.1, "observation": 0.9}
    v = judge("a", answer(offset), diagnosis((1.0, said("keypoint_offset", keypoint="wrist")), side=sides,
                                             keypoints={"elbow": 0.2, "wrist": 0.8}))  # fmt: skip
    assert v.side
    assert v.keypoint
    assert v.joint is None
    single = judge("a", answer(FRICTION, joints=["elbow"]), RIGHT)
    assert single.joint is None  # with one joint there is nothing to find


def test_parameters_angles_and_pairs():
    values = {"rest_angle": {"value": 3.0, "unit": "rad"}, "stiffness": {"value": 2.0, "unit": "N·m/rad"}}
    spring = true("joint_stiffness", joint="elbow", parameters=values)
    intervals = {"rest_angle": (-3.4, -3.2), "stiffness": (2.1, 2.4), "more": (0, 1)}
    found = said("joint_stiffness", intervals, joint="elbow")
    assert judge("a", answer(spring), diagnosis((1.0, found))).covered == {"rest_angle": True, "stiffness": False}
    pair = true("joint_coupling", joint="elbow", partner="shoulder")
    assert same(pair, said("joint_coupling", joint="shoulder", partner="elbow"))
    assert not same(pair, said("joint_coupling", joint="elbow", partner="wrist"))
    stop = true("joint_limit", joint="elbow", stop="upper", parameters={"side": {"value": 1.0, "unit": "1"}})
    assert same(stop, said("joint_limit", joint="elbow", stop="upper"))
    assert not same(stop, said("joint_limit", joint="elbow", stop="lower"))
    assert same(stop, said("joint_limit", joint="elbow"))
    assert not same(stop, said("joint_limit", joint="shoulder"))
    assert in_group(stop, "joint_limit.elbow.upper")
    assert not in_group(stop, "joint_limit.elbow.lower")
    assert in_group(pair, "joint_coupling.shoulder.elbow")


def test_the_oracle():
    v = judge("a", answer(FRICTION), diagnosis((1.0, FOUND), gain=0.9), diagnosis((1.0, FOUND), gain=1.2))
    assert v.of_oracle == pytest.approx(0.75)
    assert judge("a", answer(FRICTION), RIGHT, diagnosis((1.0, FOUND), gain=0.0)).of_oracle is None


def test_unknown_torque():
    hidden = diagnosis((0.9,), detected=False, hidden=["viscous_friction.elbow", "payload"])
    v = judge("a", answer(FRICTION, kind="unknown_torque", regime="unknown_torque"), hidden)
    assert v.hidden
    assert not judge("a", answer(true("armature", joint="elbow"), kind="unknown_torque"), hidden).hidden


ONE = {"joints": ("shoulder",)}
FLAT = {"gravity": (0, 0)}


@pytest.mark.parametrize(
    ("truth", "found", "given", "same_recordings"),
    [
        (true("gravity_tilt"), said("camera_roll"), {}, True),
        (true("camera_roll"), said("gravity_tilt"), {}, True),
        (true("camera_roll"), said("gravity_tilt"), {"base": (0.1, 0)}, False),
        (true("camera_roll"), said("gravity_tilt"), FLAT, False),
        (true("camera_latency"), said("actuator_delay"), {}, True),
        (true("camera_latency"), said("actuator_delay", joint="elbow"), {}, False),
        (true("actuator_delay", joint="shoulder"), said("camera_latency"), {}, False),
        (true("actuator_delay", joint="shoulder"), said("camera_latency"), ONE, True),
        (true("camera_scale"), said("lens_distortion"), ONE, True),
        (true("camera_scale"), said("lens_distortion"), {}, False),
        (true("armature", joint="shoulder"), said("inertial_error", link="link1"), FLAT, True),
        (true("armature", joint="elbow"), said("inertial_error", link="link2"), FLAT, False),
        (true("armature", joint="shoulder"), said("inertial_error", link="link1"), {}, False),
        (true("armature", joint="shoulder"), said("payload"), FLAT | ONE, True),
        (true("payload"), said("clock_rate"), ONE | {"regime": "passive"}, True),
        (true("payload"), said("clock_rate"), {"regime": "passive"}, False),
        (true("payload"), said("armature", joint="shoulder"), ONE | {"regime": "passive"}, True),
        (true("payload"), said("armature", joint="shoulder"), {"regime": "passive"}, False),
        (true("payload"), said("armature", joint="shoulder"), ONE, False),
        (true("viscous_friction", joint="shoulder"), said("coulomb_friction", joint="shoulder"), ONE, False),
    ],
)
def test_exact_equivalences(truth, found, given, same_recordings):
    assert exactly_equivalent(truth, found, answer(truth, **given)) is same_recordings
    assert equivalent([truth], [found], answer(truth, **given), []) is same_recordings


def test_pairs_are_matched_one_to_one():
    equal = lambda a, b: a == b  # noqa: E731
    assert paired([], [], equal)
    assert not paired([], ["a"], equal)
    assert paired(["a", "b"], ["b", "a"], equal)
    assert not paired(["a", "a"], ["a", "b"], equal)
    assert paired(["a", "c"], ["b", "a", "d"], equal, least=1)
    assert not paired(["a", "a"], ["a", "b"], equal, least=2)


def as_real(shown, stated=(), entries=(), in_part=0.9, rivals=()):
    """A robot's log, whose elbow has a spring; friction and rotors are at both joints."""
    usual = [true(name, joint=joint) for name in ("viscous_friction", "armature") for joint in ("shoulder", "elbow")]
    truth = answer(true("joint_stiffness", joint="elbow"), kind="as_real") | {"everywhere": usual}
    found = diagnosis((0.0, *entries), (0.05,), outside=0.95)
    found["causes"][0]["probability_in_part"] = in_part
    found["closing"] = {"shown": shown, "torque": {"search": {"closed": 0.8}, "regression": {"closed": 0.7}}}
    statements = [{"effect": name, "places": list(places), "rivals": dict(rivals)} for name, *places in stated]
    found["regression"] = {"statements": statements}
    return judge("a", truth, found)


def test_of_a_robots_log_the_answer_that_is_shown_counts_though_it_leaves_something():
    usual = [said("viscous_friction", joint="shoulder"), said("viscous_friction", joint="elbow")]
    v = as_real("search", entries=(*usual, said("armature", joint="elbow"), said("joint_stiffness", joint="elbow")))
    assert (v.named, v.by_set, v.usual, v.invented, v.torque_closed) == ((True,), True, 0.75, 0, 0.8)
    assert v.answer == "joint_stiffness"
    v = as_real("search", entries=(*usual, said("joint_stiffness", joint="shoulder")))
    assert (v.named, v.invented) == ((False,), 1)
    stated = [("viscous_friction", "shoulder", "elbow"), ("joint_stiffness", "elbow"), ("inertial_error", "link1")]
    v = as_real("regression", stated, entries=usual)
    assert (v.named, v.usual, v.invented, v.torque_closed) == ((True,), 0.5, 1, 0.7)


def test_one_of_several_effects_that_a_regression_names_together_is_named_if_that_is_shown():
    stated = [("constant_torque", "elbow")]
    for shown, place, named in (
        ("regression", "elbow", True),
        ("regression", "shoulder", False),
        ("search", "elbow", False),
    ):
        v = as_real(shown, stated, [said("constant_torque", joint="elbow")], rivals={place: ["joint_stiffness"]})
        assert v.named == (named,)


def test_of_a_robots_log_without_a_diagnosis_nothing_is_named():
    v = judge("a", answer(FRICTION, kind="as_real") | {"everywhere": [true("armature", joint="elbow")]}, None)
    assert (v.named, v.usual, v.torque_closed) == ((False,), 0.0, None)
    scores = score({"a": answer(FRICTION, kind="as_real") | {"everywhere": [true("armature", joint="elbow")]}}, {})
    assert scores.measure("as_real", "odd effects named, by set").value == 0.0

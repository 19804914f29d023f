"""What can be judged, and what is said of what cannot."""

import copy
import json

import pytest
from pendulum import DAMPING, FRICTION, PENDULUM, recorded

from invdyn.blindcheck.answer_schema import unreadable
from invdyn.diagnosis import diagnose
from invdyn.models.effects import EFFECTS

GOOD = {
    "gap": {"detected": True, "elpd_per_frame": {"nominal": 1.1, "corrected": None}},
    "where": {"side": {"dynamics": 1}, "intervals": [{"start": 0.1, "end": 0.2, "share": 0.8}]},
    "causes": [
        {"effects": [{"effect": "payload", "parameters": {"mass": {"interval_90": [0.1, None]}}}], "probability": 0.9},
        {"effects": [], "probability": None},
    ],
    "ambiguity_set": [["payload", "armature"]],
    "shrinkage": None,
}


def test_what_we_write_ourselves_can_be_judged():
    found = diagnose(recorded(DAMPING, rows=40), PENDULUM, without=[name for name in EFFECTS if name != FRICTION.name])
    assert found.causes
    assert unreadable(json.loads(json.dumps(found.to_json()))) is None


def test_what_others_write_may_leave_much_out():
    assert unreadable(GOOD) is None
    assert unreadable({"gap": {"detected": False}, "causes": []}) is None


BAD = {
    "nothing": (lambda d: d.clear(), "expected the key 'gap', got none"),
    "no causes": (lambda d: d.pop("causes"), "expected the key 'causes', got 'gap', 'where'"),
    "a gap of null": (lambda d: d.update(gap=None), "gap: expected an object, got None"),
    "detected by a number": (lambda d: d["gap"].update(detected=1), "gap: detected: expected true or false, got 1"),
    "one cause": (lambda d: d.update(causes={}), "causes: expected a list, got {}"),
    "no probability": (lambda d: d["causes"][1].pop("probability"), "causes[1]: expected the key 'probability'"),
    "a probability in words": (lambda d: d["causes"][0].update(probability="high"), "probability: expected a number"),
    "no effect": (lambda d: d["causes"][0]["effects"][0].pop("effect"), "effects[0]: expected the key 'effect'"),
    "an interval without an end": (lambda d: d["where"]["intervals"][0].update(end=None), "end: expected a number"),
    "one group": (lambda d: d.update(ambiguity_set=["payload"]), "ambiguity_set[0]: expected a list, got 'payload'"),
}


@pytest.mark.parametrize(("spoil", "said"), BAD.values(), ids=BAD.keys())
def test_what_is_wrong_is_said_with_its_place(spoil, said):
    found = copy.deepcopy(GOOD)
    spoil(found)
    assert said in unreadable(found)


def test_another_kind_of_json():
    assert unreadable([GOOD]) == f"diagnosis.json: expected an object, got {repr([GOOD])[:40]}…"

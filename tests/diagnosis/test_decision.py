"""The decision rule says of every number what it is, and stands for a while only where another is asked for."""

from dataclasses import FrozenInstanceError, fields

import pytest

from invdyn.diagnosis.decision import RULE, TOLD, Decision, ruled, table
from invdyn.diagnosis.problem.prior import tempered


def test_every_number_has_unit_meaning_and_source():
    """Of a number that may be halved or doubled; and there are few of them."""
    assert len(fields(Decision)) <= 25
    for each in fields(Decision):
        assert all(each.metadata[what] for what in TOLD), each.name
        assert f"| `{each.name}` | " in table()
    assert sum(RULE.number) == pytest.approx(1.0)


def test_the_rule_is_changed_for_a_while_alone():
    with pytest.raises(FrozenInstanceError):
        RULE.alpha = 1.0
    with ruled(alpha=500.0) as rule:
        assert rule is RULE
        assert tempered(500.0) == 0.5
    assert tempered(1000.0) == 0.5
    with pytest.raises(ZeroDivisionError), ruled(alpha=500.0):
        _ = 1 / 0
    assert Decision() == RULE
    with pytest.raises(TypeError, match="has no nonsense"), ruled(nonsense=1.0):
        pass

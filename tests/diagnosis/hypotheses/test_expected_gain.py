"""What a candidate must gain in the screen."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from invdyn.diagnosis.hypotheses.expected_gain import ERRS, TIMES, needed


@given(st.floats(0.0, 1e5), st.floats(0.0, 1e5), st.booleans())
def test_it_is_just_enough_for_what_may_be_gained(wanted, share, explained):
    """By the formula at the top of the file, solved for s."""
    s = needed(wanted, TIMES[explained])
    assert s + max(ERRS, (TIMES[explained] - 1) * s) == pytest.approx(wanted, abs=1e-6)
    assert needed(wanted + share, TIMES[explained]) >= s  # what is to gain more has to show more
    assert needed(wanted, TIMES[True]) >= needed(wanted, TIMES[False])

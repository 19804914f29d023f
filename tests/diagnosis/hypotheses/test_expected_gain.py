"""What a candidate must gain in the screen."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from invdyn.diagnosis.hypotheses.expected_gain import ERRS, RIVAL, UNEXPLAINED, needed


@given(st.floats(0.0, 1e5), st.floats(0.0, 1e5), st.sampled_from([UNEXPLAINED, RIVAL]))
def test_it_is_just_enough_for_what_may_be_gained(wanted, share, times):
    """By the formula at the top of the file, solved for s."""
    s = needed(wanted, times)
    assert s + max(ERRS, (times - 1) * s) == pytest.approx(wanted, abs=1e-6)
    assert needed(wanted + share, times) >= s  # what is to gain more has to show more
    assert needed(wanted, RIVAL) >= needed(wanted, UNEXPLAINED)

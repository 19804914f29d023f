"""What a candidate must gain in the screen."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from invdyn.diagnosis.hypotheses.pool import needed
from invdyn.diagnosis.rules import DEFAULT


@given(st.floats(0.0, 1e5), st.floats(0.0, 1e5), st.booleans())
def test_it_is_just_enough_for_what_may_be_gained(wanted, more, explained):
    """By the formula at the top of the file, solved for s."""
    limits = DEFAULT.search
    times = limits.rival_factor if explained else limits.unexplained_factor
    s = needed(wanted, explained=explained)
    assert s + max(limits.large_screen_error, (times - 1) * s) == pytest.approx(wanted, abs=1e-6)
    assert needed(wanted + more, explained=explained) >= s  # to gain more, a candidate has to show more
    assert needed(wanted, explained=True) >= needed(wanted, explained=False)

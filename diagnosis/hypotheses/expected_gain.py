"""How far a refinement may get beyond what the screen says, and so which candidates are worth one.

The screen is linear along one path; a refinement costs some twenty times as much. With s nats that a candidate gains
over its base in the screen, and r that its refinement gains, `python benchmarks/expected_gain.py` measures r − s and
r/s on development cases. Nineteen in twenty (99 in 100) stay under

    r − s      3 (6) nats      beside a base that leaves nothing, of s up to 5
               41 (430) nats   elsewhere, of s up to 60
    r/s        3 (3)           of s between 60 and 1000

Errors are largest where no candidate has explained the gap yet. So what a refinement may gain at most is taken to be

    s + max(ERRS, (times − 1) s),

with so many ``times`` as are stated below.
"""

DOUBT = 5.0
"""Nats by which the screen errs where there is little to gain."""

ERRS = 60.0
"""Nats by which it errs, at least, where there is much."""

UNEXPLAINED, RIVAL = 10.0, 2.0
"""Times as much as it says: where every cause leaves something; and of a rival of what is known, which shows half."""


def needed(wanted: float, times: float) -> float:
    """Nats that a candidate must gain in the screen, for its refinement may gain ERRS more, or so many ``times``."""
    return min(wanted - ERRS, wanted / times)

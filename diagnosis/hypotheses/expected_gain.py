"""How far a refinement may get beyond what the screen says, and so which candidates are worth one.

The screen is linear along one path; a refinement costs some twenty times as much. With s nats that a candidate gains
over its base in the screen, and r that its refinement gains, `python benchmarks/expected_gain.py` measures r − s and
r/s on development cases. Nineteen in twenty (99 in 100) stay under

    r − s      3 (6) nats      with a base that leaves nothing, of s up to 5
               41 (430) nats   elsewhere, of s up to 60
    r/s        3 (3)           of s between 60 and 1000

Errors are largest where no candidate has explained the gap yet. So what a refinement may gain at most is taken to be

    s + max(large_screen_error, (times − 1) s)

with unexplained_factor or rival_factor ``times`` (:mod:`invdyn.diagnosis.rules`).
"""

from invdyn.diagnosis.rules import DEFAULT, Rules


def needed(wanted: float, *, explained: bool, rules: Rules = DEFAULT) -> float:
    """Nats that a candidate must gain in the screen so that its refinement may gain what is ``wanted``.

    Whether another cause explains the gap already decides how many times as much it may gain.
    """
    times = rules.search.rival_factor if explained else rules.search.unexplained_factor
    return min(wanted - rules.search.large_screen_error, wanted / times)

"""When a burst came: moment and duration of a push sought anew along the path that it was refined to.

Evidence is as narrow a function of the moment as the arm's answer is sharp, and Gauss–Newton ends in the nearest of
its peaks. Along the path that it has found, an impulse at each of a few moments and durations about its own is one
regression (:mod:`.screen`); from the best of them it is refined again, while that gains.
"""

from itertools import product

import numpy as np

from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.unknowns import unknowns
from invdyn.diagnosis.sensitivity.screen import added, screen
from invdyn.models.effects.base import Effect

SHIFTS = (-1.5, -1.0, -0.5, -0.25, 0.0, 0.25, 0.5, 1.0, 1.5)
STRETCHES = (0.4, 0.63, 1.0, 1.6)
"""Of its duration, or of ``SHORT`` seconds at least: shifts of the moment, and other durations."""
SHORT = 0.03
TIMES, GAIN = 5, 1.0
"""How often it is moved at most, and the nats that a move must gain."""


def relocated(
    problem: DiagnosisProblem, base: FittedHypothesis, effect: Effect, cause: FittedHypothesis
) -> FittedHypothesis:
    """``cause``, which is ``base`` and an effect that acts for a while, moved in time while that is better."""
    common = unknowns(problem, base.effects)
    names = {name: f"{effect.key}.{name}" for name in ("moment", "duration")}
    first, last = problem.model.time[[0, -1]].tolist()
    for _ in range(TIMES):
        known = cause.values
        moment, duration = (known[name] for name in names.values())
        duration = max(duration, SHORT)
        middles = [(moment + a * duration, s * duration / 2) for a, s in product(SHIFTS, STRETCHES)]
        times = [(m - half, m + half) for m, half in middles if first < m < last]
        point = np.array([known[name] for name in common.names])
        model = common.set_in(base.model, point)
        best = screen(problem, model, cause.path, [effect], common, point, times=times)
        (likely,) = added(best)
        values = likely.values
        start = known | {f"{effect.key}.{name}": value for name, value in values.items()}
        size = float(likely.size)
        other = refine(problem, cause.effects, start, cause.path, size, **base.searched)
        if other.log_evidence < cause.log_evidence + GAIN:
            return cause
        cause = other
    return cause

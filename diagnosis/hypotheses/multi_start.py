"""An effect that no screen tells the size of, refined from the best of several values.

Columns are slopes, and say little where an effect of a usual size is far from a small one (``Effect.scan`` gives the
values to begin with). From each of them, and all combinations of several parameters', the cause is expanded once on a
path of its own, led there; the best is refined.
"""

from itertools import product

import torch
from torch import Tensor

from invdyn.diagnosis.hypotheses.continuation import FIRM, led, lifted
from invdyn.diagnosis.hypotheses.refine import ROUNDS, refine
from invdyn.diagnosis.hypotheses.shortlist import SHARE
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.models.effects.base import Effect


def scan(problem: DiagnosisProblem, base: FittedHypothesis, effect: Effect, enough: float) -> FittedHypothesis:
    """Refine an effect from the best of its starting values, each on a path of its own, if that has ``enough`` nats."""
    effects = (*base.effects, effect)
    model = problem.model.with_effects(*effects)

    def refined(values: dict[str, float], path: Tensor, rounds: int) -> FittedHypothesis:
        known = {name: torch.tensor([v], dtype=torch.float64) for name, v in values.items()}
        there = model.replace(**{f"effect.{k}": v for k, v in known.items() if f"effect.{k}" in model.parameters})
        path = led(problem, there, lifted(model, path), FIRM)
        return refine(problem, effects, values, path, FIRM, rounds=rounds, **base.searched)

    tried = []
    for point in product(*effect.scan.values()):
        values = base.values | {f"{effect.key}.{name}": v for name, v in zip(effect.scan, point, strict=True)}
        tried.append(refined(values, base.path, 1))
    best = max(tried, key=lambda cause: cause.log_evidence)
    most = max(base.log_evidence, base.log_evidence + (1 - SHARE) * (enough - base.log_evidence))
    return best if best.log_evidence < most else refined(best.values, best.path, ROUNDS)

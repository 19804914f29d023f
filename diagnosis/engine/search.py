"""Which causes of a gap are looked at on MuJoCo's engine: a pool as any search has (:mod:`..hypotheses.pool`).

All candidates are screened; the best are refined, until none that is left promises as much as the best one gained.
While the best cause leaves something, effects are added to it in the same way.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from invdyn.diagnosis.assessment.model_posterior import share_of_small_residuals
from invdyn.diagnosis.catalogue.engine_effects import Candidate
from invdyn.diagnosis.engine.causes import Cause, Screened, refined, screened
from invdyn.diagnosis.engine.problem import EngineLog
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.models.divergence import Diverged


def search(log: EngineLog, candidates: Sequence[Candidate], most: int) -> HypothesisPool:
    """Causes of at ``most`` so many effects; raises Diverged where the simulation itself runs away from the log."""
    none = refined(log, (), np.zeros(0))
    rules, path = log.rules.search, torch.as_tensor(none.filtered.mean[none.likely])
    first = screened(log, none, candidates) if candidates else []

    # What ranks causes asks of a problem its rules and regime alone, and of a candidate its name.
    parts: Any = (log, candidates, {"": none}, first, path, False)
    found = HypothesisPool(*parts)
    _refine(log, found, none, first, rules.max_candidates_alone)
    for count in range(1, most):
        best: Any = max(found.pool.values(), key=lambda each: each.log_evidence)
        if len(best.effects) != count or share_of_small_residuals(log, found, best) > 0:
            break
        others = [each for each in candidates if each.key not in {own.key for own in best.effects}]
        if others:
            _refine(log, found, best, screened(log, best, others), rules.max_candidates_added)
    return found


def _refine(log: EngineLog, found: HypothesisPool, base: Cause, ranked: Sequence[Screened], most: int) -> None:
    """Refine the best of what was screened next to a cause, and add them to the pool."""
    rules, gained = log.rules.search, 0.0
    for number, each in enumerate(ranked[:most]):
        promised = each.log_evidence - base.log_evidence
        if promised < -log.rules.evidence.confirm_within and number >= rules.batch_size:
            break
        if rules.rival_factor * max(promised, 0.0) + rules.large_screen_error < gained:
            break
        try:
            cause = refined(log, (*base.effects, each.effect), np.concatenate([base.values, each.values]))
        except Diverged:
            continue
        found.pool[cause.key] = cause  # type: ignore[assignment]  # it is scored as any other
        gained = max(gained, cause.log_evidence - base.log_evidence)

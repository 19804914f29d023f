"""The pool of causes of a search: which effects are considered, what was refined, and how it ranks."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from math import log

import numpy as np
from torch import Tensor

from invdyn.diagnosis.catalogue import CatalogueEntry
from invdyn.diagnosis.problem.cause import FittedHypothesis, Scored
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_outlier
from invdyn.diagnosis.problem.prior import another, log_prior_of, statements, tempered
from invdyn.diagnosis.problem.regime import Regime
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.diagnosis.sensitivity.screen import Screened
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.models.effects.base import Effect


@dataclass
class HypothesisPool:
    """The pool of causes that were refined, and what the first screen said of all.

    Attributes:
        problem: that the causes are of.
        candidates: all effects at all places that were considered.
        pool: refined causes by key.
        first: the screen of every single effect, with outliers if there are any.
        path: (T, D) of the data, for any cause.
        simulation_path: (T, D) of the simulation alone; None where its torques are unknown.
        workers: processes that may work side by side.
        followed: log evidence by key of causes that were followed to a neighbour of that key (:mod:`.swap`).
        has_outliers: whether some detections are far from it.
        missed: candidates that the budget had nothing left for.
        everywhere: names of effects that a regression states at every place; each counts once.
    """

    problem: DiagnosisProblem
    candidates: list[Effect]
    pool: dict[str, FittedHypothesis]
    first: list[Screened]
    path: Tensor
    has_outliers: bool
    simulation_path: Tensor | None = None
    workers: int = 1
    followed: dict[str, float] = field(default_factory=dict)
    missed: int = 0
    everywhere: frozenset[str] = frozenset()

    @property
    def rules(self) -> Rules:
        """The problem's."""
        return self.problem.rules

    @property
    def top(self) -> float:
        """The highest log evidence of all."""
        return max(cause.log_evidence for cause in self.pool.values())

    @property
    def temper(self) -> float:
        """Power to which evidence is raised besides outliers', or where there are none; see :func:`tempered`."""
        return tempered(self.top - self.cleaned, self.rules.evidence.temper_scale)

    def temper_within(self, effect: Effect | None = None) -> float:
        """Power for intervals of an effect's parameters, or the body's: all gain counts for outliers."""
        base = self.pool[""].log_evidence if effect is not None and is_outlier(effect) else self.cleaned
        return tempered(self.top - base, self.rules.evidence.temper_scale_within)

    def score(self, cause: FittedHypothesis) -> float:
        """Log posterior but for a constant.

        Outliers gain thousands of nats: a more probable cause is measured from there. A cause that leaves something
        beyond chance stands for a set with another effect, which has its prior.
        """
        none, temper = self.pool[""].log_evidence, self.temper
        clean = min(cause.log_evidence, self.cleaned)
        outliers = tempered(self.top - none, self.rules.evidence.temper_scale) * (clean - none)
        beyond = cause.log_evidence_at(temper) - temper * clean
        rest = log(another(self.count(cause), self.rules)) if self.leaves(cause) else 0.0
        return outliers + beyond + self.log_prior(cause.effects) + rest

    def leaves(self, cause: Scored) -> bool:
        """Whether a residual gains evidence beyond chance with a cause."""
        return leaves(cause, self.pool[""], self.problem.regime, self.rules)

    def log_prior(self, effects: Sequence[Effect]) -> float:
        """Log prior probability of a cause of these effects."""
        return log_prior_of(effects, self.candidates, self.rules, self.everywhere)

    def count(self, cause: FittedHypothesis) -> int:
        """How many effects a cause states."""
        return statements(cause.effects, self.everywhere)

    @property
    def cleaned(self) -> float:
        """The highest evidence of causes of outliers alone; of none, if there are none."""
        return max(c.log_evidence for c in self.pool.values() if all(is_outlier(e) for e in c.effects))

    @property
    def ranked(self) -> list[FittedHypothesis]:
        """The pool, best first, without sets that a part of them beats."""
        parts = {key: frozenset(e.key for e in cause.effects) for key, cause in self.pool.items()}
        scores = {key: self.score(cause) for key, cause in self.pool.items()}
        kept = [key for key, own in parts.items() if all(scores[key] > scores[o] for o in parts if parts[o] < own)]
        return [self.pool[key] for key in sorted(kept, key=lambda key: (-scores[key], key))]

    @property
    def best(self) -> FittedHypothesis:
        """The first of :attr:`ranked`."""
        return self.ranked[0]

    @property
    def explained(self) -> bool:
        """Whether the best cause has an effect and leaves nothing."""
        return self.best.complete and bool(self.best.effects)

    def add(self, cause: FittedHypothesis | None) -> None:
        """Keep a cause, or the better of two versions of it; not one that needs parameters beyond what is plausible."""
        if cause is None or not cause.plausible:
            return
        known = self.pool.get(cause.key)
        if known is None or cause.log_evidence > known.log_evidence:
            self.pool[cause.key] = cause

    def add_all(self, parts: Sequence[Callable[[], Sequence[FittedHypothesis | None]]]) -> None:
        """Keep what each of the ``parts`` finds, side by side; they know nothing of each other."""
        for causes in side_by_side(parts, self.workers, self.problem.budget):
            for cause in causes:
                self.add(cause)


def others(cause: FittedHypothesis) -> list[Effect]:
    """A cause's effects but those that make outliers."""
    return [effect for effect in cause.effects if not is_outlier(effect)]


def leaves(cause: Scored, none: Scored, regime: Regime, rules: Rules = DEFAULT) -> bool:
    """Whether a residual gains more evidence with a cause than chance, and than a share² of that with ``none``.

    A limb's own torque is always left, and no cause by itself leaves what no cause explains.
    """
    if not cause.effects or not regime.knows_torque:
        return False
    prior = regime.log_prior
    left, gap = (float(np.max(each.by_size - prior) - (each.by_size - prior)[0]) for each in (cause, none))
    return left > rules.residual.min_residual_gain + rules.residual.max_share_left**2 * gap


def considered(problem: DiagnosisProblem, without: Sequence[str] = ()) -> list[Effect]:
    """Every effect of the catalogue at every place at which it can act in this regime, bound."""
    body = problem.model.body
    observation, commanded = problem.model.observation, problem.regime.commanded
    tracked = list(observation.tracked_names)
    servos = {k for k, own in enumerate(body.joint_parts) if own.servo is not None}
    # a servo follows an encoder that no log may have
    read = {"any": True, "keypoints": bool(tracked), "encoders": observation.encoders is not None or bool(servos)}
    confident = bool(observation.data())

    def shows(entry: CatalogueEntry, effect: Effect) -> bool:
        torque = commanded and not servos & set(effect.place or servos)
        given = {"": True, "command": commanded, "torque": torque, "confidence": confident}
        return given[entry.need_of(effect)] and (not effect.sensor or read[effect.sensor])

    every = problem.catalogue.without(without).everywhere(body, tracked)
    return [effect for entry, effect in every if shows(entry, effect)]


def needed(wanted: float, *, explained: bool, rules: Rules = DEFAULT) -> float:
    """Nats that a candidate must gain in the screen so that its refinement may gain what is ``wanted``.

    The screen is linear along one path; a refinement costs some twenty times as much. With s nats that a candidate
    gains over its base in the screen, and r that its refinement gains, `python benchmarks/expected_gain.py` measures r
    − s and r/s on development cases. Nineteen in twenty (99 in 100) stay under::

        r − s      3 (6) nats      with a base that leaves nothing, of s up to 5
                   41 (430) nats   elsewhere, of s up to 60
        r/s        3 (3)           of s between 60 and 1000

    Errors are largest where no candidate has explained the gap yet. So what a refinement may gain at most is taken to
    be

        s + max(large_screen_error, (times − 1) s)

    with unexplained_factor or rival_factor ``times`` (:mod:`invdyn.diagnosis.rules`).

    Whether another cause explains the gap already (``explained``) sets how many times as much it may gain.
    """
    times = rules.search.rival_factor if explained else rules.search.unexplained_factor
    return min(wanted - rules.search.large_screen_error, wanted / times)

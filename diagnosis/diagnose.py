"""Diagnose the gap between simulation and recording: measure, locate, screen, confirm, add the cause, measure again.

Its stages are the packages next to this file. ``problem`` binds the recording (:mod:`.diagnosis_problem`).
``sensitivity`` says of every effect what it would change. ``hypotheses`` looks for causes by linearised evidence
(:mod:`.search`). ``assessment`` turns evidence into probabilities (:mod:`.model_posterior`), the best confirmed by SMC
(:mod:`.confirm`). It measures how far the gap closes on withheld data (:mod:`.gap_closure`). What no cause explains
becomes a formula (:mod:`.symbolic_regression`) with a place (:mod:`.localisation`). :mod:`.assemble` puts all together.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

from invdyn.diagnosis.assessment.assemble import assembled, nothing_to_say
from invdyn.diagnosis.assessment.closing_measures import REGRESSION, measured
from invdyn.diagnosis.assessment.findings import key
from invdyn.diagnosis.assessment.gap_closure import Closed, Unseen, all_confirmed, by_effect, closed, unseen
from invdyn.diagnosis.assessment.model_posterior import Weighed, in_part_only, only, weigh
from invdyn.diagnosis.assessment.power import too_little
from invdyn.diagnosis.assessment.regression_alone import by_regression_alone
from invdyn.diagnosis.assessment.regression_cause import regression_cause
from invdyn.diagnosis.assessment.result import LEFT_OUT, REFUSED, Diagnosis, plain
from invdyn.diagnosis.assessment.symbolic_regression import Formula, describe
from invdyn.diagnosis.budget import Budget, attempt
from invdyn.diagnosis.catalogue import CATALOGUE, Catalogue, CatalogueEntry
from invdyn.diagnosis.check.before import check_before
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.laws import finely_stepped, heavy_tailed, search_either
from invdyn.diagnosis.hypotheses.pool import HypothesisPool
from invdyn.diagnosis.hypotheses.regression_start import Start, start_of
from invdyn.diagnosis.hypotheses.search import NOTHING, search
from invdyn.diagnosis.kept_units import content_digest
from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem, NotEnoughData, cannot_follow, diagnosis_problem
from invdyn.diagnosis.problem.stretches import left_out
from invdyn.diagnosis.regression.regress import Regression, regress
from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.models import ArticulatedBody
from invdyn.models.divergence import Diverged, diverging
from invdyn.models.effects.base import Effect
from invdyn.recordings import InputError, Recording, joined, write_text

Progress = Callable[[int, int, str], None]
"""Called with (stages done, stages, what comes next)."""


def diagnose(
    recording: Recording | Sequence[Recording],
    body: ArticulatedBody,
    *,
    held_out: Recording | Sequence[Recording] | None = None,
    passive: bool = False,
    effects: Mapping[str, CatalogueEntry | type[Effect]] = CATALOGUE,
    without: Sequence[str] = (),
    most: int | None = None,
    seed: int = 0,
    workers: int = 1,
    budget: float | None = None,
    tolerance: float | None = None,
    robot: bool = False,
    rules: Rules = DEFAULT,
    checked: bool = False,
    force: bool = False,
    refused: Sequence[str] = (),
    progress: Progress | None = None,
    checkpoint: str | Path | None = None,
    interim: Callable[[Regression], None] | None = None,
) -> Diagnosis:
    """Diagnose the gap.

    Args:
        recording: keypoints, encoders or both, with the commanded torques. Without ``torques`` these are unknown.
            Several recordings of one arm are diagnosed together, with the same causes.
        body: the simulation.
        held_out: other recordings of the same arm, on which the closing of the gap is measured; by default the last
            third of ``recording``.
        passive: the torque is known to be zero.
        effects: the catalogue of effects to look for, by name, in which a class stands for an entry without words and
            relatives: ``CATALOGUE | {"belt": BeltDrag}`` has one of your own.
        without: names of effects to leave out of the catalogue, and of the regression.
        most: effects at once, at most; by default `rules.search.max_effects`. More take longer, and may imitate what
            the catalogue lacks.
        seed: same seed, same result, for any number of workers.
        workers: processes that may run in parallel; this one is one of them.
        budget: seconds after which no more candidate is started, three quarters of them for the search; the fit without
            any effect and what is said of the causes come on top. The result then depends on the machine. By default
            the search counts its work instead (:mod:`.budget`), and the result does not. Where a search cannot come to
            its first screen, the answer is the regression's (:mod:`.regression_alone`).
        tolerance: share of a joint's typical torque under which a gap does not matter (:mod:`.matters`),
            nor does what a cause leaves; by default `rules.evidence.tolerance`, of a ``robot`` its `robot_tolerance`.
        robot: the recording is a real robot's, of which something is always left, and which lacks effects at all
            joints: the search starts from what a regression states of all of them.
        rules: the numbers that the diagnosis follows: `Rules().replace(temper_scale=500)`.
        checked: :func:`.check_before` was called for each recording. Else it is called here: it refuses what is
            certainly a mistake in the recording, and warns of what may be one.
        force: go on where a mistake in the recording is sure: it is warned of, and the result says it.
        refused: what :func:`.check_before` said by force, where it was called before.
        progress: called with (done, total, what).
        checkpoint: folder of this diagnosis, made when missing: what is screened, refined and confirmed is kept there
            (:mod:`.kept_units`), so that the same call continues where it was killed, with any number of workers. With
            a ``budget`` in seconds, what is kept takes none of them.
        interim: called with what a regression says (:mod:`.regress`), a second after the start, and minutes before the
            search ends; not where torques are unknown. A ``checkpoint`` has it as regression.json.

    Raises:
        InputError: the recording does not fit the body, or has a mistake that is certain; the withheld one does not fit
            the recording, or has too few rows; the simulation diverges from the recording with any added torque;
            ``most`` or ``budget`` is not positive, ``tolerance`` is no share, or ``without`` names no effect; the
            checkpoint is another diagnosis', or broken.

    Too few rows of the recording itself are an answer and no error (:attr:`.Diagnosis.not_enough_data`). So are rows in
    which a large torque could be missing and not show (:mod:`.power`).
    """
    report = _Stages(progress)
    rules = _stated(rules, effects, without, most, tolerance, robot, budget)
    report(0, "bind")
    keeper = None
    if checkpoint is not None:
        own = {"effects": sorted(effects), "passive": passive, "without": list(without), "seed": seed, "budget": budget}
        keeper = _kept(checkpoint, recording, held_out, body, rules, own)
    if not checked:
        for each in (*_each(recording), *_each(held_out or ())):
            refused = (*refused, *check_before(each, body, passive, force, rules))
    bind = partial(diagnosis_problem, body=body, passive=passive, force=force, rules=rules)
    try:
        bound = bind(recording)
    except NotEnoughData as error:
        whole, _ = joined(_each(recording))
        return nothing_to_say(whole, body, seed, passive, str(error), rules)
    effort = rules.search.passes_per_row * max(len(bound.observations), rules.search.min_budget_rows)
    counted, seconds = (effort, math.inf) if budget is None else (math.inf, budget)
    shared: dict[str, Any] = {
        "budget": Budget(counted, seconds, on_progress=None if progress is None else report.trying),
        "checkpoint": keeper,
        "catalogue": effects if isinstance(effects, Catalogue) else Catalogue(effects),
    }
    bound = replace(bound, **shared)
    other = None if held_out is None else replace(bind(held_out), **shared)
    _check_regimes(bound, other)
    excluded = set(CATALOGUE).difference(bound.catalogue.without(without))
    said = regress(recording, body, passive=passive, rules=rules, held_out=held_out, without=excluded)
    if said is not None and checkpoint is not None:
        write_text(Path(checkpoint) / "regression.json", json.dumps(plain(said.to_json()), indent=1) + "\n")
    if said is not None and interim is not None:
        interim(said)
    run = _Run(bound, other, body, said, passive, robot, seed, workers, tuple(without), report)
    result = None if said is None else by_regression_alone(said, bound, run.without, seed, passive, robot)
    if result is None:
        result = _by_search(run)
    report(5, "done")
    return replace(result, method=result.method | _notes(recording, refused, rules))


class _Stages:
    """Passes on the progress: a stage by its number, and within it what is tried."""

    def __init__(self, progress: Progress | None) -> None:
        self._progress, self._stage = progress, (0, "")

    def __call__(self, done: int, what: str) -> None:
        self._stage = done, what
        if self._progress is not None:
            self._progress(done, 5, what)

    def trying(self, what: str) -> None:
        done, name = self._stage
        if self._progress is not None:
            self._progress(done, 5, f"{name}; {what}")


@dataclass(frozen=True)
class _Run:
    """What the stages share: the recording, the held-out one, what a regression says, and how to search."""

    bound: DiagnosisProblem
    other: DiagnosisProblem | None
    body: ArticulatedBody
    said: Regression | None
    passive: bool
    robot: bool
    seed: int
    workers: int
    without: tuple[str, ...]
    report: _Stages


def _stated(
    rules: Rules,
    effects: Mapping[str, Any],
    without: Sequence[str],
    most: int | None,
    tolerance: float | None,
    robot: bool,
    budget: float | None,
) -> Rules:
    """The rules, with the numbers that the arguments give; InputError for arguments that make no sense."""
    if isinstance(without, str):
        raise InputError(f"without: expected names of effects, such as ['payload'], got the text {without!r}")
    for name in without:
        if name not in effects:
            raise InputError(f"unknown effect {name!r}: known are {', '.join(effects)}")
    if tolerance is None and robot:
        tolerance = rules.evidence.robot_tolerance
    given = {"max_effects": most, "tolerance": tolerance}
    rules = rules.replace(**{name: value for name, value in given.items() if value is not None})
    most, tolerance = rules.search.max_effects, rules.evidence.tolerance
    if most < 1:
        usual = DEFAULT.search.max_effects
        raise InputError(f"expected one effect at once or more, got at most {most}: leave most out for {usual}")
    if not 0 <= tolerance < 1:
        raise InputError(f"expected a tolerance from 0 to 1, a share of a typical torque, got {tolerance:g}")
    if budget is not None and not budget > 0:
        raise InputError(f"expected a budget of some seconds, got {budget:g}: leave it out for the usual one")
    return rules


def _kept(
    checkpoint: str | Path,
    recording: Recording | Sequence[Recording],
    held_out: Recording | Sequence[Recording] | None,
    body: ArticulatedBody,
    rules: Rules,
    own: Mapping[str, Any],
) -> Checkpoint:
    """The checkpoint of this diagnosis, made where it is missing; InputError for another diagnosis'."""
    run = {
        "version": version("invdyn"),
        "recording": content_digest(_each(recording)),
        "held_out": content_digest(_each(held_out or ())),
        "body": repr(body),
        **own,
        **{"most": rules.search.max_effects, "tolerance": rules.evidence.tolerance, "rules": content_digest(rules)},
    }
    keeper = Checkpoint(checkpoint, run, "diagnosis")
    if keeper.load() is None:  # raises for another diagnosis'
        keeper.save({})
    return keeper


def _check_regimes(bound: DiagnosisProblem, other: DiagnosisProblem | None) -> None:
    """Raise InputError where the torques of one recording are known and those of the other are not."""
    if other is None or other.regime == bound.regime:
        return
    raise InputError(
        f"{other.problem.recording.name}: expected a held-out recording with torques "
        f"{'in it' if bound.regime.knows_torque else 'that are unknown'}, as {bound.problem.recording.name} "
        f"has, got {other.regime.phrase}: give both with torques, or hide those of both: --set hide_torque=yes"
    )


def _notes(recording: Recording | Sequence[Recording], refused: Sequence[str], rules: Rules) -> dict[str, Any]:
    """What was not looked at of the recording, and what it is refused for."""
    notes: dict[str, Any] = {}
    if (unused := left_out(_each(recording), rules)) is not None:
        notes[LEFT_OUT] = unused
    if refused:
        words = "; ".join(refused)
        notes[REFUSED] = f"By force, the diagnosis went on with a recording that is refused: {words}"
    return notes


def _by_search(run: _Run) -> Diagnosis:
    """Search, confirm what is found, measure it on held-out rows, and describe it."""
    run.report(1, "screen and refine")
    start = start_of(run.said if run.robot else None, run.bound)
    found = searched(run.bound, run.without, run.workers, start)
    bound, other, said = found.problem, run.other, run.said
    if (reason := too_little(bound, found)) is not None:
        return nothing_to_say(bound.problem.recording, run.body, run.seed, run.passive, reason, bound.rules)
    if other is not None:
        other = other.in_engine_steps() if bound.engine_step else other
        other = replace(other, shape=bound.shape).in_substeps(max(other.model.substeps, bound.model.substeps))
    run = replace(run, bound=bound, other=other)
    weighed, shares, there = _confirmed(run, found)
    best = weighed.best
    if found.everywhere:
        parts = {}  # what is usual was not added effect by effect
    elif len(best.effects) > 1:
        parts = by_effect(bound, found, best, there, other, run.seed)
        if not all_confirmed(best, parts, bound.rules):
            weighed = in_part_only(weighed)
    else:
        parts = {key(effect): shares for effect in best.effects}
    run.report(4, "describe")
    formula = describe(bound, best, best.path) if weighed.outside > 0.2 and bound.regime.knows_torque else None
    follows = _followed(bound, found.pool[""], best, formula)
    rows = "the last third of the rows" if other is None else "another recording"
    rows += ", in which the best cause leaves something" if there.leaves else ""
    complete = weighed.causes[best.key][1] > 0.5
    closing = None if said is None else measured(said, run.body, run.passive, there.cause, complete)
    result = assembled(bound, found, weighed, shares, there.fresh, parts, formula, follows, run.seed, rows)
    result = replace(result, regression=said, closing=closing)
    if run.robot and said is not None and closing is not None and closing.shown == REGRESSION:
        result = replace(result, regressed=regression_cause(said, bound, run.passive))
    return result


def _confirmed(run: _Run, found: HypothesisPool) -> tuple[Weighed, Closed, Unseen]:
    """Probabilities of causes, the share of the gap that the best closes on held-out rows, and its fit there."""
    bound, other = run.bound, run.other
    bound.budget.share = 1.0
    run.report(2, "confirm")
    none, time = found.pool[""], (other or bound).model.time.numpy()

    def tested(cause: FittedHypothesis) -> tuple[Closed, Unseen]:
        there = unseen(bound, none, cause, other)
        return closed(*there.scores, there.rows, time, run.seed, rules=bound.rules), there

    likely = found.best
    # What is likely may fail there, and not be the best.
    both: list[Callable[[], Any]] = [partial(weigh, bound, found, run.seed), partial(attempt, tested, likely)]
    weighed, known = side_by_side(both, run.workers, bound.budget)
    run.report(3, "held out")
    shares, there = tested(weighed.best) if known is None or weighed.best is not likely else known
    there = replace(there, problem=replace(there.problem, budget=bound.budget))  # not a copy of another process
    if there.leaves:
        weighed = in_part_only(weighed)
    worse = shares.per_frame["corrected"] < shares.per_frame["nominal"]
    unsure = worse or (shares.interval is not None and shares.interval[0] <= 0)
    if not bound.regime.knows_torque and weighed.best.effects and unsure:
        # Evidence there depends on the torque's prior, which no limb obeys: a cause must predict better beyond doubt.
        weighed = only(bound, found, none, weighed.log_evidence)
        shares, there = tested(none)
    return weighed, shares, there


def _each(recording: Recording | Sequence[Recording]) -> Sequence[Recording]:
    """One, or several."""
    return [recording] if isinstance(recording, Recording) else recording


def searched(bound: DiagnosisProblem, without: Sequence[str], workers: int, start: Start = NOTHING) -> HypothesisPool:
    """The search in sub-steps short enough along the data's path."""
    try:
        with diverging():
            path, has_outliers = data_path(bound)
            bound = finely_stepped(bound.shaped(path), path)
            found = search_either(bound, path, lambda law: search(law, path, has_outliers, without, workers, start))
            return heavy_tailed(found)
    except Diverged as error:
        raise cannot_follow(bound) from error


def _followed(
    bound: DiagnosisProblem, none: FittedHypothesis, best: FittedHypothesis, formula: Formula | None
) -> tuple[str, ...]:
    """Variables that the torque which the simulation lacks follows: those of a formula for all of it, in which a cause
    is not known. None where the torque is unknown, or all that the best cause changes is how the motion is seen.
    """
    moved = not all(effect.sensor for effect in best.effects)
    if not bound.regime.knows_torque or not (moved or formula):
        return ()
    whole = formula if best is none else describe(bound, none, none.path)
    return whole.variables if whole else formula.variables if formula else ()

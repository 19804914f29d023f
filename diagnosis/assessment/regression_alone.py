"""The answer where no search is made: a regression's, with the reason.

A search linearises about the file's numbers. Of a servo whose gain is some times another it finds no path of the
recording in minutes, and no cause. What the regression's answer leaves is looked for in the file that it corrects.
A search that the budget ends before its first screen says nothing of causes, either, and takes all of it: what a screen
needs is the number of its columns (:mod:`..budget`). The regression has effects in which the torque is linear, at least
once a shape is known (:mod:`..regression.shaped_effects`). The answer says which others were not examined, and what may
be missing without showing.

There is a gap where an effect is stated without a "perhaps", or where a torque is missing that is several times what is
tolerated and what the encoders' noise makes of it.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from invdyn.diagnosis.assessment.assemble import nothing_to_say
from invdyn.diagnosis.assessment.closing_measures import measured
from invdyn.diagnosis.assessment.regression_cause import regression_cause
from invdyn.diagnosis.assessment.result import NO_SEARCH, Diagnosis, Gap, Shrinkage
from invdyn.diagnosis.budget import work_of, work_per_second
from invdyn.diagnosis.hypotheses.pool import considered
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.regression.linear_effects import required_by_file
from invdyn.diagnosis.regression.regress import Regression
from invdyn.diagnosis.regression.regressors import inverse
from invdyn.diagnosis.rules import FIXED
from invdyn.diagnosis.sensitivity.screen import cost_of
from invdyn.models.dynamics.registry import dynamics_for
from invdyn.models.effects.base import Effect


def by_regression_alone(
    regression: Regression, problem: DiagnosisProblem, without: tuple[str, ...], seed: int, passive: bool, robot: bool
) -> Diagnosis | None:
    """The diagnosis that a regression gives; None where a search is to be made.

    That is where the budget has room for one, unless a ``robot``'s servo gains are far from its file's and the
    regression closes torque on rows it has not seen.
    """
    torque, effects = regression.torque, considered(problem, without)
    factors = list(regression.far_gains.values())
    if robot and factors and torque.share > 0:
        return _answer(regression, problem, seed, passive, _far(factors), True, 0)
    needed = _first_screen(problem, effects)
    speed = work_per_second(problem.model)
    if needed <= min(problem.budget.work, problem.budget.seconds * speed):
        return None
    rest = [effect for effect in effects if effect.name not in regression.examined]
    names = sorted({problem.catalogue.of(effect).phrase or effect.name for effect in rest})
    words = (
        "No causes were searched for, as the budget ends before a search's first screen (--budget "
        f"{math.ceil(needed / speed)} begins one): what is said is by regression"
    )
    words += f", which does not examine {', '.join(names)}" if names else ""
    return _answer(regression, problem, seed, passive, words, False, len(rest))


def _far(times: list[float]) -> str:
    return (
        f"No causes were searched for: the log shows servo gains of {min(times):.2g} to {max(times):.2g} times the "
        "file's, and a search about the file's ends nowhere; diagnose the corrected copy (--write-back) for the rest"
    )


def _first_screen(problem: DiagnosisProblem, effects: Sequence[Effect]) -> float:
    """Work of a budget whose share for the search has room for a fit without any effect and one screen of these."""
    model = problem.model
    columns = sum(cost_of(effect.bound(model.body), model) for effect in effects if not is_searched(effect))
    passes = FIXED.first_fit_passes + FIXED.column_cost * columns
    return work_of(passes, model, len(problem.observations)) / problem.rules.search.search_share


def _answer(
    regression: Regression, problem: DiagnosisProblem, seed: int, passive: bool, words: str, far: bool, missed: int
) -> Diagnosis:
    body, rules, torque, nan = problem.model.body, problem.rules, regression.torque, float("nan")
    names = regression.joints
    before, after = (dict(zip(names, each.tolist(), strict=True)) for each in (torque.before, torque.after))
    empty = nothing_to_say(problem.problem.recording, body, seed, passive, "", rules)
    stated = [p for each in regression.stated for p in each.probability.values()]
    limit = _tolerated(regression, problem)
    large = far or bool((torque.before > FIXED.clear_torque * limit).any())
    detected = large or any(each.sure for each in regression.stated)
    probability = 1.0 if large else max(stated, default=nan)  # nothing says how probable is what does not show
    limits = dict(zip(names, limit.tolist(), strict=True))
    gap = Gap(detected, probability, empty.gap.elpd_per_frame, before, empty.gap.replay_rms_m, limits)
    found = detected and bool(regression.stated)
    return replace(
        empty,
        not_enough_data=None,
        gap=gap,
        shrinkage=Shrinkage(torque.share, torque.interval_90, True, after) if found else empty.shrinkage,
        where=replace(empty.where, joints=dict.fromkeys(names, nan)),
        method={NO_SEARCH: words},
        not_looked_at=missed,
        regression=regression,
        closing=measured(regression, body, passive),
        regressed=regression_cause(regression, problem, passive) if found else None,
    )


def _tolerated(regression: Regression, problem: DiagnosisProblem) -> np.ndarray:
    """(K,) N·m that need no cause: a share of what the file asks for, and the encoders' noise in M q̈ and in servos."""
    motion, body = regression.unseen.motion, problem.model.body
    dynamics, numbers = dynamics_for(body), body.parameters()
    asked = required_by_file(dynamics, body, motion) - motion.servo_drag
    some, still = motion.at(slice(None, None, FIXED.inertia_rows)), np.zeros_like(motion.q[:: FIXED.inertia_rows])
    at_rest = replace(some, qd=still, qdd=still)
    rest = inverse(dynamics, numbers, at_rest)
    noise = motion.torque_sd**2
    for k in range(body.num_joints):
        only = still.copy()
        only[:, k] = 1.0
        inertia = inverse(dynamics, numbers, replace(at_rest, qdd=only)) - rest
        noise = noise + (inertia**2).mean(0) * motion.qdd_sd[:, k : k + 1] ** 2
    share = problem.rules.evidence.tolerance
    return np.asarray(np.sqrt((noise + (share * asked) ** 2).mean(0)))

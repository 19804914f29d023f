"""Relatives of what was found: effects that stand in for it, contain it or are part of it; its softer form.

A screen along the data's path cannot see a twin in time or in the direction of gravity: the path itself is what they
shift; and of effects that change a period alone (:mod:`.period_equivalents`) it sees what a little of them does,
not that much more of a load hardly slows a swing any more. And where joints stick, Gauss–Newton may lose its way
to an effect, but not from its relative's parameters and path (continuation: Allgower & Georg 1990, "Numerical
continuation methods").
"""

import numpy as np
from torch import Tensor

from invdyn.diagnosis.hypotheses import period_equivalents as period
from invdyn.diagnosis.hypotheses.innovation_tests import prediction_errors, show_more
from invdyn.diagnosis.hypotheses.load_equivalents import nearest_load
from invdyn.diagnosis.hypotheses.pool import HypothesisPool, imitable
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.hypotheses.shortlist import HALF, TOO_FAR_BEHIND, attempt, softer
from invdyn.diagnosis.problem.cause import FittedHypothesis, key_of
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.sensitivity.whiten import sizes
from invdyn.models.bodies.body import BodyParameters
from invdyn.models.effects.base import Effect
from invdyn.models.effects.hidden import Hidden
from invdyn.models.effects.inertial_error import InertialError
from invdyn.models.effects.link_flexibility import LinkFlexibility
from invdyn.models.effects.payload import Payload
from invdyn.models.effects.soft_tissue import SoftTissue

ALIKE = 1.0
"""Nats behind its twin in which a cause has arrived; and that a relative must have gained to be followed again."""

SOFTER = 3
"""Causes of one effect whose softer forms are refined, and one of two or three: each may take minutes."""

ALLOWED = 3.0
"""Standard deviations from a special case up to which an effect's parameters allow it."""


def refine_kin(problem: DiagnosisProblem, found: HypothesisPool, number: int) -> None:
    """Refine the relatives of what was found, of causes with so many effects, from values that follow.

    And the softer forms of the best few of those that leave something, a residual or errors of prediction that are
    alike: where nothing explains the gap yet, of all that gain half of what the best one does, as an ideal law may be
    as far off as another effect's.
    """
    near = [c for c in found.pool.values() if len(c.effects) == number and c.log_evidence > found.top - TOO_FAR_BEHIND]
    for cause in near:
        for mine in cause.effects:
            _refine_twins(problem, found, cause, mine)
            _refine_wider(problem, found, cause, mine)
            _refine_narrower(problem, found, cause, mine)
            _refine_load(problem, found, cause, mine)
            _refine_bent(problem, found, cause, mine)
    least, none = found.top - TOO_FAR_BEHIND, found.pool[""].log_evidence
    if not found.explained:
        least = min(least, none + HALF * (found.top - none))
    ideal = [c for c in found.pool.values() if len(c.effects) == number and c.log_evidence > least]
    ideal = [cause for cause in ideal if any(effect.softened() is not None for effect in cause.effects)]
    rough = [c for c in ideal if not c.complete or show_more(problem, c, prediction_errors(problem, c))]
    rough.sort(key=lambda cause: -cause.log_evidence)
    for cause in rough[: SOFTER // number]:
        refine_softer(problem, found, cause)


def _refine_twins(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Refine a cause with the exact equivalents of one of its effects, unless they have arrived."""
    for other, values in _twins(problem, cause, mine).items():
        twin = next((e for e in found.candidates if _is(problem, e, other)), None)
        if twin is None or any(_is(problem, e, other) for e in cause.effects):
            continue
        if problem.regime == "unknown_torque" and imitable(twin):
            continue
        there = found.pool.get(_in_place(cause, mine, twin))
        arrived = there is not None and there.log_evidence > cause.log_evidence - ALIKE
        if not arrived and not _followed(found, cause, mine, twin):
            refine_instead(problem, found, cause, mine, twin, values, [cause.path, found.path])


def _is(problem: DiagnosisProblem, effect: Effect, name: str) -> bool:
    """Whether an effect is that on the whole arm; by name on a single joint, whose effect is that on all."""
    return effect.key == name or (problem.model.body.num_joints == 1 and effect.name == name)


def _twins(problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect) -> dict[str, dict[str, float]]:
    """Parameters with which other effects, by name, are the exact equivalents of one of a cause's."""
    known = cause.values
    twins = {}
    if _is(problem, mine, mine.name):
        for other, same in mine.twins.items():
            twins[other] = {its: known[f"{mine.key}.{own}"] for own, its in same.items()}
    body = problem.model.scale.body
    hangs = isinstance(body, BodyParameters) and bool(body.gravity.any())
    swings = problem.regime == "passive" and problem.model.body.num_joints == 1 and hangs
    if swings and mine.name in period.NAMES:
        own = {p.name: known[f"{mine.key}.{p.name}"] for p in mine.parameters(problem.model.scale)}
        twins |= period.equivalents(period.factor(mine, own, body), body)
    return twins


def _refine_wider(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Refine a cause with what contains one of its effects, from where the two are the same, if it leaves something."""
    for wider in found.candidates:
        narrow = wider.contains.get(mine.name)
        if cause.complete or narrow is None or wider.where != mine.where or wider.key in cause.key.split("+"):
            continue
        there = found.pool.get(_in_place(cause, mine, wider))
        if (there is not None and there.complete) or _followed(found, cause, mine, wider, _softness(mine)):
            continue
        known = cause.values
        values = {name: known[f"{mine.key}.{its}"] for name, its in narrow.items()}
        refine_instead(problem, found, cause, mine, *_as_soft(problem, cause, mine, wider, values), [cause.path])


def _refine_narrower(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Refine a cause with a special case of one of its effects that its parameters allow: it may not have arrived.

    Where several parameters are to be the same one, that which is known best gives its value.
    """
    for narrow in found.candidates:
        names = mine.contains.get(narrow.name)
        if names is None or narrow.where != mine.where or narrow.key in cause.key.split("+"):
            continue
        there = found.pool.get(_in_place(cause, mine, narrow))
        if there is not None and there.log_evidence > cause.log_evidence:
            continue
        known, sd = cause.values, dict(zip(cause.names, cause.sd, strict=True))
        worst_first = sorted(names, key=lambda name: -sd[f"{mine.key}.{name}"])
        values = {names[name]: known[f"{mine.key}.{name}"] for name in worst_first}
        off = [abs(known[f"{mine.key}.{name}"] - values[its]) / sd[f"{mine.key}.{name}"] for name, its in names.items()]
        if max(off) > ALLOWED or _followed(found, cause, mine, narrow, _softness(mine)):
            continue
        refine_instead(problem, found, cause, mine, *_as_soft(problem, cause, mine, narrow, values), [cause.path])


def _refine_load(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Refine a cause with a payload in place of an error of the last link (:mod:`.load_equivalents`)."""
    payload = next((e for e in found.candidates if isinstance(e, Payload)), None)
    if payload is None or not isinstance(mine, InertialError) or mine.place != payload.place[:1]:
        return
    there = found.pool.get(_in_place(cause, mine, payload))
    if payload.key in cause.key.split("+") or (there and there.log_evidence > cause.log_evidence - ALIKE):
        return
    mass, off = nearest_load(cause, mine, payload, problem.model.scale)
    if off < ALLOWED and not _followed(found, cause, mine, payload):
        refine_instead(problem, found, cause, mine, payload, {"mass": mass}, [cause.path])


def _refine_bent(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis, mine: Effect) -> None:
    """Refine the best cause with a link that bends in place of soft tissue at its tip, which looks much like it.

    A screen sees little of what a bend explains along a path of its own: once, beside a stop, 67 nats of 184.
    """
    if not isinstance(mine, SoftTissue) or problem.regime == "unknown_torque" or cause is not found.ranked[0]:
        return
    bent = next((e for e in found.candidates if isinstance(e, LinkFlexibility) and e.place == mine.place), None)
    if bent is None or any(isinstance(effect, Hidden) for effect in cause.effects if effect is not mine):
        return
    there = found.pool.get(_in_place(cause, mine, bent))
    if (there and there.log_evidence > cause.log_evidence) or _followed(found, cause, mine, bent):
        return
    stiffness, damping = bent.parameters(problem.model.scale)
    for start in stiffness.grid[1::2]:  # from one that is too stiff Gauss–Newton finds no softer one
        values = {"stiffness": start, "damping": damping.grid[0]}
        refine_instead(problem, found, cause, mine, bent, values, [found.path])
        if (there := found.pool.get(_in_place(cause, mine, bent))) is not None and there.complete:
            break


def _softness(effect: Effect) -> str:
    """Which form it is."""
    return " softer" * effect.softness


def _as_soft(
    problem: DiagnosisProblem, cause: FittedHypothesis, mine: Effect, other: Effect, values: dict[str, float]
) -> tuple[Effect, dict[str, float]]:
    """A relative and its values, as soft as one of a cause's effects is."""
    form = other
    for _ in range(mine.softness):
        form = form.softened() or form
    own = {p.name: cause.values[f"{mine.key}.{p.name}"] for p in mine.parameters(problem.model.scale)}
    wanted = [p.name for p in form.parameters(problem.model.scale)]
    return form, {name: own[name] for name in wanted if name in own} | values


def refine_softer(problem: DiagnosisProblem, found: HypothesisPool, cause: FittedHypothesis) -> None:
    """Refine a cause with the softer form of each of its effects that has one; the better one stays.

    And with that one's, where it has one and something is left.
    """
    for mine in cause.effects:
        form, best = mine, cause
        while form.softened() is not None and not _followed(found, best, form, form, f" {form.key}{_softness(form)}"):
            refined = softer(problem, best, form)
            if refined is None:
                break
            found.add(refined)
            if refined.complete:
                break
            form, best = next(e for e in refined.effects if e.key == form.key), refined


def _in_place(cause: FittedHypothesis, mine: Effect, other: Effect) -> str:
    """Key of a cause with another effect in place of one."""
    return key_of((*(e for e in cause.effects if e is not mine), other))


def _followed(found: HypothesisPool, cause: FittedHypothesis, mine: Effect, other: Effect, form: str = "") -> bool:
    """Whether the relative, in a ``form`` of it, was refined from as good a cause before; from now on it was."""
    key = _in_place(cause, mine, other) + form
    if found.relatives.get(key, -np.inf) > cause.log_evidence - ALIKE:
        return True
    found.relatives[key] = cause.log_evidence
    return False


def refine_instead(
    problem: DiagnosisProblem,
    found: HypothesisPool,
    cause: FittedHypothesis,
    mine: Effect,
    other: Effect,
    values: dict[str, float],
    starts: list[Tensor],
) -> None:
    """Refine a cause with another effect in place of one, from its values, along one path after the other."""
    effects = (*(e for e in cause.effects if e is not mine), other)
    kept = {name: value for name, value in cause.values.items() if not name.startswith(f"{mine.key}.")}
    values = kept | {f"{other.key}.{name}": value for name, value in values.items()}
    size = float(sizes(problem.regime)[int(cause.by_size.argmax())])
    for path in starts:
        refined = attempt(refine, problem, effects, values, path, size, **cause.searched)
        if refined is not None:
            found.add(refined)
            if refined.complete:
                break

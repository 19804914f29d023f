"""The first hypothesis of a search for what a robot's log lacks: the usual effects, all at once, at all their places.

A real robot lacks friction and rotors at every joint, and its masses are all a little off. A search that adds one
effect at a time pays for each as for a fault of its own, and a regression (:mod:`..regression.regress`) takes what is
odd for more of what is usual. So where it states an effect at every joint, the search starts from all of the usual ones
under their priors, once with what else the regression states and once without, and asks what else is there. Of these an
effect counts as one statement in the prior
(:func:`.prior.log_prior_of`), and those that gain nothing are dropped, at all places together.
"""

from dataclasses import dataclass, field

from invdyn.diagnosis.catalogue.linear_laws import INERTIAL, JOINT_KINDS, USUAL, WITHIN
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.regression.regress import Regression
from invdyn.diagnosis.rules import FIXED
from invdyn.models.effects.base import Effect


@dataclass(frozen=True)
class Start:
    """Effects with values of their parameters, "<effect key>.<name>", and names of effects that are at every place.

    `others` are what a regression states besides.
    """

    effects: tuple[Effect, ...] = ()
    values: dict[str, float] = field(default_factory=dict)
    everywhere: frozenset[str] = frozenset()
    others: tuple[Effect, ...] = ()


def start_of(regression: Regression | None, problem: DiagnosisProblem) -> Start:
    """Where a search begins; without effects where a regression states none at every one of several joints.

    Sizes are the regression's, or small. Links begin as the file has them, as a torque tells sums of their numbers
    alone; in space they are left out unless they are stated, as they are many. A gain imitates usual effects together.
    """
    if regression is None:
        return Start()
    if not any(s.everywhere and len(s.places) > 1 and s.effect in JOINT_KINDS for s in regression.stated):
        return Start()
    body, scale = problem.model.body, problem.model.scale
    found = dict(regression.coefficients)
    found |= {(WITHIN[k[0]], *k[1:]): -v for k, v in found.items() if k[0] in WITHIN}
    stated = {s.effect for s in regression.stated}
    usual = set(USUAL) | ({INERTIAL} if body.dimensions == 2 or INERTIAL in stated else set())
    every = [effect for _, effect in problem.catalogue.everywhere(body, [])]
    effects = tuple(effect for effect in every if effect.name in usual)
    springs = {(name, place) for name, place, _ in found if name in WITHIN.values()}
    others = tuple(effect for effect in every if (effect.name, *effect.where[:1]) in springs)
    values = {f"{effect.key}.{each.name}": 0.0 for effect in (*effects, *others) for each in effect.parameters(scale)}
    for effect in (effect for effect in (*effects, *others) if effect.name != INERTIAL):
        for each in effect.parameters(scale):
            size = found.get((effect.name, effect.where[0], each.name))
            values[f"{effect.key}.{each.name}"] = size or FIXED.usual_start * float(each.prior.stddev)
    return Start(effects, values, frozenset(effect.name for effect in effects), others)

"""The first hypothesis of a search: what a regression of the torque found, all effects at all their places at once.

A real robot lacks an effect everywhere, and a search that adds one at a time pays for each as for a fault of its own.
Where a regression (:mod:`..regression.regress`) of a robot's log states an effect at every joint, its set is refined
first, and the search continues from there. Such an effect counts as one statement in the prior
(:func:`.prior.log_prior_of`).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.regression.as_model import model_on, with_coefficients
from invdyn.diagnosis.regression.linear_effects import INERTIAL, JOINT_KINDS, WITHIN
from invdyn.diagnosis.regression.regress import Regression
from invdyn.models import ArmModel
from invdyn.models.effects.base import PREFIX, Effect
from invdyn.models.effects.inertias import inertia_of


@dataclass(frozen=True)
class Start:
    """Effects with values of their parameters, "<effect key>.<name>", and names of effects that are at every place."""

    effects: tuple[Effect, ...] = ()
    values: dict[str, float] = field(default_factory=dict)
    everywhere: frozenset[str] = frozenset()


def start_of(regression: Regression | None, problem: DiagnosisProblem, passive: bool) -> Start:
    """Where a search begins; without effects where no effect is stated at every one of several joints."""
    if regression is None or regression.unseen is None:
        return Start()
    stated = [s.effect for s in regression.stated if s.everywhere and len(s.places) > 1]
    everywhere = frozenset(WITHIN.get(effect, effect) for effect in stated)
    if not everywhere & JOINT_KINDS.keys():
        return Start()
    found = regressed(regression, problem, passive)
    return replace(found, everywhere=everywhere & {effect.name for effect in found.effects})


def regressed(
    regression: Regression, problem: DiagnosisProblem, passive: bool, nominal: ArmModel | None = None
) -> Start:
    """All that a regression found, as effects of the catalogue with their numbers; ``nominal`` is :func:`.model_on`."""
    if regression.unseen is None:
        return Start()
    nominal = nominal or model_on(regression.unseen.motion, problem.model.body, passive)
    model = with_coefficients(nominal, regression.coefficients)
    values = {
        f"{effect.key}.{parameter.name}": model.parameters[f"{PREFIX}{effect.key}.{parameter.name}"].item()
        for effect in model.effects
        for parameter in effect.parameters(model.scale)
    }
    effects = list(model.effects)
    inertial = problem.catalogue.get(INERTIAL)
    links = sorted({place for kind, place, _ in regression.coefficients if kind == INERTIAL})
    for link in links:
        if inertial is None:
            break  # it is not looked for
        effect = inertial.effect(link).bound(problem.model.body)
        own, other = (inertia_of(each.body_parameters(), effect.place[0]) for each in (nominal, model))
        shift = (other.com - own.com).tolist()
        numbers = [(other.mass - own.mass).item(), *shift, (other.mean - own.mean).item()]
        names = [parameter.name for parameter in effect.parameters(problem.model.scale)]
        values |= {f"{effect.key}.{name}": value for name, value in zip(names, numbers, strict=True)}
        effects.append(effect)
    known = {effect.key for _, effect in problem.catalogue.everywhere(problem.model.body, [])}
    kept = tuple(effect for effect in effects if effect.key in known)
    keys = {effect.key for effect in kept}
    values = {name: value for name, value in values.items() if name.rpartition(".")[0] in keys and np.isfinite(value)}
    return Start(kept, values)

"""Whether what was found of a cause's effects is what their names say.

Parameters may make of an effect another one: two stops that meet hold a joint, and Stribeck friction that is less at
rest than in motion grows with speed. Such a cause explains a part at most (:mod:`.model_posterior`).
"""

from invdyn.diagnosis.problem.cause import FittedHypothesis, of_effect
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import at_far_end


def credible(bound: DiagnosisProblem, cause: FittedHypothesis) -> bool:
    """Whether what was found of each effect is what its name says, and is not as large as anything may be."""
    for effect in cause.effects:
        mean, sd = of_effect(effect, cause.values), of_effect(effect, cause.sds)
        if not bound.catalogue.of(effect).credible(effect, mean, sd, bound.model.scale):
            return False
        if is_searched(effect) and any(
            at_far_end(p, mean[p.name], bound.rules) for p in effect.parameters(bound.model.scale)
        ):
            return False
    kinds = {effect.name: bound.catalogue.of(effect).credible_together for effect in cause.effects}
    found = [(effect, of_effect(effect, cause.values)) for effect in cause.effects]
    return all(
        together is None or together([each for each in found if each[0].name == name], bound.model.scale)
        for name, together in kinds.items()
    )

"""Whether what was found of a cause's effects is what their names say.

Parameters may make of an effect another one: two stops that meet hold a joint, and Stribeck friction that is less at
rest than in motion grows with speed. Such a cause explains a part at most (:mod:`.model_posterior`).
"""

from invdyn.diagnosis.problem.cause import FittedHypothesis, of_effect
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import at_far_end
from invdyn.models.effects.joint_limit import have_room


def credible(bound: DiagnosisProblem, cause: FittedHypothesis) -> bool:
    """Whether what was found of each effect is what its name says, and is not as large as anything may be."""
    for effect in cause.effects:
        mean, sd = of_effect(effect, cause.values), of_effect(effect, cause.sds)
        if not effect.credible(mean, sd, bound.model.scale):
            return False
        if is_searched(effect) and any(
            at_far_end(p, mean[p.name], bound.rules) for p in effect.parameters(bound.model.scale)
        ):
            return False
    return have_room(cause.effects, cause.values, bound.model.scale)

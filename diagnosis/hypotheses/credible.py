"""Whether what was found of a cause's effects is what their names say.

Parameters may make of an effect another one: two stops that meet hold a joint, and Stribeck friction that is less at
rest than in motion grows with speed. Such a cause explains a part at most
(:mod:`.model_posterior`), and the search goes on as if it left something (:mod:`.search`).
"""

from invdyn.diagnosis.problem.cause import FittedHypothesis
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.problem.noise import is_searched
from invdyn.diagnosis.problem.unknowns import at_far_end
from invdyn.models.effects.joint_limit import have_room


def credible(bound: DiagnosisProblem, cause: FittedHypothesis) -> bool:
    """Whether what was found of each effect is what its name says, and is not as large as anything may be."""
    mean, sd = cause.values, dict(zip(cause.names, cause.sd.tolist(), strict=True)) | cause.noise_sd
    for effect in cause.effects:
        parameters = effect.parameters(bound.model.scale)
        names = {p.name: f"{effect.key}.{p.name}" for p in parameters}
        own, spreads = ({name: known[key] for name, key in names.items()} for known in (mean, sd))
        if not effect.credible(own, spreads, bound.model.scale):
            return False
        if is_searched(effect) and any(at_far_end(p, own[p.name]) for p in parameters):
            return False
    return have_room(cause.effects, mean, bound.model.scale)

"""What a regression found as a cause, where it explains more than the search: its numbers go into the corrected file.

Means are the regression's. Draws are of the Gaussian of its coefficients, and belong together: damping and a gain that
are known by their ratio alone stay at that ratio. A link's numbers are those of one body that has the base parameters
that were found (:mod:`..regression.as_model`).
"""

import numpy as np

from invdyn.diagnosis.assessment.findings import described_by, finding_of
from invdyn.diagnosis.assessment.result import Cause, Finding
from invdyn.diagnosis.catalogue.linear_laws import INERTIAL
from invdyn.diagnosis.hypotheses.regression_start import Start
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.regression.as_model import Coefficients, model_on, with_coefficients
from invdyn.diagnosis.regression.regress import Regression
from invdyn.models import ArmModel
from invdyn.models.effects.base import PREFIX, Effect
from invdyn.models.effects.inertias import inertia_of


def regression_cause(regression: Regression, problem: DiagnosisProblem, passive: bool) -> Cause | None:
    """Its effects with their numbers; None where it states none that the catalogue has."""
    nominal = model_on(regression.unseen.motion, problem.model.body, passive)
    mean = _regressed(regression.coefficients, problem, nominal)
    if not mean.effects:
        return None
    every = [_regressed(each, problem, nominal) for each in regression.draws]
    whole = [each for each in every if each.values.keys() == mean.values.keys()]
    findings = tuple(_finding(problem, effect, mean, whole) for effect in mean.effects)
    return Cause(findings, 0.0, float("nan"), float("nan"))


def _regressed(coefficients: Coefficients, problem: DiagnosisProblem, nominal: ArmModel) -> Start:
    """Effects of the catalogue with the numbers that a regression found."""
    model = with_coefficients(nominal, coefficients)
    values = {
        f"{effect.key}.{parameter.name}": model.parameters[f"{PREFIX}{effect.key}.{parameter.name}"].item()
        for effect in model.effects
        for parameter in effect.parameters(model.scale)
    }
    effects = list(model.effects)
    inertial = problem.catalogue.get(INERTIAL)
    links = sorted({place for kind, place, _ in coefficients if kind == INERTIAL})
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


def _finding(problem: DiagnosisProblem, effect: Effect, mean: Start, draws: list[Start]) -> Finding:
    own, whole = [p.name for p in effect.parameters(problem.model.scale)], (mean, *(draws or [mean]))
    values = {name: np.array([each.values[f"{effect.key}.{name}"] for each in whole]) for name in own}
    described = described_by(problem.catalogue.of(effect), effect, values, problem.model.scale)
    means = {name: float(each[0]) for name, (each, _) in described.items()}
    return finding_of(problem, effect, {name: (each[1:], unit) for name, (each, unit) in described.items()}, means)

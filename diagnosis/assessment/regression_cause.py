"""What a regression found as a cause, where it explains more than the search: its numbers go into the corrected file.

Means are the regression's. Draws are of the Gaussian of its coefficients, and belong together: damping and a gain that
are known by their ratio alone stay at that ratio. A link's numbers are those of one body that has the base parameters
that were found (:mod:`..regression.as_model`).
"""

from dataclasses import replace

import numpy as np

from invdyn.diagnosis.assessment.findings import described_by, place
from invdyn.diagnosis.assessment.result import Cause, Change, Estimate, Finding
from invdyn.diagnosis.hypotheses.regression_start import Start, regressed
from invdyn.diagnosis.problem.diagnosis_problem import DiagnosisProblem
from invdyn.diagnosis.regression.as_model import model_on
from invdyn.diagnosis.regression.regress import Regression
from invdyn.models.effects.base import Effect


def regression_cause(regression: Regression, problem: DiagnosisProblem, passive: bool) -> Cause | None:
    """Its effects with their numbers; None where it states none that the catalogue has."""
    if regression.unseen is None:
        return None
    nominal = model_on(regression.unseen.motion, problem.model.body, passive)
    mean = regressed(regression, problem, passive, nominal)
    if not mean.effects:
        return None
    every = [regressed(replace(regression, coefficients=each), problem, passive, nominal) for each in regression.draws]
    whole = [each for each in every if each.values.keys() == mean.values.keys()]
    findings = tuple(_finding(problem, effect, mean, whole) for effect in mean.effects)
    return Cause(findings, 0.0, float("nan"), float("nan"))


def _finding(problem: DiagnosisProblem, effect: Effect, mean: Start, draws: list[Start]) -> Finding:
    entry = problem.catalogue.of(effect)
    own, whole = [p.name for p in effect.parameters(problem.model.scale)], (mean, *draws)
    values = {name: np.array([each.values[f"{effect.key}.{name}"] for each in whole]) for name in own}
    described = described_by(entry, effect, values, problem.model.scale)
    estimates = {name: _estimate(each, unit) for name, (each, unit) in described.items()}
    changes = {}
    for name, quantity in entry.body_file_fields.items():
        if name in described and (before := problem.model.scale.filed(quantity, effect.place[0])):
            changes[name] = Change(before, _estimate(before + described[name][0], described[name][1]))
    return Finding(effect.name, effect.side, place(effect), estimates, changes, entry)


def _estimate(values: np.ndarray, unit: str) -> Estimate:
    """Of a mean, which comes first, and draws."""
    draws = values[1:] if len(values) > 1 else values
    low, high = np.quantile(draws, [0.05, 0.95])
    return Estimate(float(values[0]), float(draws.std()), (float(low), float(high)), unit, draws)

"""Effects that are what their names say."""

from dataclasses import replace

import numpy as np
import pytest
from pendulum import LOOSE, PENDULUM, recording_of

from invdyn.diagnosis.assessment.model_posterior import credible
from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.models.effects import EFFECTS


@pytest.mark.parametrize("meet", [False, True])
def test_stops_that_meet_hold_a_joint(meet):
    bound = diagnosis_problem(recording_of(EFFECTS["viscous_friction"]("pivot"), damping=0.05), PENDULUM)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    stops = [EFFECTS["joint_limit"]("pivot", side).bound(PENDULUM) for side in ("lower", "upper")]
    shaped = bound.shaped(path)
    low, high = shaped.model.scale.range[0].tolist()
    angles = {"lower": high - 0.01 if meet else low + 0.01, "upper": high - 0.01}
    values = {f"{s.key}.{n}": v for s in stops for n, v in (("angle", angles[s.where[1]]), ("stiffness", 5.0))}
    values |= {f"{stop.key}.damping": 0.01 for stop in stops}
    found = {"names": tuple(values), "mean": np.array(list(values.values())), "covariance": 1e-8 * np.eye(6)}
    assert credible(shaped, replace(none, effects=tuple(stops), **found)) is not meet

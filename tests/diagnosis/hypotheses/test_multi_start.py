"""Effects refined from the best of several values."""

import numpy as np
from pendulum import PENDULUM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.multi_start import scan
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import LOOSE, diagnosis_problem
from invdyn.models.effects import EFFECTS


def test_load_friction_is_found_from_afar():
    bound = diagnosis_problem(recording_of(EFFECTS["load_friction"]("pivot"), rows=120, coefficient=0.2), PENDULUM)
    path, _ = data_path(bound)
    none = refine(bound, (), {}, path, LOOSE)
    cause = scan(bound, none, EFFECTS["load_friction"]("pivot"), -np.inf)
    assert cause.complete
    assert abs(cause.mean[0] - 0.2) < 4 * cause.sd[0]

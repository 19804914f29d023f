"""A recording that is stamped in seconds since 1970: the model counts from its first row, answers are on its clock."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from pendulum import ARM, path_of

from invdyn.diagnosis.assessment.findings import finding
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models.effects import EFFECTS
from invdyn.simulate import random_arm, record

UNIX = 1_700_000_000.25
TRUE = {"impulse_x": 0.3, "impulse_y": 0.2, "moment": 0.7, "duration": 0.06}


@cache
def pushed(start):
    """The problem of an arm whose wrist is pushed, seen from its fifth row on, at times from ``start`` on; the push."""
    effect = EFFECTS["external_push"]("wrist")
    arm = random_arm(ARM, duration=1.5, fps=60, noise=0.0003, torque_scale=0.5, commanded=True, seed=2)
    named = {f"effect.{effect.key}.{name}": torch.tensor([v], dtype=torch.float64) for name, v in TRUE.items()}
    recording, _ = record(arm.with_effects(effect).replace(**named), 2)
    points = recording.keypoints.copy()
    points[:4] = np.nan
    stamped = replace(recording, time=recording.time + start, keypoints=points)
    return diagnosis_problem(stamped, ARM), effect.bound(ARM)


@pytest.mark.long
def test_commands_before_the_first_seen_row_stay_at_their_times():
    (here, _), (there, _) = pushed(0.0), pushed(UNIX)
    assert here.model.time[0] == pytest.approx(4 / 60)
    assert there.problem.origin == UNIX
    np.testing.assert_allclose(there.model.time, here.model.time, atol=5e-7)
    np.testing.assert_allclose(there.model.command, here.model.command, atol=1e-4)


def test_when_a_push_came_is_said_on_the_recordings_clock():
    found = {}
    for start in (0.0, UNIX):
        here, effect = pushed(start)
        values = {f"{effect.key}.{name}": value for name, value in TRUE.items()}
        cause = refine(here, (effect,), values, path_of(here), DEFAULT.residual.min_path_size)
        found[start] = finding(here, cause, effect, 0).parameters
    for name in ("start", "stop"):
        here, there = found[0.0][name], found[UNIX][name]
        assert there.mean - UNIX == pytest.approx(here.mean, abs=2e-3)
        assert there.interval_90[0] - UNIX == pytest.approx(here.interval_90[0], abs=2e-3)
        assert here.mean == pytest.approx(TRUE["moment"], abs=0.1)

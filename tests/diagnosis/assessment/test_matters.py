"""Gaps too small to matter."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import causes
from robot_log import ARM, STEP, robot_log
from scipy.signal import lfilter

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.assessment.matters import matters, tolerated
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.report.sentences import kind, verdict
from invdyn.models.effects import EFFECTS

KEPT = ("clock_rate", "base_motion", "viscous_friction")


def by_engine(here, path):
    """What is tolerated for the engine's own error alone."""
    return tolerated(replace(here, rules=here.rules.replace(tolerance=0.0)), path)


def diagnosed(damping, **options):
    left_out = [name for name in EFFECTS if name not in KEPT]
    return diagnose(robot_log(1.0, (0.0, damping)), ARM, without=left_out, **options)


@pytest.mark.long
def test_another_engines_integration_is_no_gap():
    """MuJoCo's usual step errs in the first order; whatever imitates that best is not called a gap."""
    found = diagnosed(0.0)
    assert kind(found) == "none"
    assert not found.gap.detected
    assert found.outside.probability == 0  # what is left does not matter either
    assert sum(cause.probability for cause in found.causes) == pytest.approx(1, abs=1e-3)
    assert all(found.gap.residual_torque_rms[name] < limit for name, limit in found.gap.tolerated_torque.items())


@pytest.mark.long
def test_friction_is_a_gap_and_what_integration_leaves_beside_it_is_not():
    """How large the share is that does not matter changes what is said of the gap, not its causes."""
    found = diagnosed(0.1)
    assert found.gap.detected
    best = max(found.causes, key=lambda cause: cause.probability + cause.in_part)
    assert "viscous_friction.elbow" in [effect.key for effect in best.effects]
    (friction,) = [effect for effect in best.effects if effect.key == "viscous_friction.elbow"]
    assert friction.parameters["damping"].mean == pytest.approx(0.1, rel=0.05)
    assert "no effect" not in verdict(found)
    strict = diagnosed(0.1, tolerance=0.9)
    assert (strict.gap.detected, strict.gap.probability) == (False, found.gap.probability)
    assert verdict(strict).startswith("No gap that matters: what the simulation lacks, ")
    for one, other in zip(strict.causes, found.causes, strict=True):
        assert one.effects == other.effects
        assert (one.probability, one.in_part) == (pytest.approx(other.probability + other.in_part), 0)


def test_a_push_counts_in_its_worst_second():
    """And detections that are louder than the noise matter whatever the torque."""
    here, none, _ = causes()
    limit = tolerated(here, none.path)
    rows = len(none.path)
    missing = np.zeros((rows, 1))
    assert not matters(here, none, none, missing, limit)
    missing[10:20] = 3 * limit  # a fifth of a second: √0.2 of it in the worst one
    assert np.sqrt((missing**2).mean()) < 1.1 * limit
    assert matters(here, none, none, missing, limit)
    assert not matters(here, none, none, missing, 1.5 * limit)


def test_the_tolerance_of_an_engine_is_its_error_of_the_first_order():
    """θ = A sin ωt has the third derivative −A ω³ cos ωt; where that is large its error is more than the share."""
    here, none, _ = causes()
    time, amplitude, omega = here.model.time, 0.5, 20.0
    path = torch.zeros_like(none.path)
    path[:, -1] = amplitude * omega * torch.cos(omega * time)
    (limit,) = by_engine(here, path)
    inertia = 1.0 * 0.3**2 / 3  # of the pendulum's rod about its pivot
    error = inertia * 0.001 * amplitude * omega**3 / np.sqrt(2)
    assert limit == pytest.approx(error, rel=0.1)  # a cubic through 2b seconds takes some (ωb)²/13 of it


def test_a_gap_does_not_raise_the_tolerance_that_it_is_held_against():
    """A path is as rough as the torque that is missing; the motion's own third derivative is not."""
    here = diagnosis_problem(robot_log(2.0, camera=False), ARM)
    rows, kept = len(here.observations), np.exp(-20.0 * STEP)
    shocks = np.random.default_rng(0).normal(0, np.sqrt(1 - kept**2), (rows, 2))
    missing = lfilter([1], [1, -kept], shocks, axis=0)  # 1 N·m, as an Ornstein–Uhlenbeck torque of 20/s
    inertia = here.model.dynamics.typical_inertia(here.model.scale.body).numpy()
    path = torch.zeros(rows, here.model.state_dim, dtype=torch.float64)
    path[:, -2:] = torch.from_numpy((missing / inertia).cumsum(0) * STEP)
    assert (by_engine(here, path) < 0.03).all()  # from row to row it is three times that

"""Whether errors of prediction are noise: independent of one another, and alike in all directions."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, PENDULUM, causes, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.hypotheses.refine import refine
from invdyn.diagnosis.prediction.innovation_tests import (
    along_motion,
    correlation,
    noise_ratio,
    prediction_errors,
    shared_outliers,
)
from invdyn.diagnosis.prediction.predict import seen_tips
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.models import ArmModel
from invdyn.models.effects import EFFECTS
from invdyn.recordings.jitter import MEDIAN
from invdyn.simulate import random_arm, record


def test_a_right_simulation_leaves_noise():
    """Whatever rows are missing; unit variance but for the noise scale."""
    here, _, cause = causes()
    gaps = here.observations.clone()
    gaps[[3, 40]] = torch.nan
    errors = prediction_errors(here.observing(gaps), cause)
    assert np.flatnonzero(np.isnan(errors).any(-1)).tolist() == [3, 40]
    # κ is the size of these errors, but for the two rows that it knew and they do not.
    assert abs(np.nanmean(errors**2) / cause.kappa**2 - 1) < 0.03
    alike, sd = correlation(errors)
    assert sd == pytest.approx((2 * 75) ** -0.5)
    assert abs(alike) < 4 * sd
    assert correlation(np.full((5, 2), np.nan)) == (0.0, 1.0)


def test_noise_lies_along_the_motion_no_more_than_across():
    """However large, and whether the errors are Gaussian; moved along the motion, they do."""
    here, _, cause = causes()
    share, sd = along_motion(prediction_errors(here, cause), cause)
    assert sd == pytest.approx(0.5 / np.sqrt(40))  # the faster half of 80 rows
    assert abs(share - 0.5) < 3 * sd
    rng = np.random.default_rng(0)
    wild = here.observing(here.observations + 0.02 * torch.from_numpy(rng.standard_t(2, size=(80, 2))))
    assert abs(along_motion(prediction_errors(wild, cause), cause)[0] - 0.5) < 3 * sd
    tips = seen_tips(cause.model, cause.path)[:, 0]
    late = 0.04 * rng.normal(size=(80, 1)) * np.gradient(tips, 0.02, axis=0)
    mistimed = here.observing(here.observations + torch.from_numpy(late))
    assert along_motion(prediction_errors(mistimed, cause), cause)[0] > 0.5 + 4 * sd
    unseen = here.observing(torch.full_like(here.observations, torch.nan))
    assert along_motion(prediction_errors(unseen, cause), cause) == (0.5, 0.5)


@pytest.mark.quick("label_swap")
@pytest.mark.parametrize("mistake", ["outliers", "label_swap"])
def test_swapped_keypoints_stray_as_one(mistake):
    """Under a cause that has each stray by itself; one that knows of swaps, or of no mistakes, is not asked."""
    swaps = mistake == "label_swap"
    truth = EFFECTS[mistake]("elbow", "wrist") if swaps else EFFECTS[mistake]()
    values = {"rate": 0.05} | ({} if swaps else {"scale": 0.1})
    here = diagnosis_problem(recording_of(truth, ARM, rows=200, **values), ARM)
    path = data_path(diagnosis_problem(recording_of(None, ARM, rows=200), ARM))[0]  # the same motion, without mistakes
    none = refine(here, (), {}, path, here.regime.path_size, rounds=1)

    def cause(*names):
        effects = [EFFECTS[name](*(("elbow", "wrist") if name == "label_swap" else ())).bound(ARM) for name in names]
        model = here.model.with_effects(*effects)
        known = {f"effect.{e.key}.rate": torch.tensor([0.05]).double() for e in effects}
        wide = {f"effect.{e.key}.scale": torch.tensor([0.1]).double() for e in effects if e.name == "outliers"}
        return replace(none, path=path, model=model.replace(**known, **wide))

    company, chance = shared_outliers(here, cause("outliers"))
    assert chance < 0.2
    assert (company > 0.9) if swaps else (abs(company) < 3 * chance)
    assert shared_outliers(here, cause("outliers", "label_swap")) == shared_outliers(here, cause()) == (0.0, 1.0)


def test_a_limbs_torque_may_be_smoother_than_its_prior():
    """Under the torque that has the highest evidence its errors are alike, by .28; under an ample one they are not."""
    arm = random_arm(PENDULUM, duration=4.0, fps=50, noise=5e-5, torque_scale=0.5, commanded=True, seed=1)
    command, given = torch.sin(2 * arm.time)[:, None], arm.parameters
    arm = ArmModel(PENDULUM, arm.time, arm.observation, command=command, parameters=given)
    here = diagnosis_problem(replace(record(arm, 1)[0], torques=None), PENDULUM)
    none = refine(here, (), {}, data_path(here)[0], here.regime.path_size)
    alike, sd = correlation(prediction_errors(here, none))
    assert abs(alike) < 3 * sd


@pytest.mark.long
def test_errors_are_loud_beside_all_the_noise_there_is_where_it_grows():
    """However far off the noise at rest is, which only κ knows; of other causes κ says it."""
    here, _, friction = causes()
    assert noise_ratio(here, friction) == friction.kappa
    growing = EFFECTS["varying_noise"]().bound(PENDULUM)
    here = diagnosis_problem(recording_of(growing, rows=400, slope=5.0), PENDULUM)
    rest = {"emission.keypoint_scale": torch.tensor([0.0005]).double()}  # a quarter of the true noise
    here = replace(here, problem=replace(here.problem, model=here.model.replace(**rest)))
    cause = refine(here, (), {}, data_path(here)[0], here.regime.path_size)
    assert noise_ratio(here, cause) == cause.kappa > DEFAULT.residual.max_error_ratio
    slope = {"effect.varying_noise.slope": torch.tensor([5.0]).double()}
    cause = replace(cause, effects=(growing,), model=cause.model.with_effects(growing).replace(**slope), kappa=4.0)
    # A median of n = 400 values, whose logarithm has a variance of 2 MEDIAN/n.
    assert noise_ratio(here, cause) == pytest.approx(1.0, abs=3 * np.sqrt(2 * MEDIAN / 400))
    assert noise_ratio(here, replace(cause, kappa=8.0)) == pytest.approx(2 * noise_ratio(here, cause), rel=0.1)

"""Whether errors of prediction are noise: independent of one another, and alike in all directions."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import PENDULUM, causes

from invdyn.diagnosis.paths import data_path
from invdyn.diagnosis.predict import seen_tips
from invdyn.diagnosis.refine import refine
from invdyn.diagnosis.setting import setting
from invdyn.diagnosis.whiteness import along_motion, correlation, prediction_errors
from invdyn.models import ArmModel
from invdyn.simulate import random_arm, record


def test_a_right_simulation_leaves_noise():
    """Whatever rows are missing; unit variance but for the noise scale."""
    here, _, cause = causes()
    gaps = here.observations.clone()
    gaps[[3, 40]] = torch.nan
    errors = prediction_errors(here.observing(gaps), cause)
    assert np.flatnonzero(np.isnan(errors).any(-1)).tolist() == [3, 40]
    # Squares of n = 156 unit Gaussians: their mean's sd is √(2/156).
    assert abs(np.nanmean(errors**2) / cause.kappa**2 - 1) < 4 * np.sqrt(2 / 156)
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


def test_a_limbs_torque_may_be_smoother_than_its_prior():
    """Under the torque that has the highest evidence its errors are alike, by .28; under an ample one they are not."""
    arm = random_arm(PENDULUM, duration=4.0, fps=50, noise=5e-5, torque_scale=0.5, commanded=True, seed=1)
    command, given = torch.sin(2 * arm.time)[:, None], arm.parameters
    arm = ArmModel(PENDULUM, arm.time, arm.emission_model, command=command, parameters=given)
    here = setting(replace(record(arm, 1)[0], torques=None), PENDULUM)
    none = refine(here, (), {}, data_path(here)[0], here.loose)
    alike, sd = correlation(prediction_errors(here, none))
    assert abs(alike) < 3 * sd

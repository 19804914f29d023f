"""Starting values: noise from differences of what was seen."""

import math

import numpy as np
import pytest
import torch

from invdyn.inference.posterior.initialise import (
    ORDERS,
    SUBSTEPS,
    confidence_drop,
    jitter,
    sufficient_substeps,
)
from invdyn.models import ArmModel, Body, Keypoints, Link, Observation
from invdyn.models.articulated.start import joint_angle_sd


def test_noise_is_estimated_beside_a_fast_motion():
    """A swing at 4 Hz, 60 frames/s: its third differences are above those of the noise, its fifth ones far below."""
    rng = np.random.default_rng(0)
    swing = 0.05 * np.sin(2 * np.pi * 4.0 * np.arange(600) / 60)
    noise = 0.0005 * rng.standard_normal((600, 2))
    found = jitter(np.stack([noise[:, 0], swing + noise[:, 1]], -1))
    assert found == pytest.approx([0.0005, 0.0005], rel=0.15)


def test_noise_is_estimated_beside_a_motion_that_differences_of_fifth_order_still_show():
    """At 9 Hz they have five times the noise, the tenth a ninth; and of noise alone higher orders tell no less."""
    rng = np.random.default_rng(2)
    swing = 0.5 * np.sin(2 * np.pi * 9.0 * np.arange(400) / 60 + 1.0)
    noise = 0.004 * rng.standard_normal((400, 200))
    fifth = np.diff(swing, n=5) / math.sqrt(math.comb(10, 5))
    assert np.median(np.abs(fifth)) > 4 * 0.6745 * 0.004
    assert jitter(swing[:, None] + noise).mean() == pytest.approx(0.004, rel=0.1)
    alone = jitter(noise)
    usual = [
        min(np.median(np.abs(np.diff(column, n=n))) / math.comb(2 * n, n) ** 0.5 for n in ORDERS) for column in noise.T
    ]
    assert np.mean(np.isclose(alone, 1.4826 * np.array(usual))) > 0.97


def test_noise_of_gaps_and_of_too_few():
    rng = np.random.default_rng(1)
    column = 0.1 * rng.standard_normal(1000)
    column[::5] = np.nan
    few = np.full(1000, np.nan)
    few[:3] = 1.0
    found = jitter(np.stack([column, few], -1))
    assert found[0] == pytest.approx(0.1, rel=0.1)
    assert found[1] == 0.0


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("speed", [2.0, 12.0, 18.0, 30.0])
def test_as_many_substeps_as_are_needed_and_no_more(integrator, speed):
    """Their error, to twice as many, is a tenth of what can be noticed at most, and that of fewer ones is not."""
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=0.3, mass=1.0) for k in range(2)]
    body = Body("arm", links, gravity=(0.0, -9.81))
    time = 0.02 * torch.arange(100, dtype=torch.float64)
    parameters = {"emission.keypoint_scale": 0.002, "noise.angle": 1e-4}
    model = ArmModel(body, time.numpy(), Observation(Keypoints([0, 1])), integrator=integrator, parameters=parameters)
    angles = torch.stack([torch.sin(speed * time), 0.7 * torch.cos(0.9 * speed * time)], -1)
    tips = model.dynamics.keypoints(angles, model.body_parameters()).flatten(-2)
    chosen = sufficient_substeps(model, tips)
    assert model.substeps == 1

    path = model.initial_paths(tips)
    path = path[len(path) // 2]
    limit = 0.1 * (
        model.parameters["noise.angle"] + 0.1 * torch.as_tensor(joint_angle_sd(model, model.body_parameters()))
    )

    def suffices(count):
        ends = []
        for taken in (count, 2 * count):
            with torch.no_grad():
                ends.append(model.in_substeps(taken).transition_mean(path[:-1], torch.arange(1, 100))[:, -4:-2])
        return bool((torch.quantile((ends[0] - ends[1]).abs(), 0.99, dim=0) <= limit).all())

    assert suffices(chosen) or chosen == SUBSTEPS[-1]
    assert not any(suffices(count) for count in SUBSTEPS[: SUBSTEPS.index(chosen)])
    if integrator == "rk4":
        assert chosen == {2.0: 1, 12.0: 2, 18.0: 3, 30.0: 4}[speed]


def test_points_far_off_at_a_low_confidence_start_as_lost():
    """δ = log(ratio of misfits) / (difference of drops); noise that a diagnosis may name starts at 0."""
    rng = np.random.default_rng(6)
    off = rng.normal(0, 0.01, (200, 2, 2))
    drop = np.where(np.arange(200) < 30, 0.9, 0.1)[:, None] * np.ones(2)
    off[:30, 0] *= 100  # lost
    off[:30, 1] *= 8  # noisy
    start = confidence_drop(off, drop)
    assert start[0] == pytest.approx(np.log(100) / 0.8, rel=0.1)
    assert start[1] == 0
    assert (confidence_drop(off, 0 * drop) == 0).all()

"""Starting values: sub-steps that suffice, and doubtful keypoints."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from invdyn.inference import infer
from invdyn.inference.posterior.initialise import SUBSTEPS, arm_problem, confidence_drop, sufficient_substeps
from invdyn.models import ArmModel, Keypoints, Link, Observation, OrnsteinUhlenbeck, planar_body
from invdyn.models.articulated.start import joint_angle_sd
from invdyn.simulate import random_arm, record

UNIX = 1_700_000_000.0
"""s; single precision has steps of 128 s there, double precision of 2.4e-7 s."""


@pytest.mark.parametrize("integrator", ["rk4", "semi_implicit"])
@pytest.mark.parametrize("speed", [2.0, 12.0, 18.0, 30.0])
def test_as_many_substeps_as_are_needed_and_no_more(integrator, speed):
    """Their error, to twice as many, is a tenth of what can be noticed at most, and that of fewer ones is not."""
    links = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=0.3, mass=1.0) for k in range(2)]
    body = planar_body("arm", links, gravity=(0.0, -9.81))
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


def test_points_far_off_at_a_low_confidence_start_as_outliers():
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


def test_a_models_times_count_from_the_first_row():
    """A recording that is stamped in seconds since 1970 gives the same posterior, at its own times."""
    body = planar_body("arm", [Link("rod", "pivot", "tip", length=0.3, mass=1.0)], gravity=(0.0, -9.81))
    recording, truth = record(random_arm(body, duration=1.0, fps=40, commanded=True, seed=1), 1)
    stamped, known = (replace(each, time=each.time + UNIX) for each in (recording, truth))
    problem = arm_problem(stamped, body, truth=known)
    assert problem.origin == UNIX
    np.testing.assert_allclose(problem.model.time.numpy(), recording.time, atol=5e-7)
    np.testing.assert_allclose(problem.truth.torque, truth.torque, atol=1e-4 * np.abs(truth.torque).max())

    options = {"method": "smc", "num_filters": 2, "num_particles": 50, "seed": 0, "torque": OrnsteinUhlenbeck()}
    there, here = infer(stamped, body, **options), infer(recording, body, **options)
    np.testing.assert_array_equal(there["posterior"]["time"], stamped.time)
    for name in ("torque", "angle"):
        a, b = (each["posterior"][name].mean(("chain", "draw")).values for each in (there, here))
        np.testing.assert_allclose(a, b, atol=1e-3 * np.abs(b).max())

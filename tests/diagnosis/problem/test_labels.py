"""Exchanged labels put right, and nothing else."""

import numpy as np
import pytest
import torch
from hypothesis import example, given
from hypothesis import strategies as st
from pendulum import ARM, PENDULUM

from invdyn.diagnosis.problem.outliers import relabelled
from invdyn.diagnosis.rules import FIXED
from invdyn.models import ArmModel, Encoders, Keypoints, Link, Observation, planar_body

LINKS = [Link(f"link{k}", f"joint{k}", f"tip{k}", length=x, mass=1.0) for k, x in enumerate((0.3, 0.25, 0.2))]
LONG = planar_body("long", LINKS, base=(0.1, -0.2))
ROWS, NOISE = 200, 0.002


def seen(body=ARM, tips=(0, 1), encoders=0, noise=NOISE, seed=0):
    """A model, and its keypoints along a smooth motion, (T, O); encoders behind them."""
    sensors = ([Keypoints(tips)] if tips else []) + ([Encoders()] if encoders else [])
    model = ArmModel(body, 0.01 * np.arange(ROWS), Observation(*sensors))
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 2, ROWS)[:, None]
    q = torch.as_tensor(np.sin(time * rng.uniform(2, 5, body.num_joints)) + rng.uniform(-2, 2, body.num_joints))
    points = model.dynamics.keypoints(q, model.body_parameters())[:, list(tips)].flatten(1)
    return model, torch.cat([points + noise * torch.as_tensor(rng.normal(size=points.shape)), q[:, :encoders]], -1)


def exchanged(observations, rows, i, j):
    wrong = observations.clone()
    for axis in range(2):
        wrong[rows, 2 * i + axis], wrong[rows, 2 * j + axis] = (
            observations[rows, 2 * j + axis],
            observations[rows, 2 * i + axis],
        )
    return wrong


@given(share=st.floats(0, 0.4), seed=st.integers(0, 1000))
@example(share=0.390625, seed=156)
def test_exchanged_labels_are_put_right(share, seed):
    """But where both readings have the links' lengths within some noise; and right ones are left."""
    model, right = seen(seed=seed)
    rows = np.flatnonzero(np.random.default_rng(seed).random(ROWS) < share)
    wrong = exchanged(right, rows, 0, 1)
    off = (relabelled(model, wrong) != right).any(-1).numpy()
    elbow, wrist = wrong[:, :2], wrong[:, 2:]
    misfit = torch.stack([elbow.norm(dim=-1) - 0.3, (wrist - elbow).norm(dim=-1) - 0.25]).abs().amax(0)
    assert (misfit[off] <= FIXED.label_misfit_ratio * misfit.quantile(0.5)).all()
    if len(rows) < ROWS / 3:  # of more, the median is that of the worst of the right ones
        assert (misfit[off] < 20 * NOISE).all()
    assert not off[np.setdiff1d(np.arange(ROWS), rows)].any()


def test_any_two_of_several_and_the_encoders_stay():
    model, right = seen(LONG, (0, 1, 2), encoders=3)
    wrong = exchanged(exchanged(right, [10, 11, 12, 90], 0, 2), [50, 120], 1, 2)
    torch.testing.assert_close(relabelled(model, wrong), right, rtol=0, atol=0)


@pytest.mark.parametrize("noise", [NOISE, 0.0])
def test_what_is_right_stays_as_it_is(noise):
    for body, tips in ((ARM, (0, 1)), (LONG, (0, 1, 2)), (LONG, (0, 2)), (LONG, (1, 2)), (PENDULUM, (0,))):
        model, right = seen(body, tips, noise=noise)
        right[[20, 70], :2] = torch.nan
        right[30] = torch.nan
        right[40, :2] += 0.5  # astray, and no other keypoint's
        torch.testing.assert_close(relabelled(model, right), right, rtol=0, atol=0, equal_nan=True)
    model, angles = seen(ARM, (), encoders=2)
    torch.testing.assert_close(relabelled(model, angles), angles, rtol=0, atol=0)


def test_a_picture_of_another_size_tells_nothing():
    """Lengths that are off everywhere: what is exchanged stays for the effect that exchanges labels."""
    model, right = seen()
    wrong = exchanged(1.2 * right, [10, 60], 0, 1)
    torch.testing.assert_close(relabelled(model, wrong), wrong, rtol=0, atol=0)

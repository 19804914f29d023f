"""The cubature filter on MuJoCo's engine against Kalman's own where the model is linear, and its columns."""

import numpy as np
import pytest
import torch

from invdyn.diagnosis.engine.cubature_filter import Filtered, apart, cubature_filter
from invdyn.models import Encoders, EngineModel, Observation
from invdyn.models.divergence import Diverged
from invdyn.models.engine.drives import Given

CART = """<mujoco><option timestep="0.005" integrator="Euler" gravity="0 0 0"/><worldbody><body>
  <joint name="rail" type="slide" axis="1 0 0"/><geom size=".1" mass="2"/></body></worldbody>
  <actuator><motor name="push" joint="rail"/></actuator></mujoco>"""


def cart(rows=40, force=None):
    force = np.sin(np.arange(rows))[:, None] if force is None else force
    known = {"noise.angle": 1e-3, "noise.velocity": 0.02, "emission.angle_scale": 0.01, "torque.decay": 20.0,
             "torque.scale": 1.0, "initial.angle_scale": 0.1, "initial.velocity_scale": 0.2}  # fmt: skip
    return EngineModel(CART, np.arange(rows) * 0.01, Observation(Encoders()), parameters=known, given=Given(force))


def by_kalman(model, rows, force, size):
    """Log density of rows: the cart's chain is linear, two steps of Euler a row."""
    h, n, fade = 0.005, 2, np.exp(-20.0 * 0.01)
    share = 1 - (np.arange(n) + 0.5) / n * (1 - fade)  # the drive on a line to its mean
    F, g = np.eye(3), np.zeros((3, 1))
    F[0, 0] = fade
    one = np.array([[1, h], [0, 1]])
    own, push = np.zeros((2, 1)), np.zeros((2, 1))
    for k in range(n):
        own, push = one @ own + share[k] * np.array([[h * h], [h]]) / 2, one @ push + np.array([[h * h], [h]]) / 2
    F[1:, 1:], F[1:, :1], g[1:] = np.linalg.matrix_power(one, n), own, push
    root = size * np.sqrt((1 - fade**2) / 40)
    Q, m = np.diag([root**2, 1e-6, 4e-4]), np.zeros((3, 1))
    P, H, total = np.diag([size**2 / 40, 0.01, 0.04]), np.array([[0.0, 1.0, 0.0]]), 0.0
    for t, row in enumerate(rows):
        if np.isfinite(row):
            S, off = float((H @ P @ H.T)[0, 0]) + 1e-4, float(row - (H @ m)[0, 0])
            total += -0.5 * (np.log(2 * np.pi * S) + off**2 / S)
            K = P @ H.T / S
            m, P = m + K * off, P - K @ H @ P
        if t < len(rows) - 1:
            m, P = F @ m + g * force[t], F @ P @ F.T + Q
    return total


def test_evidence_is_kalmans_for_every_size():
    model, force = cart(), np.sin(np.arange(40))[:, None]
    _, rows = model.simulate(seed=1)
    rows = rows.numpy()
    rows[7] = np.nan
    sizes = np.array([1e-3, 1.0, 30.0])
    found = cubature_filter(model, rows, sizes)
    count = np.isfinite(rows).sum()
    log_density = -0.5 * (found.innovations**2).sum((1, 2)) - found.log_det.sum(1) - 0.5 * count * np.log(2 * np.pi)
    expected = [by_kalman(model, rows[:, 0], force[:, 0], size) for size in sizes]
    assert log_density == pytest.approx(np.array(expected), abs=1e-4)


@pytest.mark.parametrize("size", [1e80, 1e160])
def test_a_residual_that_no_number_holds_runs_away_and_is_no_error_of_a_matrix(size):
    model = cart()
    _, rows = model.simulate(seed=1)
    with np.errstate(all="ignore"), pytest.raises(Diverged):
        cubature_filter(model, rows.numpy() * size, np.array([size]))


def test_columns_are_what_an_input_changes():
    """A force that is larger by a little changes the innovations by its column."""
    force = np.sin(np.arange(40))[:, None]
    one, other = cart(), cart(force=1.1 * force)
    _, rows = one.simulate(seed=2)
    sizes = np.array([1e-3, 1.0])
    found, changed = (cubature_filter(each, rows.numpy(), sizes) for each in (one, other))
    states, steps = torch.as_tensor(found.mean[:, :-1]), torch.arange(1, 40)
    inputs = (other.moved(states, steps) - one.moved(states, steps)).numpy()
    columns = found.columns(inputs.swapaxes(0, 1)[..., None])[..., 0]
    assert changed.innovations == pytest.approx(found.innovations + columns, abs=1e-5)


def test_given_inputs_act_from_their_row_on():
    model = cart(force=np.arange(40.0)[:, None])
    state = torch.zeros(3, dtype=torch.float64)
    velocity = [float(model.transition(state, t).base_dist.loc[2]) for t in (1, 2, 5)]
    assert velocity == pytest.approx([0.0, 1 * 0.01 / 2, 4 * 0.01 / 2])


def test_nothing_is_carried_over_from_a_recording_to_the_next():
    model, sizes, rng = cart(), np.array([1e-3, 1.0]), np.random.default_rng(0)
    parts = [
        cubature_filter(model, model.simulate(seed=seed)[1].numpy()[:rows], sizes) for seed, rows in ((1, 12), (2, 9))
    ]
    inputs = [rng.normal(size=(rows - 1, 2, 3, 2)) for rows in (12, 9)]
    both = Filtered.joined(parts)
    assert both.innovations.shape == (2, 21, 1)
    expected = np.concatenate([own.columns(each) for own, each in zip(parts, inputs, strict=True)], 1)
    np.testing.assert_allclose(both.columns(apart(inputs)), expected)

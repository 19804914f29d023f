"""What bursts of torque would explain: two backward passes against one column a burst."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from pendulum import ARM, PENDULUM, recording_of

from invdyn.diagnosis.hypotheses.continuation import data_path
from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.rules import DEFAULT
from invdyn.diagnosis.sensitivity.bursts import burst_products
from invdyn.diagnosis.sensitivity.sensitivities import Columns, spans
from invdyn.diagnosis.sensitivity.whiten import filter_of, linear_of, whiten
from invdyn.recordings import Recording

LEVELS = np.array([DEFAULT.residual.spike_size, DEFAULT.residual.slab_sizes[0], DEFAULT.residual.slab_sizes[2]])


def columns_of(model, response, stretches):
    """K columns for each stretch of time: a constant torque on each joint while it lasts."""
    time, (starts, stops) = model.time.numpy(), np.array(stretches).T
    low, high = time[:-1, None], time[1:, None]
    lasts = np.clip((np.minimum(high, stops) - np.maximum(low, starts)) / (high - low), 0, 1)  # (T−1, W)
    g = (response[:, :, None, :] * lasts[:, None, :, None]).reshape(len(response), response.shape[1], -1)
    return Columns(g, np.zeros((len(time), model.observation_dim, g.shape[-1])))


def uneven() -> Recording:
    """An arm with rows at odd times, one keypoint missing in some."""
    whole = recording_of(body=ARM, rows=90)
    rows = np.sort(np.random.default_rng(1).choice(90, 70, replace=False))
    keypoints = whole.keypoints.copy()
    keypoints[20:30, 0] = np.nan
    kept = keypoints[rows]
    return Recording(
        whole.time[rows],
        kept,
        whole.keypoint_names,
        torques=whole.torques[rows],
        joint_names=whole.joint_names,
    )


@pytest.mark.quick("*-even", "True-uneven")
@pytest.mark.parametrize("make", [lambda: recording_of(rows=60), uneven], ids=["even", "uneven"])
@pytest.mark.parametrize("short", [False, True])
def test_products_are_those_of_columns(make, short):
    recording = make()
    body = ARM if len(recording.joint_names) == 2 else PENDULUM
    here = diagnosis_problem(recording, body)
    model, (path, _), K = here.model, data_path(here), body.num_joints
    linear = linear_of(here, model, path)
    response = np.random.default_rng(0).normal(size=(model.num_steps - 1, model.state_dim, K))
    stretches = spans(model)
    if short:  # within a row, over the edge between two, at the last row's end
        first, last = model.time[[0, -1]].tolist()
        stretches = [(first + 0.1, first + 0.105), (first + 0.115, first + 0.125), (last - 0.01, last + 0.01)]
    about = filter_of(here, model, path, LEVELS, linear)
    whitened = whiten(here, about, columns_of(model, response, stretches))
    own, with_data, data = burst_products(about, response, model.time.numpy(), stretches)
    index = 1 + np.arange(len(stretches) * K).reshape(-1, K)
    expected = whitened.gram[:, index[:, :, None], index[:, None, :]]
    np.testing.assert_allclose(own, expected, rtol=1e-8, atol=1e-10 * np.abs(expected).max())
    expected = whitened.gram[:, index, 0]
    np.testing.assert_allclose(with_data, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())
    np.testing.assert_allclose(data, whitened.gram[:, 0, 0], rtol=1e-9)


def test_stretches_share_out_the_time():
    """A tenth of a second each, half of which they share: inner rows lie in two of them, whole."""
    model = diagnosis_problem(recording_of(rows=60), PENDULUM).model
    stretches = spans(model)
    columns = columns_of(model, np.ones((model.num_steps - 1, model.state_dim, 1)), stretches)
    time, starts = model.time.numpy(), [start for start, _ in stretches]
    np.testing.assert_allclose(np.diff(starts), DEFAULT.screening.burst_window / 2)
    share = columns.g[:, 0]  # (T−1, W)
    lengths = np.array([stop - start for start, stop in stretches])
    np.testing.assert_allclose((share * np.diff(time)[:, None]).sum(0), lengths, atol=1e-9)
    inner = (time[:-1] >= starts[1]) & (time[1:] <= starts[-1])
    np.testing.assert_allclose(share.sum(1)[inner], 2.0)


@pytest.mark.parametrize(("rows", "number"), [(2, 1), (4, 1), (6, 1), (8, 2), (10, 3)])
def test_a_short_recording_has_one_stretch_at_least(rows, number):
    """Of rows at fifty a second, within the recording, from its first row to its last."""
    model = SimpleNamespace(time=torch.arange(rows).double() / 50)
    stretches = spans(model)
    assert len(stretches) == number
    assert stretches[0][0] == 0.0
    assert stretches[-1][1] == pytest.approx(model.time[-1].item())

"""A recording whose clock counts seconds since 1970: no stretch of it is compared in single precision."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from pendulum import ARM, recording_of

from invdyn.diagnosis.problem.diagnosis_problem import diagnosis_problem
from invdyn.diagnosis.problem.stretches import left_out
from invdyn.models.effects import EFFECTS
from invdyn.models.effects.scale import Scale

UNIX = 1.7e9


def test_a_problem_counts_from_the_first_row():
    recording = recording_of(body=ARM, rows=40)
    plain = diagnosis_problem(recording, ARM)
    shifted = diagnosis_problem(replace(recording, time=recording.time + UNIX), ARM)
    torch.testing.assert_close(shifted.model.time, plain.model.time, rtol=0, atol=1e-6)
    assert shifted.problem.origin == UNIX + recording.time[0]
    (first, *_), (second, *_) = (
        EFFECTS["external_push"]("wrist").bound(ARM).parameters(each.model.scale)[2:] for each in (plain, shifted)
    )
    assert float(first.prior.high) == pytest.approx(float(second.prior.high), abs=1e-6)


def test_several_recordings_on_one_clock_are_joined_from_zero():
    recording = recording_of(body=ARM, rows=60)
    parts = [replace(recording, time=recording.time + UNIX).at(rows) for rows in (slice(0, 30), slice(30, 60))]
    time = diagnosis_problem(parts, ARM).model.time
    assert time[0] == 0
    np.testing.assert_allclose(np.diff(time), 0.02, atol=1e-6)


def test_the_time_of_a_push_is_bounded_in_double_precision():
    """Whatever clock a model has: a second since 1970 is one of 128 in single precision."""
    model = diagnosis_problem(recording_of(body=ARM, rows=40), ARM).model
    own = model.scale
    scale = Scale(own.dynamics, own.body, own.time + UNIX, own.command, own.motion, own.range, own.parts)
    _, _, moment, _ = EFFECTS["external_push"]("wrist").bound(ARM).parameters(scale)
    assert float(moment.prior.high - moment.prior.low) == pytest.approx(scale.duration, abs=1e-6)


def test_stretches_of_a_long_recording_are_named_from_its_first_row():
    time = np.arange(0, 400, 0.02) + UNIX
    recording = recording_of(body=ARM, rows=40)
    points = np.resize(recording.keypoints, (len(time), *recording.keypoints.shape[1:]))
    torques = np.resize(recording.torques, (len(time), 2))
    told = left_out([replace(recording, time=time, keypoints=points, torques=torques)])
    assert "e+09" not in told

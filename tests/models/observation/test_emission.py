"""What cameras and encoders see."""

import numpy as np
import pytest
import torch
from scipy.stats import norm, t

from invdyn.models import Emission

F64 = torch.float64
TIPS = torch.tensor([[0.3, 0.1], [0.5, -0.2], [0.9, 0.4]], dtype=F64)
ANGLES = torch.tensor([0.1, -0.7, 2.0], dtype=F64)


def parameters(emission, **given):
    values = {**emission.defaults(0.02), **{f"emission.{name}": value for name, value in given.items()}}
    return {name: torch.as_tensor(value, dtype=F64) for name, value in values.items()}


@pytest.mark.parametrize("family", ["gaussian", "student_t"])
def test_density_of_a_row(family):
    emission = Emission([2, 0], 3, family=family)
    p = parameters(emission, keypoint_scale=[0.01, 0.03], angle_scale=[0.1, 0.2, 0.3])
    assert emission.size == 7
    y = torch.randn(7, dtype=F64)
    mean = np.concatenate([TIPS[2], TIPS[0], ANGLES])  # in the recording's order of tips
    scale = np.array([0.01, 0.01, 0.03, 0.03, 0.1, 0.2, 0.3])
    law = norm if family == "gaussian" else t(4.0)
    expected = (law.logpdf((y.numpy() - mean) / scale) - np.log(scale)).sum()
    found = emission.distribution(TIPS, ANGLES, 0, p).log_prob(y)
    assert found.item() == pytest.approx(expected, rel=1e-9)


def confident(confidence):
    emission = Emission([0, 1], confidence=np.asarray(confidence))
    p = parameters(emission, keypoint_scale=[0.01, 0.02], confidence_slope=[1.5, 0.5])
    rows = torch.arange(len(confidence))
    law = emission.distribution(TIPS.expand(len(rows), 3, 2), ANGLES.expand(len(rows), 3), rows, p)
    return law.base_dist.scale.numpy()


CONFIDENCE = np.array([[0.9, 0.2], [0.5, 0.8], [0.99, 0.8], [0.1, 0.3]])


def test_noise_falls_with_confidence():
    scale = confident(CONFIDENCE)
    for point, columns in ((0, scale[:, 0]), (1, scale[:, 2])):
        order = np.argsort(CONFIDENCE[:, point], kind="stable")
        assert (np.diff(columns[order]) <= 0).all()
        assert columns[order[0]] > columns[order[-1]]
    assert np.array_equal(scale[:, ::2], scale[:, 1::2])  # x and y alike
    # the surest ones have the plain noise, and equal ones are equal
    assert scale[2, 0] == pytest.approx(0.01)
    assert scale[1, 2] == scale[2, 2] == pytest.approx(0.02)
    # γ (1 − rank): the least sure of four, rank ¼
    assert scale[3, 0] == pytest.approx(0.01 * np.exp(1.5 * 0.75))


@pytest.mark.parametrize("change", [lambda c: c**3, lambda c: 100 * c - 7, lambda c: np.log(c)])
def test_only_the_order_of_confidences_matters(change):
    assert np.array_equal(confident(change(CONFIDENCE)), confident(CONFIDENCE))


def test_a_missing_confidence_is_the_lowest():
    gappy = CONFIDENCE.copy()
    gappy[1, 0] = np.nan
    assert confident(gappy)[1, 0] == confident(gappy)[:, 0].max()


def test_a_row_as_an_int_and_as_a_tensor():
    emission = Emission([0, 1], confidence=CONFIDENCE)
    p = parameters(emission)
    rows = emission.distribution(TIPS.expand(4, 3, 2), ANGLES.expand(4, 3), torch.arange(4), p)
    for i in range(4):
        one = emission.distribution(TIPS, ANGLES, i, p)
        assert torch.equal(one.base_dist.scale.expand(4), rows.base_dist.scale[i])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(([0], 0, "cauchy"), "gaussian, student_t, got 'cauchy'"), (([], 0), "at least one tracked tip")],
)
def test_nonsense_is_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        Emission(*arguments)

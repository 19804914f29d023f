"""Cosine and sine as programs: how exact they are, and that machine code and torch agree to the bit."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from trees import paper_arm, random_state

from invdyn.models.dynamics.spatial.dynamics import SpatialDynamics
from invdyn.models.dynamics.traced.sincos import turned

WIDEST = {torch.float32: 1e4, torch.float64: 1e6}


@pytest.mark.parametrize("dtype", list(WIDEST))
@pytest.mark.parametrize("share", [1e-6, 1e-3, 1.0])
def test_error_is_within_the_types_epsilon(dtype, share):
    generator = torch.Generator().manual_seed(0)
    unit = 2 * torch.rand(100_000, generator=generator, dtype=torch.float64) - 1
    angles = (share * WIDEST[dtype] * unit).to(dtype)
    exact = angles.numpy().astype(np.longdouble)
    found = turned(angles)
    for word, function in (("cos", np.cos), ("sin", np.sin)):
        error = np.abs(found[word].numpy() - function(exact)).max()
        assert error < torch.finfo(dtype).eps


@pytest.mark.parametrize("dtype", list(WIDEST))
def test_quarter_turns_and_what_is_no_angle(dtype):
    quarters = torch.arange(-9, 10, dtype=dtype)
    found = turned(quarters * (torch.pi / 2))
    tolerance = 20 * torch.finfo(dtype).eps  # of the angles' own rounding
    expected = torch.tensor([1.0, 0.0, -1.0, 0.0], dtype=dtype)
    torch.testing.assert_close(found["cos"], expected[quarters.long() % 4], atol=tolerance, rtol=0)
    torch.testing.assert_close(found["sin"], expected[(quarters.long() + 3) % 4], atol=tolerance, rtol=0)
    odd = turned(torch.tensor([torch.nan, torch.inf, -torch.inf], dtype=dtype))
    assert odd["cos"].isnan().all()
    assert odd["sin"].isnan().all()


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_any_angle_gives_a_point_of_the_circle(angle):
    found = turned(torch.tensor([angle], dtype=torch.float64))
    length = torch.hypot(found["cos"], found["sin"]).item()
    assert length == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("dtype", list(WIDEST))
def test_machine_code_is_torchs_of_wild_angles(dtype):
    pytest.importorskip("llvmlite")
    tree, (q, qd, tau) = paper_arm(), random_state(4, 0, (40,), dtype)
    p = tree.parameters(dtype)
    for factor in (1.0, 1e3, 1e8, 1e20):
        fast, slow = (SpatialDynamics(tree, after).forward(factor * q, qd, tau, p) for after in (0, float("inf")))
        assert torch.equal(fast, slow)

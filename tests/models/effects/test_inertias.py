"""A link with a point mass is the two bodies together, by their sums of m r rᵀ about the joint."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from invdyn.models.effects.inertias import Inertia

POINTS = st.tuples(*[st.floats(-0.5, 0.5)] * 3)


def about_the_joint(mass, com, moments):
    """The tensor (3, 3) kg·m² about the frame's origin."""
    xx, yy, zz, xy, xz, yz = moments
    own = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return own + mass * (np.dot(com, com) * np.eye(3) - np.outer(com, com))


@given(st.floats(0.01, 3.0), POINTS, POINTS)
def test_a_load_adds_its_own_moments(mass, com, at):
    moments = (0.02, 0.03, 0.04, 0.001, -0.002, 0.003)
    own = Inertia(*(torch.tensor(value, dtype=torch.float64) for value in ([1.2], com, moments)))
    both = own.loaded(torch.tensor([mass], dtype=torch.float64), torch.tensor(at, dtype=torch.float64))
    assert both.mass.item() == pytest.approx(1.2 + mass)
    np.testing.assert_allclose(both.mass * both.com, 1.2 * np.array(com) + mass * np.array(at), atol=1e-12)
    summed = about_the_joint(1.2, com, moments) + about_the_joint(mass, at, np.zeros(6))
    found = about_the_joint(both.mass.item(), both.com.numpy(), both.moments.numpy())
    np.testing.assert_allclose(found, summed, rtol=0, atol=1e-12)


def test_in_the_plane_it_is_the_same_about_one_axis():
    own = Inertia(*(torch.tensor([value], dtype=torch.float64) for value in (1.2, 0.1, 0.03)))
    both = own.loaded(*(torch.tensor([value], dtype=torch.float64) for value in (0.5, 0.3)))
    about = both.moments + both.mass * both.com**2
    assert about.item() == pytest.approx(0.03 + 1.2 * 0.1**2 + 0.5 * 0.3**2)

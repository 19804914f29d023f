"""Each scheme draws N W_i copies of particle i on average, and never one of weight zero."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from invdyn.inference import RESAMPLERS, ess, resample

EVERY = pytest.mark.parametrize("scheme", RESAMPLERS)


def counts(index, size):
    """How often each particle was chosen, (M, N)."""
    return torch.zeros(len(index), size).scatter_add_(1, index, torch.ones(index.shape))


@EVERY
@pytest.mark.parametrize("concentration", [0.1, 1.0, 20.0])
def test_counts_are_unbiased(scheme, concentration):
    size, runs = 12, 20_000
    weights = torch.distributions.Dirichlet(torch.full((size,), concentration).double()).sample()
    seen = counts(resample(weights.log().expand(runs, size), scheme), size).double()
    expected = size * weights
    # no whole-numbered count varies less than one that is only rounded up or down
    least = torch.sqrt(expected.frac() * (1 - expected.frac()))
    error = torch.maximum(seen.std(0), least) / runs**0.5
    assert ((seen.mean(0) - expected).abs() <= 4.5 * error + 1e-9).all()


@pytest.mark.parametrize("scheme", ["systematic", "stratified", "residual"])
def test_counts_vary_less_than_those_of_independent_draws(scheme):
    weights = torch.tensor([0.31, 0.22, 0.17, 0.13, 0.09, 0.08]).double()
    seen = counts(resample(weights.log().expand(5000, 6), scheme), 6)
    assert (seen.var(0) < 0.9 * 6 * weights * (1 - weights)).all()
    if scheme != "stratified":  # these two stay within one of N W, or keep its whole part
        assert (seen >= torch.floor(6 * weights)).all()
    if scheme == "systematic":
        assert (seen <= torch.ceil(6 * weights)).all()


def test_multinomial_counts_have_the_variance_of_independent_draws():
    weights = torch.tensor([0.31, 0.22, 0.17, 0.13, 0.09, 0.08]).double()
    seen = counts(resample(weights.log().expand(20_000, 6), "multinomial"), 6)
    assert seen.var(0) / (6 * weights * (1 - weights)) == pytest.approx(np.ones(6), abs=0.05)


@EVERY
@settings(max_examples=60)
@given(
    st.lists(
        st.one_of(
            st.just(-np.inf),
            st.floats(-800, 0),
            st.floats(-1e-6, 0),
            st.floats(-1e30, -1e3),
        ),
        min_size=1,
        max_size=40,
    ).filter(lambda logs: max(logs) > -np.inf),
    st.sampled_from([torch.float32, torch.float64]),
    st.floats(-1e4, 1e4),
)
def test_indices_exist_are_sorted_and_never_of_weight_zero(scheme, logs, dtype, offset):
    log_weights = torch.tensor([logs, logs[::-1]], dtype=dtype) + offset  # need not be normalised
    index = resample(log_weights, scheme)
    assert index.shape == log_weights.shape
    assert index.dtype == torch.int64
    assert (index >= 0).all()
    assert (index < len(logs)).all()
    assert (index.diff(dim=-1) >= 0).all()
    weights = torch.softmax(log_weights.double(), -1)
    assert (weights.gather(-1, index) > 0).all()


@EVERY
@pytest.mark.parametrize("size", [1, 2, 100_000, 300_001])
def test_float32_weights_of_many_particles_never_give_an_index_that_does_not_exist(scheme, size):
    log_weights = torch.randn(3, size)
    log_weights[:, -1] = -torch.inf if size > 1 else 0.0  # rounding at the end would choose this one
    for _ in range(3):
        index = resample(log_weights, scheme)
        assert index.max() < max(1, size - 1)
        assert index.min() >= 0


@EVERY
def test_the_uniform_draw_at_its_extremes(scheme, monkeypatch):
    """Zero, and the largest double below one, for each of the draws."""
    weights = torch.tensor([[0.0, 0.1, 0.2, 0.0, 0.3, 0.4, 0.0]]).double()
    for value in (0.0, 1 - 2**-53):
        monkeypatch.setattr(torch, "rand", lambda *size, value=value, **kw: torch.full(size, value, **kw))
        index = resample(weights.log(), scheme)
        assert (weights.gather(-1, index) > 0).all()
        assert (index.diff() >= 0).all()


@EVERY
def test_equal_weights_leave_each_particle_once(scheme):
    index = resample(torch.zeros(2, 1000), scheme)
    if scheme == "multinomial":
        # the share of distinct ones is 1 − 1/e, with sd 0.01
        assert len(set(index[0].tolist())) / 1000 == pytest.approx(1 - np.exp(-1), abs=0.05)
    else:
        assert torch.equal(index, torch.arange(1000).expand(2, 1000))


@EVERY
def test_filters_are_resampled_independently_of_their_neighbours(scheme):
    weights = torch.tensor([[0.0, 1.0, 0.0], [0.5, 0.0, 0.5], [0.0, 0.0, 1.0]]).log()
    index = resample(weights, scheme)
    assert index[0].tolist() == [1, 1, 1]
    assert set(index[1].tolist()) <= {0, 2}
    assert index[2].tolist() == [2, 2, 2]


def test_an_unknown_scheme_is_refused():
    with pytest.raises(ValueError, match="systematic, stratified, residual, multinomial, got 'stratifed'"):
        resample(torch.zeros(1, 3), "stratifed")


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_ess(dtype):
    weights = torch.distributions.Dirichlet(torch.full((50,), 0.3).double()).sample((4,))
    expected = 1 / weights.square().sum(-1)
    found = ess((weights.log() - 700).to(dtype))
    assert found.dtype == torch.float64
    torch.testing.assert_close(found, expected, rtol=1e-12 if dtype == torch.float64 else 2e-4, atol=0)
    assert ess(torch.zeros(7, dtype=dtype)).item() == pytest.approx(7)
    assert ess(torch.tensor([0.0, -torch.inf], dtype=dtype)).item() == pytest.approx(1)

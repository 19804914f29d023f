"""Filters and smoothers in windows of rows give the bits of the whole."""

import pytest
import torch

from invdyn.inference import Bootstrap, Controlled, ParticleFilter, backward_simulation, gauss_newton, genealogy
from invdyn.inference.filters import windows
from invdyn.inference.filters.windows import window_rows
from invdyn.models import LinearGaussian

ROWS, FILTERS, PARTICLES = 40, 3, 20


def chain():
    torch.manual_seed(0)
    eye = torch.eye(2, dtype=torch.float64)
    model = LinearGaussian(
        transition=0.9 * eye,
        transition_covariance=0.2 * eye,
        emission=eye[:1],
        emission_covariance=0.1 * eye[:1, :1],
        mean=torch.zeros(2, dtype=torch.float64),
        covariance=eye,
        num_steps=ROWS,
    )
    return model, model.simulate()[1]


@pytest.mark.parametrize("guided", [False, True])
def test_windows_have_the_bits_of_the_whole(monkeypatch, guided):
    """Evidence, ancestral lines, simulated paths, and again: what is made once more stays the same."""
    monkeypatch.setattr(windows, "WHOLE", 0)
    model, y = chain()
    y[7:9] = torch.nan
    guide = Controlled(model, y, gauss_newton(model, y)) if guided else Bootstrap(model)
    filters = ParticleFilter(model, guide, PARTICLES, num_filters=FILTERS)
    whole, parts = (filters.run(y, seed=1, windows=each) for each in (False, True))
    assert len(parts.states) == ROWS % 6
    assert parts.rows == ROWS
    for name in ("log_evidence", "log_evidence_increment", "ess", "resampled"):
        assert torch.equal(getattr(whole, name), getattr(parts, name))
    for smooth in (genealogy, lambda result, count: backward_simulation(model, result, y, count)):
        found = []
        for result in (whole, parts, parts):
            torch.manual_seed(2)
            found.append((smooth(result, 4), torch.rand(1)))
        for paths, then in found[1:]:
            assert torch.equal(found[0][0], paths)
            assert torch.equal(found[0][1], then)  # no random number more was drawn


def test_windows_have_the_root_of_all_rows_where_these_take_much():
    """Of 10,000 rows 100 each; up to 400 MB are kept whole, 4 (6 + 3) bytes a particle."""
    assert window_rows(10_000, 32 * 100, 6) == 100
    assert window_rows(3472, 32 * 100, 6) == 3472

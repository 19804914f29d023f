"""What was not seen adds nothing; what was seen beside it keeps its density and its gradient."""

import math

import pyro.distributions as dist
import pytest
import torch
from pyro import poutine

from invdyn.models.observation.missing import gaussian_rows, observe, observed_log_prob

F64 = torch.float64
NAN = torch.nan
LOC = torch.tensor([0.3, -0.2, 1.1], dtype=F64)
TRIL = torch.tensor([[0.5, 0.0, 0.0], [0.2, 0.8, 0.0], [-0.3, 0.1, 0.4]], dtype=F64)

EMISSIONS = {
    "normal": lambda loc: dist.Normal(loc, TRIL.diagonal()).to_event(1),
    "student": lambda loc: dist.StudentT(3.0, loc, TRIL.diagonal()).to_event(1),
    "cauchy": lambda loc: dist.StudentT(torch.tensor(0.7, dtype=F64), loc, TRIL.diagonal()).to_event(1),
    "correlated": lambda loc: dist.MultivariateNormal(loc, scale_tril=TRIL),
}
EVERY = pytest.mark.parametrize("name", EMISSIONS)
ROWS = [[0.1, 0.4, 0.9], [NAN, 0.4, 0.9], [0.1, NAN, NAN], [NAN, NAN, NAN]]


def marginal(name, loc, row):
    """Log-density of what was seen, one row at a time."""
    seen = ~torch.isnan(row)
    if name == "correlated":
        if not bool(seen.any()):
            return torch.zeros((), dtype=F64)
        cov = (TRIL @ TRIL.mT)[seen][:, seen]
        return dist.MultivariateNormal(loc[seen], cov).log_prob(row[seen])
    return EMISSIONS[name](loc).base_dist.log_prob(row.nan_to_num())[seen].sum()


@EVERY
@pytest.mark.parametrize("values", ROWS)
def test_one_row_and_its_gradient(name, values):
    row = torch.tensor(values, dtype=F64)
    found, expected = (LOC.clone().requires_grad_() for _ in range(2))
    one = observed_log_prob(EMISSIONS[name](found), row)
    other = marginal(name, expected, row)
    torch.testing.assert_close(one, other)
    if row.isfinite().any():
        one.backward()
        other.backward()
        torch.testing.assert_close(found.grad, expected.grad)
    many = observed_log_prob(EMISSIONS[name](LOC.expand(2, 4, 3)), row)
    torch.testing.assert_close(many, one.detach().expand(2, 4))


@EVERY
def test_rows_at_once(name):
    rows = torch.tensor(ROWS, dtype=F64)
    loc = LOC + torch.randn(2, len(rows), 3, dtype=F64)
    expected = torch.stack(
        [torch.stack([marginal(name, m, y) for m, y in zip(path, rows, strict=True)]) for path in loc]
    )
    torch.testing.assert_close(observed_log_prob(EMISSIONS[name](loc), rows), expected)


@EVERY
@pytest.mark.parametrize("values", ROWS)
def test_a_pyro_site_holds_what_was_seen(name, values):
    row = torch.tensor(values, dtype=F64)

    def model():
        observe("y", EMISSIONS[name](LOC.expand(5, 3)), row)

    trace = poutine.trace(model).get_trace()
    if not row.isfinite().any():
        assert "y" not in trace.nodes
        return
    trace.compute_log_prob()
    assert trace.nodes["y"]["is_observed"]
    torch.testing.assert_close(trace.nodes["y"]["log_prob"], marginal(name, LOC, row).expand(5))


@EVERY
@pytest.mark.parametrize("values", ROWS)
def test_gaussian_rows_touch_the_log_density(name, values):
    """−½|W (y − h)|² + c has its value and its slope in h; for a Gaussian it is the density."""
    row = torch.tensor(values, dtype=F64)
    loc = LOC.clone().requires_grad_()
    emission = EMISSIONS[name](loc)
    with torch.no_grad():
        whitening, constant = gaussian_rows(emission, row)
    if whitening.ndim == 1:
        whitening = torch.diag(whitening)
    residual = torch.where(row.isfinite(), row, 0.0) - torch.where(row.isfinite(), loc, 0.0)
    value = constant - 0.5 * (whitening @ residual).square().sum()
    expected = observed_log_prob(emission, row)
    torch.testing.assert_close(value, expected, rtol=1e-12, atol=1e-12)
    if row.isfinite().any():
        slopes = [torch.autograd.grad(f, loc, retain_graph=True)[0] for f in (value, expected)]
        torch.testing.assert_close(*slopes)
    assert (whitening[~row.isfinite()] == 0).all()
    assert (whitening[:, ~row.isfinite()] == 0).all()


@EVERY
def test_gaussian_rows_of_many_parameter_sets(name):
    rows = torch.tensor(ROWS, dtype=F64)
    factors = torch.tensor([1.0, 2.0], dtype=F64)

    def emission(factor, loc):
        if name == "correlated":
            return dist.MultivariateNormal(loc, scale_tril=factor[..., None, None] * TRIL)
        scale = factor[..., None] * TRIL.diagonal()
        if name == "normal":
            return dist.Normal(loc, scale).to_event(1)
        return dist.StudentT(3.0, loc, scale).to_event(1)

    loc = torch.randn(2, 4, 3, dtype=F64)
    whitening, constant = gaussian_rows(emission(factors[:, None], loc), rows)
    for i, factor in enumerate(factors):
        for t in range(4):
            one, c = gaussian_rows(emission(factor, loc[i, t]), rows[t])
            torch.testing.assert_close(whitening[i, t], one)
            torch.testing.assert_close(constant[i, t], c)


def test_other_families_are_refused():
    with pytest.raises(TypeError, match="expected a Normal, StudentT or MultivariateNormal"):
        gaussian_rows(dist.Laplace(LOC, 1.0).to_event(1), torch.tensor(ROWS[0]))
    mixture = dist.MixtureOfDiagNormals(LOC.expand(2, 3), torch.ones(2, 3).double(), torch.zeros(2).double())
    assert math.isfinite(observed_log_prob(mixture, torch.tensor(ROWS[0], dtype=F64)))
    with pytest.raises(TypeError, match="where entries are missing"):
        observed_log_prob(mixture, torch.tensor(ROWS[1], dtype=F64))

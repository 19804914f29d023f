"""Evidence of a regression against the closed form of its marginal, and against integrals by quadrature."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import halfnorm, multivariate_normal, norm

from invdyn.diagnosis.sensitivity.evidence import regression

N = 60
COEFFICIENTS, SD = np.array([0.8, -0.5, 0.0]), np.array([1.5, 0.7, 2.0])


def data(seed=0, kappa=1.3):
    """Columns (N, 5): the data, those of three parameters, and an offset that they are shifted by."""
    rng = np.random.default_rng(seed)
    A, offset = rng.normal(size=(N, 3)), 2 * rng.normal(size=N)
    w = kappa * rng.normal(size=N) - A @ COEFFICIENTS
    return np.column_stack([w, A, offset])


def fitted(columns, index, offset=0, mean=None, sd=None, lower=None, upper=None, log_det=0.0):
    """The regression of one candidate."""
    index = np.array(index, int)[None]
    p = index.shape[1]
    mean = np.zeros(p) if mean is None else np.array(mean)
    sd = SD[:p] if sd is None else np.array(sd)
    lower = np.full(p, -np.inf) if lower is None else np.array(lower)
    upper = np.full(p, np.inf) if upper is None else np.array(upper)
    gram = columns.T @ columns
    return regression(gram, index, np.array([offset]), mean[None], sd[None], lower[None], upper[None], N, log_det)


def marginal(w, A, mean, sd, kappa):
    """Log N(w; −A μ, κ² I + A diag(s²) Aᵀ)."""
    return multivariate_normal.logpdf(w, -A @ mean, kappa**2 * np.eye(N) + (A * sd**2) @ A.T)


def test_evidence_is_that_of_the_marginal():
    columns, mean = data(), np.array([0.3, -0.2, 0.1])
    result = fitted(columns, [1, 2, 3], mean=mean, log_det=7.5)
    expected = marginal(columns[:, 0], columns[:, 1:4], mean, SD, result.kappa[0])
    assert result.log_evidence[0] == pytest.approx(expected - 7.5, abs=1e-8)


def test_posterior_is_that_of_the_joint_gaussian():
    """Conditioning of (φ, w_0) written out, instead of the information form."""
    columns, mean = data(), np.array([0.3, -0.2, 0.1])
    w, A = columns[:, 0], columns[:, 1:4]
    result = fitted(columns, [1, 2, 3], mean=mean)
    S = result.kappa[0] ** 2 * np.eye(N) + (A * SD**2) @ A.T
    across = -(A * SD**2).T  # Cov(φ, w_0)
    np.testing.assert_allclose(result.mean[0], mean + across @ np.linalg.solve(S, w + A @ mean), atol=1e-9)
    covariance = np.diag(SD**2) - across @ np.linalg.solve(S, across.T)
    np.testing.assert_allclose(result.covariance[0], covariance, atol=1e-9)
    sd = np.sqrt(np.diag(result.covariance[0]))
    assert (np.abs(result.mean[0] - COEFFICIENTS) < 4 * sd).all()


@pytest.mark.parametrize("kappa", [0.4, 1.0, 5.0])
def test_kappa_is_the_likeliest(kappa):
    columns = data(seed=3, kappa=kappa)
    result = fitted(columns, [1, 2, 3])

    def at(factor):
        return marginal(columns[:, 0], columns[:, 1:4], np.zeros(3), SD, factor * result.kappa[0])

    assert at(1.0) > max(at(0.97), at(1.03))
    # n = 60 squares: the sd of κ is κ/√120.
    assert abs(result.kappa[0] - kappa) < 4 * kappa / np.sqrt(2 * N)


@pytest.mark.parametrize("truth", [1.5, 0.05, -0.3])
def test_a_half_normal_parameter(truth):
    """Also where the data ask for values near the edge or below it."""
    rng = np.random.default_rng(4)
    A = rng.normal(size=N)
    w = rng.normal(size=N) - truth * A
    result = fitted(np.column_stack([w, A]), [1], lower=[0.0])
    kappa, sd = result.kappa[0], SD[0]
    shift = norm.logpdf(w, -max(truth, 0.0) * A, kappa).sum()

    def density(phi):
        return np.exp(norm.logpdf(w, -phi * A, kappa).sum() - shift) * halfnorm.pdf(phi, scale=sd)

    integral, _ = quad(density, 0.0, 4.0, points=[max(truth, 0.1)], limit=200)
    assert result.log_evidence[0] == pytest.approx(np.log(integral) + shift, abs=1e-6)


def test_a_bound_about_a_point_that_is_not_the_prior_mean():
    """As refinement asks: φ = point + change, the half-normal's edge at −point."""
    columns = data(seed=5)[:, :2]
    plain = fitted(columns, [1], lower=[0.0])
    point = 0.6
    moved = columns.copy()
    moved[:, 0] += point * columns[:, 1]
    other = fitted(moved, [1], mean=[-point], lower=[-point])
    assert other.log_evidence[0] == pytest.approx(plain.log_evidence[0], abs=1e-6)
    assert other.mean[0, 0] + point == pytest.approx(plain.mean[0, 0], abs=1e-6)


def test_an_offset_is_added_to_the_data():
    columns = data(seed=6)
    shifted = columns.copy()
    shifted[:, 0] += columns[:, 4]
    with_offset, plain = fitted(columns, [1, 2, 3], offset=4), fitted(shifted, [1, 2, 3])
    assert with_offset.log_evidence[0] == pytest.approx(plain.log_evidence[0], abs=1e-9)
    np.testing.assert_allclose(with_offset.mean, plain.mean, atol=1e-10)


def test_candidates_together_and_filled_up_are_those_alone():
    columns = data(seed=7)
    index = np.array([[1, 2, 3], [2, 0, 0], [0, 3, 0], [0, 0, 0]])
    offset = np.array([0, 4, 0, 4])
    lower = np.array([[0.0, -np.inf, -1.0], [0.0, 0.0, 0.0], [-np.inf, 0.0, -np.inf], [0.0, 0.0, 0.0]])
    sd, log_det = np.tile(SD, (4, 1)), np.array([1.0, 2.0, 3.0, 4.0])
    gram = columns.T @ columns
    upper = np.where(np.isfinite(lower), lower + 10.0, np.inf)
    together = regression(gram, index, offset, 0.1 * np.ones((4, 3)), sd, lower, upper, N, log_det)
    for h in range(4):
        used = index[h] > 0
        alone = regression(
            gram,
            index[h][used][None],
            offset[h : h + 1],
            np.full((1, used.sum()), 0.1),
            sd[h][used][None],
            lower[h][used][None],
            upper[h][used][None],
            N,
            log_det[h],
        )
        assert together.log_evidence[h] == pytest.approx(alone.log_evidence[0], abs=1e-9)
        np.testing.assert_allclose(together.mean[h][used], alone.mean[0], atol=1e-10)
        np.testing.assert_allclose(together.covariance[h][np.ix_(used, used)], alone.covariance[0], atol=1e-10)
        assert together.kappa[h] == pytest.approx(alone.kappa[0])


def test_without_parameters_it_is_the_noise_alone():
    w = data()[:, 0]
    result = fitted(data(), [])
    assert result.kappa[0] == pytest.approx(np.sqrt((w**2).mean()))
    assert result.log_evidence[0] == pytest.approx(norm.logpdf(w, 0.0, result.kappa[0]).sum(), abs=1e-9)


@pytest.mark.parametrize("bounds", [(-0.3, 0.9), (-np.inf, 0.2), (2.0, 3.0), (-9.0, -7.0)])
def test_bounds_cut_prior_and_posterior(bounds):
    """Against the ratio of the two Gaussians' masses by quadrature, also where both are nearly nothing."""
    columns = data()
    free = fitted(columns, [1])
    cut = fitted(columns, [1], lower=[bounds[0]], upper=[bounds[1]])

    def log_mass(mean, sd):
        low, high = max(bounds[0], mean - 60 * sd), min(bounds[1], mean + 60 * sd)
        edge = np.clip(mean, low, high)  # the density's largest value, taken out of the integral
        top = norm.logpdf(edge, mean, sd)
        nearest = np.sort(edge + np.array([-1, 1]) * sd)
        inside = [x for x in nearest if low < x < high]
        return top + np.log(quad(lambda x: np.exp(norm.logpdf(x, mean, sd) - top), low, high, points=inside)[0])

    expected = log_mass(free.mean[0, 0], free.covariance[0, 0, 0] ** 0.5) - log_mass(0.0, SD[0])
    assert cut.log_evidence[0] - free.log_evidence[0] == pytest.approx(expected, rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("far", [np.inf, 1e14])
def test_a_candidate_that_runs_away_has_no_evidence_and_leaves_the_others_alone(far):
    """Beyond what numbers can hold, two columns that are alike make a matrix that nobody can invert."""
    columns = data()
    gram = columns.T @ columns
    index, p = np.array([[1, 2], [2, 3]]), 2
    settings = np.zeros(2, int), np.zeros((2, p)), np.ones((2, p)), np.full((2, p), -np.inf), np.full((2, p), np.inf)
    usual = regression(gram, index, *settings, N, 0.0)
    gram[1] *= far
    gram[:, 1] *= far
    beside = regression(gram, index, *settings, N, 0.0)
    assert beside.log_evidence[0] == -np.inf
    assert np.isnan(beside.mean[0]).all()
    assert beside.log_evidence[1] == usual.log_evidence[1]
    assert np.array_equal(beside.mean[1], usual.mean[1])

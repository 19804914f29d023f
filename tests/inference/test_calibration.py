"""The machinery of benchmarks/calibration.py: ranks that are uniform, and are seen not to be; a small calibration."""

import numpy as np
import pytest
from pages import script
from scipy.stats import kstest, norm

PRIOR, NOISE, DRAWS, SIMULATIONS = 1.0, 0.5, 40, 400
"""Of a conjugate example: x ~ N(0, PRIOR²), y ~ N(x, NOISE²)."""


@pytest.fixture(scope="module")
def calibration():
    return script("benchmarks/calibration.py")


def conjugate_ranks(calibration, widen=1.0, shift=0.0, seed=0, proposal=None):
    """u (1, S) of the exact posterior, ``widen`` times as wide and ``shift`` sds off; or by importance sampling."""
    rng = np.random.default_rng(seed)
    precision = 1 / PRIOR**2 + 1 / NOISE**2
    sd, out = precision**-0.5, []
    for _ in range(SIMULATIONS):
        truth = rng.normal(0, PRIOR)
        mean = rng.normal(truth, NOISE) / NOISE**2 / precision
        if proposal is None:
            draws, weights = rng.normal(mean + shift * sd, widen * sd, size=(DRAWS, 1)), np.full(DRAWS, 1 / DRAWS)
        else:
            draws = rng.normal(mean, proposal * sd, size=(10 * DRAWS, 1))
            weights = norm.pdf(draws[:, 0], mean, sd) / norm.pdf(draws[:, 0], mean, proposal * sd)
            weights /= weights.sum()
        out.append(calibration.uniform_ranks(draws, weights, np.array([truth]), rng))
    return np.array(out).T


def test_ranks_of_the_exact_posterior_are_uniform(calibration):
    u = conjugate_ranks(calibration)
    assert kstest(u[0], "uniform").pvalue > 0.05
    assert calibration.UniformBands(SIMULATIONS).p_value(u)[0] > 0.05
    assert calibration.chi_squared(u)[0] > 0.05


def test_equal_weights_give_the_rank_and_its_noise(calibration):
    draws = np.arange(4.0)[:, None]
    for rank, truth in enumerate((-1, 0.5, 1.5, 2.5, 9)):
        u = calibration.uniform_ranks(draws, np.full(4, 0.25), np.array([truth]), np.random.default_rng(0))
        assert rank / 5 <= u[0] < (rank + 1) / 5


def test_weighted_draws_rank_as_well(calibration):
    u = conjugate_ranks(calibration, proposal=2.0)
    assert calibration.UniformBands(SIMULATIONS).p_value(u)[0] > 0.05


@pytest.mark.parametrize(("widen", "shift"), [(0.6, 0.0), (1.7, 0.0), (1.0, 0.5)])
def test_a_posterior_that_is_wrong_is_found_out(calibration, widen, shift):
    u = conjugate_ranks(calibration, widen, shift)
    assert calibration.UniformBands(SIMULATIONS).p_value(u)[0] < 0.001
    assert calibration.chi_squared(u)[0] < 0.001


def test_bands_hold_a_whole_curve_as_often_as_they_say(calibration):
    uniform = calibration.UniformBands(100, num_samples=10_000)
    rng = np.random.default_rng(1)
    u = rng.uniform(size=(2000, 100))
    low, high = uniform.bands(0.1)
    curves = calibration.ecdf(u, uniform.grid)
    # Counts are whole numbers: not more often outside than one in ten, and little less.
    outside = 1 - ((low <= curves) & (curves <= high)).all(-1).mean()
    assert 0.06 < outside < 0.1 + 3 * np.sqrt(0.1 * 0.9 / 2000)
    # The test and the bands are one.
    p = uniform.p_value(u)
    assert np.abs((p <= 0.1).mean() - outside) < 0.02
    # A p-value is uniform, or a little above where it is discrete.
    assert (p < 0.5).mean() < 0.5 + 3 * np.sqrt(0.25 / 2000)


def test_the_distribution_function_counts(calibration):
    grid = np.array([0.25, 0.5, 0.75])
    u = np.array([[0.1, 0.5, 0.6, 0.9], [0.8, 0.2, 0.2, 0.2]])
    assert calibration.ecdf(u, grid).tolist() == [[0.25, 0.5, 0.75], [0.75, 0.75, 0.75]]


def test_a_method_without_draws_has_no_width(calibration):
    options = calibration.SETTINGS["differentiate"]
    u = np.array([calibration.simulate_and_rank("differentiate", number, *options[1:]) for number in range(20)])
    assert u.shape == (20, len(calibration.QUANTITIES))
    assert ((u < 0.02) | (u > 0.98)).all()


def test_an_arm_whose_refit_diverges_is_sampled_all_the_same(calibration):
    """The refitted guide of this one grows beyond all bounds; the guide it began with does not."""
    u = calibration.simulate_and_rank("smc", 60, *calibration.SETTINGS["smc"][1:])
    assert np.isfinite(u).all()
    assert all(0 < value < 1 for value in u)


@pytest.mark.slow
def test_smc_is_calibrated_and_mean_field_is_not(calibration):
    def p_values(method, count):
        options = calibration.SETTINGS[method]
        u = np.array([calibration.simulate_and_rank(method, n, *options[1:]) for n in range(1000, 1000 + count)]).T
        return calibration.UniformBands(count).p_value(u) * len(u)

    assert p_values("smc", 60).min() > 0.01
    assert p_values("svi", 15)[:6].min() < 0.001

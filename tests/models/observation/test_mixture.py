"""Rows of a tracker that errs: densities against sums written out, the Gauss–Newton bound, drawing."""

import itertools
import math

import numpy as np
import pytest
import torch
from scipy.stats import multivariate_normal, norm

from invdyn.models import ArmModel, Keypoints, Link, Observation, planar_body
from invdyn.models.effects import LabelSwap, Outliers
from invdyn.models.observation.missing import explained, gaussian_rows, observed_log_prob, times
from invdyn.models.observation.mixture import MistakenRows
from invdyn.models.observation.view import Outlier, Shift, Swap

F64 = torch.float64
POINTS = 3
LOC = np.array([0.1, 0.2, 0.5, -0.1, 0.9, 0.3, 1.2])  # three points and an encoder
SCALE = np.array([0.02, 0.02, 0.03, 0.03, 0.04, 0.04, 0.01])
RATE, WIDTH, FIRST, SECOND = 0.1, 0.5, 0.06, 0.03
MOVED = 0.3
ALONG = np.array([[0.2, -0.1], [0.3, 0.0], [-0.4, 0.2]])
BESIDE = np.array([[0.01, 0.02], [0.0, 0.03], [0.05, 0.0]])
ROWS = {
    "plain": LOC + 0.01,
    "shifted": LOC + np.append(1.4 * ALONG, 0.0) + 0.01,
    "stray": LOC + np.array([0.0, 0.0, 0.6, -0.4, 0.0, 0.0, 0.0]),
    "swapped": LOC[[2, 3, 0, 1, 4, 5, 6]] + 0.02,
    "half missing": np.where(np.arange(7) == 2, np.nan, LOC[[2, 3, 0, 1, 4, 5, 6]]),
    "one missing": np.where(np.arange(7) // 2 == 1, np.nan, LOC + 0.02),
    "unread": np.where(np.arange(7) == 6, np.nan, LOC),
    "nothing": np.full(7, np.nan),
}
EVERY = pytest.mark.parametrize("row", ROWS)
SHIFTED = pytest.mark.parametrize("shifted", [False, True], ids=["not shifted", "shifted"])


def tensor(value):
    return torch.tensor(value, dtype=F64)


def rows_of(loc=LOC, scale=SCALE, rate=RATE, outliers=1, shifted=False):
    shift = Shift(tensor([MOVED]), torch.as_tensor(ALONG), torch.as_tensor(BESIDE)) if shifted else None
    stray = Outlier(tensor([rate]), tensor([[WIDTH]]))
    swaps = [Swap(0, 1, tensor([FIRST])), Swap(1, 2, tensor([SECOND]))]
    return MistakenRows(torch.as_tensor(loc), torch.as_tensor(scale), (POINTS, 2), [stray] * outliers, swaps, shift)


def by_hand(y, loc=LOC, outliers=1, shifted=False):
    """Sum over orders, over which detections are stray and over whether the row is shifted."""
    seen = np.isfinite(y[:6])
    total = 0.0
    for weight, order in ((1 - FIRST - SECOND, (0, 1, 2)), (FIRST, (1, 0, 2)), (SECOND, (0, 2, 1))):
        for hits in itertools.product(range(outliers + 1), repeat=POINTS):
            term = weight
            mean = np.concatenate([loc[2 * k : 2 * k + 2] for k in order])
            variance = np.concatenate([SCALE[2 * k : 2 * k + 2] ** 2 for k in order])
            for p, count in enumerate(hits):
                term *= math.comb(outliers, count) * RATE**count * (1 - RATE) ** (outliers - count)
                variance[2 * p : 2 * p + 2] += count * WIDTH**2
            for moved in (False, True) if shifted else (False,):
                chance = (MOVED if moved else 1 - MOVED) if shifted else 1.0
                along, beside = (np.concatenate([part[k] for k in order]) for part in (ALONG, BESIDE))
                covariance = np.diag(variance + moved * beside**2) + moved * np.outer(along, along)
                density = multivariate_normal(mean[seen], covariance[np.ix_(seen, seen)]) if seen.any() else None
                total += term * chance * (density.pdf(y[:6][seen]) if density else 1.0)
    angle = norm.logpdf(y[6], loc[6], SCALE[6]) if np.isfinite(y[6]) else 0.0
    return math.log(total) + angle


@EVERY
@SHIFTED
@pytest.mark.parametrize("outliers", [0, 1, 2])
def test_density(row, outliers, shifted):
    y, emission = tensor(ROWS[row]), rows_of(outliers=outliers, shifted=shifted)
    expected = by_hand(ROWS[row], outliers=outliers, shifted=shifted)
    assert emission.log_prob(y).item() == pytest.approx(expected, abs=1e-9)
    assert observed_log_prob(emission, y).item() == pytest.approx(expected)


def test_density_of_batches():
    """Parameter sets (S, 1, 1) beside rows (T, O)."""
    rates, y = tensor([0.05, 0.2]).reshape(2, 1, 1), tensor(np.stack(list(ROWS.values())))
    loc = torch.as_tensor(LOC).expand(len(ROWS), 7)
    many = MistakenRows(loc, torch.as_tensor(SCALE), (POINTS, 2), [Outlier(rates, tensor([[WIDTH]]))], [])
    assert many.batch_shape == (2, len(ROWS))
    found = many.log_prob(y)
    for s in range(2):
        for t in range(len(ROWS)):
            alone = MistakenRows(
                loc[t], torch.as_tensor(SCALE), (POINTS, 2), [Outlier(rates[s, 0], tensor([[WIDTH]]))], []
            )
            torch.testing.assert_close(found[s, t], alone.log_prob(y[t]))


@EVERY
@SHIFTED
def test_gaussian_rows_touch_the_density_from_below(row, shifted):
    """−½|W (ỹ − h)|² + c has its value and slope at h, and is nowhere above it."""
    y = tensor(ROWS[row])
    loc = torch.as_tensor(LOC).clone().requires_grad_()
    emission = rows_of(loc, shifted=shifted)
    with torch.no_grad():
        whitening, constant = gaussian_rows(emission, y)
        target = explained(emission, y)
    whole = whitening if shifted else torch.diag(whitening)
    torch.testing.assert_close(times(whitening, target.unsqueeze(-1)), whole @ target.unsqueeze(-1))

    def bound(at):
        return constant - 0.5 * (whole @ (target - at).unsqueeze(-1)).square().sum((-2, -1))

    expected = observed_log_prob(emission, y)
    torch.testing.assert_close(bound(loc), expected)
    slopes = [torch.autograd.grad(f, loc, allow_unused=True)[0] for f in (bound(loc), expected)]
    torch.testing.assert_close(*(torch.zeros(7, dtype=F64) if slope is None else slope for slope in slopes))
    elsewhere = torch.as_tensor(LOC) + 0.05 * torch.randn(500, 7, generator=torch.Generator().manual_seed(1)).double()
    there = observed_log_prob(rows_of(elsewhere, shifted=shifted), y)
    assert bool((bound(elsewhere) <= there + 1e-9).all())
    if row in ("unread", "nothing"):  # what is missing of points that change places is another's
        missing = torch.isnan(y)
        assert not whole[missing].any()
        assert not whole[:, missing].any()


def test_a_swap_is_seen_where_it_belongs():
    y = tensor(ROWS["swapped"])
    assert explained(rows_of(), y).numpy() == pytest.approx(LOC[[0, 1, 2, 3, 4, 5, 6]] + 0.02, abs=1e-3)
    plain = torch.distributions.Normal(torch.as_tensor(LOC), torch.as_tensor(SCALE))
    assert explained(torch.distributions.Independent(plain, 1), y) is y


@pytest.mark.parametrize("outliers", [1, 2])
def test_which_detections_are_outliers(outliers):
    """By Bayes' rule, keypoint by keypoint, of a row as it stands; NaN where nothing is seen."""
    y = np.stack([ROWS["stray"], ROWS["half missing"], ROWS["one missing"]])
    found = rows_of(outliers=outliers).outlier_probability(torch.as_tensor(y)).numpy()
    assert np.argwhere(np.isnan(found)).tolist() == [[2, 1]]
    for row, point in np.argwhere(~np.isnan(found)):
        here = slice(2 * point, 2 * point + 2)
        seen = np.isfinite(y[row, here])
        off, sd = (y[row, here] - LOC[here])[seen], SCALE[here][seen]
        widths = [norm.pdf(off, 0, np.hypot(sd, math.sqrt(k) * WIDTH)).prod() for k in range(outliers + 1)]
        chance = [math.comb(outliers, k) * RATE**k * (1 - RATE) ** (outliers - k) for k in range(outliers + 1)]
        none, *some = np.array(widths) * chance
        assert found[row, point] == pytest.approx(sum(some) / (none + sum(some)))


def test_draws():
    torch.manual_seed(0)
    n = 40000
    # stray detections narrower than the distance between points, so that swaps can be counted
    emission = MistakenRows(
        torch.as_tensor(LOC),
        torch.as_tensor(SCALE) / 100,
        (POINTS, 2),
        [Outlier(tensor([RATE]), tensor([[0.01]]))],
        [Swap(0, 1, tensor([FIRST])), Swap(1, 2, tensor([SECOND]))],
    )
    y = emission.sample((n,)).numpy()
    near = np.abs(y[:, None, 0:2] - LOC[:6].reshape(3, 2)).sum(-1).argmin(-1)  # whose detection stands first
    assert (near == 1).mean() == pytest.approx(FIRST, abs=5 * math.sqrt(FIRST / n))
    third = np.abs(y[:, None, 4:6] - LOC[:6].reshape(3, 2)).sum(-1).argmin(-1)
    assert (third == 1).mean() == pytest.approx(SECOND, abs=5 * math.sqrt(SECOND / n))
    off = np.abs(y[near == 0, 0] - LOC[0]) > 0.002
    expected = RATE * 2 * norm.sf(0.2)
    assert off.mean() == pytest.approx(expected, abs=5 * math.sqrt(expected / n))
    error = y.std(0) / math.sqrt(n)
    assert (np.abs(y.mean(0) - emission.mean.numpy()) < 5 * error).all()
    assert emission.expand((2, 3)).sample().shape == (2, 3, 7)


def test_shifted_draws():
    """All detections of a shifted row are off by one and the same chance."""
    torch.manual_seed(1)
    n = 40000
    y = rows_of(rate=0.0, shifted=True).expand((n,))
    y.swaps = ()
    off = (y.sample() - y.loc)[:, :6].numpy()
    covariance = np.diag(SCALE[:6] ** 2 + MOVED * BESIDE.ravel() ** 2) + MOVED * np.outer(ALONG, ALONG)
    # Fourth moments of a mixture of a share ρ: three times the variance's square, over ρ.
    error = np.sqrt(np.outer(covariance.diagonal(), covariance.diagonal()) * 3 / MOVED / n)
    assert (np.abs(np.cov(off.T) - covariance) < 5 * error).all()


def test_rates_of_zero_are_no_mixture_and_have_slopes():
    rate = torch.zeros(1, dtype=F64, requires_grad=True)
    emission = MistakenRows(
        torch.as_tensor(LOC), torch.as_tensor(SCALE), (POINTS, 2), [Outlier(rate, tensor([[0.3]]))], [Swap(0, 1, rate)]
    )
    y = tensor(ROWS["plain"])
    value = emission.log_prob(y)
    assert value.item() == pytest.approx(norm.logpdf(ROWS["plain"], LOC, SCALE).sum())
    assert bool(torch.autograd.grad(value, rate)[0].isfinite().all())


def test_effects_know_the_recordings_order():
    """Tips tracked in another order than the body's, and not all of them."""
    body = planar_body("arm", [Link(f"l{k}", f"j{k}", f"t{k}", length=0.3, mass=1.0) for k in range(3)])
    model = ArmModel(body, 0.01 * np.arange(4), Observation(Keypoints([2, 0]))).with_effects(
        LabelSwap("t0", "t2"), Outliers()
    )
    values = {"effect.label_swap.t0.t2.rate": tensor([1.0])}
    x = torch.cat([torch.zeros(3), torch.tensor([0.3, 0.4, 0.5]), torch.zeros(3)]).to(F64)
    plain, swapped = model.emission(x, 1).mean, model.replace(**values).emission(x, 1).mean
    torch.testing.assert_close(swapped, plain[[2, 3, 0, 1]])
    with pytest.raises(ValueError, match="gaussian noise under outliers"):
        ArmModel(body, 0.01 * np.arange(4), Observation(Keypoints([0]), family="student_t")).with_effects(
            Outliers()
        ).emission(x, 1)

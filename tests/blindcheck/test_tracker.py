"""Forms of the camera and its tracker that not every generator has: against equations, and their statistics."""

import numpy as np
import pytest

from invdyn.blindcheck.engine import film_of_any_law as film
from invdyn.blindcheck.tracker import LAWS, noise_law
from invdyn.blindcheck.world import Trajectory

FINE = np.arange(0, 4, 1e-3)
FRAMES = np.arange(0.5, 3.5, 0.01)


def arm(time):
    """Two links that swing: heading (T, 2) and points (T, 3, 2)."""
    heading = np.stack([0.6 * np.sin(3 * time), 1.2 + 0.8 * np.sin(4 * time)], axis=-1)
    steps = np.array([0.3, 0.2])[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    tips = np.cumsum(steps, axis=1)
    return heading, np.concatenate([0 * tips[:, :1], tips], axis=1)


HEADING, POINTS = arm(FINE)
REAL = Trajectory(FINE, 0 * HEADING, 0 * HEADING, POINTS, HEADING, FINE[:1], np.zeros((1, 2)))
TRUE = arm(FRAMES)[1]
SEED = (1, 2, 3, 4)


def seed_of(law):
    """A reality whose tracker has this law."""
    return next(seed for seed in ((number, 2, 3, 4) for number in range(500)) if noise_law(seed) == law)


def seen(name, place=None, noise=0.0, seed=SEED, **parameters):
    return film(REAL, FRAMES, [(name, place, parameters)], noise, seed)


@pytest.mark.parametrize("present", [[], [("soft_tissue", 1, {"kappa": 4e-4, "damping_ratio": 0.9})]])
@pytest.mark.parametrize("rows", [slice(1000, 2000), slice(1, None)], ids=["a while", "but one"])
def test_nothing_is_seen_where_a_replay_diverges(present, rows):
    """Of some start of a fit; the rest of it is as it was."""
    points = POINTS.copy()
    points[rows] = np.nan
    start, end = FINE[rows][[0, -1]]
    since = FRAMES - start
    gone = (since > 0) & (since < end - start)
    paths = film(REAL._replace(points=points), FRAMES, present, 0.0, SEED)
    assert np.isnan(paths[gone]).any((1, 2)).all()
    assert gone.any()
    before = since < -0.02
    np.testing.assert_allclose(paths[before], film(REAL, FRAMES, present, 0.0, SEED)[before], atol=1e-6)


def test_nothing_is_seen_as_it_is():
    np.testing.assert_allclose(film(REAL, FRAMES, [], 0.0, SEED), TRUE, atol=1e-9)


def test_a_division_lens_is_the_radial_one_to_first_order():
    small = {"division": 1e-3}, {"k1": 1e-3}
    one, other = (seen("lens_distortion", **parameters) for parameters in small)
    change = np.abs(other - TRUE).max()
    assert np.abs(one - other).max() < 1e-3 * change
    r = np.linalg.norm(TRUE, axis=-1)
    points = seen("lens_distortion", division=0.5)
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), r / (1 - 0.5 * r**2), atol=1e-8)


@pytest.mark.parametrize("law", LAWS)
def test_noise_is_of_its_law(law):
    frames = np.linspace(0.5, 3.5, 4000)
    noise = film(REAL, frames, [], 2e-3, seed_of(law)) - film(REAL, frames, [], 0.0, seed_of(law))
    unit = noise / 2e-3
    assert unit.std() == pytest.approx(1.0, abs=0.02)  # of 24000 numbers, of which some are alike
    each = unit.std(axis=(0, 2))
    tails = (unit**4).mean() / (unit**2).mean() ** 2
    memory = np.mean(unit[1:] * unit[:-1])
    assert (np.ptp(each) > 0.1) == (law == "uneven")
    assert (0.08 < memory < 0.27) == (law == "trailing")
    if law == "rounded":
        assert tails == pytest.approx(2.7, abs=0.1)  # (3 + 1.8 + 6)/4
    if law == "heavy":
        assert tails > 3.5  # 4.5 in all, slow to come


def test_laws_are_met_as_often_as_they_say():
    met = [noise_law((number, 7, 7, 7)) for number in range(1000)]
    for law, share in LAWS.items():
        assert met.count(law) / 1000 == pytest.approx(share, abs=0.05)  # three standard deviations
    assert noise_law((5, 1, 1, 1, 1)) == noise_law((5, 1, 1, 1))  # another recording of the same reality


def test_noise_grows_with_speed_in_squares():
    quiet = film(REAL, FRAMES, [], 1e-3, SEED) - film(REAL, FRAMES, [], 0.0, SEED)
    noisy = seen("varying_noise", noise=1e-3, slope_in_squares=3.0) - film(REAL, FRAMES, [], 0.0, SEED)
    speed = np.linalg.norm(np.gradient(POINTS, FINE, axis=0), axis=-1)
    speed = np.stack([np.interp(FRAMES, FINE, column) for column in speed.T], axis=-1)
    np.testing.assert_allclose((noisy / quiet)[..., 0], np.sqrt(1 + 9 * speed**2), rtol=1e-4)


@pytest.mark.parametrize("longest", [1, 3])
def test_mistakes_come_in_rows_at_their_rate(longest):
    frames = np.linspace(0.5, 3.5, 20000)
    true = arm(frames)[1]
    swapped = film(REAL, frames, [("label_swap", 1, {"rate": 0.05, "in_a_row": longest})], 0.0, SEED)
    at = np.abs(swapped - true).max(axis=(1, 2)) > 1e-6
    assert at.mean() == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(swapped[at][:, [2, 1]], true[at][:, [1, 2]], atol=1e-8)
    rows = at[1:][at[:-1]].mean()  # how often one is followed by another
    assert (rows > 0.3) == (longest > 1)
    outlying = film(REAL, frames, [("outliers", None, {"rate": 0.05, "in_a_row": longest, "within": 0.6})], 0.0, SEED)
    off = np.abs(outlying - true).max(axis=2) > 1e-6
    assert off.mean() == pytest.approx(0.05, abs=0.01)
    assert np.abs(outlying).max() < 0.61


@pytest.mark.parametrize("uniform", [0.0, 1.0])
def test_jitter_has_its_sd(uniform):
    frames = np.linspace(0.5, 3.5, 20000)
    points = film(REAL, frames, [("timestamp_jitter", None, {"rate": 0.5, "sd": 0.002, "uniform": uniform})], 0.0, SEED)
    heading = np.arctan2(points[:, 1, 1], points[:, 1, 0])
    fast = np.abs(np.cos(3 * frames)) > 0.7
    when = (heading - 0.6 * np.sin(3 * frames))[fast] / (1.8 * np.cos(3 * frames[fast]))
    assert when.std() == pytest.approx(0.002, rel=0.05)
    assert (np.abs(when) < 1e-8).mean() == pytest.approx(0.5, abs=0.02)

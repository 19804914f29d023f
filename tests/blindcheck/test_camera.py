"""Each effect of the camera does what its equation says, on a track that is known in closed form."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from invdyn.blindcheck.camera import film, optics
from invdyn.blindcheck.world import Trajectory

STEP, SEED = 5e-4, (1, 2)
LENGTHS = np.array([0.3, 0.2])


def arm(time):
    """Angles (N, 2) of an arm that swings, and its points (N, 3, 2) and headings (N, 2)."""
    q = np.stack([-1.0 + 0.8 * np.sin(3 * time), 0.5 + 0.6 * np.cos(4 * time)], axis=-1)
    heading = np.cumsum(q, axis=1)
    links = LENGTHS[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    return q, np.concatenate([np.zeros((len(time), 1, 2)), np.cumsum(links, axis=1)], axis=1), heading


TIME = np.arange(-800, 8801) * STEP
FRAMES = np.arange(400) / 100
Q, POINTS, HEADING = arm(TIME)
REAL = Trajectory(TIME, Q, np.gradient(Q, TIME, axis=0), POINTS, HEADING, TIME[:1], Q[:1])
TRUE = arm(FRAMES)[1]


def seen(name, place=None, noise=0.0, frames=FRAMES, **parameters):
    return film(REAL, frames, [(name, place, parameters)], noise, SEED)


def test_without_effects_it_shows_the_points():
    np.testing.assert_allclose(film(REAL, FRAMES, [], 0.0, SEED), TRUE, atol=1e-6)
    noisy = film(REAL, FRAMES, [], 0.002, SEED)
    assert np.std(noisy - TRUE) == pytest.approx(0.002, rel=4 / np.sqrt(2 * TRUE.size))
    np.testing.assert_array_equal(noisy, film(REAL, FRAMES, [], 0.002, SEED))


def test_offset_turns_with_its_link():
    change = seen("keypoint_offset", 1, along=0.01, across=-0.02) - film(REAL, FRAMES, [], 0.0, SEED)
    heading = arm(FRAMES)[2][:, 1]
    expected = 0.01 * np.stack([np.cos(heading), np.sin(heading)], -1)
    expected += -0.02 * np.stack([-np.sin(heading), np.cos(heading)], -1)
    np.testing.assert_allclose(change[:, 2], expected, atol=1e-6)
    assert np.abs(change[:, :2]).max() == 0


def test_soft_tissue_lags_behind_the_acceleration():
    change = seen("soft_tissue", 1, kappa=1e-3) - film(REAL, FRAMES, [], 0.0, SEED)
    h = 1e-3
    before, now, after = (arm(FRAMES + shift)[1][:, 2] for shift in (-h, 0.0, h))
    np.testing.assert_allclose(change[:, 2], -1e-3 * (before - 2 * now + after) / h**2, atol=1e-6)


def test_soft_tissue_swings_by_itself():
    """δ̈ + 2ζω δ̇ + ω² δ = −p̈ by an ODE solver, steady at first."""
    kappa, ratio = 2e-3, 0.2
    track = REAL.points[:, 2]
    a = np.gradient(np.gradient(track, REAL.time, axis=0), REAL.time, axis=0)

    def slope(t, x):
        now = np.array([np.interp(t, REAL.time, column) for column in a.T])
        return np.r_[x[2:], -x[:2] / kappa - 2 * ratio * kappa**-0.5 * x[2:] - now]

    start = np.r_[-kappa * a[0], 0.0, 0.0]
    swung = solve_ivp(slope, REAL.time[[0, -1]], start, t_eval=FRAMES, rtol=1e-8, atol=1e-11, max_step=2e-3).y[:2].T
    change = seen("soft_tissue", 1, kappa=kappa, damping_ratio=ratio) - film(REAL, FRAMES, [], 0.0, SEED)
    np.testing.assert_allclose(change[:, 2], swung, atol=1e-6)
    assert np.abs(change[:, 2] - (seen("soft_tissue", 1, kappa=kappa) - TRUE)[:, 2]).max() > 1e-4


@pytest.mark.parametrize("effect", ["lens_distortion", "camera_yaw"])
def test_optics_about_a_centre_are_those_of_a_frame_there(effect):
    centre = np.array([0.07, -0.11])
    parameters = {"lens_distortion": {"k1": 0.3}, "camera_yaw": {"angle": 0.15, "distance": 1.5}}[effect]
    found = seen(effect, **parameters, centre_x=centre[0], centre_y=centre[1])
    expected = optics(TRUE - centre, {effect: (None, parameters)}) + centre
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert np.abs(found - seen(effect, **parameters)).max() > 1e-4


def test_scale_roll_and_lens():
    np.testing.assert_allclose(seen("camera_scale", scale=1.05), 1.05 * TRUE, atol=1e-6)
    rolled, complex_true = seen("camera_roll", angle=0.04), TRUE[..., 0] + 1j * TRUE[..., 1]
    np.testing.assert_allclose(rolled[..., 0] + 1j * rolled[..., 1], complex_true * np.exp(0.04j), atol=1e-6)
    radius = np.linalg.norm(TRUE, axis=-1, keepdims=True)
    np.testing.assert_allclose(seen("lens_distortion", k1=0.3), TRUE * (1 + 0.3 * radius**2), atol=1e-6)


def test_yaw_is_a_plane_turned_before_a_pinhole():
    angle, distance = 0.15, 1.5
    depth = distance + TRUE[..., 0] * np.sin(angle)
    expected = np.stack([TRUE[..., 0] * np.cos(angle), TRUE[..., 1]], -1) * distance / depth[..., None]
    np.testing.assert_allclose(seen("camera_yaw", angle=angle, distance=distance), expected, atol=1e-6)
    far = seen("camera_yaw", angle=angle, distance=1e6)
    np.testing.assert_allclose(far, TRUE * [np.cos(angle), 1.0], atol=1e-6)


def test_latency_and_rolling_shutter_look_at_other_times():
    np.testing.assert_allclose(seen("camera_latency", latency=0.03), arm(FRAMES - 0.03)[1], atol=1e-6)
    rolled = seen("rolling_shutter", readout=0.05)
    for point in range(3):
        when = FRAMES + 0.05 * rolled[:, point, 1]
        np.testing.assert_allclose(rolled[:, point], arm(when)[1][:, point], atol=1e-6)


def test_jitter_mistimes_its_share_of_frames():
    change = seen("timestamp_jitter", rate=0.3, sd=0.004) - TRUE
    mistimed = np.abs(change).max(axis=(1, 2)) > 1e-5
    assert abs(mistimed.mean() - 0.3) < 4 * np.sqrt(0.21 / len(FRAMES)) + 0.02
    velocity = np.gradient(TRUE[:, 2], FRAMES, axis=0)
    late = (change[:, 2] * velocity).sum(-1) / (velocity**2).sum(-1)  # to first order
    fast = np.linalg.norm(velocity, axis=-1) > 0.3
    # kurtosis of the mixture is 3/rate, so the variance's own sd is √((3/rate − 1)/n)
    assert np.mean(late[fast] ** 2) == pytest.approx(0.004**2, rel=3 * np.sqrt((3 / 0.3 - 1) / fast.sum()))


def test_outliers_and_swaps_come_at_their_rate():
    off = seen("outliers", rate=0.05, scale=0.2) - TRUE
    stray = np.abs(off).max(axis=-1) > 1e-5
    assert off[stray].std() == pytest.approx(0.2, rel=4 / np.sqrt(2 * off[stray].size))
    assert abs(stray.mean() - 0.05) < 4 * np.sqrt(0.05 * 0.95 / stray.size)
    swapped = seen("label_swap", 1, rate=0.04)
    exchanged = np.abs(swapped - TRUE).max(axis=(1, 2)) > 1e-4
    assert abs(exchanged.mean() - 0.04) < 4 * np.sqrt(0.04 * 0.96 / len(FRAMES))
    np.testing.assert_allclose(swapped[exchanged], TRUE[exchanged][:, [0, 2, 1]], atol=1e-6)
    np.testing.assert_array_equal(swapped, seen("label_swap", 0, rate=0.04))  # the same two, named from the other


def test_varying_noise_grows_with_speed():
    frames = np.arange(40000) * 1e-4
    points = arm(frames)[1]
    error = seen("varying_noise", noise=0.001, slope=4.0, frames=frames) - points
    speed = np.linalg.norm(np.gradient(points, frames, axis=0), axis=-1, keepdims=True)
    standard = error / (0.001 * (1 + 4.0 * speed))
    assert np.std(standard) == pytest.approx(1.0, rel=4 / np.sqrt(2 * standard.size))
    assert np.std(standard[speed[..., 0] > 1.0]) == pytest.approx(1.0, rel=0.05)


def test_one_effect_draws_nothing_from_another():
    both = [("outliers", None, {"rate": 0.05, "scale": 0.2}), ("timestamp_jitter", None, {"rate": 0.5, "sd": 0.01})]
    jitter = film(REAL, FRAMES, both[1:], 0.001, SEED)
    apart = np.abs(film(REAL, FRAMES, both, 0.001, SEED) - jitter).max(axis=-1) > 0
    alone = np.abs(film(REAL, FRAMES, both[:1], 0.0, SEED) - film(REAL, FRAMES, [], 0.0, SEED)).max(axis=-1) > 0
    np.testing.assert_array_equal(apart, alone)

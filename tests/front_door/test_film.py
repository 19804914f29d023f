"""Films have the right frames at the right times, show what was observed, and are whole or absent."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from PIL import Image

from invdyn.film import (
    FRAMES_PER_SECOND,
    MAX_SHOWN_FRAMES,
    Picture,
    arm_points,
    film_frames,
    force_lines,
    save_film,
    shown_frames,
    still_parts,
    write_gif,
)
from invdyn.plots import GREEN, ORANGE, VERMILION
from invdyn.recordings import InputError


def gif(path):
    """Frames (number, height, width, 3) and their durations, s."""
    with Image.open(path) as image:
        frames, durations = [], []
        for number in range(image.n_frames):
            image.seek(number)
            frames.append(np.asarray(image.convert("RGB")))
            durations.append(image.info["duration"] / 1000)
    return np.stack(frames), np.array(durations)


@pytest.mark.quick("2-*")
@pytest.mark.parametrize(("num_joints", "interval"), [(1, 0.03), (2, 1 / 30), (6, 0.047)])
def test_gif_shows_every_frame_at_the_recordings_speed(make_posterior, tmp_path, num_joints, interval):
    idata = make_posterior(num_joints, num_frames=25, frame_interval=interval)
    save_film(idata, tmp_path / "film.gif")
    frames, durations = gif(tmp_path / "film.gif")
    assert len(frames) == 25
    assert durations[:-1].sum() == pytest.approx(24 * interval, abs=0.0051)
    assert (np.abs(np.diff(frames.astype(float), axis=0)).max(axis=(1, 2, 3)) > 50).all(), "a frame stands still"
    assert list(tmp_path.iterdir()) == [tmp_path / "film.gif"]


def test_a_gif_has_the_colours_of_all_that_is_drawn(tmp_path):
    """A force's line is green, not the nearest of other colours."""
    inks = [np.full((2, 2, 3), np.round(255 * np.array(to_rgb(color))), np.uint8) for color in (GREEN, ORANGE)]
    write_gif(iter(inks), np.arange(2) / 10, tmp_path / "film.gif")
    np.testing.assert_array_equal(gif(tmp_path / "film.gif")[0], inks)


def test_axes_and_panels_are_named_for_what_they_show(make_posterior):
    """Axes as the posterior's coordinates; panels of activations, where it has some, below those of torques."""
    idata = make_posterior(1, num_frames=4)
    idata.posterior = idata.posterior.assign_coords(space=["x", "z"])
    activation = idata.posterior.torque.drop_vars("joint").rename(joint="activation_of")
    idata.posterior["activation"] = activation.assign_coords(activation_of=["biceps"])
    _, (axes,), panels = still_parts(idata, arm_points(idata), np.full((4, 1, 2), np.nan), None)
    assert [axes.get_xlabel(), axes.get_ylabel()] == ["x (m)", "z (m)"]
    joint = str(idata.posterior.joint.values[0])
    titles = [f"{joint} torque (N·m)", "biceps activation"]
    assert [each.get_title(loc="left") for each in panels] == titles


def test_background_is_white_and_stays(make_posterior, tmp_path):
    save_film(make_posterior(2, num_frames=5), tmp_path / "film.gif")
    frames, _ = gif(tmp_path / "film.gif")
    assert (frames == 255).all(axis=-1).mean() > 0.8


def test_a_fast_or_long_recording_shows_fewer_frames_at_the_same_speed():
    fast = shown_frames(np.arange(300) / 100)
    assert 100 / (fast[1] - fast[0]) <= FRAMES_PER_SECOND
    assert len(shown_frames(np.arange(10_000) / 30)) <= MAX_SHOWN_FRAMES
    np.testing.assert_array_equal(shown_frames(np.arange(90) / 30), np.arange(90))
    np.testing.assert_array_equal(shown_frames(0.03 * np.arange(90)), np.arange(90))


def test_gif_of_a_fast_recording_lasts_as_long(make_posterior, tmp_path):
    save_film(make_posterior(1, num_frames=101, frame_interval=0.01), tmp_path / "film.gif")
    frames, durations = gif(tmp_path / "film.gif")
    assert len(frames) == 34
    assert durations[:-1].sum() == pytest.approx(0.99, abs=0.005)


def test_observed_joints_are_drawn_where_seen_only(make_posterior):
    idata = make_posterior(2, num_frames=30)
    missing = np.isnan(idata.observed_data.position.values[:, 1, 0])
    seen, unseen = np.flatnonzero(~missing)[-1], np.flatnonzero(missing)[-1]
    idata.observed_data["position"][:, 0] = np.nan
    frames = list(film_frames(idata, np.array([unseen, seen])))
    color = 255 * np.array(to_rgb(VERMILION))
    # the trail is fainter, and the legend's own dot is in both
    unseen_pixels, seen_pixels = (np.abs(frame - color).max(axis=-1) < 40 for frame in frames)
    assert seen_pixels.sum() > 1.5 * unseen_pixels.sum() > 0


def test_forces_are_lines_from_where_they_act(make_posterior):
    """The largest is .3 of the size long; where a pair does not touch there is none. Those of joints are orange."""
    idata = make_posterior(1, num_frames=4, num_filters=2, num_draws=1)
    centre = np.full((2, 1, 4, 1, 3), [0.5, -0.2, 7.0])
    centre[:, :, 1], centre[0, :, 2] = np.nan, np.nan
    force = np.full(centre.shape, [0.0, 5.0, 0.0])
    force[:, :, 0] = [0.0, 10.0, 0.0]
    of = {"dims": ("chain", "draw", "time", "contact", "axis"), "coords": {"contact": ["floor-foot"]}}
    idata.posterior["contact_force"] = xr.DataArray(force, **of)
    idata.posterior["centre_of_pressure"] = xr.DataArray(centre, **of)
    found, inks = force_lines(idata, size=2.0)
    assert inks == [GREEN]
    assert found.shape == (1, 4, 2, 2)  # contact, time, ends, space: points of a row, as an overlay has them
    lines = found[0]
    np.testing.assert_allclose(lines[[0, 2]], [[[0.5, -0.2], [0.5, 0.4]], [[0.5, -0.2], [0.5, 0.1]]])
    assert np.isnan(lines[1]).all()
    overlay = SimpleNamespace(
        pixels=lambda points: 100 + 20 * points,
        pictures=lambda shown, _: iter(np.zeros((len(shown), 1, 1, 3))),
        size=(200, 200),
    )
    for over in (None, overlay):
        pushed, free = film_frames(idata, np.array([0, 1]), overlay=over)
        green = [np.all(frame == np.round(255 * np.array(to_rgb(GREEN))), axis=-1).sum() for frame in (pushed, free)]
        assert green[0] > green[1] + 50 > 50  # those of the legend are in both
    idata.posterior = idata.posterior.assign_coords(space=["x", "z"])
    borne = {"dims": ("chain", "draw", "time", "link", "axis"), "coords": {"link": ["shank"]}}
    idata.posterior["reaction_force"] = xr.DataArray(np.full(force.shape, [0.0, 0.0, -20.0]), **borne)
    idata.posterior["joint_centre"] = xr.DataArray(np.full(force.shape, [0.1, 3.0, 1.0]), **borne)
    found, inks = force_lines(idata, size=2.0)
    assert inks == [GREEN, ORANGE]
    np.testing.assert_allclose(found[:, 0], [[[0.5, 7.0], [0.5, 7.0]], [[0.1, 1.0], [0.1, 0.4]]])


def test_a_view_from_the_side_shows_forces_along_its_own_axes():
    picture = Picture(Figure().add_subplot(), [1, 2], "none")
    force = np.arange(6.0).reshape(1, 2, 3)
    points = np.zeros((2, 3))
    picture.show(points[None], points, [[0, 1]], points[:1], points[:0], force)
    (line,) = picture.forces.get_segments()
    np.testing.assert_array_equal(line, [[1, 2], [4, 5]])


def test_time_line_moves_with_time(make_posterior):
    idata = make_posterior(1, num_frames=31)
    first, last = film_frames(idata, np.array([5, 25]))
    height = first.shape[0]
    torques = slice(int(0.88 * height), int(0.90 * height))
    dark = [np.flatnonzero((frame[torques] < 60).all(axis=(0, 2))).mean() for frame in (first, last)]
    shift = (dark[1] - dark[0]) / first.shape[1]
    assert shift == pytest.approx(20 / 30, rel=0.15)  # 20 of 30 intervals, of axes almost as wide as the page


def test_the_picture_is_cropped_to_where_the_arm_goes(make_posterior):
    """An arm that stays in a tall and narrow place fills it, whatever its shape."""
    idata = make_posterior(2, num_frames=30)
    idata.posterior["position"][..., 0] *= 0.2
    idata.observed_data["position"][..., 0] *= 0.2
    arms = arm_points(idata)
    figure, (axes,), _ = still_parts(idata, arms, idata.observed_data.position.values, None)
    FigureCanvasAgg(figure).draw()
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    x, y = arms.reshape(-1, 2).T
    assert top - bottom < 1.4 * np.ptp(y)
    assert right - left < np.ptp(x) + 0.4 * np.ptp(y)
    assert left < x.min() < x.max() < right
    assert bottom < y.min() < y.max() < top


def test_over_a_film_the_picture_stays_within_its_own(make_posterior):
    idata = make_posterior(1, num_frames=20)
    pixels = arm_points(idata) * [10.0, -10.0] + [12.0, 15.0]  # of pictures 40 × 30 px
    _, (axes,), _ = still_parts(idata, pixels, idata.observed_data.position.values * 10 + 15, (30, 40))
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert -0.5 <= left < right <= 39.5
    assert -0.5 <= top < bottom <= 29.5  # v points down
    assert right - left < 39


def test_the_time_stands_above_the_picture(make_posterior):
    """Not over the film, in which it could not be read."""
    idata = make_posterior(1, num_frames=31)
    first, last = film_frames(idata, np.array([5, 25]))
    figure, (axes,), _ = still_parts(idata, arm_points(idata), idata.observed_data.position.values, None)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    top = first.shape[0] - axes.get_window_extent(canvas.get_renderer()).y1
    changed = np.abs(first.astype(int) - last).max(-1) > 50
    assert changed[: int(top) - 1, int(0.8 * first.shape[1]) :].any()


@pytest.mark.long
def test_still_parts_are_drawn_once_and_200_frames_take_few_megabytes(make_posterior, monkeypatch, tmp_path):
    idata, drawn, draw = make_posterior(2, num_frames=200, num_filters=64), [], FigureCanvasAgg.draw
    monkeypatch.setattr(FigureCanvasAgg, "draw", lambda self: (drawn.append(self), draw(self))[1])
    save_film(idata, tmp_path / "film.gif")
    assert len(drawn) == 1
    assert (tmp_path / "film.gif").stat().st_size < 4e6


def test_mp4_holds_every_frame(make_posterior, tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    save_film(make_posterior(2, num_frames=40), tmp_path / "film.mp4")
    count, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert count == 40
    assert seconds == pytest.approx(40 * 0.03, abs=0.05)
    assert list(tmp_path.iterdir()) == [tmp_path / "film.mp4"]


def test_progress_reaches_the_end(make_posterior, tmp_path):
    calls = []
    save_film(make_posterior(1, num_frames=8), tmp_path / "film.gif", lambda *call: calls.append(call))
    assert calls == [(number, 8, "film") for number in range(1, 9)]


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_interrupted_film_leaves_nothing(make_posterior, tmp_path, suffix):
    if suffix == "mp4":
        pytest.importorskip("imageio_ffmpeg")

    def stop(done, total, what):
        if done == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        save_film(make_posterior(1, num_frames=10), tmp_path / f"film.{suffix}", stop)
    assert not list(tmp_path.iterdir())


def test_mp4_without_its_extra_says_what_to_do(make_posterior, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"invdyn\[video\]"):
        save_film(make_posterior(1), tmp_path / "film.mp4")


def test_other_suffixes_are_refused(make_posterior, tmp_path):
    with pytest.raises(InputError, match=r"\.gif or \.mp4, got '\.avi'"):
        save_film(make_posterior(1), tmp_path / "film.avi")

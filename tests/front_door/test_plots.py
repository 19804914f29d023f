"""Figures show what the posterior holds, in its units, with nothing on top of the data."""

import arviz as az
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.image import imread

from invdyn.plots import plot_posterior, quantiles, save_figure


def panel(figure, title):
    (axes,) = [axes for axes in figure.axes if axes.get_title(loc="left") == title]
    return axes


def texts(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("num_joints", range(1, 7))
def test_every_joint_has_its_panels_with_units(make_posterior, num_joints):
    idata = make_posterior(num_joints)
    figure = plot_posterior(idata)
    assert len(figure.axes) == 3 * num_joints + 1
    for joint, tip in zip(idata.posterior.joint.values, idata.posterior.keypoint.values, strict=True):
        assert panel(figure, f"{tip} keypoint").get_ylabel() == "m"
        assert panel(figure, f"{joint} angle").get_ylabel() == "rad"
        assert panel(figure, f"{joint} torque").get_ylabel() == "N·m"


@pytest.mark.quick("1", "3")
@pytest.mark.parametrize("num_joints", [1, 3, 6])
def test_nothing_overlaps(make_posterior, num_joints):
    figure = plot_posterior(make_posterior(num_joints))
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.canvas.draw()
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes]
    boxes += [legend.get_window_extent(renderer) for legend in figure.legends]
    page = figure.bbox
    for number, box in enumerate(boxes):
        assert box.x0 >= page.x0 - 1
        assert box.x1 <= page.x1 + 1
        assert box.y1 <= page.y1 + 1
        for other in boxes[number + 1 :]:
            width = min(box.x1, other.x1) - max(box.x0, other.x0)
            height = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(width, height) < 1, "two panels, or a panel and the legend, cover each other"


def test_torque_panel_holds_median_bands_and_truth(make_posterior):
    idata = make_posterior(2)
    axes = panel(plot_posterior(idata), "elbow torque")
    low, lower, median, upper, high = quantiles(idata, "torque")[:, :, 1]
    ours, truth = axes.get_lines()
    np.testing.assert_allclose(ours.get_ydata(), median)
    np.testing.assert_allclose(truth.get_ydata(), idata.constant_data.truth_torque.values[:, 1])
    spans = [band.get_paths()[0].get_extents().intervaly for band in axes.collections]
    np.testing.assert_allclose(spans[0], [low.min(), high.max()])
    np.testing.assert_allclose(spans[1], [lower.min(), upper.max()])


def test_quantiles_are_of_all_draws(make_posterior):
    idata = make_posterior(2, num_filters=3, num_draws=50)
    draws = idata.posterior.torque.values.reshape(150, *idata.posterior.torque.shape[2:])
    expected = np.quantile(draws, (0.05, 0.25, 0.5, 0.75, 0.95), axis=0)
    np.testing.assert_allclose(quantiles(idata, "torque"), expected)


def test_keypoint_bands_include_the_observation_noise(make_posterior):
    idata = make_posterior(1, num_filters=20, noise=0.5)
    assert np.ptp(quantiles(idata, "position", "posterior_predictive"), axis=0).mean() > 1.2
    axes = panel(plot_posterior(idata), "elbow keypoint")
    (outer, *_) = axes.collections
    assert np.ptp(outer.get_paths()[0].get_extents().intervaly) > 2.0


def test_missing_keypoints_leave_gaps(make_posterior):
    idata = make_posterior(2)
    observed = idata.observed_data.position.values[:, 1]
    assert np.isnan(observed).any()
    dots = [line for line in panel(plot_posterior(idata), "wrist keypoint").get_lines() if line.get_marker() == "."]
    assert len(dots) == 2
    for space, line in enumerate(dots):
        np.testing.assert_array_equal(line.get_ydata(), observed[:, space])


def test_only_what_is_known_is_shown(make_posterior):
    with_truth, without = (plot_posterior(make_posterior(2, truth=truth)) for truth in (True, False))
    assert "truth" in texts(with_truth)
    assert "truth" not in texts(without)
    assert len(panel(without, "elbow torque").get_lines()) == 1
    idata = make_posterior(2, truth=False)
    idata.constant_data["command"] = (("time", "joint"), np.ones((60, 2)))
    figure = plot_posterior(idata)
    assert "command" in texts(figure)
    np.testing.assert_array_equal(panel(figure, "elbow torque").get_lines()[1].get_ydata(), np.ones(60))


@pytest.mark.parametrize("number", [2, 3])
def test_the_legend_names_as_many_axes_as_there_are(make_posterior, number):
    idata = make_posterior(2)
    if number == 3:
        groups = {
            name: idata[name].pad(space=(0, 1), constant_values=0.5)
            for name in idata.groups()
            if "space" in idata[name].dims
        }
        for name, group in groups.items():
            idata[name] = group
    assert texts(plot_posterior(idata))[: number + 1] == [*"xyz"[:number], "observed"]


def test_encoders_alone_are_enough(make_posterior):
    idata = make_posterior(2, angles=True)
    idata.observed_data = idata.observed_data.drop_vars("position")
    figure = plot_posterior(idata)
    dots = panel(figure, "elbow angle").get_lines()[1]
    np.testing.assert_array_equal(dots.get_ydata(), idata.observed_data.angle.values[:, 1])


def test_sample_sizes_with_a_mark_wherever_filters_resampled(make_posterior):
    idata = make_posterior(2)
    axes = panel(plot_posterior(idata), "effective sample size of the filters")
    median = np.median(idata.sample_stats.ess.values, axis=0)
    np.testing.assert_allclose(axes.get_lines()[0].get_ydata(), median)
    share = idata.sample_stats.resampled.values.mean(axis=0)
    resampled = share > 0
    marks = axes.collections[-1].get_segments()
    opacity = axes.collections[-1].get_colors()[:, 3]
    assert np.corrcoef(opacity, share[resampled])[0, 1] > 0.99
    np.testing.assert_allclose([mark[0, 0] for mark in marks], idata.posterior.time.values[resampled])
    assert "outer sample size" in axes.get_title(loc="right")


def test_filters_that_never_resampled_have_no_marks(make_posterior, tmp_path):
    idata = make_posterior(1)
    idata.sample_stats["resampled"][:] = False
    figure = plot_posterior(idata)
    save_figure(figure, tmp_path / "figure.png")
    assert "filters resampled" not in texts(figure)
    assert "filters resampled" in texts(plot_posterior(make_posterior(1)))


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_saves_whole_files(make_posterior, tmp_path, suffix):
    path = tmp_path / f"figure.{suffix}"
    save_figure(plot_posterior(make_posterior(2)), path)
    assert path.stat().st_size > 10_000
    assert list(tmp_path.iterdir()) == [path]


def test_png_is_drawn_not_blank(make_posterior, tmp_path):
    save_figure(plot_posterior(make_posterior(2)), tmp_path / "figure.png")
    image = imread(tmp_path / "figure.png")
    assert image.shape[1] == 1800
    assert 0.03 < (image[..., :3].min(axis=-1) < 0.9).mean() < 0.5


def test_interrupted_saving_leaves_nothing(make_posterior, tmp_path, monkeypatch):
    figure = plot_posterior(make_posterior(1))

    def stop(path, **_):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure, "savefig", stop)
    with pytest.raises(KeyboardInterrupt):
        save_figure(figure, tmp_path / "figure.png")
    assert not list(tmp_path.iterdir())


@pytest.mark.long
def test_many_frames_stay_quick(make_posterior, tmp_path):
    idata = make_posterior(2, num_frames=5000, num_filters=8)
    save_figure(plot_posterior(idata), tmp_path / "figure.pdf")
    assert (tmp_path / "figure.pdf").stat().st_size < 5e6
    assert isinstance(idata, az.InferenceData)

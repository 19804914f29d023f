"""Figures show what the posterior holds, in its units, with nothing on top of the data."""

import arviz as az
import numpy as np
import pytest
import xarray as xr
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from invdyn.plots import AXIS_COLORS, plot_posterior, quantiles, save_figure, usual_range
from invdyn.summary import quantity_table, summary_text


def panel(figure, title):
    (axes,) = [axes for axes in figure.axes if axes.get_title(loc="left") == title]
    return axes


def texts(figure):
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


@pytest.mark.parametrize("num_joints", [1, 2, 6])
def test_every_joint_has_its_panels_with_units(make_posterior, num_joints):
    idata = make_posterior(num_joints)
    figure = plot_posterior(idata)
    assert len(figure.axes) == 3 * num_joints
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
            name: idata[name].pad(space=(0, 1), constant_values=0.5).assign_coords(space=list("xyz"))
            for name in idata.groups()
            if "space" in idata[name].dims
        }
        for name, group in groups.items():
            idata[name] = group
    assert texts(plot_posterior(idata))[: number + 1] == [*"xyz"[:number], "observed"]


def test_contacts_that_act_have_panels_of_force_and_centre(make_posterior):
    """In the colours of axes; a centre has a gap where most of the draws do not touch.

    Below those of joints; a contact acts whose force is of 1 N in the median of draws, in some row.
    """
    idata = make_posterior(2)
    drawn, rng = idata.posterior.torque.transpose("chain", "draw", "time", "joint"), np.random.default_rng(0)
    shape = (*drawn.shape[:3], 3, 3)
    force = rng.normal([0, 0, 20], 1, shape) * np.array([1, 0.02, 0])[:, None]  # the second is too weak
    force[0, 0, :, 1], force[..., 5:8, 2, 2], force[..., 50, 0, 2] = 50, 20, 1e4
    centre = rng.normal(0, 0.01, shape)
    centre[:3, :, 20:30], centre[:2, :, 30:40] = np.nan, np.nan  # of five filters
    of = {"dims": ("chain", "draw", "time", "contact", "axis")}
    coords = {"contact": ["floor-foot", "floor-knee", "floor-hand"], "axis": list("xyz")}
    for name, values, unit in (("contact_force", force, "N"), ("centre_of_pressure", centre, "m")):
        idata.posterior[name] = xr.DataArray(values, **of, coords=coords, attrs={"units": unit})
    figure = plot_posterior(idata)
    assert len(figure.axes) == 2 + 2 * (2 + 2)
    pushed, place = panel(figure, "floor-foot force"), panel(figure, "floor-foot centre of pressure")
    assert [pushed.get_ylabel(), place.get_ylabel()] == ["N", "m"]
    assert [panel(figure, f"{name} force").get_subplotspec().rowspan.start for name in coords["contact"][::2]] == [2, 3]
    assert pushed.get_subplotspec().get_gridspec().nrows == 4
    assert pushed.get_ylim()[1] < 100  # of most rows, without the one that strikes
    assert [line.get_color() for line in pushed.get_lines()[:3]] == list(AXIS_COLORS.values())
    median = np.median(force.reshape(-1, *shape[2:]), 0)
    np.testing.assert_allclose(pushed.get_lines()[2].get_ydata(), median[:, 0, 2])
    assert np.flatnonzero(np.isnan(place.get_lines()[0].get_ydata())).tolist() == list(range(20, 30))
    assert texts(figure)[:3] == ["x", "y", "z"]
    borne = {"dims": (*of["dims"][:3], "link", "axis"), "coords": {"link": ["thigh", "shank", "hand"]}}
    for name, size, unit in (("reaction_force", 1, "N"), ("reaction_moment", 0.1, "N·m")):
        idata.posterior[name] = xr.DataArray(size * force, **borne, attrs={"units": unit})
    figure = plot_posterior(idata)  # the shank's joint bears nothing
    assert len(figure.axes) == 2 + 2 * (2 + 2 + 2)
    bears, turns = panel(figure, "hand reaction force"), panel(figure, "hand reaction moment")
    assert [bears.get_ylabel(), turns.get_ylabel()] == ["N", "N·m"]
    assert bears.get_subplotspec().rowspan.start == turns.get_subplotspec().rowspan.start == 5
    np.testing.assert_allclose(turns.get_lines()[2].get_ydata(), 0.1 * median[:, 2, 2])
    idata.posterior = idata.posterior.assign_coords(space=["x", "z"])
    keypoint = plot_posterior(idata).axes[0].get_lines()
    assert [line.get_color() for line in keypoint[:2]] == [AXIS_COLORS["x"], AXIS_COLORS["z"]]


def test_actuators_have_panels_below_contacts_and_lines_in_the_summary(make_posterior):
    """Activations are to the left of forces; a motor has no activation."""
    idata = make_posterior(1)
    drawn = idata.posterior.torque.isel(joint=[0, 0]).transpose("chain", "draw", "time", "joint")
    for name, dim, names in (
        ("activation", "activation_of", ["biceps"]),
        ("actuator_force", "actuator", ["biceps", "motor"]),
    ):
        values = drawn.isel(joint=slice(len(names))).drop_vars("joint").rename(joint=dim) + 100.0 * len(names)
        idata.posterior[name] = values.assign_coords({dim: names})
    figure = plot_posterior(idata)
    assert len(figure.axes) == 3 + 3
    excited, pulled, pushed = (
        panel(figure, f"{name}") for name in ("biceps activation", "biceps force", "motor force")
    )
    assert [axes.get_ylabel() for axes in (excited, pulled, pushed)] == ["", "N", "N"]
    places = [axes.get_subplotspec() for axes in (excited, pulled, pushed)]
    assert [(each.rowspan.start, each.colspan.start) for each in places] == [(1, 1), (1, 2), (2, 2)]
    np.testing.assert_allclose(excited.get_lines()[0].get_ydata(), quantiles(idata, "torque")[2, :, 0] + 100)
    table = summary_text(idata).split("Forces of actuators (N)")[1]
    assert "actuator" in table
    assert table.index("biceps") < table.index("motor")
    assert quantity_table(idata, "activation").index.tolist() == ["biceps"]


def test_encoders_alone_are_enough(make_posterior):
    idata = make_posterior(2, angles=True)
    idata.observed_data = idata.observed_data.drop_vars("position")
    figure = plot_posterior(idata)
    dots = panel(figure, "elbow angle").get_lines()[1]
    np.testing.assert_array_equal(dots.get_ydata(), idata.observed_data.angle.values[:, 1])


def test_rows_with_few_particles_are_marked_below_the_torques(make_posterior):
    """The median filter decides, and where each has enough nothing is said."""
    idata = make_posterior(2)
    assert not any("few particles" in text for text in texts(plot_posterior(idata)))
    spans = len(panel(plot_posterior(idata), "elbow torque").patches)
    idata.sample_stats.ess[:, 20:25] = 4.0
    idata.sample_stats.ess[0, 40:45] = 4.0  # one filter of five
    figure = plot_posterior(idata)
    assert "few particles (least: 4.0)" in texts(figure)
    (mark,) = panel(figure, "elbow torque").patches[spans:]
    time = idata.posterior.time.values
    assert [mark.get_x(), mark.get_x() + mark.get_width()] == pytest.approx([time[19:21].mean(), time[24:26].mean()])
    assert mark.get_height() < 0.05  # a thin strip at the axis
    assert len(panel(figure, "elbow angle").patches) == 0


def test_what_few_draws_there_are_is_said_in_one_line(make_posterior):
    figure = plot_posterior(make_posterior(2))
    assert "outer sample size" in figure.get_supxlabel()
    idata = make_posterior(2)
    del idata.sample_stats["ess"], idata.sample_stats["resampled"]  # a method without particles
    assert not any("few particles" in text for text in texts(plot_posterior(idata)))


def test_a_spike_does_not_flatten_its_panel(make_posterior):
    """Nine tenths of the panel stay for what it had without the spike, and a triangle says where that is."""
    idata = make_posterior(2, 200)
    usual = panel(plot_posterior(idata), "elbow torque").get_ylim()
    idata.posterior.torque[:, :, 100, 1] += 1000.0
    axes = panel(plot_posterior(idata), "elbow torque")
    low, high = axes.get_ylim()
    assert low == pytest.approx(usual[0], abs=0.3 * np.diff(usual)[0])
    assert high - low < 1.8 * np.diff(usual)[0]
    (mark,) = [line for line in axes.get_lines() if line.get_marker() == "^"]
    np.testing.assert_allclose(mark.get_xdata(), idata.posterior.time.values[[100]])


def test_an_outlier_of_the_tracker_is_shown_at_the_edge(make_posterior):
    idata = make_posterior(2)
    idata.observed_data["position"][30, 0, 1] = -50.0
    axes = panel(plot_posterior(idata), "elbow keypoint")
    assert axes.get_ylim()[0] > -5
    (mark,) = [line for line in axes.get_lines() if line.get_marker() == "v"]
    np.testing.assert_allclose(mark.get_xdata(), idata.posterior.time.values[[30]])


def test_nothing_that_is_usual_is_cut_off(make_posterior):
    for axes in plot_posterior(make_posterior(2)).axes:
        low, high = axes.get_ylim()
        for line in axes.get_lines():
            assert np.nanmin(line.get_ydata()) > low
            assert np.nanmax(line.get_ydata()) < high


def test_dots_are_drawn_over_the_median_and_darker(make_posterior):
    axes = panel(plot_posterior(make_posterior(2)), "elbow keypoint")
    lines = axes.get_lines()
    dots = [line for line in lines if line.get_marker() == "."]
    medians = [line for line in lines if line.get_marker() != "."]
    assert min(line.get_zorder() for line in dots) > max(line.get_zorder() for line in medians)
    for dot, median in zip(dots, medians, strict=True):
        np.testing.assert_array_less(to_rgb(dot.get_color()), np.array(to_rgb(median.get_color())) + 1e-9)


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


def test_a_panel_of_missing_values_has_no_range():
    assert usual_range(np.full(3, np.nan)) is None

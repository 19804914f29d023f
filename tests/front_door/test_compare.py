"""`invdyn compare`: its files, its table, its figure, and what it says when something is wrong."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from invdyn.inference import METHODS, load_posterior
from invdyn.plots import METHOD_COLORS, plot_comparison, quantiles

CALL = ("compare", "rec.csv", "--body", "arm.toml", "--out", "DIR")
QUICK = ("--filters", 4, "--particles", 40, "--torque", "ornstein_uhlenbeck", "--seed", 1)


def failing(problem, **_):
    raise RuntimeError("no convergence")


@pytest.fixture
def simulated(folder, run):
    """A second of a simulated arm, as rec.csv and truth.csv."""
    run("simulate", "--body", "arm.toml", "--out", "rec.csv", "--truth", "truth.csv", "--duration", 0.8, "--seed", 1)
    return folder


def test_writes_table_figure_and_posteriors(simulated, run, monkeypatch):
    monkeypatch.setitem(METHODS, "broken", failing)
    outcome = run(*CALL, "--methods", "differentiate, broken,laplace", "--set", "truth=truth.csv", *QUICK)
    assert outcome.exit_code == 0, outcome.output
    written = {path.name for path in Path("DIR").iterdir()}
    assert written == {"comparison.csv", "comparison.json", "figure.png", "differentiate.nc", "laplace.nc"}
    table = pd.read_csv("DIR/comparison.csv", index_col="method")
    assert list(table.index) == ["differentiate", "broken", "laplace"]
    assert table.loc["broken", "failure"] == "RuntimeError: no convergence"
    assert load_posterior("DIR/laplace.nc").attrs["log_evidence"] == pytest.approx(table.loc["laplace", "log_evidence"])
    rows = json.loads(Path("DIR/comparison.json").read_text())["methods"]
    for method in ("differentiate", "laplace"):
        assert rows[method]["elbow_crps"] == pytest.approx(table.loc[method, "elbow_crps"])
    assert rows["laplace"]["evidence_kind"] == table.loc["laplace", "evidence_kind"]
    for said in ("CRPS", "90 % covers", "approximation", "broken failed: RuntimeError: no convergence", "figure.png"):
        assert said in outcome.stdout
    assert "broken.nc" not in outcome.stdout


def test_all_failed_is_an_error(folder, run, monkeypatch):
    monkeypatch.setitem(METHODS, "broken", failing)
    outcome = run(*CALL, "--methods", "broken", *QUICK)
    assert outcome.exit_code == 2
    assert outcome.stderr == "error: no method succeeded: broken: RuntimeError: no convergence\n"
    assert not Path("DIR").exists()


@pytest.mark.parametrize(
    ("more", "named"),
    [
        (("--methods", "smc,magic"), "'magic'"),
        (("--methods", ""), "''"),
        (("--methods", "smc", "--torque", "magic"), "'magic'"),
        (("--methods", "smc", "--out", "rec.csv"), "rec.csv"),
        (("--methods", "smc", "--set", "truth=none.csv"), "none.csv"),
        (("--methods", "smc", "--held-out", "1.5"), "held-out"),
        ((), "--methods"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(folder, run, contents, more, named):
    before = contents(folder)
    outcome = run(*CALL, *more)
    assert outcome.exit_code == 2
    (line,) = outcome.stderr.splitlines()
    assert line.startswith("error: ")
    assert named in line
    assert contents(folder) == before
    assert not Path("DIR").exists()


def test_options_of_a_recording_are_those_of_infer(run):
    """One declaration serves both commands."""
    infer, compare = (run(command, "--help").stdout for command in ("infer", "compare"))
    shared = {
        "--body",
        "  truth ",
        "--units",
        "--frames",
        "--torque",
        "  noise ",
        "--zero-torque",
        "--filters",
        "--seed",
    }
    for option in shared:
        assert option in infer
        assert option in compare
    assert "isolate" not in infer
    assert "kinematic" not in compare


# -- the figure --------------------------------------------------------------------------------------------


def posteriors(make_posterior, count, truth=True, joints=2):
    """The same recording by several methods, each with draws of its own weights."""
    return {f"method {number}": make_posterior(joints, truth=truth, seed=number) for number in range(count)}


@pytest.mark.quick("6-9", "1-*")
@pytest.mark.parametrize("count", [1, 5, 9])
@pytest.mark.parametrize("joints", [1, 6])
def test_every_method_is_in_every_panel_and_nothing_overlaps(make_posterior, count, joints):
    figure = plot_comparison(posteriors(make_posterior, count, joints=joints))
    assert len(figure.axes) == 2 * joints
    for axes in figure.axes:
        assert len(axes.collections) == count
        assert axes.get_ylabel() == "N·m"
    (legend,) = figure.legends
    texts = [text.get_text() for text in legend.get_texts()]
    assert texts == [*(f"method {number}" for number in range(count)), "90 %", "truth"]
    renderer = FigureCanvasAgg(figure).get_renderer()
    figure.canvas.draw()
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes] + [legend.get_window_extent(renderer)]
    for number, box in enumerate(boxes):
        assert box.x1 <= figure.bbox.x1 + 1
        for other in boxes[number + 1 :]:
            width = min(box.x1, other.x1) - max(box.x0, other.x0)
            height = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(width, height) < 1


def test_curves_are_the_posteriors_own(make_posterior):
    given = posteriors(make_posterior, 3)
    whole, less = plot_comparison(given).axes[2:]
    truth = given["method 0"].constant_data.truth_torque.values[:, 1]
    medians = {line.get_color(): line for line in whole.get_lines() if line.get_linewidth() > 1}
    for color, idata in zip(METHOD_COLORS, given.values(), strict=False):
        np.testing.assert_allclose(medians[color].get_ydata(), quantiles(idata, "torque")[2, :, 1])
    shifted = [line for line in less.get_lines() if line.get_color() == METHOD_COLORS[2] and line.get_linewidth() > 1]
    np.testing.assert_allclose(
        shifted[0].get_ydata(), quantiles(given["method 2"], "torque")[2, :, 1] - truth, atol=1e-12
    )


def test_without_truth_the_first_method_is_the_reference(make_posterior):
    figure = plot_comparison(posteriors(make_posterior, 2, truth=False))
    assert figure.axes[1].get_title(loc="left") == "less the median of method 0"
    assert "truth" not in [text.get_text() for text in figure.legends[0].get_texts()]


def test_a_method_far_off_does_not_press_the_others_flat(make_posterior):
    given = posteriors(make_posterior, 3)
    given["method 1"].posterior["torque"] *= 1000.0
    near = plot_comparison({name: given[name] for name in ("method 0", "method 2")}).axes[0].get_ylim()
    low, high = plot_comparison(given).axes[0].get_ylim()
    assert high - low < 3 * (near[1] - near[0])

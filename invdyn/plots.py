"""The posterior as a figure: keypoints, angles and torques with 50 and 90 % bands, and the filters' health.

Each joint has a row with its angle (rad) and its torque (N·m). Next to them each tracked keypoint has a row, or a point
of the body where none was tracked: observed and predicted, in the recording's length unit. Below stands the effective
sample size of the filters over time, with resampling marked. Rows that tell nothing of a coordinate are hatched: what
is drawn there is the prior.
Figures are plain `matplotlib.figure.Figure` objects: no window, no pyplot state, fit for a server.
"""

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import arviz as az
import matplotlib
import numpy as np
import xarray as xr
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from invdyn.inference import evidence_note, pooled
from invdyn.recordings import atomic_path

# Okabe and Ito's colours: the colour-blind can distinguish them too.
BLUE, VERMILION, GREEN, PURPLE = "#0072B2", "#D55E00", "#009E73", "#AA4499"
ORANGE, SKY, PINK = "#E69F00", "#56B4E9", "#CC79A7"
METHOD_COLORS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, PINK)
INK, GREY = "#111111", "#777777"
STYLE: dict[Any, Any] = {
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#999999",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#e9e9e9",
    "grid.linewidth": 0.6,
    "axes.titlesize": 9.5,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "text.parse_math": False,  # a joint may be called $\\frac
    "font.family": "DejaVu Sans",  # comes with matplotlib: every machine draws the same
}
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
UNSEEN: dict[str, Any] = {"facecolor": "none", "edgecolor": "#bbbbbb", "hatch": "////", "linewidth": 0}
SHIFTING = {"torque": "N", "angle": "m", "velocity": "m/s"}
FIGURE_SUFFIXES = (".png", ".pdf", ".svg")


def plot_posterior(idata: az.InferenceData) -> Figure:
    """Draw a posterior of the layout that `invdyn.inference` documents.

    Keypoint bands are for observations (posterior predictive, noise included) where the posterior has them,
    else for the noise-free tips. What is not known (truth, command, what was not observed) is left out.
    """
    posterior, observed, known = idata["posterior"], idata["observed_data"], idata["constant_data"]
    time = posterior["time"].values
    joints = posterior["joint"].values
    predicted = "posterior_predictive" in idata.groups() and "position" in idata["posterior_predictive"]
    group = "posterior_predictive" if predicted else "posterior"
    shown = slice(None) if predicted else slice(-len(joints), None)  # a robot's file may name many points
    keypoints, tips = idata[group]["keypoint"].values[shown], quantiles(idata, "position", group)[:, :, shown]
    rows = max(len(joints), len(keypoints))
    filtered = "ess" in idata["sample_stats"]  # else there are no particles whose number could be drawn
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12, 1.7 * rows + (2.2 if filtered else 0.8)), layout="constrained")
        grid = figure.add_gridspec(rows + filtered, 3, height_ratios=[1] * rows + [0.7] * filtered)
        for row, keypoint in enumerate(keypoints):
            axes = figure.add_subplot(grid[row, 0])
            axes.set_title(f"{keypoint} keypoint", loc="left")
            axes.set_ylabel(posterior["position"].attrs["units"])
            for space, color in zip(range(tips.shape[-1]), (BLUE, VERMILION, GREEN), strict=False):
                draw_bands(axes, time, tips[:, :, row, space], color)
                if "position" in observed:
                    draw_dots(axes, time, observed["position"].sel(keypoint=keypoint).values[:, space], color)
        last = "torque" if "torque" in posterior else "velocity"  # a kinematic model knows no forces
        for column, (name, color) in enumerate((("angle", GREEN), (last, PURPLE)), 1):
            bands = quantiles(idata, name)
            for row, joint in enumerate(joints):
                axes = figure.add_subplot(grid[row, column])
                axes.set_title(f"{joint} {name}", loc="left")
                axes.set_ylabel(unit_of(idata, name, row))
                draw_bands(axes, time, bands[:, :, row], color)
                draw_unseen(axes, idata, row)
                if name == "angle" and "angle" in observed:
                    draw_dots(axes, time, observed["angle"].values[:, row], color)
                if name == "torque" and "command" in known:
                    axes.step(time, known["command"].values[:, row], where="post", color=GREY, linewidth=0.9)
                if f"truth_{name}" in known:
                    draw_truth(axes, time, known[f"truth_{name}"].values[:, row])
        if filtered:
            draw_sample_sizes(figure.add_subplot(grid[rows, :]), idata)
        for axes in figure.axes:
            axes.set_xlim(time[0], time[-1])
            place = axes.get_subplotspec()
            lowest = len(keypoints) if place is not None and place.colspan.stop == 1 else rows
            if place is not None and place.rowspan.stop >= lowest:
                axes.set_xlabel("time (s)")
            else:
                axes.tick_params(labelbottom=False)
        figure.align_ylabels()
        figure.legend(handles=legend_entries(idata), loc="outside upper left", ncols=10)
    return figure


MAX_PANELS = 8
"""States that a comparison draws, the first ones."""


def plot_comparison(posteriors: Mapping[str, az.InferenceData], truth: np.ndarray | None = None) -> Figure:
    """Torques, or states, by several methods, one row each: median and 90 % band of each method, and the truth.

    On the right the same less the truth (without one: less the first method's median), where they differ. A method
    that is far off leaves the panel there instead of pressing the others flat.

    ``truth`` (time, names) is known of states; that of torques stands in the posterior.
    """
    first = next(iter(posteriors.values()))
    of_arm = "torque" in first["posterior"]
    variable, dim = ("torque", "joint") if of_arm else ("state", "state_name")
    time = first["posterior"]["time"].values
    names = first["posterior"][dim].values[:MAX_PANELS]
    unit = first["posterior"][variable].attrs["units"] if of_arm else ""
    bands = {method: quantiles(idata, variable)[[0, 2, 4]][..., : len(names)] for method, idata in posteriors.items()}
    if of_arm and "truth_torque" in first["constant_data"]:
        truth = first["constant_data"]["truth_torque"].transpose("time", "joint").values
    reference = next(iter(bands.values()))[1] if truth is None else truth[:, : len(names)]
    less = "less the truth" if truth is not None else f"less the median of {next(iter(posteriors))}"
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12, 2.3 * len(names) + 0.9), layout="constrained")
        panels = figure.subplots(len(names), 2, sharex=True, squeeze=False)
        for row, name in enumerate(names):
            whole = f"{name} torque" if of_arm else f"state {name}"
            for column, (title, base) in enumerate(((whole, 0 * reference), (less, reference))):
                axes = panels[row, column]
                shifted = [curves[:, :, row] - base[:, row] for curves in bands.values()]
                for curves, color in zip(shifted, cycle(METHOD_COLORS)):
                    axes.fill_between(time, curves[0], curves[2], color=color, alpha=0.13, linewidth=0)
                    axes.plot(time, curves[[0, 2]].T, color=color, linewidth=0.5, alpha=0.6)
                for curves, color in zip(shifted, cycle(METHOD_COLORS)):  # medians over every band
                    axes.plot(time, curves[1], color=color, linewidth=1.3)
                if truth is not None:
                    draw_truth(axes, time, (reference - base)[:, row])
                if of_arm:
                    draw_unseen(axes, first, row)
                axes.set_title(title, loc="left")
                axes.set_ylabel(unit)
                limit_to_most(axes, shifted, reference[:, row] - base[:, row])
                axes.set_xlim(time[0], time[-1])
        for axes in panels[-1]:
            axes.set_xlabel("time (s)" if of_arm else "row")
        figure.align_ylabels()
        entries: list[Artist] = [
            Line2D([], [], color=color, linewidth=2, label=method)
            for method, color in zip(posteriors, cycle(METHOD_COLORS))
        ]
        entries.append(Patch(color=GREY, alpha=0.3, linewidth=0, label="90 %"))
        if truth is not None:
            entries.append(Line2D([], [], color=INK, linewidth=1, dashes=(4, 2), label="truth"))
        entries += unseen_entry(first) if of_arm else []
        figure.legend(handles=entries, loc="outside upper left", ncols=10)
    return figure


def limit_to_most(axes: Axes, bands: list[np.ndarray], reference: np.ndarray) -> None:
    """Vertical limits that hold the reference and most of what the better half of the methods say."""
    reach = [np.nanquantile(np.abs(curves - np.nanmedian(reference)), 0.995) for curves in bands]
    half = sorted(reach)[: (len(reach) + 1) // 2][-1] * 1.6
    half = max(half, 1.05 * np.nanmax(np.abs(reference - np.nanmedian(reference)), initial=0.0))
    if np.isfinite(half) and half > 0:
        middle = float(np.nanmedian(reference))
        low = min(float(np.nanmin(curves)) for curves in bands)
        high = max(float(np.nanmax(curves)) for curves in bands)
        axes.set_ylim(max(middle - half, low - 0.05 * half), min(middle + half, high + 0.05 * half))


def save_figure(figure: Figure, path: str | Path) -> None:
    """Write a figure (.png, .pdf, .svg), whole or not at all. Raises OSError when it cannot."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=150)


def quantiles(idata: az.InferenceData, variable: str, group: str = "posterior") -> np.ndarray:
    """QUANTILES (5, time, …) of a variable's draws."""
    draws = pooled(idata, group=group)[variable]
    return np.quantile(draws.transpose("sample", "time", ...).values, QUANTILES, axis=0)


def unit_of(idata: az.InferenceData, name: str, joint: int) -> str:
    """Unit of a joint's torque, angle or velocity: of a joint that shifts N, m and m/s."""
    if shifts(idata)[joint]:
        return SHIFTING[name]
    return str(idata["posterior"][name].attrs["units"])


def shifts(idata: az.InferenceData) -> np.ndarray:
    """Which joints (K,) shift, as a slide does, where the others turn."""
    joints = idata["posterior"].sizes["joint"]
    return idata["constant_data"].get("turns", xr.DataArray(np.ones(joints))).values == 0


def draw_bands(axes: Axes, time: np.ndarray, bands: np.ndarray, color: str) -> None:
    """Median line with its 50 and 90 % bands; bands (5, time) as from `quantiles`."""
    low, lower, median, upper, high = bands
    axes.fill_between(time, low, high, color=color, alpha=0.18, linewidth=0)
    axes.fill_between(time, lower, upper, color=color, alpha=0.35, linewidth=0)
    axes.plot(time, median, color=color, linewidth=1.1)


def draw_dots(axes: Axes, time: np.ndarray, values: np.ndarray, color: str) -> None:
    """Observations; a missing one leaves its place empty. Many become pixels, not 10,000 vector shapes."""
    axes.plot(time, values, ".", color=color, markersize=3, markeredgewidth=0, rasterized=len(time) > 1000)


def draw_truth(axes: Axes, time: np.ndarray, values: np.ndarray) -> None:
    """The known curve."""
    axes.plot(time, values, color=INK, linewidth=1, dashes=(4, 2))


def unseen_rows(idata: az.InferenceData) -> np.ndarray:
    """Which rows tell nothing of which coordinates, (time, joint) bool; a body in the plane is seen throughout."""
    posterior = idata["posterior"]
    seen = xr.DataArray(np.zeros((posterior.sizes["time"], posterior.sizes["joint"])), dims=("time", "joint"))
    return idata["constant_data"].get("unseen", seen).transpose("time", "joint").values > 0


def draw_unseen(axes: Axes, idata: az.InferenceData, joint: int) -> None:
    """Hatch the rows that do not tell a coordinate, each from halfway to the one before to halfway to the next."""
    time, unseen = idata["posterior"]["time"].values, unseen_rows(idata)[:, joint]
    edges = np.concatenate([time[:1], (time[1:] + time[:-1]) / 2, time[-1:]])
    changes = np.flatnonzero(np.diff(np.concatenate([[0], unseen.astype(int), [0]])))
    for begin, end in changes.reshape(-1, 2):
        axes.axvspan(edges[begin], edges[end], **UNSEEN)


def unseen_entry(idata: az.InferenceData) -> list[Artist]:
    """The legend's word for what is hatched, where something is."""
    return [Patch(**UNSEEN, label="not seen: the prior")] if unseen_rows(idata).any() else []


def draw_sample_sizes(axes: Axes, idata: az.InferenceData) -> None:
    """Effective sample size, median and bands over filters; marks where they resampled, darker for more."""
    statistics = idata["sample_stats"]
    time = statistics["time"].values
    sizes = statistics["ess"].transpose("filter", "time").values
    draw_bands(axes, time, np.quantile(sizes, QUANTILES, axis=0), GREY)
    share = statistics["resampled"].transpose("filter", "time").values.mean(axis=0)
    marks = [[(t, 0.0), (t, 0.09)] for t in time[share > 0]]
    colors = [to_rgba(INK, 0.15 + 0.85 * part) for part in share[share > 0]]
    axes.add_collection(LineCollection(marks, colors=colors, linewidths=1, transform=axes.get_xaxis_transform()))
    axes.set_title("effective sample size of the filters", loc="left")
    axes.set_title(heading(idata), loc="right", color=GREY)
    axes.set_ylabel("particles")
    axes.set_ylim(0, 1.08 * sizes.max())


def heading(idata: az.InferenceData) -> str:
    """Method, evidence, and health of the importance sampler over whole filters, in one line."""
    method, evidence, size = (idata.attrs[name] for name in ("method", "log_evidence", "outer_ess"))
    filters = idata["sample_stats"].sizes["filter"]
    outer = f"outer sample size {size:.1f} of {filters} filters"
    stated = "not usable" if evidence_note(idata) else f"{evidence:.1f}"
    return f"method {method}   ·   log evidence {stated}   ·   {outer}"


def legend_entries(idata: az.InferenceData) -> list[Artist]:
    """Only what the figure shows; colours belong to the panels, so bands and lines stand here in grey."""
    known = idata["constant_data"]
    axes = list(zip("xyz", (BLUE, VERMILION, GREEN), strict=True))[: idata["posterior"]["position"].sizes["space"]]
    entries: list[Artist] = [
        *(Line2D([], [], color=color, linewidth=2, label=axis) for axis, color in axes),
        Line2D([], [], color=GREY, linestyle="none", marker=".", label="observed"),
        Line2D([], [], color=GREY, linewidth=1.2, label="posterior median"),
        Patch(color=GREY, alpha=0.55, linewidth=0, label="50 %"),
        Patch(color=GREY, alpha=0.22, linewidth=0, label="90 %"),
    ]
    if any(str(name).startswith("truth_") for name in known):
        entries.append(Line2D([], [], color=INK, linewidth=1, dashes=(4, 2), label="truth"))
    if "command" in known:
        entries.append(Line2D([], [], color=GREY, linewidth=1, label="command"))
    if "resampled" in idata["sample_stats"] and idata["sample_stats"]["resampled"].any():
        entries.append(Line2D([], [], color=INK, ls="none", marker="|", markersize=8, label="filters resampled"))
    return entries + unseen_entry(idata)

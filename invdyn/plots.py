"""The posterior as a figure: keypoints, angles and torques with 50 and 90 % bands.

Each joint has a row with its angle (rad) and its torque (N·m). Below them each contact that acts has one with its force
(N) and its centre of pressure (m), each body one with the force (N) and moment (N·m) that its joint bears, and each
actuator that is inferred one with its activation and its force (N). Next to them each tracked keypoint has a row, or a
point of the body where none was tracked: observed and predicted, in the recording's length unit. Rows that tell nothing
of a coordinate are hatched: what is drawn there is the prior. Rows in which the filters kept few effective particles
are marked below the torques: bands there differ from one seed to the next. A panel shows what nearly all rows hold, and
a triangle at its edge says where a curve or a point leaves it.
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
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from invdyn.inference import evidence_note, pooled
from invdyn.inference.study.figure import COLORS, STYLE
from invdyn.recordings import atomic_path

BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY = COLORS
METHOD_COLORS = (BLUE, VERMILION, GREEN, ORANGE, PURPLE, SKY, "#CC79A7")
AXIS_COLORS = {"x": BLUE, "y": VERMILION, "z": GREEN}
INK, GREY = "#111111", "#777777"
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)  # of draws: bands of 90 and 50 %, median
UNSEEN: dict[str, Any] = {"facecolor": "none", "edgecolor": "#bbbbbb", "hatch": "////", "linewidth": 0}
FEW: dict[str, Any] = {"facecolor": "#cc3311", "edgecolor": "none", "ymax": 0.03, "zorder": 4}
MIN_PARTICLES = 10
"""Effective particles of the median filter; of fewer its estimate of a quantile is mostly chance."""
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
    borne, actuators = acting(idata), actuator_curves(idata)
    above = len(joints) + len(borne)
    rows = max(above + max((len(curves) for curves in actuators.values()), default=0), len(keypoints))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(12, 1.9 * rows + 1.0), layout="constrained")
        grid = figure.add_gridspec(rows, 3)
        for row, keypoint in enumerate(keypoints):
            axes = figure.add_subplot(grid[row, 0])
            axes.set_title(f"{keypoint} keypoint", loc="left")
            axes.set_ylabel(posterior["position"].attrs["units"])
            spaces = [(k, AXIS_COLORS[str(name)]) for k, name in enumerate(posterior["space"].values)]
            for space, color in spaces:
                draw_bands(axes, time, tips[:, :, row, space], color)
            for space, color in spaces if "position" in observed else ():  # over all bands
                draw_dots(axes, time, observed["position"].sel(keypoint=keypoint).values[:, space], color)
            limit_to_usual(axes, time)
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
                if name == last:
                    draw_few(axes, idata)
                if name == "torque" and "command" in known:
                    axes.step(time, known["command"].values[:, row], where="post", color=GREY, linewidth=0.9)
                if f"truth_{name}" in known:
                    draw_truth(axes, time, known[f"truth_{name}"].values[:, row])
                limit_to_usual(axes, time)
        for row, (each, panels) in enumerate(borne, len(joints)):
            for column, (name, words) in enumerate(panels.items(), 1):
                axes = figure.add_subplot(grid[row, column])
                axes.set_title(f"{each} {words}", loc="left")
                axes.set_ylabel(posterior[name].attrs["units"])
                for bands, color in zip(bands_of_axes(idata, name, each), AXIS_COLORS.values(), strict=True):
                    draw_bands(axes, time, bands, color)
                    axes.get_lines()[-1].set(marker=".", markersize=3)  # a lone row has no line
                limit_to_usual(axes, time)
        for column, curves in actuators.items():
            for row, (title, unit, bands) in enumerate(curves, above):
                axes = figure.add_subplot(grid[row, column])
                axes.set_title(title, loc="left")
                axes.set_ylabel(unit)
                draw_bands(axes, time, bands, ORANGE)
                limit_to_usual(axes, time)
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
        figure.supxlabel(heading(idata), x=0.995, ha="right", fontsize=8.5, color=GREY)
    return figure


OF_CONTACT = {"contact_force": "force", "centre_of_pressure": "centre of pressure"}
OF_LINK = {"reaction_force": "reaction force", "reaction_moment": "reaction moment"}
OF_ACTUATOR = (("activation", "activation_of", "activation", ""), ("actuator_force", "actuator", "force", "N"))
ACTS = 1.0
"""N, median force of a contact or a joint in some row, from which on it has panels."""


def acting(idata: az.InferenceData) -> list[tuple[str, dict[str, str]]]:
    """Names of the contacts that act, then of the bodies whose joints bear something, each with its panels."""
    found = []
    for dim, panels in (("contact", OF_CONTACT), ("link", OF_LINK)):
        if (name := next(iter(panels))) in idata["posterior"]:
            force = pooled(idata)[name].transpose("sample", "time", "axis", dim)
            most = np.median(np.linalg.norm(force.values, axis=2), axis=0).max(0)
            found += [(str(each), panels) for each in force[dim].values[most > ACTS]]
    return found


def bands_of_axes(idata: az.InferenceData, name: str, of: str) -> np.ndarray:
    """QUANTILES (axis, 5, time) of a contact's or body's variable; NaN in rows where half of the draws have none."""
    own = pooled(idata)[name]
    dim = "contact" if "contact" in own.dims else "link"
    draws = own.sel({dim: of}).transpose("axis", "time", "sample").values
    known = np.isfinite(draws).mean(-1) > 0.5
    found = np.full((len(QUANTILES), *known.shape), np.nan)
    found[:, known] = np.nanquantile(draws[known], QUANTILES, axis=-1)
    return found.swapaxes(0, 1)


def actuator_curves(idata: az.InferenceData) -> dict[int, list[tuple[str, str, np.ndarray]]]:
    """Of each column of the figure: titles, units and QUANTILES (5, time) of activations and of actuators' forces."""
    found = {}
    for column, (name, dim, words, unit) in enumerate(OF_ACTUATOR, 1):
        if name in idata["posterior"]:
            bands = quantiles(idata, name)
            titles = [f"{each} {words}" for each in idata["posterior"][dim].values]
            found[column] = [(title, unit, bands[..., k]) for k, title in enumerate(titles)]
    return found


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


def usual_range(values: np.ndarray) -> tuple[float, float] | None:
    """What a panel shows of some values: all of them, but for spikes; None where all are the same or missing.

    Usual is from the 2 % to the 98 % quantile, and half of that span beyond.
    """
    if not np.isfinite(values).any():
        return None
    low, high = np.nanquantile(values, [0.02, 0.98])
    room = 0.5 * (high - low)
    least, most = max(np.nanmin(values), low - room), min(np.nanmax(values), high + room)
    margin = 0.05 * (most - least)
    return (float(least - margin), float(most + margin)) if margin > 0 else None


def limit_to_usual(axes: Axes, time: np.ndarray) -> None:
    """Limit a panel to :func:`usual_range` of its lines, dots and bands, so that a spike does not flatten the others.

    What leaves the panel has a triangle at its edge, in its colour.
    """
    drawn = [(np.asarray(line.get_ydata(), float), line.get_color()) for line in axes.get_lines()]
    edges = [np.asarray(path.vertices)[:, 1] for band in axes.collections for path in band.get_paths()]
    limits = usual_range(np.concatenate([*(values for values, _ in drawn), *edges]))
    if limits is None:
        return
    axes.set_ylim(*limits)
    for values, color in drawn:
        for beyond, place, marker in ((values > limits[1], 0.97, "^"), (values < limits[0], 0.03, "v")):
            turns = np.flatnonzero(beyond & ~np.concatenate([[False], beyond[:-1]]))
            if len(turns):
                edge = axes.get_xaxis_transform()
                axes.plot(time[turns], 0 * turns + place, marker, color=color, markersize=5, transform=edge, zorder=6)


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
    """Observations, darker than the median and over it. Many become pixels, not 10,000 vector shapes.

    A missing one leaves its place empty.
    """
    dark = tuple(0.55 * part for part in to_rgb(color))
    size = 4 if len(time) < 300 else 2.5
    axes.plot(time, values, ".", color=dark, markersize=size, mew=0, zorder=3, rasterized=len(time) > 1000)


def draw_truth(axes: Axes, time: np.ndarray, values: np.ndarray) -> None:
    """The known curve."""
    axes.plot(time, values, color=INK, linewidth=1, dashes=(4, 2))


def unseen_rows(idata: az.InferenceData) -> np.ndarray:
    """Which rows tell nothing of which coordinates, (time, joint) bool; a body in the plane is seen throughout."""
    posterior = idata["posterior"]
    seen = xr.DataArray(np.zeros((posterior.sizes["time"], posterior.sizes["joint"])), dims=("time", "joint"))
    return idata["constant_data"].get("unseen", seen).transpose("time", "joint").values > 0


def draw_unseen(axes: Axes, idata: az.InferenceData, joint: int) -> None:
    """Hatch the rows that do not tell a coordinate."""
    span_rows(axes, idata, unseen_rows(idata)[:, joint], UNSEEN)


def span_rows(axes: Axes, idata: az.InferenceData, rows: np.ndarray, style: dict[str, Any]) -> None:
    """Mark some ``rows`` (time,), each from halfway to the one before to halfway to the next."""
    time = idata["posterior"]["time"].values
    edges = np.concatenate([time[:1], (time[1:] + time[:-1]) / 2, time[-1:]])
    changes = np.flatnonzero(np.diff(np.concatenate([[0], rows.astype(int), [0]])))
    for begin, end in changes.reshape(-1, 2):
        axes.axvspan(edges[begin], edges[end], **style)


def unseen_entry(idata: az.InferenceData) -> list[Artist]:
    """The legend's word for what is hatched, where something is."""
    return [Patch(**UNSEEN, label="not seen: the prior")] if unseen_rows(idata).any() else []


def effective_particles(idata: az.InferenceData) -> np.ndarray:
    """Of the median filter, (time,); infinite for a method without particles."""
    if "ess" not in idata["sample_stats"]:
        return np.full(idata["posterior"].sizes["time"], np.inf)
    return np.median(idata["sample_stats"]["ess"].transpose("filter", "time").values, axis=0)


def draw_few(axes: Axes, idata: az.InferenceData) -> None:
    """Mark, along the time axis, the rows with few effective particles."""
    span_rows(axes, idata, effective_particles(idata) < MIN_PARTICLES, FEW)


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
    drawn = {*idata["posterior"]["space"].values.tolist(), *(AXIS_COLORS if acting(idata) else ())}
    entries: list[Artist] = [
        *(Line2D([], [], color=AXIS_COLORS[axis], linewidth=2, label=axis) for axis in AXIS_COLORS if axis in drawn),
        Line2D([], [], color=GREY, linestyle="none", marker=".", label="observed"),
        Line2D([], [], color=GREY, linewidth=1.2, label="posterior median"),
        Patch(color=GREY, alpha=0.55, linewidth=0, label="50 %"),
        Patch(color=GREY, alpha=0.22, linewidth=0, label="90 %"),
    ]
    if any(str(name).startswith("truth_") for name in known):
        entries.append(Line2D([], [], color=INK, linewidth=1, dashes=(4, 2), label="truth"))
    if "command" in known:
        entries.append(Line2D([], [], color=GREY, linewidth=1, label="command"))
    if (least := effective_particles(idata).min()) < MIN_PARTICLES:
        entries.append(Patch(facecolor=FEW["facecolor"], linewidth=0, label=f"few particles (least: {least:.1f})"))
    return entries + unseen_entry(idata)

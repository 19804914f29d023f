"""`invdyn view`: what one page (:mod:`.page`) shows of a posterior, a diagnosis or a study.

Of a posterior: the mean body, some draws, keypoints as seen, torques and angles with their 50 and 90 % bands. Of a
diagnosis: the simulation before and after the correction, the torque that each misses, with 90 % bands, and how far
each is off when it is simulated alone. Of a study: torques of all trials, aligned at an event, and the average of
each condition, with its 90 % band and that of a further trial.

Recordings of more than `MAX_ROWS` rows are thinned: median and edges of the bands at evenly spaced rows.
"""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import pandas as pd
import xarray as xr

from invdyn.inference import load_posterior
from invdyn.inference.posterior.functionals import Z90
from invdyn.inference.study.store import FILES, study_files
from invdyn.recordings import InputError

from .film import arm_points, skeleton
from .page import View
from .plots import quantiles, shifts, unit_of
from .summary import doubts_of, summary_text

MAX_ROWS = 2000
"""Rows that a page has at most: a screen has no more pixels."""
DRAWS = 8
"""Posterior draws of the body, pale."""
DIAGNOSIS = "diagnosis.json"
ASIDE = ("left_out", "in_doubt")
"""Tables of a study's trials that do not count, or may be wrong."""
SENTENCES = 3
"""Of such trials, above all else; their tables have all of them."""
STYLES = ("after", "before", "third", "fourth")
"""Of a study's levels."""


def view_of(path: str | Path, align: str | None = None) -> View:
    """What a page shows of a posterior (.nc), of a diagnosis (its folder or diagnosis.json) or of a study (its folder).

    A study's trials are aligned at the event ``align``, by default the first by name. Raises InputError for a file of
    another kind, or an event that no trial has; OSError where it cannot be read.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    if (path / FILES).exists():
        return _of_study(path, align)
    if align is not None:
        raise InputError(f"{path}: expected the folder of a study to align at {align!r}: leave --align out")
    if path.is_dir() and not (path / DIAGNOSIS).exists():
        raise InputError(
            f"{path}: expected a posterior, .nc, or a folder of `invdyn diagnose` or `invdyn trials`, with {DIAGNOSIS} "
            f"or {FILES} in it"
        )
    if path.is_dir() or path.name == DIAGNOSIS:
        path = folder / "posterior.nc"
        if not path.exists():
            raise InputError(f"{folder}: this diagnosis left no posterior.nc to look at: read its report.html")
    idata = load_posterior(path)
    if "joint" not in idata["posterior"].dims:
        raise InputError(f"{path}: expected the posterior of a body, got that of a state-space model: read it by ArviZ")
    return _of_diagnosis(idata) if "tracks" in idata.groups() else of_posterior(idata, path.name)


def of_posterior(idata: az.InferenceData, name: str) -> View:
    """What a page shows of a posterior; ``name`` says which."""
    points = arm_points(idata)
    rows = _rows(points.shape[1])
    posterior, observed, known = idata["posterior"], idata["observed_data"], idata["constant_data"]
    seen = np.full((points.shape[1], 0, points.shape[-1]), np.nan)
    if "position" in observed:
        seen = observed["position"].transpose("time", "keypoint", "space").values
    chosen = np.linspace(0, len(points) - 1, min(DRAWS, len(points)), dtype=int)
    joints = [str(joint) for joint in posterior["joint"].values]
    torque = "torque" in posterior
    named = ", ".join(joints) if len(joints) < 4 else f"{len(joints)} joints"
    view = View(
        title=f"{'Torques' if torque else 'Motion'} of {named}",
        kicker=f"Posterior {name}, method {idata.attrs['method']}",
        time=posterior["time"].values[rows],
        unit=str(posterior["position"].attrs["units"]),
        lines=skeleton(idata),
        names=[str(each) for each in posterior["keypoint"].values],
        arms={("posterior mean", "after"): points.mean(0)[rows]},
        draws=points[chosen][:, rows],
        observed=seen[rows],
        doubts=[each.removeprefix("warning: ") for each in doubts_of(idata)],
        summary=summary_text(idata),
        foot=_thinned(rows, points.shape[1]),
    )
    for group in ("torque" if torque else "velocity", "angle"):
        bands = quantiles(idata, group)[:, rows]
        view.notes[group] = "Median, with bands that hold 50 and 90 % of the probability."
        for k, joint in enumerate(joints):
            side: dict[str, Any] = {"name": "posterior median", "style": "after"}
            side |= zip(("low", "lower", "middle", "upper", "high"), bands[:, :, k], strict=True)
            more = {"truth": known.get(f"truth_{group}"), "dots": observed.get(group)}
            more |= {"command": known.get("command")} if group == "torque" else {}
            curves = {name: None if each is None else _of_joint(each, k)[rows] for name, each in more.items()}
            view.panel(group, joint, unit_of(idata, group, k), [side], more=curves)
    return view


def _of_diagnosis(idata: az.InferenceData) -> View:
    """What a page shows of a diagnosis that `invdyn diagnose` saved."""
    tracks, turning = idata["tracks"], ~shifts(idata)
    rows = _rows(tracks.sizes["time"])
    base = np.broadcast_to(tracks["base"].values, (len(rows), 1, tracks.sizes["space"]))
    sides = {("simulation as it is", "before"): "nominal", ("corrected", "after"): "corrected"}
    replays = {side: tracks[f"{name}_replay"].values[rows] for side, name in sides.items()}
    before, after = replays.values()
    if np.array_equal(before, after, equal_nan=True):
        del replays["corrected", "after"]
    view = View(
        title=str(tracks.attrs["verdict"]),
        kicker=f"From simulation to reality: {tracks.attrs['recording']}",
        time=tracks["time"].values[rows],
        unit=str(idata["posterior"]["position"].attrs["units"]),
        lines=skeleton(idata),
        names=[str(name) for name in tracks["site"].values],
        arms={side: np.concatenate([base, each], 1) for side, each in replays.items()},
        draws=np.empty((0, len(rows), 1, tracks.sizes["space"])),
        observed=tracks["observed"].values[rows],
        said=[text for text in str(tracks.attrs["details"]).split("\n") if text],
        foot=f"Simulations restart from the recorded motion every {tracks.attrs['replay_window']:g} s. "
        + _thinned(rows, tracks.sizes["time"]),
    )
    view.notes = {
        "missing torque": "What the simulation needs at the joint to follow the recording, with 90 % bands.",
        "replay error": "How far the link's point is from the smoothed recording, simulated without feedback.",
        "angle": "Smoothed under the corrected simulation.",
    }
    for k, joint in enumerate([str(name) for name in tracks["joint"].values]):
        curves = []
        for name, style in list(replays):
            mean, sd = (_of_joint(tracks[f"residual_{style}{end}"], k)[rows] for end in ("", "_sd"))
            band = {"low": mean - Z90 * sd, "middle": mean, "high": mean + Z90 * sd}
            curves.append({"name": name, "style": style} | band)
        view.panel("missing torque", joint, "N·m" if turning[k] else "N", curves)
    for k, joint in enumerate([str(name) for name in tracks["joint"].values]):
        angle = _of_joint(tracks["angle"], k)[rows]
        side = {"name": "smoothed", "style": "after", "low": angle, "middle": angle, "high": angle}
        view.panel("angle", joint, "rad" if turning[k] else "m", [side])
    joints = [str(name) for name in tracks["joint"].values]
    for s, place in enumerate(joints if len(joints) == len(view.names) else view.names):
        curves = []
        for (name, style), each in replays.items():
            off = np.linalg.norm(each[:, s] - tracks["smoothed"].values[rows, s], axis=-1)
            curves.append({"name": name, "style": style, "low": off, "middle": off, "high": off})
        if np.isfinite(curves[0]["middle"]).any():  # MuJoCo's engine is not played on its own
            view.panel("replay error", place, view.unit, curves)
    return view


def _of_study(folder: Path, align: str | None) -> View:
    """What a page shows of the folder that `invdyn trials` left."""
    files = study_files(folder)
    events = sorted(path.stem.removeprefix("averages_") for path in files if path.match("averages_*.csv"))
    if not events:
        raise InputError(f"{folder}: expected averages, got none: at least two trials need an event (event_NAME)")
    event = events[0] if align is None else align
    if event not in events:
        raise InputError(f"{folder}: expected --align with an event among {', '.join(events)}, got {event!r}")
    table = folder / f"averages_{event}.csv"
    factor = str(pd.read_csv(table, nrows=0).columns[1])
    averages = pd.read_csv(table, dtype={"joint": str, factor: str}, keep_default_na=False)
    levels = sorted(averages[factor].unique())
    styles = dict(zip(levels, STYLES * len(levels), strict=False))
    time = np.unique(averages["time"])
    left_out, in_doubt = (pd.read_csv(folder / f"{name}.csv", dtype=str, keep_default_na=False) for name in ASIDE)
    doubts = [f"{each.trial} is left out: {each.reason}" for each in left_out.itertuples()]
    doubts += [f"{each.trial}: {each.doubt}" for each in in_doubt.itertuples()]
    if (more := len(doubts) - SENTENCES) > 1:
        doubts[SENTENCES:] = [f"{more} more, in the tables at the end of this page"]
    curves = _aligned([path for path in files if path.suffix == ".nc"], event, factor, time)
    count = averages.groupby(factor)["trials"].max().sum()
    view = View(
        title=f"Torques of {count} trials by {factor}" if len(levels) > 1 else f"Torques of {count} trials",
        kicker=f"Study {folder.name}, trials aligned at {event}",
        time=time,
        unit="",
        lines=[],
        names=[],
        arms={},
        draws=np.empty(0),
        observed=np.empty(0),
        doubts=doubts,
        foot=f"Events to align at: {', '.join(events)}." if len(events) > 1 else "",
    )
    view.notes["torque"] = (
        f"Time in s after {event}. Dark: the average, 90 %. Pale: a further trial, 90 %. Thin: each trial's median."
    )
    for joint in averages["joint"].unique():
        own = averages[averages["joint"] == joint]
        sides = []
        for level in sorted(own[factor].unique()):
            rows = own[own[factor] == level].set_index("time").reindex(time)
            side = {"name": f"{level or factor} ({rows['trials'].max():g} trials)", "style": styles[level]}
            named = {"low": "trial_q05", "lower": "q05", "middle": "mean", "upper": "q95", "high": "trial_q95"}
            sides.append(side | {name: rows[column].to_numpy() for name, column in named.items()})
        trials = [(styles[level], each) for level, each in curves.get(joint, ()) if level in styles]
        view.panel("torque", joint, str(own["unit"].iloc[0]), sides, trials)
    for path in sorted(path for path in files if path.match("differences*.csv") or path.stem in ASIDE):
        table = pd.read_csv(path, keep_default_na=False)
        cells = table.map(lambda cell: f"{cell:.3g}" if isinstance(cell, float) else str(cell))
        if len(table):
            view.tables[path.stem.replace("_", " ").capitalize()] = [list(table.columns), *cells.values.tolist()]
    return view


def _aligned(
    posteriors: Iterable[Path], event: str, factor: str, time: np.ndarray
) -> dict[str, list[tuple[str, np.ndarray]]]:
    """By joint, each trial's level and its median torque at times after the event; none of those that lack it."""
    found: dict[str, list[tuple[str, np.ndarray]]] = {}
    for path in sorted(posteriors):
        with xr.open_dataset(path, engine="h5netcdf") as session:
            if f"event_{event}" not in session:
                continue
            medians = np.median(session["torque"].transpose("trial", "row", "joint", "draw").values, axis=-1)
            for at, level, clock, torque in zip(
                session[f"event_{event}"].values, session[factor].values, session["time"].values, medians, strict=True
            ):
                there = np.isfinite(clock)
                for k, joint in enumerate(session["joint"].values) if np.isfinite(at) else ():
                    curve = np.interp(time + at, clock[there], torque[there, k], left=np.nan, right=np.nan)
                    found.setdefault(str(joint), []).append((str(level), curve))
    return found


def _of_joint(values: xr.DataArray, k: int) -> np.ndarray:
    return values.transpose("time", "joint").values[:, k]


def _rows(count: int) -> np.ndarray:
    return np.arange(0, count, -(-count // MAX_ROWS))


def _thinned(rows: np.ndarray, count: int) -> str:
    return "" if len(rows) == count else f"One in {rows[1]} of {count} rows is shown."

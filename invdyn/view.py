"""`invdyn view`: a posterior or a diagnosis as one page that opens anywhere, without a server or a network.

The page has the body and its curves on one time axis. Of a posterior: the mean arm, some draws, the keypoints as seen,
angles and torques with their 50 and 90 % bands. Of a diagnosis: the simulation before and after the correction, and the
torque that each misses, with 90 % bands. Curves are drawn by uPlot 1.6.32 (Leon Sorokin, MIT), which the page holds.

Recordings of more than `MAX_ROWS` rows are thinned: median and edges of the bands at evenly spaced rows.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import arviz as az
import numpy as np
import xarray as xr
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from invdyn.diagnosis.report.report import TEMPLATES, digest, environment
from invdyn.inference import load_posterior
from invdyn.recordings import InputError, write_text

from .film import arm_points, skeleton
from .plots import quantiles, shifts, unit_of, usual_range
from .summary import doubts_of, summary_text

PAGE = Path(__file__).parent / "view_page"
MAX_ROWS = 2000
"""Rows that a page has at most: a screen has no more pixels."""
DRAWS = 8
"""Posterior draws of the body, pale."""
Z90 = 1.6448536
DIAGNOSIS = "diagnosis.json"


@dataclass
class View:
    """What a page shows; T rows, N points of the body (the first one is its base), d dimensions.

    Attributes:
        title, kicker: heading, and the line above it.
        time: (T,) s.
        unit: of length.
        lines: of the body, as numbers of points along each.
        names: of the last points, one each, in words.
        arms: name and style (before, after) -> (T, N, d), the most important one last.
        draws: (R, T, N, d), pale.
        observed: (T, P, d), NaN where missing.
        panels: one a curve, see :meth:`panel`.
        doubts, said: sentences above all else.
        notes: what a group's curves are. summary: text of a run. foot: the last line.
    """

    title: str
    kicker: str
    time: np.ndarray
    unit: str
    lines: list[list[int]]
    names: list[str]
    arms: dict[tuple[str, str], np.ndarray]
    draws: np.ndarray
    observed: np.ndarray
    doubts: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    notes: dict[str, str] = field(default_factory=dict)
    summary: str = ""
    foot: str = ""
    panels: list[dict[str, Any]] = field(default_factory=list)

    def panel(self, group: str, joint: str, unit: str, sides: list[dict[str, Any]], **more: np.ndarray | None) -> None:
        """Add the curves of a joint.

        Each side has a name, a style, and `low`, `middle`, `high` (T,), of a posterior also `lower` and `upper`. More
        curves are `truth`, `command` and `dots`.
        """
        own = {name: values for name, values in more.items() if values is not None and np.isfinite(values).any()}
        curves = [side[each] for side in sides for each in ("low", "middle", "high")]
        shown = usual_range(np.concatenate([*curves, *own.values()])) or (-1.0, 1.0)
        last = sides[-1]
        places = [int(np.nanargmin(last["middle"])), int(np.nanargmax(last["middle"]))]
        least, most = (f"{last['middle'][at]:.3g} at {self.time[at]:.2f} s" for at in places)
        width = 0.5 * float(np.nanmedian(last["high"] - last["low"]))
        label = f"{group} of {joint} over time, {unit}: from {least} to {most}, give or take {width:.2g} (90 %)"
        joints, groups = ([each[key] for each in self.panels] for key in ("joint", "group"))
        row, column = (list(dict.fromkeys(names)).index(names[-1]) for names in ([*joints, joint], [*groups, group]))
        every = [{k: v if isinstance(v, str) else rounded(v, shown) for k, v in side.items()} for side in sides]
        kept = {name: rounded(values, shown) for name, values in own.items()}
        self.panels.append(
            {"id": len(self.panels), "group": group, "joint": joint, "unit": unit, "label": label, "range": shown}
            | {"sides": every, "row": row, "column": 1 + column, **kept}
        )

    def legend(self, group: str) -> list[tuple[str, str]]:
        """Names and styles of a group's curves."""
        own = [panel for panel in self.panels if panel["group"] == group]
        named = [(side["name"], side["style"]) for panel in own for side in panel["sides"]]
        named += [(name, name) for name in ("truth", "command") if any(name in panel for panel in own)]
        return list(dict.fromkeys(named))

    def html(self) -> str:
        """The page."""
        points = np.concatenate([*self.arms.values(), self.observed], axis=1).reshape(-1, self.observed.shape[-1])
        low, high = np.nanquantile(points, [0.005, 0.995], axis=0)  # an outlier must not shrink the body
        edge = 0.04 * (high - low).max()
        box = low - edge, high + edge
        span = float(low.min()), float(low.min() + (high - low).max())
        data = {
            "time": rounded(self.time, (0.0, 1.0)),
            "space": len(low),
            "unit": self.unit,
            "lines": self.lines,
            "named": self.names,
            "spots": list(range(next(iter(self.arms.values())).shape[1]))[-len(self.names) :],
            "box": rounded(np.array(box), span),
            "arms": [{"style": style, "points": rounded(each, span)} for (_, style), each in self.arms.items()],
            "draws": rounded(self.draws, span),
            "observed": rounded(self.observed, span),
            "panels": self.panels,
        }
        groups = list(dict.fromkeys(panel["group"] for panel in self.panels))
        script = "".join((PAGE / name).read_text(encoding="utf-8") for name in ("uPlot.min.js", "view.js"))
        styles = [PAGE / "uPlot.min.css", TEMPLATES / "report.css", PAGE / "view.css"]
        return (
            environment(PAGE)
            .get_template("view.html.j2")
            .render(
                title=self.title,
                kicker=self.kicker,
                doubts=self.doubts,
                said=self.said,
                notes={group: self.notes.get(group, "") for group in groups},
                legends={group: self.legend(group) for group in groups},
                arms=[{"name": name, "style": style} for name, style in self.arms],
                observed=bool(np.isfinite(self.observed).any()),
                groups=groups,
                joints=list(dict.fromkeys(panel["joint"] for panel in self.panels)),
                panels=self.panels,
                space=len(low),
                last=len(self.time) - 1,
                summary=self.summary,
                foot=self.foot,
                data=htmlsafe_json_dumps(data, separators=(",", ":"), allow_nan=False),
                script=Markup(script),
                style=Markup("\n".join(path.read_text(encoding="utf-8") for path in styles)),
                digest=digest(script),
            )
        )


def write_view(path: str | Path, out: str | Path) -> None:
    """Write the page of a posterior (.nc) or of a diagnosis (its folder or diagnosis.json), whole or not at all.

    Raises InputError for a file of another kind, OSError where one cannot be read or written.
    """
    write_text(out, view_of(path).html())


def view_of(path: str | Path) -> View:
    """What a page shows of a file; raises as :func:`write_view`."""
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    if path.is_dir() and not (path / DIAGNOSIS).exists():
        raise InputError(f"{path}: expected a posterior, .nc, or the folder of a diagnosis with {DIAGNOSIS} in it")
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
            side = {"name": "posterior median", "style": "after"}
            side |= zip(("low", "lower", "middle", "upper", "high"), bands[:, :, k], strict=True)
            more = {"truth": known.get(f"truth_{group}"), "dots": observed.get(group)}
            more |= {"command": known.get("command")} if group == "torque" else {}
            curves = {name: None if each is None else _of_joint(each, k)[rows] for name, each in more.items()}
            view.panel(group, joint, unit_of(idata, group, k), [side], **curves)
    return view


def _of_diagnosis(idata: az.InferenceData) -> View:
    """What a page shows of a diagnosis that `invdyn diagnose` saved."""
    tracks, turning = idata["tracks"], ~shifts(idata)
    rows = _rows(tracks.sizes["time"])
    base = np.broadcast_to(tracks["base"].values, (len(rows), 1, tracks.sizes["space"]))
    sides = {("simulation as it is", "before"): "nominal", ("corrected", "after"): "corrected"}
    replays = {side: tracks[f"{name}_replay"].values[rows] for side, name in sides.items()}
    corrected = not np.array_equal(*replays.values(), equal_nan=True)
    if not corrected:
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
    return view


def rounded(values: np.ndarray, span: tuple[float, float]) -> Any:
    """As nested lists, to a five-thousandth of a span; NaN becomes None."""
    digits = max(0, 4 - math.floor(math.log10(max(span[1] - span[0], 1e-12))))
    values = np.round(np.asarray(values, float), digits)
    lists = np.where(np.isfinite(values), values, None)
    return lists.tolist()


def _of_joint(values: xr.DataArray, k: int) -> np.ndarray:
    return values.transpose("time", "joint").values[:, k]


def _rows(count: int) -> np.ndarray:
    return np.arange(0, count, -(-count // MAX_ROWS))


def _thinned(rows: np.ndarray, count: int) -> str:
    return "" if len(rows) == count else f"Every {rows[1]}th of {count} rows is shown."

"""A page of curves, and of a body that moves with them: one file that opens anywhere, without a server or a network.

Curves are drawn by uPlot 1.6.32 (Leon Sorokin, MIT), which the page holds; its own script is `view_page/view.js`. As a
report, it carries the digest of the one script that may run, and escapes all that it is given. Its content may also be
a recording of the viewer Rerun (rerun.io), .rrd:

body/<arm>, body/draws, body/seen        lines and points, in the recording's unit of length; a plane has z = 0
<group>/<joint>/<side>/middle, low, high  scalars, as on the page, whose rows these are
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup

from invdyn.diagnosis.report.report import TEMPLATES, digest, environment
from invdyn.recordings import InputError, atomic_path

from .plots import usual_range

ASSETS = Path(__file__).parent / "view_page"
SMALL = 0.01
"""Of a unit: below it a panel's numbers are in thousandths."""


@dataclass
class View:
    """What a page shows; T rows, N points of the body (the first one is its base), d dimensions. A study has no body.

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
        tables: title -> rows of cells, the first one its head.
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
    tables: dict[str, list[list[str]]] = field(default_factory=dict)

    def panel(
        self,
        group: str,
        joint: str,
        unit: str,
        sides: list[dict[str, Any]],
        trials: Sequence[tuple[str, np.ndarray]] = (),
        more: Mapping[str, np.ndarray | None] = MappingProxyType({}),
    ) -> None:
        """Add the curves of a joint.

        Numbers are in ``unit``; the page shows small ones in thousandths or millionths of it.
        Each side has a name, a style, and `low`, `middle`, `high` (T,), of a posterior also `lower` and `upper`.
        ``trials`` are pale, each of a style. ``more`` curves are `truth`, `command` and `dots`.
        """
        own = {name: values for name, values in more.items() if values is not None and np.isfinite(values).any()}
        curves = [side[each] for side in sides for each in ("low", "middle", "high")]
        shown = usual_range(np.concatenate([*curves, *own.values()])) or (-1.0, 1.0)
        factor, unit = with_prefix(unit, max(map(abs, shown)))
        words = "; ".join(self._in_words(side, factor) for side in sides)
        label = f"{group} of {joint} over time, {unit}: {words}"
        joints, groups = ([each[key] for each in self.panels] for key in ("joint", "group"))
        row, column = (list(dict.fromkeys(names)).index(names[-1]) for names in ([*joints, joint], [*groups, group]))
        every = [{k: v if isinstance(v, str) else rounded(v, shown) for k, v in side.items()} for side in sides]
        kept = {name: rounded(values, shown) for name, values in own.items()}
        self.panels.append(
            {"id": len(self.panels), "group": group, "joint": joint, "unit": unit, "label": label, "range": shown}
            | {"factor": factor, "sides": every, "row": row, "column": 1 + column, **kept}
            | {"trials": [{"style": style, "values": rounded(values, shown)} for style, values in trials]}
        )

    def _in_words(self, side: dict[str, Any], factor: float) -> str:
        low, middle, high = (factor * side[each] for each in ("low", "middle", "high"))
        if not np.isfinite(middle).any():
            return f"{side['name']}: not known"
        least, most = (
            f"{middle[at]:.3g} at {self.time[at]:.2f} s" for at in (np.nanargmin(middle), np.nanargmax(middle))
        )
        half = 0.5 * float(np.nanmedian(high - low))
        return f"{side['name']} from {least} to {most}, give or take {half:.2g} (90 %)"

    def legend(self, group: str) -> list[tuple[str, str]]:
        """Names and styles of a group's curves."""
        own = [panel for panel in self.panels if panel["group"] == group]
        named = [(side["name"], side["style"]) for panel in own for side in panel["sides"]]
        named += [(name, name) for name in ("truth", "command") if any(name in panel for panel in own)]
        return list(dict.fromkeys(named))

    def _body(self) -> dict[str, Any]:
        """What the script draws of the body."""
        if not self.arms:
            return {}
        points = np.concatenate([*self.arms.values(), self.observed], axis=1).reshape(-1, self.observed.shape[-1])
        low, high = np.nanquantile(points, [0.005, 0.995], axis=0)  # an outlier must not shrink the body
        edge = 0.04 * (high - low).max()
        box = low - edge, high + edge
        span = float(low.min()), float(low.min() + (high - low).max())
        return {
            "space": len(low),
            "unit": self.unit,
            "lines": self.lines,
            "named": self.names,
            "spots": list(range(next(iter(self.arms.values())).shape[1]))[-len(self.names) :],
            "box": rounded(np.array(box), span),
            "arms": [{"style": style, "points": rounded(each, span)} for (_, style), each in self.arms.items()],
            "draws": rounded(self.draws, span),
            "observed": rounded(self.observed, span),
        }

    def html(self) -> str:
        """The page."""
        body = self._body()
        data = {"time": rounded(self.time, (0.0, 1.0)), "panels": self.panels, **body}
        groups = list(dict.fromkeys(panel["group"] for panel in self.panels))
        script = "".join((ASSETS / name).read_text(encoding="utf-8") for name in ("uPlot.min.js", "view.js"))
        styles = [ASSETS / "uPlot.min.css", TEMPLATES / "report.css", ASSETS / "view.css"]
        return (
            environment(ASSETS)
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
                tables=self.tables,
                space=body.get("space", 0),
                last=len(self.time) - 1,
                summary=self.summary,
                foot=self.foot,
                data=htmlsafe_json_dumps(data, separators=(",", ":"), allow_nan=False),
                script=Markup(script),
                style=Markup("\n".join(path.read_text(encoding="utf-8") for path in styles)),
                digest=digest(script),
            )
        )


def with_prefix(unit: str, largest: float) -> tuple[float, str]:
    """By what to multiply numbers up to ``largest``, so that few begin with zeros, and the unit that they then have."""
    if unit in ("N·m", "N", "m") and 0 < largest < SMALL:
        return (1e3, f"m{unit}") if largest >= 1e-3 * SMALL else (1e6, f"µ{unit}")
    return 1.0, unit


def rounded(values: np.ndarray, span: tuple[float, float]) -> Any:
    """As nested lists, to a five-thousandth of a span; NaN becomes None."""
    digits = max(0, 4 - math.floor(math.log10(max(span[1] - span[0], 1e-12))))
    lists = np.round(np.asarray(values, float), digits).astype(object)
    lists[~np.isfinite(values)] = None
    return lists.tolist()


def write_rerun(view: View, out: Path) -> None:
    """Write it, whole or not at all. Raises InputError without the library, OSError where it cannot be written."""
    try:
        import rerun
    except ImportError:
        raise InputError(f"{out}: .rrd needs `pip install 'invdyn[rerun]'`; the page works without") from None
    flat = 3 - (view.observed.shape[-1] if view.arms else 3)
    body = [(["body", name], points) for (name, _), points in view.arms.items()]
    body += [(["body", "draws", str(number)], points) for number, points in enumerate(view.draws if view.arms else ())]
    with atomic_path(out) as temporary:
        recording = rerun.RecordingStream("invdyn")
        recording.save(str(temporary))
        for row, time in enumerate(view.time):
            recording.set_time("time", duration=float(time))
            for name, points in body:
                placed = np.pad(points[row], ((0, 0), (0, flat)))
                strips = [placed[line] for line in view.lines if np.isfinite(placed[line]).all()]
                recording.log(name, rerun.LineStrips3D(strips))
            if view.arms:
                seen = view.observed[row][np.isfinite(view.observed[row]).all(-1)]
                recording.log(["body", "seen"], rerun.Points3D(np.pad(seen, ((0, 0), (0, flat)))))
            for panel in view.panels:
                for side in panel["sides"]:
                    place = [panel["group"], panel["joint"], side["name"]]
                    for curve in ("middle", "low", "high"):
                        if (value := side[curve][row]) is not None:
                            recording.log([*place, curve], rerun.Scalars(value))
        recording.disconnect()

"""Figures as SVG in HTML: the box stretches with the page while text and lines keep their size.

A plot is a box of 2000 × 1000 units that the browser stretches to any width; ticks are HTML around it. Everything that
is written passes :class:`markupsafe.Markup`, which escapes what files contain.
"""

import math
from collections.abc import Sequence

import numpy as np
from markupsafe import Markup

from invdyn.diagnosis.report.numbers import fixed
from invdyn.diagnosis.rules import FIXED


def ticks(low: float, high: float, count: int) -> list[float]:
    """Round numbers (1, 2 or 5 times a power of ten apart) from `low` to `high`, about `count` of them."""
    raw = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(raw))
    step = min((m * power for m in (1, 2, 5, 10)), key=lambda s: abs(math.log(s / raw)))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [i * step for i in range(first, last + 1)]


def limits(*arrays: np.ndarray, zero: bool = False, margin: float = 0.05) -> tuple[float, float]:
    """Range of all finite numbers with a margin; (0, 1) where there are none."""
    values = np.concatenate([np.ravel(a) for a in arrays] + [np.zeros(1 if zero else 0)])
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    room = margin * (high - low) if high > low else 0.5 * abs(high) or 1.0
    return low - room, high + room


def thinned(x: np.ndarray, y: np.ndarray, most: int = FIXED.max_plot_points) -> tuple[np.ndarray, np.ndarray]:
    """At most about `most` points of a line, the lowest and the highest of each stretch, so that every spike stays."""
    if len(x) <= most:
        return x, y
    keep = set()
    for block in np.array_split(np.arange(len(x)), most // 2):
        part = y[block]
        if np.isfinite(part).any():
            keep |= {int(block[np.nanargmin(part)]), int(block[np.nanargmax(part)])}
        if not np.isfinite(part).all():
            keep.add(int(block[np.flatnonzero(~np.isfinite(part))[0]]))
    index = np.array(sorted(keep), int)
    return x[index], y[index]


def path(points: np.ndarray) -> str:
    """SVG path through (N, 2) whole numbers, broken at NaN; a single point is the shortest of lines."""
    pieces: list[str] = []
    run: list[tuple[float, float]] = []

    def close() -> None:
        if run:
            pieces.append("M" + " ".join(f"{round(x)} {round(y)}" for x, y in run) + ("h.1" if len(run) == 1 else ""))
        run.clear()

    for x, y in points.tolist():
        if math.isfinite(x) and math.isfinite(y):
            run.append((x, y))
        else:
            close()
    close()
    return "".join(pieces)


def dots(points: np.ndarray) -> str:
    """SVG path of separate points, drawn by the caps of the shortest of lines (of none, printers draw no square)."""
    seen = points[np.isfinite(points).all(-1)]
    return "".join(f"M{round(x)} {round(y)}h.1" for x, y in seen.tolist())


class Plot:
    """Axes with what is drawn on them.

    Args:
        x, y: limits.
        x_name, y_name: with units.
        counts: ticks of x and y, about.
        height: of the box, in px.
    """

    def __init__(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        x_name: str,
        y_name: str,
        counts: tuple[int, int] = (6, 4),
        height: int = 170,
    ):
        self.x, self.y, self.names, self.counts, self.height = x, y, (x_name, y_name), counts, height
        self._marks: list[Markup] = []
        self._texts: list[Markup] = []

    def _points(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        across = FIXED.plot_width * (np.asarray(x, float) - self.x[0]) / (self.x[1] - self.x[0])
        up = FIXED.plot_height * (self.y[1] - np.asarray(y, float)) / (self.y[1] - self.y[0])
        return np.stack(np.broadcast_arrays(across, up), -1)

    def _add(self, d: str, style: str) -> None:
        if d:
            self._marks.append(Markup('<path class="{}" d="{}"/>').format(style, d))

    def line(self, x: np.ndarray, y: np.ndarray, style: str) -> None:
        """A line, broken where `y` is NaN."""
        self._add(path(self._points(*thinned(x, y))), style)

    def dots(self, x: np.ndarray, y: np.ndarray, style: str) -> None:
        """Separate points."""
        self._add(dots(self._points(x, y)), style)

    def band(self, x: np.ndarray, low: np.ndarray, high: np.ndarray, style: str) -> None:
        """The area between two lines, one for each stretch without NaN."""
        good = np.isfinite(low) & np.isfinite(high)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], good.astype(int), [0]])))
        d = ""
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            part = slice(start, stop)
            upper = self._points(*thinned(x[part], high[part], FIXED.max_plot_points // 2))
            lower = self._points(*thinned(x[part], low[part], FIXED.max_plot_points // 2))
            d += path(np.concatenate([upper, lower[::-1]])) + "Z"
        self._add(d, style)

    def level(self, y: float, style: str = "level") -> None:
        """A horizontal line."""
        self.line(np.array(self.x), np.array([y, y]), style)

    def span(self, start: float, stop: float, text: str) -> None:
        """A stretch of x, shaded, with a word at its top."""
        ends = np.clip([start, stop], *self.x)
        a, b = (float(v) for v in self._points(ends, np.zeros(2))[:, 0])
        self._add(f"M{round(a)} 0H{max(round(b), round(a) + 3)}V{FIXED.plot_height}H{round(a)}Z", "span")
        place = min(max((a + b) / 2 / FIXED.plot_width, 0.05), 0.95)
        self._texts.append(Markup('<b style="left:{:.1%}">{}</b>').format(place, text))

    def html(self, label: str) -> Markup:
        """The figure; `label` tells what it shows to those who do not see it."""
        across, up = ticks(*self.x, self.counts[0]), ticks(*self.y, self.counts[1])
        xs, ys = (
            self._points(np.array(across), np.zeros(len(across)))[:, 0] / FIXED.plot_width,
            self._points(np.zeros(len(up)), np.array(up))[:, 1],
        )
        grid = "".join(f"M{round(v * FIXED.plot_width)} 0V{FIXED.plot_height}" for v in xs) + "".join(
            f"M0 {round(v)}H{FIXED.plot_width}" for v in ys
        )
        return Markup(
            '<div class="plot" role="img" aria-label="{}"><div class="yname">{}</div>'
            '<div class="y">{}</div><div class="box" style="height:{}px">{}'
            '<svg viewBox="0 0 {} {}" preserveAspectRatio="none" aria-hidden="true">'
            '<path class="grid" d="{}"/>{}</svg></div><div class="x">{}</div><div class="xname">{}</div></div>'
        ).format(
            label,
            self.names[1],
            _labels("top", ys / FIXED.plot_height, up),
            self.height,
            Markup("").join(self._texts),
            FIXED.plot_width,
            FIXED.plot_height,
            grid,
            Markup("").join(self._marks),
            _labels("left", xs, across),
            self.names[0],
        )


def _labels(edge: str, places: np.ndarray, values: Sequence[float]) -> Markup:
    step = values[1] - values[0] if len(values) > 1 else abs(values[0]) if values and values[0] else 1.0
    digits = -math.floor(math.log10(step) + 1e-9)
    return Markup("").join(
        Markup('<i style="{}:{:.2%}">{}</i>').format(edge, float(p), fixed(v, digits))
        for p, v in zip(places, values, strict=True)
    )

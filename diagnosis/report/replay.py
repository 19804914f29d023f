"""The replay: recorded keypoints, the simulation as it is and with the cause, over one another, as data for the page.

Positions become whole tenths of the picture's units, rows are thinned to `FRAMES`; missing is null.
"""

import numpy as np

from invdyn.diagnosis.assessment.result import Diagnosis
from invdyn.diagnosis.report.arm import View
from invdyn.diagnosis.report.drawing import Plot, dots, limits
from invdyn.diagnosis.report.numbers import fixed, root_mean_square
from invdyn.diagnosis.rules import FIXED


def replay(diagnosis: Diagnosis) -> dict | None:
    """Data of the animation, its still picture and the error over time; None where nothing was replayed.

    Where nothing was corrected the simulation is drawn once.
    """
    tracks = diagnosis.tracks
    if tracks is None or not np.isfinite(tracks.nominal_replay).any():
        return None
    rows = np.arange(0, len(tracks.time), -(-len(tracks.time) // FIXED.max_replay_frames))
    seen_from = np.eye(2) if diagnosis.posture is None else diagnosis.posture.views[0]
    time = tracks.time[rows]
    whole = {"nominal": tracks.nominal_replay[rows]}
    if corrected := not np.array_equal(tracks.nominal_replay, tracks.corrected_replay, equal_nan=True):
        whole["corrected"] = tracks.corrected_replay[rows]
    off = {name: 1e3 * np.linalg.norm(v[:, -1] - tracks.smoothed[rows, -1], axis=-1) for name, v in whole.items()}
    observed, smoothed, base_at = (v @ seen_from.T for v in (tracks.observed[rows], tracks.smoothed[rows], tracks.base))
    sides = {name: v @ seen_from.T for name, v in whole.items()}
    seen = _usual(np.concatenate([observed.reshape(-1, 2), smoothed.reshape(-1, 2)]))
    drawn = _usual(np.concatenate([v.reshape(-1, 2) for v in sides.values()]))
    view = View(
        _within(np.concatenate([seen, drawn, base_at[None]]), seen), (FIXED.replay_width, FIXED.replay_height), (14, 14)
    )
    base = 10 * view(base_at)
    worst = int(np.nanargmax(off["nominal"])) if np.isfinite(off["nominal"]).any() else 0
    data = {
        "time": [round(float(t), 4) for t in time - time[0]],
        "start": worst,
        "base": _whole(base),
        "observed": _whole(10 * view(observed)),
        "off": {name: _whole(10 * v) for name, v in off.items()},
        **{name: _whole(10 * view(v)) for name, v in sides.items()},
    }
    plot = Plot(limits(time - time[0], margin=0), limits(*off.values(), zero=True), "time, s", "mm", height=90)
    plot.line(time - time[0], off["nominal"], "line before")
    if corrected:
        plot.line(time - time[0], off["corrected"], "line after")
    label = ", ".join(f"{name} {fixed(root_mean_square(v), 1)} mm rms" for name, v in off.items())
    ghosts = observed[:: -(-len(rows) // FIXED.max_background_points)].reshape(-1, 2)
    return {
        "data": data,
        "corrected": corrected,
        "width": 10 * FIXED.replay_width,
        "height": 10 * FIXED.replay_height,
        "ghosts": dots(10 * view(ghosts)),
        "still": {name: chain(base, 10 * view(v[worst])) for name, v in sides.items()},
        "points": dots(10 * view(observed[worst])),
        "last": len(rows) - 1,
        "time": fixed(float(time[worst] - time[0]), 2),
        "off": {name: fixed(float(v[worst]), 1) for name, v in off.items()},
        "errors": plot.html(f"Distance of the replayed tip from the recorded one, smoothed, over time: {label}"),
        "window": tracks.replay_window,
        "thinned": len(rows) < len(tracks.time),
    }


def chain(base: np.ndarray, tips: np.ndarray) -> str:
    """SVG path from the base through the tips; empty where one is missing."""
    if not np.isfinite(tips).all():
        return ""
    return "M" + "L".join(f"{round(x)} {round(y)}" for x, y in [base.tolist(), *tips.tolist()])


def _whole(values: np.ndarray) -> list:
    values = np.asarray(values)
    if values.ndim > 1:
        return [_whole(v) for v in values]
    return [round(v) if np.isfinite(v) else None for v in values.tolist()]


def _usual(points: np.ndarray) -> np.ndarray:
    """Without those far outside of where nearly all are: an outlier must not shrink the picture."""
    points = points[np.isfinite(points).all(-1)]
    if not len(points):
        return points
    low, high = np.quantile(points, [0.01, 0.99], axis=0)
    room = 0.5 * (high - low).max()
    return points[((points >= low - room) & (points <= high + room)).all(-1)]


def _within(points: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Points pulled to at most one width of what was seen outside of it: a replay may run away."""
    if not len(seen):
        return points
    low, high = seen.min(0), seen.max(0)
    room = (high - low).max()
    return np.clip(points, low - room, high + room)

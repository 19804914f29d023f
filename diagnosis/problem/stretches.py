"""A long recording in its most informative stretches, where evenly spaced rows would lie too far apart.

A diagnosis uses `max_rows` rows. More than `max_row_spacing` apart they no longer show how the arm moves between them,
so that a long recording is cut into windows, and those are chosen that together make the parameters of a motion known
best: greedily by the determinant of their information (D-optimal design: Fedorov 1972; Wynn 1970),

    w = argmax log det(A + X_wᵀ X_w),    A ← A + X_wᵀ X_w,    X = (1, y, ẏ, ÿ, tanh(ẏ/v)) of every column y,

each column of X in its own rms. Gravity, damping, inertia and dry friction are known by y, ẏ, ÿ and its sign; no body
is needed, as encoders and keypoints follow the joints. Windows next to each other are one stretch.

Shapes: W windows, n rows in each, P = 1 + 4 columns.
"""

import numpy as np

from invdyn.diagnosis.rules import Rules
from invdyn.recordings import Recording


def stretches(recording: Recording, rules: Rules) -> list[Recording]:
    """Stretches of a recording, in their order, that `max_rows` rows show well; itself where they show all of it."""
    most = rules.recording.max_rows
    table = np.concatenate(
        [
            values.reshape(recording.num_frames, -1)
            for values in (recording.angles, recording.keypoints)
            if values is not None and values.size
        ],
        -1,
    )
    seen = recording.time[np.isfinite(table).any(1)]
    if len(seen) <= most:
        return [recording]
    apart = max(rules.recording.max_row_spacing, float(np.median(np.diff(seen))))
    window = apart * most / rules.recording.num_windows
    count = int((seen[-1] - seen[0]) / window)
    if count <= rules.recording.num_windows:
        return [recording]
    edges = seen[0] + window * np.arange(count + 1)
    chosen = np.sort(_most_informative(_information(recording.time, table, edges, apart, rules), rules))
    pieces = np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1)
    return [
        recording.at((recording.time >= edges[piece[0]]) & (recording.time < edges[piece[-1] + 1])) for piece in pieces
    ]


def _information(time: np.ndarray, table: np.ndarray, edges: np.ndarray, apart: float, rules: Rules) -> np.ndarray:
    """X_wᵀ X_w (W, P, P) of each window, from means over ``apart`` seconds of columns (T, C), NaN where missing."""
    per = max(round((edges[1] - edges[0]) / apart), 3)
    bins = np.linspace(edges[0], edges[-1], per * (len(edges) - 1) + 1)
    middle = (bins[1:] + bins[:-1]) / 2
    features = [np.ones(len(middle))]
    for column in table.T[np.isfinite(table).any(0)]:
        known = np.isfinite(column)
        total, rows = (np.histogram(time[known], bins, weights=w)[0] for w in (column[known], None))
        there = rows > 0
        y = np.interp(middle, middle[there], total[there] / rows[there])
        yd = np.gradient(y, middle)
        speed = max(float(np.sqrt((yd**2).mean())), 1e-12)
        features += [y - y.mean(), yd, np.gradient(yd, middle), np.tanh(yd / (rules.check.slow_velocity * speed))]
    X = np.stack(features, -1)
    X = (X / np.maximum(np.sqrt((X**2).mean(0)), 1e-12)).reshape(len(edges) - 1, per, -1)
    return np.swapaxes(X, 1, 2) @ X


def _most_informative(information: np.ndarray, rules: Rules) -> np.ndarray:
    """Numbers (`num_windows`,) of the windows with most information together, by greedy choice."""
    known = rules.recording.window_prior * (information.mean(0) + 1e-9 * np.eye(information.shape[-1]))
    chosen: list[int] = []
    for _ in range(rules.recording.num_windows):
        gain = np.linalg.slogdet(known + information)[1]
        gain[chosen] = -np.inf
        chosen.append(int(gain.argmax()))
        known = known + information[chosen[-1]]
    return np.array(chosen)

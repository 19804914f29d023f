"""A long recording in fewer rows, or in its most informative stretches where those would lie too far apart.

A diagnosis takes time and memory by the row, and uses `max_rows` rows. A log of 500 rows/s says next to nothing that
one of 100 does not say as well; what drives the arm in between is known, and a row carries it as it came. So encoders
and keypoints are seen less often, each still evenly. Of two streams the rarer one, a camera's with encoders, keeps up
to half of the rows.

Rows that are more than `max_row_spacing` apart no longer show how the arm moves between them. So a long recording is
cut into windows, and those are chosen that together make the parameters of a motion known best: greedily by the
determinant of their information (D-optimal design: Fedorov 1972; Wynn 1970),

    w = argmax log det(A + X_wᵀ X_w),    A ← A + X_wᵀ X_w,    X = (1, y, ẏ, ÿ, tanh(ẏ/v)) of every column y,

each column of X in its own rms. Gravity, damping, inertia and dry friction are known by y, ẏ, ÿ and its sign; no body
is needed, as encoders and keypoints follow the joints. Windows next to each other are one stretch.

Shapes: W windows, n rows in each, P = 1 + 4 columns.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from invdyn.diagnosis.rules import DEFAULT, Rules
from invdyn.recordings import Recording


def looked_at(recording: Recording, rules: Rules = DEFAULT) -> list[Recording]:
    """What a diagnosis looks at of a recording, `max_rows` rows of observations at most: itself, or stretches of it."""
    parts = stretches(recording, rules)
    most = rules.recording.max_rows
    lasts = [part.time[-1] - part.time[0] for part in parts]
    return [thinned(part, int(most * last / sum(lasts))) for part, last in zip(parts, lasts, strict=True)]


def thinned(recording: Recording, most: int) -> Recording:
    """``recording`` with no more than ``most`` rows of observations; itself where it has no more. NaN elsewhere."""
    streams: dict[str, Any] = {"keypoints": recording.keypoints, "angles": recording.angles}
    seen = _seen(recording)
    if _rows(seen) <= most:
        return recording
    changed: dict[str, Any] = {}
    room = most
    for place, (name, rows) in enumerate(sorted(seen.items(), key=lambda each: len(each[1]))):
        share = room // (len(seen) - place)
        every = -(-len(rows) // max(share, 1)) or 1
        kept = rows[::every]
        room -= len(kept)
        values = np.full_like(streams[name], np.nan)
        values[kept] = streams[name][kept]
        changed[name] = values
    return replace(recording, **changed)


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
    chosen = np.sort(most_informative(information_in(recording.time, table, edges, apart, rules), rules))
    pieces = np.split(chosen, np.flatnonzero(np.diff(chosen) > 1) + 1)
    return [
        recording.at((recording.time >= edges[piece[0]]) & (recording.time < edges[piece[-1] + 1])) for piece in pieces
    ]


def information_in(time: np.ndarray, table: np.ndarray, edges: np.ndarray, apart: float, rules: Rules) -> np.ndarray:
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


def most_informative(information: np.ndarray, rules: Rules) -> np.ndarray:
    """Numbers (`num_windows`,) of the windows with most information together, by greedy choice."""
    known = rules.recording.window_prior * (information.mean(0) + 1e-9 * np.eye(information.shape[-1]))
    chosen: list[int] = []
    for _ in range(rules.recording.num_windows):
        gain = np.linalg.slogdet(known + information)[1]
        gain[chosen] = -np.inf
        chosen.append(int(gain.argmax()))
        known = known + information[chosen[-1]]
    return np.array(chosen)


def left_out(recordings: Sequence[Recording], rules: Rules = DEFAULT) -> str | None:
    """A sentence about what a diagnosis does not look at of recordings; None where it looks at all."""
    parts = [looked_at(each, rules) for each in recordings]
    total, used = (sum(_rows(_seen(each)) for each in some) for some in (recordings, chain(*parts)))
    if used == total:
        return None
    rows = f"Of {total} rows with an observation {used} were used, at even spacing, with all commands between them"
    cut = [_where(each, of) for each, of in zip(recordings, parts, strict=True) if len(of) > 1]
    return ". ".join([rows, *cut])


def _where(recording: Recording, parts: Sequence[Recording]) -> str:
    """A sentence about the stretches of a recording."""
    whole, some = (sum(each.time[-1] - each.time[0] for each in of) for of in ([recording], parts))
    begin = recording.time[0]
    spans = ", ".join(f"{part.time[0] - begin:.4g}–{part.time[-1] - begin:.4g}" for part in parts)
    return (
        f"{recording.name} is long: of its {whole:.4g} s the {some:.4g} s with most information were used, {spans} s, "
        "one after the other"
    )


def _seen(recording: Recording) -> dict[str, np.ndarray]:
    """Rows at which each stream is seen."""
    streams = {"keypoints": recording.keypoints, "angles": recording.angles}
    return {
        name: np.flatnonzero(np.isfinite(values).reshape(len(values), -1).any(1))
        for name, values in streams.items()
        if values is not None and values.size
    }


def _rows(seen: dict[str, np.ndarray]) -> int:
    return len(np.unique(np.concatenate(list(seen.values())))) if seen else 0

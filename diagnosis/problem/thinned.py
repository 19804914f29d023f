"""A long recording in fewer rows: encoders and keypoints seen less often, each still evenly, and every command kept.

A diagnosis takes time and memory by the row. A log of 500 rows/s says next to nothing that one of 100 does not say as
well; what drives the arm in between is known, and a row carries it as it came. Of two streams the rarer one, a camera's
with encoders, keeps up to half of the rows. Of a recording too long for that, the most informative stretches are
used (:mod:`.stretches`).
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from invdyn.diagnosis.problem.stretches import stretches
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

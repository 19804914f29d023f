"""Two keypoints whose names are exchanged throughout: distances that fit at no scale, but fit after the exchange.

Let d be the distances of points that are L apart on the body. With the scale s = ΣL/Σ median d,

    r = max median |s d/L − 1|

Names are exchanged where r is large, and far smaller after exchanging two of them; or smaller, and the distances' own
changes, the same with each pair's median d for its L/s, far smaller, as where L is a table's. A wrong scale, markers
next to their joints and perspective do not reduce r that way.

Shapes: T frames, S axes.
"""

from collections.abc import Collection, Mapping
from itertools import combinations

import numpy as np

from .errors import InputError
from .limits import PLAUSIBLE


def check_names(
    points: Mapping[str, np.ndarray], lengths: Mapping[tuple[str, str], float], keypoints: Collection[str]
) -> None:
    """Raise InputError where two names of ``keypoints`` are exchanged; other points have theirs from the body.

    Args:
        points: by name, tracks (T, S), NaN where missing.
        lengths: by two names, all of them in ``points``, in any unit.
        keypoints: names that the recording gave.
    """
    own = _misfit(points, lengths)
    if not own > PLAUSIBLE.misfit:
        return
    ends = [name for name in dict.fromkeys(name for pair in lengths for name in pair) if name in keypoints]
    exchanged = {(a, b): {**points, a: points[b], b: points[a]} for a, b in combinations(ends, 2)}
    tried = {pair: np.nan_to_num(_misfit(tracks, lengths), nan=np.inf) for pair, tracks in exchanged.items()}
    (one, other), left = min(tried.items(), key=lambda item: item[1], default=(("", ""), np.inf))
    bent, bent_left = (_misfit(each, lengths, own=True) for each in (points, exchanged.get((one, other), points)))
    if left < PLAUSIBLE.misfit_left * own or (left < own and bent_left < PLAUSIBLE.misfit_left * bent):
        raise InputError(
            f"keypoints {one!r} and {other!r} seem to be exchanged: distances differ from the body's lengths by "
            f"{100 * own:.0f} % (median, at any scale), with the two names exchanged by {100 * left:.0f} %: "
            "exchange their names"
        )


def _misfit(points: Mapping[str, np.ndarray], lengths: Mapping[tuple[str, str], float], own: bool = False) -> float:
    """r; of the distances' ``own`` medians; NaN where two are never seen together, or coincide."""
    apart = {pair: np.linalg.norm(points[pair[0]] - points[pair[1]], axis=-1) for pair in lengths}
    seen = {pair: distance[np.isfinite(distance)] for pair, distance in apart.items()}
    if not all(map(len, seen.values())):
        return np.nan
    medians = {pair: float(np.median(distance)) for pair, distance in seen.items()}
    if not min(medians.values(), default=0) > 0:
        return np.nan
    given = medians if own else lengths
    scale = sum(given.values()) / sum(medians.values())
    return max(float(np.median(np.abs(scale * seen[pair] / length - 1))) for pair, length in given.items())

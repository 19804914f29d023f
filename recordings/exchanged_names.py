"""Two keypoints whose names are exchanged throughout: distances that fit at no scale, but fit after the exchange.

Let d be the distances of points that are L apart on the body. With the scale s = ΣL/Σ median d,

    r = max median |s d/L − 1|

Names are exchanged where r is large, and far smaller after exchanging two of them. A wrong scale, markers next to their
joints and perspective do not reduce r that way.

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
    tried = {
        (one, other): _misfit({**points, one: points[other], other: points[one]}, lengths)
        for one, other in combinations(ends, 2)
    }
    none = (("", ""), np.inf)
    (one, other), left = min(tried.items(), key=lambda item: np.nan_to_num(item[1], nan=np.inf), default=none)
    if left < PLAUSIBLE.misfit_left * own:
        raise InputError(
            f"keypoints {one!r} and {other!r} seem to be exchanged: distances differ from the body's lengths by "
            f"{100 * own:.0f} % (median, at any scale), with the two names exchanged by {100 * left:.0f} %: "
            "exchange their names"
        )


def _misfit(points: Mapping[str, np.ndarray], lengths: Mapping[tuple[str, str], float]) -> float:
    """r; NaN where two are never seen together, or always coincide."""
    apart = {pair: np.linalg.norm(points[pair[0]] - points[pair[1]], axis=-1) for pair in lengths}
    seen = {pair: distance[np.isfinite(distance)] for pair, distance in apart.items()}
    if not all(map(len, seen.values())):
        return np.nan
    total = sum(float(np.median(distance)) for distance in seen.values())
    if not total > 0:
        return np.nan
    scale = sum(lengths.values()) / total
    return max(float(np.median(np.abs(scale * seen[pair] / length - 1))) for pair, length in lengths.items())

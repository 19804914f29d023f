"""Two keypoints whose names are exchanged throughout: lengths that no scale mends, and an exchange does.

Let d be the distances of points that a body keeps apart by L. With s = ΣL/Σ median d, whatever the scale is,

    r = max median |s d/L − 1|

Names are exchanged where r is large, and far smaller once two of them change places. A scale that is wrong, markers
aside of their joints and a picture that shortens leave r as large as before.

Shapes: T frames, S axes.
"""

from collections.abc import Collection, Mapping
from itertools import combinations

import numpy as np

from .errors import InputError

OFF = 0.15
"""r that noise and markers aside of their joints seldom reach."""
MENDED = 0.3
"""Of r, what may be left of it: as of torques that a mistake explains."""


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
    if not own > OFF:
        return
    ends = [name for name in dict.fromkeys(name for pair in lengths for name in pair) if name in keypoints]
    tried = {
        (one, other): _misfit({**points, one: points[other], other: points[one]}, lengths)
        for one, other in combinations(ends, 2)
    }
    none = (("", ""), np.inf)
    (one, other), left = min(tried.items(), key=lambda item: np.nan_to_num(item[1], nan=np.inf), default=none)
    if left < MENDED * own:
        raise InputError(
            f"keypoints {one!r} and {other!r} seem to be exchanged: distances differ from the body's lengths by "
            f"{100 * own:.0f} % (median, at any scale), with the two names exchanged by {100 * left:.0f} %: "
            "exchange their names"
        )


def _misfit(points: Mapping[str, np.ndarray], lengths: Mapping[tuple[str, str], float]) -> float:
    """r; NaN where some two are never seen together, or lie in one place."""
    apart = {pair: np.linalg.norm(points[pair[0]] - points[pair[1]], axis=-1) for pair in lengths}
    seen = {pair: distance[np.isfinite(distance)] for pair, distance in apart.items()}
    if not all(map(len, seen.values())):
        return np.nan
    total = sum(float(np.median(distance)) for distance in seen.values())
    if not total > 0:
        return np.nan
    scale = sum(lengths.values()) / total
    return max(float(np.median(np.abs(scale * seen[pair] / length - 1))) for pair, length in lengths.items())

"""What a tracker makes of points: noise by one of several laws, and mistakes that come one by one or in rows."""

from collections.abc import Sequence

import numpy as np

LAWS = {"normal": 0.3, "rounded": 0.2, "uneven": 0.2, "heavy": 0.15, "trailing": 0.15}
"""Noise laws and how often they are met: normal; half of the variance of rounding to pixels; keypoints of unequal
noise; Student's t of eight degrees of freedom; correlated from frame to frame by .1 to .25."""


def noise_law(seed: Sequence[int]) -> str:
    """The law of a reality's tracker."""
    return str(np.random.default_rng([*seed[:4], 101]).choice(list(LAWS), p=list(LAWS.values())))


def unit_noise(shape: tuple[int, ...], law: str, rng: np.random.Generator, seed: Sequence[int]) -> np.ndarray:
    """Noise (T, P, 2) of a law of `LAWS`, of unit variance over all keypoints."""
    own, normal = np.random.default_rng([*seed[:4], 102]), rng.standard_normal(shape)
    if law == "rounded":  # as wide as the pixels are, the rest of a pixel is as good as random
        return np.sqrt(0.5) * (normal + rng.uniform(-np.sqrt(3), np.sqrt(3), shape))
    if law == "uneven":
        each = own.uniform(0.6, 1.5, shape[1])
        return normal * (each / np.sqrt((each**2).mean()))[:, None]
    if law == "heavy":
        return normal * np.sqrt(6 / rng.chisquare(8, shape[:2]))[..., None]
    if law == "trailing":
        memory = own.uniform(0.1, 0.25)
        for row in range(1, shape[0]):
            normal[row] = memory * normal[row - 1] + np.sqrt(1 - memory**2) * normal[row]
    return normal


def mistaken(rng: np.random.Generator, shape: tuple[int, ...], rate: float, most: float = 1.0) -> np.ndarray:
    """Which entries (T, …) are mistaken, 1 to `most` frames in a row, at a share of `rate` of all frames."""
    longest = int(most)
    starts = rng.random(shape) < rate / ((1 + longest) / 2)
    lengths = rng.integers(1, longest + 1, shape) if longest > 1 else np.ones(shape)
    found = np.zeros(shape, dtype=bool)
    for late in range(longest):
        found[late:] |= (starts & (lengths > late))[: len(starts) - late]
    return found

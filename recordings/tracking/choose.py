"""Which pictures of a film to label: those that differ, and those that a model finds improbable.

Different: Gonzalez (Theoretical Computer Science, 1985). Of all pictures, as grey thumbnails, the next is the one that
is farthest from all that are chosen; no choice of as many pictures covers the film twice as well.

Surprising: the largest first, each some pictures apart from those before, as one outlier often lasts several.
"""

from collections.abc import Collection

import numpy as np

from ..errors import InputError
from .film import Film
from .tracker import Progress

THUMBNAIL_SIDE = 32  # px of the longer side


def different(
    film: Film, count: int, labelled: Collection[int] = (), progress: Progress | None = None, compared: int = 2000
) -> list[int]:
    """Numbers of `count` pictures, rising, that differ from one another and from those that are labelled.

    At most about `compared` pictures, at equal intervals, are considered.

    Fewer, where the film has no more. Raises InputError where all are labelled.
    """
    factor = THUMBNAIL_SIDE / max(film.width, film.height)
    size = max(2, round(factor * film.height)), max(2, round(factor * film.width))
    stride = max(1, film.expected // compared)
    numbers, thumbnails = [], []
    for picture in film.pictures(size):
        if picture.number % stride == 0 or picture.number in labelled:
            numbers.append(picture.number)
            thumbnails.append(picture.rgb.mean(-1, dtype=np.float32).ravel())
        if progress is not None:
            progress(picture.number + 1, max(film.expected, picture.number + 1), "look through the film")
    seen = np.array(thumbnails)
    known = [index for index, number in enumerate(numbers) if number in labelled]
    free = len(numbers) - len(known)
    if free == 0:
        raise InputError(f"{film.path}: all of its pictures are labelled")
    chosen: list[int] = []
    distance = np.full(len(seen), np.inf)
    for index in known:
        distance = np.minimum(distance, np.linalg.norm(seen - seen[index], axis=-1))
    if not known:
        distance = -np.linalg.norm(seen - seen.mean(0), axis=-1)  # the first one is the most typical
    for number in range(min(count, free)):
        distance[known + chosen] = -np.inf
        chosen.append(int(distance.argmax()))
        if number == 0 and not known:
            distance = np.full(len(seen), np.inf)
        distance = np.minimum(distance, np.linalg.norm(seen - seen[chosen[-1]], axis=-1))
    return sorted(numbers[index] for index in chosen)


def surprising(
    surprise: np.ndarray, numbers: np.ndarray, count: int, labelled: Collection[int] = (), apart: int = 3
) -> list[int]:
    """Numbers of up to `count` pictures, rising, of the largest surprise (T,); `numbers` (T,) are theirs.

    Two of them are at least `apart` pictures from each other.
    A surprise that is not finite does not count.
    """
    chosen: list[int] = []
    known = np.flatnonzero(np.isfinite(surprise))
    for index in known[np.argsort(-surprise[known], kind="stable")]:
        number = int(numbers[index])
        if number not in labelled and all(abs(number - other) >= apart for other in chosen):
            chosen.append(number)
        if len(chosen) == count:
            break
    return sorted(chosen)

"""Which pictures of a film are worth a label: such as differ, and such as a model finds hard to believe.

Different: Gonzalez (Theoretical Computer Science, 1985). Of all pictures, as grey thumbnails, the next is the one that
is farthest from all that are chosen; no choice of as many pictures covers the film twice as well.

Surprising: the largest first, each a little apart from those before, for one stray often lasts some pictures.
"""

from collections.abc import Collection

import numpy as np

from ..errors import InputError
from .film import Film
from .tracker import Progress

THUMBNAIL = 32  # px of the longer side
MOST = 2000  # pictures that are compared
APART = 3  # pictures between two surprising ones


def different(film: Film, count: int, labelled: Collection[int] = (), progress: Progress | None = None) -> list[int]:
    """Numbers of `count` pictures, rising, that differ from one another and from those that are labelled.

    Fewer, where the film has no more. Raises InputError where all are labelled.
    """
    factor = THUMBNAIL / max(film.width, film.height)
    size = max(2, round(factor * film.height)), max(2, round(factor * film.width))
    stride = max(1, film.expected // MOST)
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
    far = np.full(len(seen), np.inf)
    for index in known:
        far = np.minimum(far, np.linalg.norm(seen - seen[index], axis=-1))
    if not known:
        far = -np.linalg.norm(seen - seen.mean(0), axis=-1)  # begin with the most usual one
    for number in range(min(count, free)):
        far[known + chosen] = -np.inf
        chosen.append(int(far.argmax()))
        if number == 0 and not known:
            far = np.full(len(seen), np.inf)
        far = np.minimum(far, np.linalg.norm(seen - seen[chosen[-1]], axis=-1))
    return sorted(numbers[index] for index in chosen)


def surprising(surprise: np.ndarray, numbers: np.ndarray, count: int, labelled: Collection[int] = ()) -> list[int]:
    """Numbers of up to `count` pictures, rising, of the largest surprise (T,); `numbers` (T,) are theirs.

    A surprise that is not finite is none.
    """
    chosen: list[int] = []
    known = np.flatnonzero(np.isfinite(surprise))
    for index in known[np.argsort(-surprise[known], kind="stable")]:
        number = int(numbers[index])
        if number not in labelled and all(abs(number - other) >= APART for other in chosen):
            chosen.append(number)
        if len(chosen) == count:
            break
    return sorted(chosen)

"""The particles of a long recording, one window of rows at a time.

Smoothing walks back through all rows' particles, 4 (D + 3) bytes each. Instead of these the particles of each window's
first row are kept, with the state of the random numbers. Walking back, a window's rows are filtered once more from
there, to the same bits (checkpointing: Griewank & Walther 2000, "Algorithm 799: revolve"). Of T rows in windows of W
there are 3 W + T/W rows of particles in memory, 4 √T with W = √T, for twice the filter's time.

Shapes: M filters, N particles, T rows of D states.
"""

import math
from collections.abc import Callable
from copy import copy
from typing import Any

from invdyn.inference.execution.seeds import Stream
from invdyn.inference.filters.particles import FilterResult, History

WHOLE = 400e6
"""Bytes of all rows' particles up to which they are kept."""


def window_rows(rows: int, particles: int, dim: int) -> int:
    """Rows of a window, of so many ``particles`` of all filters; all ``rows`` where they are few enough."""
    return rows if 4 * rows * particles * (dim + 3) <= WHOLE else math.isqrt(rows)


def in_windows(filters: Any, history: History, onward: Callable[..., Any], rows: int, size: int) -> FilterResult:
    """The result of filters that have not begun, with the particles of the last window.

    ``onward`` takes filters, their particles and a range of rows, and returns the particles that go on.
    """
    starts: list[Any] = []
    particles: Any = {}
    device = history.ess.device
    for first in range(0, rows, size):
        starts.append((copy(filters), dict(particles), Stream(None, device), range(first, min(first + size, rows))))
        history.keep_from(first, len(starts[-1][-1]))
        particles = onward(filters, particles, starts[-1][-1])
    log_evidence = filters.log_evidence

    def again(k: int) -> FilterResult:
        own, particles, random, numbers = starts[k]
        own, random = copy(own), copy(random)
        history.keep_from(numbers.start, len(numbers))
        with random.drawing():
            onward(own, particles, numbers, None)
        return history.result(log_evidence, before(k))

    def before(k: int) -> Callable[[], FilterResult] | None:
        return (lambda: again(k - 1)) if k else None

    return history.result(log_evidence, before(len(starts) - 1))

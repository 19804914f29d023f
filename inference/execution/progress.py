"""How work in progress tells what is done."""

from collections.abc import Callable

Report = Callable[[int, int], None]
"""Called with (done, total)."""
Progress = Callable[[int, int, str], None]
"""Called with (done, total, what)."""


def stage(progress: Progress | None, what: str) -> Report | None:
    """What a stage called ``what`` tells its own progress to; None where nobody listens."""
    return None if progress is None else lambda done, total: progress(done, total, what)

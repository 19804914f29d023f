"""Progress callbacks."""

from collections.abc import Callable

Report = Callable[[int, int], None]
"""Called with (done, total)."""
Progress = Callable[[int, int, str], None]
"""Called with (done, total, what)."""


def stage(progress: Progress | None, what: str) -> Report | None:
    """The progress callback of a stage called ``what``; None without one."""
    return None if progress is None else lambda done, total: progress(done, total, what)

"""How work in progress tells what is done."""

from collections.abc import Callable

Report = Callable[[int, int], None]
"""Called with (done, total)."""
Progress = Callable[[int, int, str], None]
"""Called with (done, total, what)."""

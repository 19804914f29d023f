"""What is wrong with a recording in itself, without a body, and can be put right; each repair warns with its first row.

Left and right exchanged (:mod:`.sides`), another person (:mod:`.other_person`), wrapped encoders (:mod:`.revolutions`).
Repairs of a repaired recording find nothing, so that both a reader and who takes a recording made in Python may ask.
"""

from collections.abc import Collection

from .other_person import without_others
from .recording import Recording
from .revolutions import unwrapped
from .sides import with_sides_put_back


def repaired(recording: Recording, shifting: Collection[str] = ()) -> Recording:
    """The recording put right; ``shifting`` are joints whose positions are in m."""
    return unwrapped(without_others(with_sides_put_back(recording)), shifting)

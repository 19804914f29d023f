"""What is wrong with a recording in itself, without a body, and can be put right; each repair warns with its first row.

Left and right exchanged (:mod:`.sides`), another person (:mod:`.other_person`), wrapped encoders. Repairs of a repaired
recording find nothing, so that both a reader and who takes a recording made in Python may use.

A wrapped angle starts again at −π when it passes π, or at 0 after a whole revolution: it never leaves an interval of
2π, and steps by almost 2π where the joint moves as before. Whole revolutions are added after each step of more than
`STEP` of one (Itoh 1982, Appl. Opt. 21, 2470, for phases).
"""

import warnings
from collections.abc import Collection
from dataclasses import replace

import numpy as np

from .other_person import without_others
from .recording import Recording
from .sides import with_sides_put_back

REVOLUTION = 2 * np.pi
STEP = 0.75
"""Of a revolution: a joint would have to go three quarters of one between two rows."""
RANGE = 1.001
"""Revolutions: what a wrapped angle, with its last digit, stays within."""


def unwrapped(recording: Recording, shifting: Collection[str] = ()) -> Recording:
    """The recording with angles that go on where they were wrapped; a UserWarning names joint and row.

    ``shifting`` are joints whose positions are in m.
    """
    if recording.angles is None:
        return recording
    angles = recording.angles.copy()
    for name, angle in zip(recording.joint_names, angles.T, strict=True):
        seen = np.flatnonzero(np.isfinite(angle))
        if name in shifting or len(seen) < 2 or np.ptp(angle[seen]) > RANGE * REVOLUTION:
            continue
        step = np.diff(angle[seen])
        back = np.where(np.abs(step) > STEP * REVOLUTION, -np.round(step / REVOLUTION), 0.0)
        glitch = np.flatnonzero((back[:-1] != 0) & (back[:-1] == -back[1:]))  # one row that is off, and no wrap
        back[glitch] = back[glitch + 1] = 0.0
        if not back.any():
            continue
        first = int(seen[1:][back != 0][0])
        warnings.warn(
            f"{recording.name}: the angle of {name} is wrapped {np.count_nonzero(back)} times, first in row "
            f"{first + 1} ({recording.time[first]:.6g} s): whole revolutions were added, so that it goes on",
            stacklevel=4,
        )
        angle[seen[1:]] += REVOLUTION * np.cumsum(back)
    return replace(recording, angles=angles)


def repaired(recording: Recording, shifting: Collection[str] = ()) -> Recording:
    """The recording put right; ``shifting`` are joints whose positions are in m."""
    return unwrapped(without_others(with_sides_put_back(recording)), shifting)

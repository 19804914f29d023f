"""The memory that filters would take, checked before it is allocated.

What a run holds at once is bounded from below, so that nothing is refused that fits: of M filters in tasks of m, with N
particles, R trajectories, T rows and a state of D ≥ 3 K numbers for K joints,

    particles     4 T m N (D + 2) bytes     every row's states, weights and ancestors, of one task, in float32;
                                            in windows (:mod:`.windows`) of 2 √T rows at least
    trajectories  8 · 2 T M R D bytes       of all filters, in float64, as drawn and as they are saved
"""

import ctypes
import math
import os
import sys
from contextlib import suppress
from pathlib import Path

from invdyn.inference.filters.filtering import SMCOptions
from invdyn.recordings import InputError

WINDOWED = frozenset({"smc", "bootstrap"})
"""Methods that keep particles of a window of rows at a time."""
PARTICLES = WINDOWED | {"particle-gibbs", "vsmc"}
"""Methods that keep particles; the others have trajectories alone."""


def check_memory(rows: int, joints: int, options: SMCOptions, methods: tuple[str, ...]) -> None:
    """Raise InputError, with what it would take, where ``rows`` of that many joints do not fit into this machine.

    And as :meth:`.SMCOptions.check` does.
    """
    options.check()
    state = 3 * joints
    kept = rows if (PARTICLES - WINDOWED) & {*methods} else min(rows, 2 * math.isqrt(rows))
    taken = {
        "--filters × --set draws": 16 * rows * options.num_filters * options.num_draws * state,
        "--particles": 4 * kept * options.at_once * options.num_particles * (state + 2)
        if PARTICLES & {*methods}
        else 0,
    }
    what, most = max(taken.items(), key=lambda each: each[1])
    most = min(most, int(sys.float_info.max))  # a count may have any number of digits
    if most > (there := total_memory()):
        counts = options.num_filters, options.num_particles, options.num_draws
        filters, particles, draws = (str(count) if count < 1e18 else "far too many" for count in counts)
        raise InputError(
            f"{what}: {filters} filters of {particles} particles and {draws} draws "
            f"over {rows} rows take {most / 1e9:.3g} GB of memory or more, and {there / 1e9:.3g} are there: take fewer"
        )


def give_back() -> None:
    """Return freed memory to the system: glibc keeps what lies between blocks, a fit of many rows hundreds of MB."""
    with suppress(OSError, AttributeError, TypeError):  # other systems have another allocator
        ctypes.CDLL(None).malloc_trim(0)


def total_memory() -> float:
    """Bytes that this process may have, of the machine or of its control group; infinite where it is not known."""
    try:
        found = float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, OSError, ValueError):
        found = float("inf")
    try:
        limit = Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii").strip()
        return min(found, float(limit)) if limit.isdecimal() else found
    except OSError:
        return found

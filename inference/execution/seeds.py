"""Random numbers that depend on a seed and a place in the work, and on nothing else that runs.

Each part of a computation draws from a stream of its own, whose seed is hashed from the user's seed and the part's
number (NumPy's ``SeedSequence``; O'Neill 2015). Which process runs a part, or when, does not matter.
"""

import numpy as np

from invdyn.models.seeds import seeded

__all__ = ["derived", "seeded"]


def derived(seed: int, *place: int) -> int:
    """Seed, under 2³², of the part at ``place`` (its numbers, from the coarse to the fine), unlike any other part's."""
    return int(np.random.SeedSequence(seed, spawn_key=place).generate_state(1)[0])

"""Random numbers that depend on a seed and a place in the work, and on nothing else that runs.

Each part of a computation draws from a stream of its own, whose seed is hashed from the user's seed and the part's
number (NumPy's ``SeedSequence``; O'Neill 2015). Which process runs a part, or when, does not matter.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch


def derived(seed: int, *place: int) -> int:
    """Seed, under 2³², of the part at ``place`` (its numbers, from the coarse to the fine), unlike any other part's."""
    return int(np.random.SeedSequence(seed, spawn_key=place).generate_state(1)[0])


@contextmanager
def seeded(seed: int, device: torch.device | str = "cpu") -> Iterator[None]:
    """Torch's random numbers from ``seed`` on, on the CPU and on ``device``; afterwards the caller's go on."""
    device = torch.device(device)
    with torch.random.fork_rng(devices=[] if device.type == "cpu" else [device]):
        torch.manual_seed(seed)
        yield

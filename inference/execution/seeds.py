"""Random numbers that depend on a seed and a place in the work, and on nothing else that runs.

Each part of a computation draws from a stream of its own, whose seed is hashed from the user's seed and the part's
number (NumPy's ``SeedSequence``; O'Neill 2015). Which process runs a part, or when, does not matter.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import torch

from invdyn.models.seeds import seeded

__all__ = ["Stream", "derived", "seeded"]


def derived(seed: int, *place: int) -> int:
    """Seed, under 2³², of the part at ``place`` (its numbers, from the coarse to the fine), unlike any other part's."""
    return int(np.random.SeedSequence(seed, spawn_key=place).generate_state(1)[0])


class Stream:
    """Random numbers of an iterator: torch's, from ``seed`` on, that nothing drawn between two of its items moves.

    From where torch's own are, without a seed.
    """

    def __init__(self, seed: int | None, device: torch.device | str = "cpu"):
        self.device = torch.device(device)
        with seeded(seed, self.device):
            self._states = self._current()

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Torch's random numbers go on from where this stream stopped; afterwards the caller's go on."""
        on_gpu = self.device.type != "cpu"
        with torch.random.fork_rng(devices=[self.device] if on_gpu else []):
            torch.set_rng_state(self._states[0])
            if on_gpu:
                torch.cuda.set_rng_state(self._states[1], self.device)
            yield
            self._states = self._current()

    def _current(self) -> list[torch.Tensor]:
        gpu = [] if self.device.type == "cpu" else [torch.cuda.get_rng_state(self.device)]
        return [torch.get_rng_state(), *gpu]

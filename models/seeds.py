"""Random numbers from a seed, for a stretch of code, without a trace in the caller's own."""

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def seeded(seed: int | None, device: torch.device | str = "cpu") -> Iterator[None]:
    """Torch's random numbers from ``seed`` on, on the CPU and on ``device``; afterwards the caller's go on.

    None leaves the caller's generators in use.
    """
    if seed is None:
        yield
        return
    device = torch.device(device)
    on_gpu = device.type == "cuda"
    with torch.random.fork_rng(devices=[device] if on_gpu else []):
        # Not torch.manual_seed, which would seed other devices, too, and leave them so.
        torch.default_generator.manual_seed(seed)
        if on_gpu:
            with torch.cuda.device(device):
                torch.cuda.manual_seed(seed)
        yield

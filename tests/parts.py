"""Parts of a computation that workers can import, for tests of what happens when a worker dies."""

import os
import signal
from pathlib import Path

import torch


def noise(seed, progress=None):
    """Two numbers of a seed."""
    rng = torch.Generator().manual_seed(seed)
    if progress is not None:
        progress(1, 1)
    return {"x": torch.randn(2, generator=rng)}


def noise_or_death(seed, marker, progress=None):
    """The same, but the worker that comes first is killed; each one where there is no ``marker``."""
    try:
        Path(marker).touch(exist_ok=False)
    except OSError:
        if marker != os.devnull:
            return noise(seed)
    os.kill(os.getpid(), signal.SIGKILL)


def failing(seed, progress=None):
    """As a filter that loses all its particles."""
    raise ArithmeticError(f"no particles left with seed {seed}")

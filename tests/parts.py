"""Parts of a computation that workers can import, for tests of what happens when a worker dies."""

import os
import signal
import time
from multiprocessing.connection import Connection
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


LARGE = 2**20
"""Bytes, far more than a pipe holds."""


def half_a_result(told):
    """A large result of which the worker sends half and no more; the file ``told`` is there once it has."""
    whole = Connection._send

    def stops(self, buffer, *_):
        if len(buffer) < LARGE:
            return whole(self, buffer)
        whole(self, buffer[: LARGE // 2])
        without_end(told)

    Connection._send = stops
    return bytes(LARGE)


def without_end(told, progress=None):
    """Work that never ends; the file ``told`` is there once it has begun."""
    Path(told).touch()
    while True:
        time.sleep(1)

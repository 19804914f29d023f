"""A pool of processes ends at once, whatever its workers are doing."""

import os
import time
from contextlib import suppress

import parts
import pytest

from invdyn.inference.execution.executors import process_pool


def wait_for(path):
    """However long it takes: pytest ends what waits for ever."""
    while not path.exists():
        time.sleep(0.005)


@pytest.mark.long
def test_interrupted_while_a_worker_writes_its_result(tmp_path):
    marker = tmp_path / "half"
    with suppress(KeyboardInterrupt), process_pool(2) as pool:
        tasks = [pool.submit(parts.half_a_result, marker)]
        tasks += [pool.submit(parts.without_end, os.devnull) for _ in range(9)]
        wait_for(marker)
        raise KeyboardInterrupt
    assert all(task.done() for task in tasks)


@pytest.mark.long
def test_what_was_cancelled_before_is_no_error(tmp_path):
    marker = tmp_path / "begun"
    with suppress(KeyboardInterrupt), process_pool(2) as pool:
        tasks = [pool.submit(parts.without_end, marker) for _ in range(99)]
        wait_for(marker)
        for task in tasks:
            task.cancel()
        raise KeyboardInterrupt
    assert all(task.done() for task in tasks)


def test_without_work_it_ends():
    with process_pool(2) as pool:
        assert pool.submit(os.getpid).result() != os.getpid()

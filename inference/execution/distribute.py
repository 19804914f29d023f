"""Work in parts, distributed over the workers of any ``concurrent.futures`` executor.

Results are the same to the bit without an executor, on one worker or on many, because

* a part is a fixed share of the work, on any worker, with a seed of its own (:mod:`.seeds`);
* two parts never run in one process at once (torch's random numbers are the process's, and a Dask worker may have
  several threads), and the number of torch's threads changes no number in them;
* results are put together in the order of the parts, not of their arrival, and of parts that have failed by then the
  first is the one that is reported.

Machines of different processors may still round differently.

A part whose worker dies is done again, with the same seed: in a fresh pool where the pool broke
(:class:`concurrent.futures.BrokenExecutor`), by the cluster itself on Dask. A part that cannot be had is an error
(:class:`LostWork`): results without it would be of another computation.
"""

import time
from collections.abc import Callable, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Executor, Future, wait
from contextlib import ExitStack
from functools import partial
from threading import RLock
from typing import Any, TypeVar

import cloudpickle as pickle  # which can send what a script or a notebook has defined
import torch
from torch import Tensor

from invdyn.inference.execution import executors
from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.inference.execution.executors import has_workers, process_pool
from invdyn.inference.execution.records import keep, kept

Tensors = dict[str, Tensor]
Part = Callable[..., Any]
"""A module-level function of one part's arguments and ``progress``, called with (steps done, steps) or None."""

T = TypeVar("T")

RETRIES = 3
"""Fresh pools that a computation is given, at most."""

_one_at_a_time = RLock()


class LostWork(OSError):
    """Parts whose worker died each time, or whose cluster went away; the message names them."""


def distribute(
    part: Part,
    arguments: Sequence[tuple],
    names: Sequence[str],
    *,
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
    steps: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> list[Any]:
    """Return ``part(*arguments[i])`` for each i, in order.

    Args:
        part: what to do; it and its arguments must pickle where there is an executor.
        arguments: of each part, its seed among them.
        names: of the parts, for errors: "filters 32 to 63".
        executor: whose workers do it; None for this process.
        checkpoint: in whose folder each result (:mod:`.records`) is kept as soon as it is there, and looked for at
            first: part i lies in a folder of its own, ``part-<i>``.
        steps: that each part consists of, for ``progress``.
        progress: called with (steps done, steps of all parts).

    Raises LostWork; any error of a part, with its name as a note; and InputError for a broken checkpoint.
    """
    count = len(arguments)
    stores = [inside(checkpoint, f"part-{i}") for i in range(count)]
    results: dict[int, Any] = {}
    for i, store in enumerate(stores):
        if store is not None and (found := kept(store)) is not None:
            results[i] = found

    def report(extra: int = 0) -> None:
        if progress is not None:
            progress(len(results) * steps + extra, count * steps)

    def arrived(i: int, result: Any) -> None:
        if (store := stores[i]) is not None:
            keep(store, result)
        results[i] = result
        report()

    missing = [i for i in range(count) if i not in results]
    if executor is None:
        for i in missing:
            work = partial(_run, part, arguments[i], lambda done, _: report(done))
            arrived(i, _named(names[i], work))
    elif missing:
        _collect(part, arguments, names, missing, executor, arrived)
    return [results[i] for i in range(count)]


def inside(checkpoint: Checkpoint | None, name: str) -> Checkpoint | None:
    """The same run's checkpoint ``name`` in the folder of another; None where there is none."""
    if checkpoint is None:
        return None
    return Checkpoint(checkpoint.folder / name, checkpoint.fingerprint, f"{checkpoint.place}/{name}".lstrip("/"))


Arrived = Callable[[int, Any], None]


def _collect(
    part: Part,
    arguments: Sequence[tuple],
    names: Sequence[str],
    missing: list[int],
    executor: Executor,
    arrived: Arrived,
) -> None:
    """Have the ``missing`` parts done by the executor's workers, in fresh pools if its own breaks."""
    with ExitStack() as pools:
        for attempt in range(RETRIES + 1):
            if attempt > 0:
                executor = pools.enter_context(process_pool(getattr(executor, "_max_workers", None)))
            missing = _collect_once(part, arguments, names, missing, executor, arrived)
            if not missing:
                return
    missing_parts = ", ".join(names[i] for i in missing)
    raise LostWork(
        f"{missing_parts} could not be had: workers died {RETRIES + 1} times; is there memory for so many at once?"
    )


def _collect_once(
    part: Part,
    arguments: Sequence[tuple],
    names: Sequence[str],
    missing: list[int],
    executor: Executor,
    arrived: Arrived,
) -> list[int]:
    """Have the ``missing`` parts done; returns those that were missing_parts because the pool broke."""
    pending: dict[Future, int] = {}
    missing_parts: list[int] = []
    try:
        for i in missing:
            try:
                pending[executor.submit(_in_worker, pickle.dumps((part, arguments[i])))] = i
            except BrokenExecutor:
                missing_parts.append(i)
        seen = time.monotonic()
        while pending:
            # With a timeout, for Windows hears no Ctrl-C inside a wait without end.
            ready, _ = wait(pending, timeout=1.0, return_when=FIRST_COMPLETED)
            if ready or has_workers(executor):
                seen = time.monotonic()
            elif time.monotonic() - seen > executors.DESERTED:  # a cluster itself would wait for workers without end
                first = names[min(pending.values())]
                raise LostWork(f"{first} could not be had: for {executors.DESERTED} s the cluster has had no workers")
            for future in sorted(ready, key=pending.__getitem__):
                i = pending.pop(future)
                try:
                    result = pickle.loads(_named(names[i], future.result))
                except BrokenExecutor:
                    missing_parts.append(i)
                except Exception as error:
                    if not _is_cluster_error(error):
                        raise
                    raise LostWork(f"{names[i]} could not be had: {type(error).__name__}: {error}") from error
                else:
                    arrived(i, result)
    finally:
        for future in pending:
            future.cancel()
    return sorted(missing_parts)


def _run(part: Part, arguments: tuple, progress: Callable[[int, int], None] | None) -> Any:
    with _one_at_a_time:
        return part(*arguments, progress=progress)


def _in_worker(work: bytes) -> bytes:
    """One part in one thread: as many workers as cores then do not crowd each other out.

    Both ways as bytes: by themselves tensors would go through shared memory, which lasts no longer than the worker.
    """
    with _one_at_a_time:
        threads = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            part, arguments = pickle.loads(work)
            return pickle.dumps(part(*arguments, progress=None))
        finally:
            torch.set_num_threads(threads)


def _named(name: str, work: Callable[[], T]) -> T:
    try:
        return work()
    except Exception as error:
        error.add_note(f"in {name}")
        raise


def _is_cluster_error(error: Exception) -> bool:
    """Whether the part got no answer, as opposed to failing; Dask has classes of its own for that."""
    if isinstance(error, ConnectionError | CancelledError):
        return True
    return type(error).__module__.partition(".")[0] == "distributed"

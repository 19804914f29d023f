"""Executors for :mod:`.distribute`: processes of this machine, a Dask cluster, MPI.

Any :class:`concurrent.futures.Executor` serves as well; these are the ones that the command line opens.
"""

import asyncio
import os
import signal
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing import get_context, parent_process
from multiprocessing.synchronize import Barrier
from threading import Thread, current_thread, main_thread
from typing import Any

import torch

from invdyn.recordings import InputError
from invdyn.recordings.errors import first_line

PATIENCE = 10
"""Seconds in which a scheduler must answer."""

DESERTED = 60
"""Seconds after which a cluster without any worker is given up: a worker that died is replaced sooner."""

GRACE = 2
"""Seconds for what a worker is sending, before it is ended."""


@contextmanager
def open_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor | None]:
    """Yield the requested executor, or None, and end it afterwards.

    Args:
        workers: of a pool of processes.
        scheduler: address of a Dask scheduler, such as "tcp://host:8786", or "mpi".

    Raises InputError for both at once, a scheduler that does not answer or has no workers, or a missing package.
    """
    if workers is not None and scheduler is not None:
        raise InputError("expected a number of workers or a scheduler, got both: a scheduler has its own workers")
    opened: AbstractContextManager[Executor | None]
    if workers is not None:
        opened = process_pool(workers)
    elif scheduler == "mpi":
        opened = mpi_pool()
    elif scheduler is not None:
        opened = dask_cluster(scheduler)
    else:
        opened = nullcontext()
    with opened as executor:
        yield executor


@contextmanager
def process_pool(workers: int | None) -> Iterator[ProcessPoolExecutor]:
    """Yield a pool of processes (None: as many as cores); they end with the block, even at work.

    They leave Ctrl-C to their parent, and end by themselves when it is killed.
    """
    context, count = get_context("spawn"), workers or os.cpu_count() or 1
    # None works before all have started: the pool starts one only while no other is idle, and one that it started
    # later would run the program's script, and hear Ctrl-C.
    started = context.Barrier(count)
    pool = ProcessPoolExecutor(count, context, _begin, (started,))
    try:
        # The children inherit the first, from before their first line of Python.
        with deaf_to_interrupt(), script_not_run_again():
            for _ in range(count):
                pool.submit(os.getpid)
        # Only the workers write results: of one that is killed while it writes, the rest is then not waited for.
        pool._result_queue._writer.close()  # type: ignore[attr-defined]
        yield pool
    finally:
        _end(pool)


def _end(pool: ProcessPoolExecutor) -> None:
    """End the pool at once: by itself it waits for what its workers are doing."""
    manager: Any = pool._executor_manager_thread
    processes = list((pool._processes or {}).values())
    pool.shutdown(wait=False, cancel_futures=True)
    if manager is None:  # nothing was ever submitted
        return
    heard = time.monotonic() + GRACE
    try:
        # Its thread must hear of that before the workers die, or takes their end for a failure and trips over what was
        # cancelled. While it receives a result it hears nothing, and a worker may stop in the middle of one.
        while pool._cancel_pending_futures and manager.is_alive() and time.monotonic() < heard:
            manager.join(0.01)
    finally:
        for process in processes:
            process.terminate()
    manager.join()


@contextmanager
def deaf_to_interrupt() -> Iterator[None]:
    """Ignore Ctrl-C within the block, and in the processes that are started there for as long as they live."""
    if current_thread() is not main_thread():  # where signals are not ours to set
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextmanager
def script_not_run_again() -> Iterator[None]:
    """Let processes that are started within the block leave the program's own script alone.

    Python's spawn runs that script in each worker, so that pickles find what it defines. Without a guard
    (``if __name__ == "__main__":``) a worker then does all of its work, down to the pool, and dies there. Here work is
    sent by value (cloudpickle, :mod:`.distribute`), and the script is not needed.
    """
    script = sys.modules["__main__"]
    names = [name for name in ("__spec__", "__file__") if name in vars(script)]
    before = {name: vars(script)[name] for name in names}
    try:
        for name in names:
            setattr(script, name, None)
        yield
    finally:
        for name, value in before.items():
            setattr(script, name, value)


def _begin(started: Barrier) -> None:
    """First thing in a worker, which then waits until all have started."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    # A worker that waits for work holds its queue open itself, and would wait for ever after its parent was killed.
    Thread(target=_end_with_parent, daemon=True).start()
    started.wait()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        parent.join()
    os._exit(1)


@contextmanager
def dask_cluster(address: str) -> Iterator[Executor]:
    """Yield the executor of the Dask scheduler at ``address``; raises InputError unless it answers and has workers."""
    if "://" not in address:
        raise InputError(f"expected a scheduler such as tcp://host:8786, or mpi, got {address!r}")
    try:
        from distributed import Client
        from distributed.core import connect
    except ImportError:
        raise InputError("a Dask scheduler needs one more package: pip install 'invdyn[cluster]'") from None

    async def greet() -> None:
        await (await connect(address, timeout=PATIENCE)).close()

    try:
        # First by hand: a Client that fails to connect takes long to give up, and complains when it is dropped.
        asyncio.run(greet())
    except Exception as error:  # a server of another kind may answer anything
        raise InputError(f"{address}: no Dask scheduler answers there: {first_line(error)}") from None
    with Client(address, timeout=PATIENCE, set_as_default=False) as client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError:
            raise InputError(
                f"{address}: this Dask scheduler has no workers; start some: dask worker {address}"
            ) from None
        yield client.get_executor()


def has_workers(executor: Executor) -> bool:
    """Whether a Dask executor's scheduler answers and has any workers; True for other executors, which own theirs."""
    client = getattr(executor, "_client", None)
    if client is None:
        return True
    try:
        return client.status == "running" and bool(client.scheduler_info(n_workers=1)["workers"])
    except Exception:  # a scheduler that is gone fails in many ways
        return False


@contextmanager
def mpi_pool() -> Iterator[Executor]:
    """Yield MPI's executor; raises InputError without mpi4py, or where each rank runs the program for itself."""
    try:
        from mpi4py import MPI
        from mpi4py.futures import MPIPoolExecutor
    except (ImportError, RuntimeError) as error:  # RuntimeError: mpi4py is there, and no MPI library
        raise InputError(f"MPI needs an MPI library and one more package: pip install mpi4py ({error})") from None
    if MPI.COMM_WORLD.Get_rank() > 0:
        raise InputError("each rank runs the whole program: start it as mpirun -n 5 python -m mpi4py.futures -m invdyn")
    with MPIPoolExecutor() as pool:
        yield pool

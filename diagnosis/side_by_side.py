"""Independent parts of one diagnosis side by side, on the cores that there are.

Each part but the first runs in a copy of this process (fork), which knows all that it needs without being told, and
sends back its result. Nothing is drawn at random in a part but from seeds of its own, and results come in the parts'
order: they are the same whatever the number of workers. Where the system has no fork, or has one worker to spend, the
parts run one after the other.
"""

import multiprocessing
import pickle
import sys
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from typing import TypeVar

import torch

T = TypeVar("T")


def side_by_side(parts: Sequence[Callable[[], T]], workers: int) -> list[T]:
    """Results of ``parts``, ``workers`` of them at a time.

    Raises what the first of them that fails raises; RuntimeError where a process ends without a word.
    """
    if workers < 2 or not sys.platform.startswith("linux") or multiprocessing.current_process().daemon:
        return [part() for part in parts]
    results: list[T] = []
    for first in range(0, len(parts), workers):
        mine, *others = parts[first : first + workers]
        children = [_begun(part) for part in others]
        try:
            results += [mine(), *(_result(child, inbox) for child, inbox in children)]
        finally:
            for child, inbox in children:
                child.kill()
                child.join()
                inbox.close()
    return results


def _begun(part: Callable[[], T]) -> tuple[multiprocessing.process.BaseProcess, Connection]:
    context = multiprocessing.get_context("fork")
    inbox, outbox = context.Pipe(duplex=False)
    child = context.Process(target=_work, args=(part, outbox), daemon=True)
    child.start()
    outbox.close()
    return child, inbox


def _work(part: Callable[[], T], outbox: Connection) -> None:
    torch.set_num_threads(1)  # the parent's threads are not in the copy
    try:
        answer = True, part()
    except Exception as error:
        answer = False, error
    # By pickle itself: torch's way with pipes would share tensors' memory through files.
    outbox.send_bytes(pickle.dumps(answer))
    outbox.close()


def _result(child: multiprocessing.process.BaseProcess, inbox: Connection) -> T:
    try:
        done, answer = pickle.loads(inbox.recv_bytes())
    except EOFError:
        child.join()
        raise RuntimeError(f"a process of the diagnosis ended with code {child.exitcode}: too little memory?") from None
    if not done:
        raise answer
    return answer

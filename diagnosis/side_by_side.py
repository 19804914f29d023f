"""Independent parts of one diagnosis side by side, on the cores that there are.

This process and copies of it (fork), which share its memory, take the parts in turn, each the
next one as soon as it is free; copies send back what they found. Nothing is drawn at random in a part but from seeds of
its own, and results come in the parts' order: they are the same for any number of workers. Where the system has no
fork, or has one worker to spend, the parts run one after the other.
"""

import multiprocessing
import pickle
import sys
from collections.abc import Callable, Sequence
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.context import ForkContext
from multiprocessing.sharedctypes import Synchronized
from typing import Any, TypeVar

import cloudpickle
import torch

from invdyn.diagnosis.budget import Budget
from invdyn.inference.execution.distribute import LostWork
from invdyn.inference.execution.executors import deaf_to_interrupt

T = TypeVar("T")

Answers = dict[int, tuple[bool, Any]]
"""By the number of a part: whether it was done, and its result, or what it raised."""


def side_by_side(parts: Sequence[Callable[[], T]], workers: int, budget: Budget | None = None) -> list[T]:
    """Results of ``parts``, ``workers`` of them at a time; the first one is this process's.

    Each part finds the ``budget`` as it is before the first, wherever it runs; their work counts once all are done.

    Raises what the first of them that fails raises; LostWork where a process ends without a word.
    """
    if budget is not None:
        return budget.together(side_by_side([partial(budget.apart, part) for part in parts], workers))
    here = workers < 2 or len(parts) < 2 or not sys.platform.startswith("linux")
    if here or multiprocessing.current_process().daemon:
        return [part() for part in parts]
    context = multiprocessing.get_context("fork")
    turn = context.Value("i", 1)
    children = [_started(context, parts, turn) for _ in range(min(workers, len(parts)) - 1)]
    try:
        answers = _worked(parts, turn, 0)
        for child, inbox in children:
            answers |= _received(child, inbox)
    finally:
        for child, inbox in children:
            child.kill()
            child.join()
            inbox.close()
    for _, (done, answer) in sorted(answers.items()):
        if not done:
            raise answer
    return [answers[place][1] for place in range(len(parts))]


def _worked(parts: Sequence[Callable[[], T]], turn: Synchronized, place: int) -> Answers:
    """Answers of part ``place`` and of those whose ``turn`` it is next, until there are no more or one has failed."""
    answers: Answers = {}
    while place < len(parts):
        try:
            answers[place] = True, parts[place]()
        except Exception as error:
            answers[place] = False, error
            turn.value = len(parts)
        place = _next(turn)
    return answers


def _next(turn: Synchronized) -> int:
    with turn.get_lock():
        place = turn.value
        turn.value += 1
    return place


def _started(
    context: ForkContext, parts: Sequence[Callable[[], T]], turn: Synchronized
) -> tuple[multiprocessing.process.BaseProcess, Connection]:
    inbox, outbox = context.Pipe(duplex=False)
    child = context.Process(target=_work, args=(parts, turn, outbox), daemon=True)
    with deaf_to_interrupt():  # the copy is so from its first line: Ctrl-C is its parent's
        child.start()
    outbox.close()
    return child, inbox


def _work(parts: Sequence[Callable[[], T]], turn: Synchronized, outbox: Connection) -> None:
    torch.set_num_threads(1)  # the parent's threads are not in the copy
    answers = _worked(parts, turn, _next(turn))
    # By pickle itself: torch's way with pipes would share tensors' memory through files.
    try:
        packed = pickle.dumps(answers)
    except (pickle.PicklingError, AttributeError, TypeError):  # a function in a function, as a catalogue's entry has
        packed = cloudpickle.dumps(answers)
    outbox.send_bytes(packed)
    outbox.close()


def _received(child: multiprocessing.process.BaseProcess, inbox: Connection) -> Answers:
    try:
        return pickle.loads(inbox.recv_bytes())
    except EOFError:
        child.join()
        raise LostWork(f"a process of the diagnosis ended with code {child.exitcode}: too little memory?") from None

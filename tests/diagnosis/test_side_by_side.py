"""Parts in processes of their own: order, failures, and a diagnosis that is the same to the byte."""

import json
import multiprocessing
import os
import signal
from functools import partial

import pytest
import torch
from pendulum import ALL_BUT_THREE, DAMPING, PENDULUM, diagnosed, recorded

from invdyn.diagnosis import diagnose
from invdyn.diagnosis.side_by_side import side_by_side
from invdyn.inference.execution.distribute import LostWork

WORKERS = pytest.mark.parametrize("workers", [1, 2, 3, 8])


def power(base, exponent):
    return torch.full((2, 2), float(base), dtype=torch.float64) ** exponent


@WORKERS
def test_results_come_in_order(workers):
    results = side_by_side([partial(power, n, 2) for n in range(7)], workers)
    assert [result[0, 0].item() for result in results] == [n**2 for n in range(7)]
    assert side_by_side([], workers) == []


FORK = multiprocessing.get_context("fork")  # what it makes, the copies share


def pid_once(until):
    """This process's number, once `until()` has returned."""
    until()
    return os.getpid()


def test_each_but_the_first_runs_elsewhere():
    """None goes on before all have begun."""
    here, *others = side_by_side([partial(pid_once, FORK.Barrier(3).wait)] * 3, 3)
    assert here == os.getpid()
    assert len({here, *others}) == 3
    assert side_by_side([os.getpid] * 3, 1) == [here] * 3


def test_ctrl_c_is_left_to_the_first():
    """None of the others dies of it, nor says a word: a terminal sends it to all of them."""

    def handler():
        both_have_begun()
        return signal.getsignal(signal.SIGINT)

    both_have_begun = FORK.Barrier(2).wait
    assert side_by_side([handler] * 2, 2) == [signal.getsignal(signal.SIGINT), signal.SIG_IGN]


def test_who_is_free_takes_the_next_part():
    """The first part lasts until the others are done."""
    done = FORK.Semaphore(0)

    def all_others():
        for _ in range(6):
            done.acquire()

    here, *others = side_by_side([partial(pid_once, all_others), *[partial(pid_once, done.release)] * 6], 2)
    assert here not in others


@WORKERS
def test_what_a_part_raises_is_raised(workers):
    def fails(number):
        raise ValueError(f"part {number} failed")

    with pytest.raises(ValueError, match="part 2 failed"):
        side_by_side([partial(power, 2, 2), partial(fails, 2), partial(fails, 3)], workers)


def test_functions_without_a_name_come_back():
    """As those in an entry of a catalogue of one's own."""
    begun = FORK.Event()
    parts = [begun.wait, lambda: (begun.set(), lambda x: 2 * x)[1]]
    assert side_by_side(parts, 2)[1](21) == 42


def test_a_process_that_dies_is_one_line():
    begun = FORK.Event()

    def dies():
        begun.set()
        os._exit(9)

    with pytest.raises(LostWork, match="ended with code 9: too little memory"):
        side_by_side([partial(pid_once, begun.wait), dies], 2)


@pytest.mark.long
def test_a_diagnosis_is_the_same_whatever_the_number_of_workers():
    two = diagnose(recorded(DAMPING), PENDULUM, without=ALL_BUT_THREE, workers=2)
    assert json.dumps(two.to_json()) == json.dumps(diagnosed().to_json())

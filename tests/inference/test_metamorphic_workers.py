"""The same seed gives the same bits, whatever the number of workers."""

import os
from concurrent.futures import ProcessPoolExecutor, wait
from multiprocessing import get_context

import numpy as np
import pytest
from swinging_arm import ARM, EYES, NOISE, SMALL, SWING, bits, draws, simulated, states

from invdyn.inference import infer, infer_states

PARTICLES = {"method": "smc", "num_filters": 4, "num_particles": 20, "num_draws": 2, "seed": 1}
KNOWN = {"torque.scale": 5.0, "torque.decay": 2.0, "emission.keypoint_scale": NOISE, "noise.velocity": 0.01}


@pytest.mark.parametrize("options", [SMALL, PARTICLES], ids=["laplace", "smc"])
def test_the_same_seed(options):
    one, again, other = (infer(SWING, ARM, settings=KNOWN, **{**options, "seed": seed}) for seed in (1, 1, 2))
    assert bits(one) == bits(again)
    assert not np.array_equal(draws(one), draws(other))


@pytest.fixture(scope="module")
def workers():
    """Function of a number of workers -> a pool; their imports are shared, for speed."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["invdyn.inference"])

    def pool(count):
        executor = ProcessPoolExecutor(count, context, context.Barrier(count).wait)
        wait([executor.submit(os.getpid) for _ in range(count)])
        return executor

    return pool


@pytest.mark.long
@pytest.mark.parametrize("batch", [None, 3])
def test_workers_share_the_filters(workers, batch):
    """One worker, two or none give the same bits, in batches of a given size."""
    options = {"settings": KNOWN, "filters_per_task": batch, **PARTICLES}
    model, y = states(*EYES, 20), simulated(20)
    alone = bits(infer(SWING, ARM, **options)), bits(infer_states(model, y, filters_per_task=batch, **PARTICLES))
    for count in (1, 2):
        with workers(count) as executor:
            assert bits(infer(SWING, ARM, executor=executor, **options)) == alone[0]
            own = infer_states(model, y, filters_per_task=batch, executor=executor, **PARTICLES)
            assert bits(own) == alone[1]


@pytest.mark.long
def test_the_number_of_filters_a_task_is_no_more_than_there_are():
    """By default all four are one batch: asking for four, or for more, is the same."""
    options = {"settings": KNOWN, **PARTICLES}
    plain, four, more = (bits(infer(SWING, ARM, filters_per_task=n, **options)) for n in (None, 4, 9))
    assert plain == four == more

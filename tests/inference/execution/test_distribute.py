"""Spread over workers: the same to the bit whoever does the work, workers that die, parts that cannot be had."""

import os
import signal
import sys
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor, wait
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import parts
import pytest
import torch

from invdyn.inference import SMCOptions, arm_problem, compare, infer
from invdyn.inference.execution.distribute import RETRIES, LostWork, distribute
from invdyn.inference.execution.executors import open_executor
from invdyn.inference.execution.seeds import derived, seeded
from invdyn.inference.methods.registry import smc
from invdyn.models import Link, planar_body
from invdyn.recordings import InputError, Recording

TIME = 0.03 * np.arange(14)
ARM = planar_body("arm", [Link("rod", "shoulder", "elbow", length=0.4, mass=1.2)])
KNOWN = {
    "torque.scale": 3.0,
    "torque.decay": 4.0,
    "emission.keypoint_scale": 0.01,
    "noise.angle": 0.003,
    "noise.velocity": 0.05,
}
ANGLE = -1.3 + 0.4 * np.sin(4 * TIME)
SWING = Recording(TIME, 0.4 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], -1)[:, None], ("elbow",), name="swing")
SIZES = {"num_filters": 7, "num_particles": 30, "num_draws": 2, "filters_per_task": 2, "settings": KNOWN}
UNCERTAIN = replace(ARM, uncertainty={"mass": 0.1})


def bits(idata):
    """All numbers of a posterior."""
    return {
        (group, name): idata[group][name].values.tobytes()
        for group in idata.groups()
        for name in idata[group].data_vars
    }


@pytest.fixture(scope="module")
def alone():
    """Without workers."""
    return infer(SWING, ARM, seed=4, **SIZES)


@pytest.fixture(scope="module")
def pool():
    """Function of a number of workers -> a pool; their imports are shared, for speed."""
    context = get_context("forkserver")
    context.set_forkserver_preload(["invdyn.inference", "parts"])

    def pool(workers):
        # All workers before any work: Python's pool waits for ever for one that it starts while another dies.
        executor = ProcessPoolExecutor(workers, context, context.Barrier(workers).wait)
        wait([executor.submit(os.getpid) for _ in range(workers)])
        return executor

    return pool


@pytest.fixture(scope="module")
def cluster():
    """A real Dask cluster of this machine: two worker processes, and a client."""
    distributed = pytest.importorskip("distributed")
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),  # two deaths will do
        distributed.LocalCluster(n_workers=2, threads_per_worker=2, dashboard_address=":0", memory_limit=0) as local,
        distributed.Client(local) as client,
    ):
        yield client


# -- seeds ---------------------------------------------------------------------------------------------------


def test_derived_seeds_differ_and_last():
    seeds = [derived(seed, *place) for seed in range(20) for place in [(), (0,), (1,), (0, 0), (0, 1), (1, 0)]]
    assert len(set(seeds)) == len(seeds)
    assert derived(7, 1, 2) == derived(7, 1, 2)
    assert max(seeds) < 2**32


def test_seeded_leaves_the_callers_numbers_alone():
    torch.manual_seed(1)
    expected = torch.rand(2)
    torch.manual_seed(1)
    with seeded(9):
        first = torch.rand(2)
    with seeded(9):
        assert torch.equal(torch.rand(2), first)
    assert torch.equal(torch.rand(2), expected)


# -- the same numbers whoever does the work -------------------------------------------------------------------


@pytest.mark.parametrize("workers", [1, 3])
def test_any_number_of_processes(alone, pool, workers):
    reported = []
    with pool(workers) as executor:
        distributed = infer(
            SWING, ARM, seed=4, executor=executor, progress=lambda *step: reported.append(step), **SIZES
        )
    assert bits(distributed) == bits(alone)
    rows = [(done, total) for done, total, what in reported if what == "filter and smooth"]
    assert rows == [(28 * k, 112) for k in range(1, 5)]  # four tasks, 14 rows forwards and backwards


def test_threads_of_one_process_take_turns(alone):
    with ThreadPoolExecutor(3) as executor:
        assert bits(infer(SWING, ARM, seed=4, executor=executor, **SIZES)) == bits(alone)


def test_torchs_threads_change_nothing():
    """Enough particles for torch to share them out (it does above 32,768 numbers)."""
    problem = arm_problem(SWING.select(0, 3), ARM, parameters=KNOWN)
    options = SMCOptions(2, 12_000, 1, refits=0)
    before = torch.get_num_threads()
    found = []
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            found.append(bits(smc(problem, options=options, seed=1)))
    finally:
        torch.set_num_threads(before)
    assert found[0] == found[1]


@pytest.mark.slow
def test_draws_of_an_uncertain_body(pool):
    sizes = {**SIZES, "num_filters": 3}
    alone = infer(SWING, UNCERTAIN, seed=4, **sizes)
    assert len(np.unique(alone.posterior["mass"])) == 3
    with pool(2) as executor:
        assert bits(infer(SWING, UNCERTAIN, seed=4, executor=executor, **sizes)) == bits(alone)
        laplace = infer(SWING, UNCERTAIN, method="laplace", seed=4, executor=executor, **sizes)
    assert bits(laplace) == bits(infer(SWING, UNCERTAIN, method="laplace", seed=4, **sizes))


@pytest.mark.long
def test_comparison(pool):
    methods = ["smc", "bootstrap", "laplace"]
    sizes = {**SIZES, "num_particles": 200}
    alone = compare(SWING, ARM, methods, seed=4, **sizes)
    with pool(2) as executor:
        distributed = compare(SWING, ARM, methods, seed=4, executor=executor, **sizes)
        with pytest.raises(InputError, match="isolated"):
            compare(SWING, ARM, methods, isolate=True, executor=executor, **sizes)
    measured = ["seconds", "memory", "ess_per_second"]
    assert distributed.table.drop(columns=measured).equals(alone.table.drop(columns=measured))
    assert {"recording": "swing", "seed": 4}.items() <= alone.to_dict().items()


def test_tasks_are_part_of_the_result(alone):
    """Their size decides which filters share random numbers; what they estimate is the same."""
    other = infer(SWING, ARM, seed=4, **{**SIZES, "filters_per_task": 7})
    assert bits(other) != bits(alone)
    error = 4 * np.hypot(other.attrs["log_evidence_sd"], alone.attrs["log_evidence_sd"])
    assert other.attrs["log_evidence"] == pytest.approx(alone.attrs["log_evidence"], abs=error)


def test_sizes_of_tasks():
    assert SMCOptions(7, filters_per_task=3).tasks() == [3, 3, 1]
    assert SMCOptions(6, filters_per_task=3).tasks() == [3, 3]
    assert SMCOptions(2, filters_per_task=3).tasks() == [2]
    assert SMCOptions(70).tasks() == [32, 32, 6]
    assert SMCOptions(70, device="cuda").tasks() == [70]


@pytest.mark.parametrize(
    ("options", "said"),
    [({"device": "tpu"}, "cpu or cuda"), ({"filters_per_task": 0}, "at least one filter")],
)
def test_impossible_options(options, said):
    with pytest.raises(InputError, match=said):
        infer(SWING, ARM, **{**SIZES, **options})


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is one")
def test_no_cuda_device():
    with pytest.raises(InputError, match="no CUDA device"):
        infer(SWING, ARM, device="cuda", **SIZES)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")
def test_cuda_estimates_the_same(alone):
    there = infer(SWING, ARM, seed=4, device="cuda", **SIZES)
    error = 4 * np.hypot(there.attrs["log_evidence_sd"], alone.attrs["log_evidence_sd"])
    assert there.attrs["log_evidence"] == pytest.approx(alone.attrs["log_evidence"], abs=error)


# -- workers that die ----------------------------------------------------------------------------------------

SEEDS = [(seed,) for seed in range(5)]
NAMES = [f"part {seed}" for (seed,) in SEEDS]


@pytest.fixture
def fresh_pools(pool, monkeypatch):
    monkeypatch.setattr(sys.modules[distribute.__module__], "process_pool", pool)


def test_a_killed_worker_of_a_pool_is_replaced(pool, fresh_pools, tmp_path):
    expected = distribute(parts.noise, SEEDS, NAMES)
    marker = tmp_path / "killed"
    with pool(2) as executor:
        found = distribute(parts.noise_or_death, [(seed, str(marker)) for (seed,) in SEEDS], NAMES, executor=executor)
    assert marker.exists()
    assert all(torch.equal(a["x"], b["x"]) for a, b in zip(found, expected, strict=True))


def test_a_part_that_kills_all_its_workers_is_named(pool, fresh_pools):
    with pool(1) as executor, pytest.raises(LostWork, match=f"part 0 could not be had.* {RETRIES + 1} times"):
        distribute(parts.noise_or_death, [(0, os.devnull)], ["part 0"], executor=executor)


@pytest.mark.long
def test_a_killed_worker_of_a_cluster_changes_nothing(alone, cluster):
    assert bits(infer(SWING, ARM, seed=4, executor=cluster.get_executor(), **SIZES)) == bits(alone)
    before = set(cluster.run(os.getpid).values())
    killed = []

    def kill_one(done, total, what):
        if what == "filter and smooth" and not killed:
            killed.append(min(before))
            os.kill(killed[0], signal.SIGKILL)

    executor = cluster.get_executor(pure=False)  # else Dask remembers the answers
    disturbed = infer(SWING, ARM, seed=4, executor=executor, progress=kill_one, **SIZES)
    assert bits(disturbed) == bits(alone)
    assert killed[0] not in cluster.run(os.getpid).values()


@pytest.mark.long
def test_a_cluster_that_keeps_dying_is_an_error(cluster):
    with pytest.raises(LostWork, match="part 0 could not be had: KilledWorker"):
        distribute(parts.noise_or_death, [(0, os.devnull)], ["part 0"], executor=cluster.get_executor())


class AtOnce(Executor):
    """All parts are done before anyone waits for the first."""

    def submit(self, work, /, *arguments):
        done = Future()
        try:
            done.set_result(work(*arguments))
        except ArithmeticError as error:
            done.set_exception(error)
        return done


def test_what_fails_is_not_tried_again(pool):
    for executor in (None, pool(1), AtOnce()):
        with pytest.raises(ArithmeticError, match="seed 0") as failure:
            distribute(parts.failing, SEEDS, NAMES, executor=executor)
        assert failure.value.__notes__ == ["in part 0"]
        if executor is not None:
            executor.shutdown()


# -- executors by name ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"workers": 2, "scheduler": "mpi"}, "got both"),
        ({"scheduler": "cluster"}, "tcp://host:8786"),
        ({"scheduler": "magic://host:1"}, "no Dask scheduler answers"),
        ({"scheduler": "tcp://127.0.0.1:9"}, "no Dask scheduler answers"),
    ],
)
def test_executors_that_cannot_be_had(monkeypatch, options, said):
    pytest.importorskip("distributed")
    monkeypatch.setattr(sys.modules[open_executor.__module__], "PATIENCE", 0.3)
    with pytest.raises(InputError, match=said), open_executor(**options):
        pass


# -- kept, and gone on from -------------------------------------------------------------------------------------


class Interrupted(Exception):
    pass


@pytest.mark.quick("known body")
@pytest.mark.parametrize("body", [ARM, UNCERTAIN], ids=["known body", "uncertain body"])
def test_an_interrupted_run_continues(tmp_path, monkeypatch, body):
    pytest.importorskip("safetensors")
    settings = {name: value for name, value in KNOWN.items() if name != "torque.scale"}
    sizes = {**SIZES, "num_filters": 5, "settings": settings}
    whole = infer(SWING, body, seed=4, **sizes)

    def interrupt(done, total, what):
        if what in ("filter and smooth", "parameter sets") and done >= total / 2:
            raise Interrupted

    with pytest.raises(Interrupted):
        infer(SWING, body, seed=4, checkpoint=tmp_path / "run", progress=interrupt, **sizes)
    fits, reported = sys.modules["invdyn.inference.fit_processes"], []
    with monkeypatch.context() as patch:
        patch.setattr(fits, "fit_over_gaps", lambda *_, **__: pytest.fail("the fit was kept"))
        resumed = infer(
            SWING, body, seed=4, checkpoint=tmp_path / "run", progress=lambda *step: reported.append(step), **sizes
        )
    assert bits(resumed) == bits(whole)
    assert resumed.attrs["settings"] == whole.attrs["settings"]
    assert reported[0][0] > reported[0][1] / 3  # it did not begin at the beginning
    with pytest.raises(InputError, match="seed 4 there, 5 here"):
        infer(SWING, body, seed=5, checkpoint=tmp_path / "run", **sizes)

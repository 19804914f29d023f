"""Scripts without a guard, and clusters whose workers or scheduler are killed: an answer or one line, and no hang."""

import json
import os
import signal
import subprocess
import sys
import time
from multiprocessing.spawn import get_preparation_data
from threading import Thread

import parts
import pytest

from invdyn.inference.execution import executors
from invdyn.inference.execution.distribute import LostWork, distribute
from invdyn.inference.execution.executors import dask_cluster, has_workers, script_not_run_again

SCRIPT = """
print("the script runs", flush=True)
import torch
from invdyn.inference.execution.distribute import distribute
from invdyn.inference.execution.executors import open_executor

def part(seed, progress=None):
    return {"x": torch.tensor(float(seed))}

arguments, names = [(seed,) for seed in range(5)], [f"part {seed}" for seed in range(5)]
with open_executor(workers=2) as executor:
    found = distribute(part, arguments, names, executor=executor)
print([each["x"].item() for each in found])
"""

OWN_MODEL = """
import sys
import torch
from pyro.distributions import Normal
from invdyn.inference import infer_states
from invdyn.inference.execution import executors
from invdyn.models import StateSpaceModel

print("the script runs", flush=True)
executors.PATIENCE = 300  # on a machine that is busy


class Walk(StateSpaceModel):
    state_dim, observation_dim, num_steps = 1, 1, 10

    def initial(self):
        return Normal(torch.zeros(1), 1.0).to_event(1)

    def transition(self, state, t):
        return Normal(state, 0.3).to_event(1)

    def emission(self, state, t):
        return Normal(state, 0.5).to_event(1)


model = Walk()
rows = model.simulate(seed=0)[1]


def bits(executor=None):
    found = infer_states(model, rows, num_filters=6, num_particles=20, filters_per_task=2, seed=1, executor=executor)
    return [found[group][name].values.tobytes() for group in found.groups() for name in found[group].data_vars]


alone = bits()
for place in ({"workers": 2}, {"scheduler": sys.argv[1]}):
    with executors.open_executor(**place) as executor:
        print(*place, bits(executor) == alone, flush=True)
"""


def wait_until(true):
    """However long it takes: pytest ends what waits for ever."""
    while not true():
        time.sleep(0.005)


def test_workers_do_not_run_the_script(monkeypatch):
    script = sys.modules["__main__"]
    monkeypatch.setattr(script, "__file__", "script.py", raising=False)
    monkeypatch.setattr(script, "__spec__", None)
    assert "init_main_from_path" in get_preparation_data("worker")
    with script_not_run_again():
        assert not [key for key in get_preparation_data("worker") if key.startswith("init_main")]
    assert script.__file__ == "script.py"


@pytest.mark.long
def test_a_script_without_a_guard_runs_once(tmp_path):
    """As a notebook's cell that was saved as a file; its part of the work is defined in it."""
    (tmp_path / "script.py").write_text(SCRIPT)
    done = subprocess.run(
        [sys.executable, "-W", "ignore", tmp_path / "script.py"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["the script runs", "[0.0, 1.0, 2.0, 3.0, 4.0]"]
    assert done.stderr == ""


@pytest.fixture
def cluster(tmp_path):
    """A Dask scheduler and two workers, each a process of its own, by "scheduler" and "workers"; and its address."""
    pytest.importorskip("distributed")
    file, processes = tmp_path / "scheduler.json", []

    def started(module, *words):
        command = [sys.executable, "-W", "ignore", "-m", f"distributed.cli.{module}", "--scheduler-file", file, *words]
        found = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}  # this folder's modules, too
        processes.append(subprocess.Popen(command, env=found, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    started("dask_scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1")
    for _ in range(2):
        started("dask_worker", "--no-nanny", "--nthreads", "1", "--no-dashboard")
    try:
        # It is written in several steps.
        wait_until(lambda: file.exists() and file.read_text().rstrip().endswith("}"))
        yield {"scheduler": processes[:1], "workers": processes[1:]}, json.loads(file.read_text())["address"]
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_model_of_a_script_gives_the_serial_bits_everywhere(cluster, tmp_path):
    """By two processes, and by a Dask cluster of two; the script has no guard, and ends."""
    (tmp_path / "script.py").write_text(OWN_MODEL)
    command = [sys.executable, "-W", "ignore", tmp_path / "script.py", cluster[1]]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr == ""
    assert done.stdout.splitlines() == ["the script runs", "workers True", "scheduler True"]


@pytest.mark.long
@pytest.mark.parametrize("killed", ["workers", "scheduler"])
def test_a_cluster_that_is_gone_is_one_line(cluster, tmp_path, monkeypatch, killed):
    """All are killed while the first part is at work."""
    processes, address = cluster
    monkeypatch.setattr(executors, "PATIENCE", 300)  # to start, on a machine that is busy
    with dask_cluster(address) as executor:
        assert has_workers(executor)
        monkeypatch.setattr(executors, "DESERTED", 0.5)
        marker = tmp_path / "begun"

        def kill_once_begun():
            wait_until(marker.exists)
            for process in processes[killed]:
                os.kill(process.pid, signal.SIGKILL)

        killer = Thread(target=kill_once_begun, daemon=True)
        killer.start()
        with pytest.raises(LostWork, match="part 0 could not be had") as lost:
            distribute(parts.without_end, [(marker,)], ["part 0"], executor=executor)
        killer.join(60)
        assert not killer.is_alive()
        assert "\n" not in str(lost.value)

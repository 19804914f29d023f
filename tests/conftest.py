"""Fixtures for all rooms."""

import os
from pathlib import Path

import pyro
import pytest
import torch
from hypothesis import settings
from stand_in import human_arm

settings.register_profile("invdyn", deadline=None, derandomize=True)  # the same examples, however busy the machine
settings.load_profile("invdyn")
torch.set_num_threads(1)  # for what is made before a module's first test, too; see `_seeded`


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Notebooks first: at the end the longest tests would leave all workers but one without work."""
    items.sort(key=lambda item: item.path.parent.name != "notebooks")


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real recordings.

    A test that asks for it is skipped, and says so, when there is none; with INVDYN_REQUIRE_DATA=1 it fails.
    """
    folder = os.environ.get("INVDYN_DATA")
    if not folder:
        stop = pytest.fail if os.environ.get("INVDYN_REQUIRE_DATA") == "1" else pytest.skip
        stop("needs real recordings: set INVDYN_DATA")
    return Path(folder).expanduser()


@pytest.fixture
def with_human_arm(request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """INVDYN_DATA with the human arm in it: the real one, or a simulated one where there is no folder."""
    if os.environ.get("INVDYN_DATA") or os.environ.get("INVDYN_REQUIRE_DATA") == "1":
        return request.getfixturevalue("data_folder")
    folder = human_arm(tmp_path / "recordings")
    monkeypatch.setenv("INVDYN_DATA", str(folder))
    return folder


@pytest.fixture(autouse=True)
def _seeded():
    """Every test starts from the same seed, an empty parameter store and one thread, whatever those before it left.

    One: the suite shares its machine, where two threads for small arrays take twenty times as long; and sums do not
    depend on how work was split.
    """
    torch.set_num_threads(1)
    torch.manual_seed(0)
    pyro.clear_param_store()


@pytest.fixture
def fine_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The blind check's reality in steps of .2 ms at most: its own errors stay below what a test measures."""
    monkeypatch.setattr("invdyn.blindcheck.simulator.LONGEST_STEP", 2e-4)


@pytest.fixture
def coarse_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The blind check's reality in steps of a millisecond, half as many: no longer true to the micrometre."""
    monkeypatch.setattr("invdyn.blindcheck.simulator.LONGEST_STEP", 1e-3)


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch, coarse_steps: None) -> None:
    """Cases that hardly show are not drawn anew for long, d′ is soon settled: whole they are all the same."""
    monkeypatch.setattr("invdyn.blindcheck.cases.TRIES", 2)
    monkeypatch.setattr("invdyn.blindcheck.initial_state_fit.STEPS", 1)
    monkeypatch.setattr("invdyn.blindcheck.initial_state_fit.DOUBLED", 0)

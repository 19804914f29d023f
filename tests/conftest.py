"""Fixtures for all rooms."""

import fnmatch
import gc
import os
from pathlib import Path

import pyro
import pytest
import torch
from browsing import chromium
from hypothesis import settings
from stand_in import human_arm

settings.register_profile("invdyn", deadline=None, derandomize=True)  # the same examples, however busy the machine
settings.load_profile("invdyn")
torch.set_num_threads(1)  # for what is made before a module's first test, too; see `_seeded`
gc.disable()  # while modules are imported, which is half of a collection's time; see `pytest_collection_finish`


def pytest_collection_finish() -> None:
    """From here on garbage is collected again, but for what was imported: that stays."""
    gc.freeze()
    gc.enable()


@pytest.hookimpl(tryfirst=True)  # before what is long is left out
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of a test with ``quick("case", …)`` the named cases run in `make test`; the others are long.

    Notebooks come first: at the end the longest tests would leave all workers but one without work.
    """
    found = {}
    for item in items:
        if (mark := item.get_closest_marker("quick")) is not None:
            case = item.callspec.id
            here = {name for name in mark.args if fnmatch.fnmatchcase(case, name)}
            found.setdefault(item.nodeid.removesuffix(f"[{case}]"), set(mark.args)).difference_update(here)
            if not here:
                item.add_marker("long")
    wrong = [f"{test}: {', '.join(sorted(names))}" for test, names in found.items() if names]
    if wrong and not any("::" in argument for argument in config.args):
        raise pytest.UsageError(f"expected cases in the mark quick, got other names: {'; '.join(wrong)}")
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


@pytest.fixture(scope="session")
def browser(tmp_path_factory):
    """A headless Chromium for all pages; `opened` sets its width."""
    with chromium(tmp_path_factory.mktemp("chromium")) as window:
        yield window


@pytest.fixture
def fine_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The blind check's reality in steps of .2 ms at most: its own errors stay below what a test measures."""
    monkeypatch.setattr("invdyn.blindcheck.simulator.MAX_STEP", 2e-4)


@pytest.fixture
def coarse_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """The blind check's reality in steps of a millisecond, half as many: no longer true to the micrometre."""
    monkeypatch.setattr("invdyn.blindcheck.simulator.MAX_STEP", 1e-3)


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch, coarse_steps: None) -> None:
    """Cases that hardly show are not drawn again for long, d′ is soon settled: whole they are all the same."""
    monkeypatch.setattr("invdyn.blindcheck.cases.MAX_DRAWS", 2)
    monkeypatch.setattr("invdyn.blindcheck.initial_state_fit.MAX_GAUSS_NEWTON_STEPS", 1)
    monkeypatch.setattr("invdyn.blindcheck.initial_state_fit.MAX_WINDOW_DOUBLINGS", 0)

"""The memory that filters would take is checked before it is allocated."""

import pytest

from invdyn.inference import SMCOptions
from invdyn.inference.filters import memory
from invdyn.inference.filters.memory import check_memory
from invdyn.recordings import InputError


@pytest.fixture(autouse=True)
def one_gigabyte(monkeypatch):
    monkeypatch.setattr(memory, "total_memory", lambda: 1e9)


def test_what_is_asked_for_is_what_states_weights_and_trajectories_take():
    """100 rows of two joints have 6 numbers: 4 · 100 · 32 · (6 + 2) bytes are 102,400 a particle of each filter.

    And windows of smc have twenty of these rows in memory.
    """
    check_memory(100, 2, SMCOptions(64, 9_765, 1), ("vsmc",))
    with pytest.raises(InputError, match=r"--particles: 64 filters of 9766 particles .* take 1 GB .* 1 are there"):
        check_memory(100, 2, SMCOptions(64, 9_766, 1), ("smc", "vsmc"))
    check_memory(100, 2, SMCOptions(64, 5 * 9_765, 1), ("smc",))
    with pytest.raises(InputError, match=r"--particles: .* take 1 GB .* 1 are there"):
        check_memory(100, 2, SMCOptions(64, 5 * 9_766, 1), ("smc",))
    # 16 · 100 · 64 · 6 bytes are 614,400 a trajectory of each filter
    check_memory(100, 2, SMCOptions(64, 1, 1_627), ("smc",))
    with pytest.raises(InputError, match="--filters × --set draws"):
        check_memory(100, 2, SMCOptions(64, 1, 1_628), ("smc",))


@pytest.mark.parametrize("count", [2**63, 10**30, 10**400])
@pytest.mark.parametrize("which", ["num_filters", "num_particles", "num_draws"])
def test_a_count_of_any_number_of_digits_is_reported(count, which):
    with pytest.raises(InputError, match=r"far too many .* of memory or more") as reported:
        check_memory(100, 2, SMCOptions(**{which: count}), ("smc",))
    assert len(str(reported.value)) < 200


def test_only_methods_with_particles_count_them():
    many = SMCOptions(2, 10**9, 1)
    check_memory(100, 2, many, ("laplace", "nuts"))
    with pytest.raises(InputError, match="--particles"):
        check_memory(100, 2, many, ("laplace", "vsmc"))


def test_filters_come_a_task_at_a_time():
    check_memory(100, 2, SMCOptions(1024, 9_000, 1), ("vsmc",))
    with pytest.raises(InputError, match="--particles"):
        check_memory(100, 2, SMCOptions(1024, 9_000, 1, filters_per_task=64), ("vsmc",))


def test_this_machine_has_memory(monkeypatch):
    monkeypatch.undo()
    assert 1e8 < memory.total_memory() < 1e14

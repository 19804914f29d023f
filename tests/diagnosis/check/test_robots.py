"""A slice of `benchmarks/check.py --robots`: logs of robots' own files, right or with one mistake."""

import pytest
from pages import script

ROBOTS = script("benchmarks/robot_mistakes.py")
SEED = 9000
CLEAN = {robot.name: number for number, robot in enumerate(ROBOTS.ROBOTS)}


@pytest.mark.quick("arm6", "servo3", "pendubot")
@pytest.mark.parametrize("name", CLEAN)
def test_a_right_log_is_accused_of_nothing(name):
    assert ROBOTS.answered(SEED, "none", CLEAN[name])["answer"] == "right"


@pytest.mark.quick("drift", "stray", "gear", "first stamp")
@pytest.mark.parametrize("kind", ROBOTS.MISTAKES)
def test_a_mistake_is_named_first(kind):
    assert ROBOTS.answered(SEED, kind, 0)["answer"] == "right"


WINDOWS = {
    "radians-7": 72_000,
    "thinned targets-1": 72_000,
    "delay-1": 91_000,
    "delay-14": 91_000,
    "half exchanged-10": 91_000,
}


@pytest.mark.quick("radians-7", "half exchanged-10")
@pytest.mark.parametrize("case", WINDOWS)
def test_a_motion_is_smoothed_as_the_mistake_asks(case):
    """A map of a passive joint, targets of .2 s, late or exchanged commands: other windows hide what is wrong."""
    kind, number = case.rsplit("-", 1)
    assert ROBOTS.answered(WINDOWS[case], kind, int(number))["answer"] == "right"


@pytest.mark.long
def test_a_gear_of_minus_one_that_the_file_states_is_named_before_a_sign():
    assert ROBOTS.answered(97_000, "target's gear", 0)["answer"] == "right"

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


@pytest.mark.quick("radians-7")
@pytest.mark.parametrize(("kind", "number"), [("radians", 7), ("thinned targets", 1)])
def test_a_motion_is_smoothed_as_the_mistake_asks(kind, number):
    """A passive joint whose map says degrees, and targets that stand for .2 s: other windows hide what is wrong."""
    assert ROBOTS.answered(72_000, kind, number)["answer"] == "right"

"""Two keypoints whose names are exchanged, and what only looks like it."""

from itertools import pairwise, permutations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from invdyn.recordings import InputError
from invdyn.recordings.exchanged_names import check_names

NAMES, LENGTHS = ("shoulder", "elbow", "wrist", "hand"), (0.3, 0.25, 0.1)
LINKS = dict(zip(pairwise(NAMES), LENGTHS, strict=True))


def moving(seed=0, noise=0.0, scale=1.0, tilt=0.0):
    """Tracks of a chain that moves, as a picture tilted by so many rad shows it."""
    rng = np.random.default_rng(seed)
    time = np.linspace(0, 3, 150)[:, None]
    angles = np.cumsum(np.sin(time * rng.uniform(2, 5, 3)) + rng.uniform(-1, 1, 3), axis=1)
    links = np.array(LENGTHS)[:, None] * np.stack([np.cos(angles), np.sin(angles)], -1) * [np.cos(tilt), 1]
    points = np.concatenate([np.zeros((150, 1, 2)), links.cumsum(1)], axis=1)
    points = scale * points + noise * rng.normal(size=points.shape)
    return dict(zip(NAMES, points.swapaxes(0, 1), strict=True))


@given(seed=st.integers(0, 1000), scale=st.floats(0.4, 2.5), noise=st.sampled_from([0.0, 0.002, 0.02]))
def test_names_that_are_right_pass_at_any_scale(seed, scale, noise):
    check_names(moving(seed, noise, scale), LINKS, NAMES)


@given(seed=st.integers(0, 1000), tilt=st.floats(0, 1.2))
def test_a_picture_that_shortens_passes(seed, tilt):
    check_names(moving(seed, 0.002, tilt=tilt), LINKS, NAMES)


@pytest.mark.parametrize("scale", [1.0, 2.0])
@pytest.mark.parametrize(("one", "other"), [("elbow", "wrist"), ("wrist", "hand"), ("elbow", "hand")])
def test_exchanged_names_are_told(one, other, scale):
    points = moving(noise=0.002, scale=scale)
    wrong = {**points, one: points[other], other: points[one]}
    with pytest.raises(InputError, match=f"'{one}' and '{other}' seem to be exchanged.* exchange their names"):
        check_names(wrong, LINKS, NAMES)
    # what the body places has no name of the recording's
    check_names(wrong, LINKS, [name for name in NAMES if name != one])


def test_a_few_exchanged_rows_and_missing_points_pass():
    points = {name: track.copy() for name, track in moving(noise=0.002).items()}
    few = slice(20, 60)
    points["elbow"][few], points["wrist"][few] = points["wrist"][few].copy(), points["elbow"][few].copy()
    check_names(points, LINKS, NAMES)
    check_names({**points, "wrist": np.full((150, 2), np.nan)}, LINKS, NAMES)
    check_names({name: np.zeros((150, 2)) for name in NAMES}, LINKS, NAMES)


def test_a_single_length_tells_no_names():
    for one, other in permutations(("shoulder", "elbow")):
        check_names(moving(scale=2.0), {(one, other): 0.3}, NAMES)


def test_lengths_that_differ_by_a_tenth_tell_no_names():
    """A body has that much from one side to the other; no one number of the recording's is odd."""
    links = {("hip", "left"): 0.40, ("hip", "right"): 0.36}
    points = {name: np.full((9, 2), [x, 0.0]) for name, x in (("hip", 0.0), ("left", 0.36), ("right", -0.40))}
    check_names(points, links, list(points))


def test_exchanged_names_are_told_where_points_are_missing():
    """Of points that are never seen together an exchange says nothing; of one name there is none to exchange."""
    points = moving(noise=0.002)
    wrong = {**points, "wrist": points["hand"].copy(), "hand": points["wrist"]}
    wrong["shoulder"] = points["shoulder"].copy()
    wrong["shoulder"][::2], wrong["wrist"][1::2] = np.nan, np.nan
    with pytest.raises(InputError, match="'wrist' and 'hand' seem to be exchanged"):
        check_names(wrong, LINKS, NAMES)
    check_names(wrong, LINKS, ["wrist"])

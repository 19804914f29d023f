"""No save erases what another program or page has written: points are merged, and the same point is refused."""

import multiprocessing

import numpy as np
import pytest

from invdyn.recordings import InputError
from invdyn.recordings.tracking.labels import Labels, read_labels, write_labels
from invdyn.recordings.tracking.shared_labels import Change, SharedLabels

NAMES = ("elbow", "wrist")
COUNT = 20
"""Points that each of several programs sets."""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "l.csv"


def shared(path, numbers=(4, 9)):
    return SharedLabels(path, numbers, NAMES)


def points(path):
    """Labelled points by (picture's number, name)."""
    labels = read_labels(path)
    return {
        (int(frame), name): tuple(point)
        for frame, row in zip(labels.frames, labels.points, strict=True)
        for name, point in zip(labels.names, row.tolist(), strict=True)
        if np.isfinite(point).all()
    }


def test_other_points_of_another_program_stay(path):
    one, other = shared(path), shared(path)
    assert one.save([Change(0, 0, (1.0, 2.0), 0)]) == []
    assert other.save([Change(0, 1, (3.0, 4.0), 0), Change(1, 0, (5.0, 6.0), 0)]) == []
    assert points(path) == {(4, "elbow"): (1, 2), (4, "wrist"): (3, 4), (9, "elbow"): (5, 6)}
    assert one.save([]) == []
    assert {(each.picture, each.keypoint): each.point for each in one.changed_since(1)} == {
        (0, 1): (3.0, 4.0),
        (1, 0): (5.0, 6.0),
    }


def test_the_same_point_is_refused_and_says_what_is_there(path):
    one, other = shared(path), shared(path)
    one.save([Change(0, 0, (1.0, 2.0), 0)])
    (now,) = other.save([Change(0, 0, (7.0, 8.0), 0), Change(1, 1, (5.0, 6.0), 0)])
    assert (now.picture, now.keypoint, now.point) == (0, 0, (1.0, 2.0))
    assert points(path) == {(4, "elbow"): (1, 2), (9, "wrist"): (5, 6)}  # the rest of a save is not lost with it
    assert other.save([Change(0, 0, (7.0, 8.0), now.version)]) == []
    assert points(path)[4, "elbow"] == (7, 8)
    (now,) = one.save([Change(0, 0, None, 1)])
    assert now.point == (7.0, 8.0)
    assert other.save([Change(0, 0, (7.0, 8.0), 0)]) == []  # an old version, and no other point


def test_pictures_of_other_programs_stay(path):
    write_labels(Labels(np.array([2]), np.ones((1, 2, 2)), NAMES[::-1]), path)
    one = shared(path)
    write_labels(Labels(np.array([2, 7]), np.full((2, 2, 2), 3.0), NAMES), path)  # by an editor
    one.save([Change(0, 0, (1.0, 2.0), 0)])
    assert read_labels(path).frames.tolist() == [2, 4, 7]
    assert points(path)[2, "wrist"] == (3, 3)


def test_a_file_that_is_gone_is_written_again(path):
    one = shared(path)
    one.save([Change(0, 0, (1.0, 2.0), 0)])
    path.unlink()
    one.save([Change(1, 0, (5.0, 6.0), 0)])
    assert points(path) == {(4, "elbow"): (1, 2), (9, "elbow"): (5, 6)}


def test_without_a_label_there_is_no_file(path):
    one = shared(path)
    one.save([Change(0, 0, (1.0, 2.0), 0)])
    assert one.save([Change(0, 0, None, 1)]) == []
    assert not path.exists()
    assert points_of(shared(path)) == []


def points_of(labels):
    return [each for each in labels.changed_since(0) if each.point is not None]


@pytest.mark.parametrize(
    ("content", "message"),
    [("frame,elbow_x\n1,2\n", "expected 'frame', then"), ("frame,hip_x,hip_y\n1,2,3\n", "labels of hip are there")],
)
def test_a_file_that_others_made_something_else_is_left_as_it_is(path, content, message):
    one = shared(path)
    one.save([Change(0, 0, (1.0, 2.0), 0)])
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        one.save([Change(1, 0, (5.0, 6.0), 0)])
    assert path.read_text() == content
    assert [each.point for each in points_of(one)] == [(1.0, 2.0)]
    with pytest.raises(InputError, match=message):
        shared(path)


def label_many(path, keypoint, start):
    """One program that sets COUNT points of a keypoint, one at a time."""
    own = shared(path, range(COUNT))
    start.wait()
    for picture in range(COUNT):
        assert own.save([Change(picture, keypoint, (1.0, 2.0), 0)]) == []


def test_programs_that_write_at_once_lose_nothing(path):
    context = multiprocessing.get_context("fork")
    start = context.Barrier(2)
    programs = [context.Process(target=label_many, args=(path, keypoint, start)) for keypoint in (0, 1)]
    for each in programs:
        each.start()
    for each in programs:
        each.join()
    assert [each.exitcode for each in programs] == [0, 0]
    assert len(points(path)) == 2 * COUNT
    assert [file.name for file in path.parent.iterdir()] == ["l.csv"]

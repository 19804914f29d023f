"""What every tracker does, whatever it is made of."""

import numpy as np
import pytest
import torch
from people import detector, landmarks, painted, person

from invdyn.recordings.tracking.blazepose import PersonTracker
from invdyn.recordings.tracking.heatmap import HeatmapTracker
from invdyn.recordings.tracking.unet import UNet


def heatmap():
    torch.manual_seed(0)
    network = UNet(3, (8, 12))
    return HeatmapTracker(network, ("a", "b", "c"), (300, 400), (90.0,) * 3, (60.0,) * 3, widths=(8, 12))


TRACKERS = {
    "heatmap": heatmap,
    "person": lambda: PersonTracker(detector, landmarks, "left", "largest"),
    "right arm": lambda: PersonTracker(detector, landmarks, "right"),
}
FILM = [painted([person((150 + 9 * n, 160 - 2 * n), 0.1 * n)]) for n in range(4)]


@pytest.fixture(params=TRACKERS)
def make(request, monkeypatch):
    if request.param == "person":  # the stand-ins see a right arm
        monkeypatch.setitem(__import__("people").LANDMARK, 11, "shoulder")
        monkeypatch.setitem(__import__("people").LANDMARK, 13, "elbow")
        monkeypatch.setitem(__import__("people").LANDMARK, 15, "wrist")
    return TRACKERS[request.param]


def test_keypoints_with_confidence(make):
    tracker = make()
    assert len(set(tracker.keypoint_names)) == 3
    for picture in FILM:
        before = picture.copy()
        found = tracker.track(picture)
        assert found.shape == (3, 3)
        assert ((found[:, 2] >= 0) & (found[:, 2] <= 1)).all()
        assert ((found[:, :2] > -1) & (found[:, :2] < [400, 300])).all()
        np.testing.assert_array_equal(picture, before)


def test_memory_is_all_that_it_carries(make):
    first = make()
    whole = [first.track(picture) for picture in FILM]
    second = make()
    for picture in FILM[:2]:
        second.track(picture)
    third = make()
    third.memory = np.array(second.memory)  # as a checkpoint gives it back
    for picture, expected in zip(FILM[2:], whole[2:], strict=True):
        np.testing.assert_array_equal(third.track(picture), expected)
    assert third.memory.ndim == 1


def test_points_move_with_the_picture(make):
    """By a multiple of every stride; a point beyond the border is none of its business."""
    apart = make().track(np.roll(FILM[0], (16, 32), (0, 1)))[:, :2] - make().track(FILM[0])[:, :2]
    np.testing.assert_allclose(apart, np.broadcast_to([32, 16], (3, 2)), atol=0.6)

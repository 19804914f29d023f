"""What stands around BlazePose's networks: squares, landmarks back in the film's pixels, and who is followed."""

import json
import os

import numpy as np
import pytest
import torch
from people import detector, landmarks, painted, person

from invdyn.recordings import InputError
from invdyn.recordings.tracking import blazepose_weights
from invdyn.recordings.tracking.blazepose import PersonTracker, cut, person_tracker, refined
from invdyn.recordings.tracking.blazepose_weights import MODULES, content_digest, load_graphs, weights_file
from invdyn.recordings.tracking.heatmap import import_safetensors

ONE = person((150, 160))
SMALL, LARGE = person((90, 150), tall=50), person((300, 190), tall=70)
ARM = ("shoulder", "elbow", "wrist")


def arm(of):
    return np.array([of[name] for name in ARM])


def tracker(person=None):
    return PersonTracker(detector, landmarks, "right", person)


@pytest.mark.parametrize("turn", [0.0, 0.6, -1.2, np.pi])
def test_an_arm_is_found_where_it_is(turn):
    there = person((150, 160), turn)
    found = tracker().track(painted([there]))
    np.testing.assert_allclose(found[:, :2], arm(there), atol=0.5)  # discs' centroids, from another grid
    np.testing.assert_allclose(found[:, 2], 1 / (1 + np.exp(-4.0)), rtol=1e-6)


def test_a_person_is_followed_without_the_detector():
    moving = tracker()
    moving.track(painted([ONE]))
    moving.detector = None
    for step in range(1, 5):
        there = person((150 + 8 * step, 160 - 3 * step), 0.1 * step)
        np.testing.assert_allclose(moving.track(painted([there]))[:, :2], arm(there), atol=0.5)


def test_the_person_that_is_asked_for():
    both = painted([SMALL, LARGE])
    with pytest.raises(InputError, match=r"2 people are in view, about \((90|300), .*choose one, --person left"):
        tracker().track(both)
    chosen = {"left": SMALL, "right": LARGE, "largest": LARGE, (60.0, 90.0, 60.0, 90.0): SMALL}
    for word, expected in chosen.items():
        np.testing.assert_allclose(tracker(word).track(both)[:, :2], arm(expected), atol=0.6)


def test_who_was_lost_is_found_again_where_they_were():
    lost = tracker("largest")
    lost.track(painted([SMALL, LARGE]))
    assert np.isnan(lost.track(painted([]))).all()
    nearby = person((280, 180), tall=40)  # now the smaller one, but near
    np.testing.assert_allclose(lost.track(painted([person((90, 150), tall=60), nearby]))[:, :2], arm(nearby), atol=0.6)


def test_nobody_in_view():
    assert np.isnan(tracker().track(painted([]))).all()


def test_a_square_reaches_beyond_the_picture():
    picture = np.full((20, 30, 3), 255, np.uint8)
    inside = cut(picture, np.array([14.5, 9.5, 10.0, 0.3]), 8)
    np.testing.assert_allclose(inside, 1.0, atol=1e-6)
    half = cut(picture, np.array([-0.5, 9.5, 10.0, 0.0]), 8)[0, :, :, 0].numpy()
    np.testing.assert_allclose(half[:, :4], 0, atol=0.2)
    np.testing.assert_allclose(half[:, 4:], 1, atol=0.2)
    assert not cut(picture, np.array([500.0, 9.5, 10.0, 0.0]), 8).any()


def test_a_landmark_moves_to_the_mean_of_its_map():
    maps = np.zeros((64, 64, 39))
    maps[30, 21, 0], maps[30, 22, 0] = 0.9, 0.3
    maps[10, 10, 1] = 0.4  # not sure
    places = np.full((39, 2), 0.5)
    places[0], places[1] = (20 / 64, 31 / 64), (10 / 64, 10 / 64)
    moved = refined(places, maps)
    np.testing.assert_allclose(moved[0], [21.25 / 64, 30 / 64])
    np.testing.assert_array_equal(moved[1:], places[1:])


def test_words_that_choose_nobody(monkeypatch):
    for word, message in (("both", "--arm is left or right"),):
        with pytest.raises(InputError, match=message):
            person_tracker(word, None)
    for word in ("me", "1,2", "1,2,0,4", "nan,1,2,3", "1,2,3,inf"):
        with pytest.raises(InputError, match="--person is left, right, largest, or a box"):
            person_tracker("left", word)


def test_a_download_that_fails_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(blazepose_weights.platformdirs, "user_cache_dir", lambda name: str(tmp_path))
    monkeypatch.setattr(blazepose_weights, "SHA256", "0" * 64)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(InputError, match=r"could not be downloaded \(ERROR: .*train one of your own"):
        load_graphs()
    assert not list(tmp_path.rglob("*.safetensors"))


def kept_graphs(monkeypatch, tmp_path):
    """Two small graphs in an empty cache, pinned as they are; a function that counts downloads of the same two."""
    monkeypatch.setattr(blazepose_weights.platformdirs, "user_cache_dir", lambda name: str(tmp_path))
    downloads = []

    def fetch(*_):
        downloads.append(1)
        for number, which in enumerate(MODULES):
            described = json.dumps({"steps": [], "given": "in", "wanted": ["in"]})
            weights_file(which).parent.mkdir(exist_ok=True)
            tensors = {"kernel": torch.full((2, 3), 1.0 + number)}
            weights_file(which).write_bytes(import_safetensors().save(tensors, {"invdyn": described}))

    fetch()
    pinned = {which: content_digest(weights_file(which)) for which in MODULES}
    monkeypatch.setattr(blazepose_weights, "CONTENT", pinned)
    monkeypatch.setattr(blazepose_weights, "_download", lambda folder: folder)
    monkeypatch.setattr(blazepose_weights, "_convert", fetch)
    return downloads


@pytest.mark.parametrize("harm", ["a weight", "a step", "half a file", "no file"])
def test_weights_that_are_not_those_that_were_kept_are_fetched_again(monkeypatch, tmp_path, harm):
    downloads = kept_graphs(monkeypatch, tmp_path)
    load_graphs()
    assert len(downloads) == 1  # what is whole is not fetched
    path = weights_file("landmarks")
    whole = path.read_bytes()
    at = whole.index(b"wanted") + 13
    harmed = {
        "a weight": whole[:-1] + bytes([whole[-1] ^ 1]),
        "a step": whole[:at] + whole[at:].replace(b"in", b"on", 1),
        "half a file": whole[: len(whole) // 2],
    }
    path.unlink() if harm == "no file" else path.write_bytes(harmed[harm])
    graphs = load_graphs()
    assert len(downloads) == 2
    assert path.read_bytes() == whole
    assert graphs["landmarks"].wanted == ["in"]
    np.testing.assert_array_equal(graphs["landmarks"].constants["kernel"], 2.0)


def test_the_true_networks():
    """Their shapes, and that nobody is seen in noise; only where they are in the cache, or INVDYN_BLAZEPOSE=1 asks."""
    there = all(weights_file(which).exists() for which in MODULES)
    if not there and os.environ.get("INVDYN_BLAZEPOSE") != "1":
        pytest.skip("needs BlazePose's weights: set INVDYN_BLAZEPOSE=1 to fetch them, 36 MB")
    graphs = load_graphs()
    assert {which: content_digest(weights_file(which)) for which in MODULES} == blazepose_weights.CONTENT
    noise = torch.rand(1, 224, 224, 3)
    boxes, scores = graphs["detector"](noise)
    assert boxes.shape == (1, 2254, 12)
    assert scores.shape == (1, 2254, 1)
    assert scores.sigmoid().max() < 0.5
    rows, presence, _, maps, _ = graphs["landmarks"](torch.rand(1, 256, 256, 3))
    assert rows.shape == (1, 195)
    assert maps.shape == (1, 64, 64, 39)
    assert presence.item() < 0.5

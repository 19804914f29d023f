"""What surrounds BlazePose's networks: squares, landmarks in the film's pixels, the choice of a person, the weights."""

import hashlib
import os
import sys
import zipfile

import numpy as np
import pytest
from people import detector, landmarks, painted, person

from invdyn.recordings import InputError
from invdyn.recordings.tracking import blazepose_weights
from invdyn.recordings.tracking.blazepose import ANCHORS, PersonTracker, crop, person_tracker, refined
from invdyn.recordings.tracking.blazepose_weights import FILES, load_networks, run_by_litert, weights_file

RNG = np.random.default_rng(0)
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


def test_the_chosen_person_is_tracked():
    both = painted([SMALL, LARGE])
    with pytest.raises(InputError, match=r"2 people are in view, about \((90|300), .*choose one, --set person=left"):
        tracker().track(both)
    chosen = {"left": SMALL, "right": LARGE, "largest": LARGE, (60.0, 90.0, 60.0, 90.0): SMALL}
    for word, expected in chosen.items():
        np.testing.assert_allclose(tracker(word).track(both)[:, :2], arm(expected), atol=0.6)


def test_a_person_who_left_the_view_is_found_again_nearby():
    left = tracker("largest")
    left.track(painted([SMALL, LARGE]))
    assert np.isnan(left.track(painted([]))).all()
    nearby = person((280, 180), tall=40)  # now the smaller one, but near
    np.testing.assert_allclose(left.track(painted([person((90, 150), tall=60), nearby]))[:, :2], arm(nearby), atol=0.6)


def test_no_person_in_view():
    assert np.isnan(tracker().track(painted([]))).all()


def test_a_square_reaches_beyond_the_picture():
    picture = np.full((20, 30, 3), 255, np.uint8)
    inside = crop(picture, np.array([14.5, 9.5, 10.0, 0.3]), 8)
    np.testing.assert_allclose(inside, 1.0, atol=1e-6)
    half = crop(picture, np.array([-0.5, 9.5, 10.0, 0.0]), 8)[0, :, :, 0]
    np.testing.assert_allclose(half[:, :4], 0, atol=0.2)
    np.testing.assert_allclose(half[:, 4:], 1, atol=0.2)
    assert not crop(picture, np.array([500.0, 9.5, 10.0, 0.0]), 8).any()


def test_a_landmark_moves_to_the_mean_of_its_map():
    maps = np.zeros((64, 64, 39))
    maps[30, 21, 0], maps[30, 22, 0] = 0.9, 0.3
    maps[10, 10, 1] = 0.4  # below the least score
    places = np.full((39, 2), 0.5)
    places[0], places[1] = (20 / 64, 31 / 64), (10 / 64, 10 / 64)
    moved = refined(places, maps)
    np.testing.assert_allclose(moved[0], [21.25 / 64, 30 / 64])
    np.testing.assert_array_equal(moved[1:], places[1:])


def test_words_that_choose_no_person(monkeypatch):
    for word, message in (("both", "an arm is left or right"),):
        with pytest.raises(InputError, match=message):
            person_tracker(word, None)
    for word in ("me", "1,2", "1,2,0,4", "nan,1,2,3", "1,2,3,inf"):
        with pytest.raises(InputError, match="person is left, right, largest, or a box"):
            person_tracker("left", word)


def test_a_download_that_fails_is_one_line(tmp_path, monkeypatch):
    monkeypatch.setattr(blazepose_weights.platformdirs, "user_cache_dir", lambda name: str(tmp_path))
    monkeypatch.setattr(blazepose_weights, "SHA256", "0" * 64)
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    with pytest.raises(InputError, match=r"could not be downloaded \(ERROR: .*train one of your own"):
        load_networks()
    assert not list(tmp_path.rglob("*.tflite"))


def logistic_network(shape):
    """A TensorFlow Lite file of one operator, the logistic function."""
    flatbuffers = pytest.importorskip("flatbuffers")
    schema = pytest.importorskip("ai_edge_litert.schema_py_generated")
    code, operator, graph, model = schema.OperatorCodeT(), schema.OperatorT(), schema.SubGraphT(), schema.ModelT()
    code.builtinCode = code.deprecatedBuiltinCode = schema.BuiltinOperator.LOGISTIC
    tensors = [schema.TensorT(), schema.TensorT()]
    for tensor in tensors:
        tensor.shape = list(shape)
    operator.inputs, operator.outputs = [0], [1]
    graph.tensors, graph.operators, graph.inputs, graph.outputs = tensors, [operator], [0], [1]
    model.version, model.operatorCodes, model.subgraphs, model.buffers = 3, [code], [graph], [schema.BufferT()]
    builder = flatbuffers.Builder(0)
    builder.Finish(model.Pack(builder), b"TFL3")
    return bytes(builder.Output())


def test_litert_runs_a_network():
    picture = RNG.normal(size=(1, 2, 3, 1)).astype(np.float32)
    (out,) = run_by_litert(logistic_network(picture.shape))(picture)
    np.testing.assert_allclose(out, 1 / (1 + np.exp(-picture)), rtol=1e-6)


@pytest.mark.parametrize("damage", ["one bit", "half a file", "no file"])
def test_damaged_weights_are_fetched_again(monkeypatch, tmp_path, damage):
    contents = {which: logistic_network((1, 2, 3, k + 1)) for k, which in enumerate(FILES)}
    pinned = {which: hashlib.sha256(content).hexdigest() for which, content in contents.items()}
    downloads = []

    def download(folder):
        downloads.append(folder)
        with zipfile.ZipFile(folder / "mediapipe.whl", "w") as wheel:
            for which, name in FILES.items():
                wheel.writestr(f"mediapipe/modules/{name}.tflite", contents[which])
        return folder / "mediapipe.whl"

    monkeypatch.setattr(blazepose_weights.platformdirs, "user_cache_dir", lambda name: str(tmp_path))
    monkeypatch.setattr(blazepose_weights, "CONTENT", pinned)
    monkeypatch.setattr(blazepose_weights, "download_wheel", download)
    load_networks()
    load_networks()
    assert len(downloads) == 1  # a complete file is not fetched again
    path, whole = weights_file("landmarks"), contents["landmarks"]
    damaged = {"one bit": whole[:-1] + bytes([whole[-1] ^ 1]), "half a file": whole[: len(whole) // 2]}
    path.unlink() if damage == "no file" else path.write_bytes(damaged[damage])
    (out,) = load_networks()["landmarks"](np.zeros((1, 2, 3, 2), np.float32))
    assert len(downloads) == 2
    assert path.read_bytes() == whole
    np.testing.assert_allclose(out, 0.5)


def test_without_litert_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ai_edge_litert.interpreter", None)
    with pytest.raises(InputError, match=r"needs one more package: pip install 'invdyn\[tracking\]'"):
        person_tracker("left", None)


def test_blazepose_finds_no_person_in_noise():
    """Also the shapes of its outputs. Runs only where the weights are in the cache, or INVDYN_BLAZEPOSE=1 is set."""
    cached = all(weights_file(which).exists() for which in FILES)
    if not cached and os.environ.get("INVDYN_BLAZEPOSE") != "1":
        pytest.skip("needs BlazePose's weights: set INVDYN_BLAZEPOSE=1 to fetch them, 36 MB")
    networks = load_networks()
    boxes, scores = networks["detector"](RNG.random((1, 224, 224, 3), dtype=np.float32))
    assert boxes.shape == (1, len(ANCHORS), 12)
    assert scores.shape == (1, len(ANCHORS), 1)
    assert scores.max() < 0  # a probability of one half
    rows, presence, _, maps, _ = networks["landmarks"](RNG.random((1, 256, 256, 3), dtype=np.float32))
    assert rows.shape == (1, 195)
    assert maps.shape == (1, 64, 64, 39)
    assert presence.item() < 0.5

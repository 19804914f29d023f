"""The network learns to track a stick from labels, goes on after a kill, and knows how sure it is."""

import json

import numpy as np
import pytest
import torch
from filmed import NAMES, picture, swinging, write_film

from invdyn.inference.execution.checkpoint import Checkpoint
from invdyn.recordings import InputError
from invdyn.recordings.tracking.confidence import fit_platt, platt
from invdyn.recordings.tracking.film import Film
from invdyn.recordings.tracking.heatmap import HeatmapTracker, import_safetensors, read_safetensors
from invdyn.recordings.tracking.labels import Labels
from invdyn.recordings.tracking.tracker import track_film
from invdyn.recordings.tracking.training import examples, train
from invdyn.recordings.tracking.unet import UNet, peaks, targets

WIDTHS = (12, 16, 24)


class Killed(Exception):
    """In place of a signal."""


def killer(at, what):
    """A progress that dies."""

    def progress(done, total, words):
        if done == at and words.startswith(what):
            raise Killed

    return progress


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "f.mov"
    times, points = swinging(path, 80)
    return Film(path), times, points


@pytest.fixture(scope="module")
def labels(film):
    return Labels(np.arange(0, 80, 2), film[2][::2], NAMES)


@pytest.fixture(scope="module")
def trained(film, labels):
    return train(examples([film[0]], [labels], 40), steps=150, widths=WIDTHS)


def test_it_tracks_pictures_that_it_was_not_trained_on(film, trained):
    times, tracks = track_film(film[0], trained.tracker)
    np.testing.assert_allclose(times, film[1], atol=1e-9)
    errors = np.linalg.norm(tracks[1::2, :, :2] - film[2][1::2], axis=-1)
    assert np.median(errors) < 0.5  # px; a joint is a disc of 6 px
    assert len(trained.errors) == 2 * (len(film[2]) // 2 // 8)
    assert np.median(trained.errors) < 0.5


def test_confidence_falls_where_there_is_no_arm(film, trained):
    usual = trained.tracker.track(picture(film[2][3]))[:, 2]
    nothing = trained.tracker.track(np.full((40, 40, 3), 70, np.uint8))[:, 2]
    assert (nothing < usual - 0.1).all()


def test_a_network_is_kept_whole(film, trained, tmp_path):
    trained.tracker.save(tmp_path / "n.safetensors")
    again = HeatmapTracker.load(tmp_path / "n.safetensors")
    assert again.keypoint_names == NAMES
    np.testing.assert_array_equal(again.track(picture(film[2][3])), trained.tracker.track(picture(film[2][3])))
    whole = (tmp_path / "n.safetensors").read_bytes()
    for content in (whole[:1000], b"", b"{}", whole.replace(b"keypoint_names", b"keypoint_nomes")):
        (tmp_path / "broken").write_bytes(content)
        with pytest.raises(InputError, match="not a network of `invdyn train`"):
            HeatmapTracker.load(tmp_path / "broken")


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("widths", [8, 1000]),
        ("widths", [0, 0]),
        ("picture_size", [10**9, 10**9]),
        ("picture_size", [float("inf"), 20]),
        ("mean", [1.0]),
        ("calibration", [1.0]),
        ("calibration", [1.0, float("nan")]),
        ("mean", [1.0, float("inf"), 1.0]),
        ("deviation", [1.0, 0.0, 1.0]),
        ("tolerance", 10**400),
        ("keypoint_names", ["wrist", "wrist"]),
    ],
)
def test_a_network_that_claims_what_it_has_not(tmp_path, monkeypatch, key, value):
    HeatmapTracker(UNet(2, (8, 12)), NAMES, (20, 20), [9.0] * 3, [9.0] * 3, widths=(8, 12)).save(tmp_path / "n")
    tensors, text = read_safetensors(tmp_path / "n")
    claims = json.dumps(json.loads(text) | {key: value})
    (tmp_path / "n").write_bytes(import_safetensors().save(tensors, {"invdyn": claims}))

    def without_memory(*given):
        """As widths are the file's word alone, until its tensors are seen to fit."""
        network = UNet(*given)
        assert all(each.is_meta for each in network.parameters())
        return network

    monkeypatch.setattr("invdyn.recordings.tracking.heatmap.UNet", without_memory)
    with pytest.raises(InputError, match="not a network of `invdyn train`"):
        HeatmapTracker.load(tmp_path / "n")


def test_pictures_for_which_a_network_needs_too_much_memory(tmp_path):
    HeatmapTracker(UNet(2, (8, 12)), NAMES, (4000, 4000), [9.0] * 3, [9.0] * 3, widths=(8, 12)).save(tmp_path / "n")
    with pytest.raises(InputError, match=r"n: pictures of 4000 × 4000 px take a network of 2 levels 1\.48 GiB"):
        HeatmapTracker.load(tmp_path / "n")


def test_weights_that_are_no_numbers(tmp_path):
    network = UNet(2, (8, 12))
    with torch.no_grad():
        network.head.bias[0] = np.nan
    HeatmapTracker(network, NAMES, (20, 20), [9.0] * 3, [9.0] * 3, widths=(8, 12)).save(tmp_path / "n")
    with pytest.raises(InputError, match="weights are finite"):
        HeatmapTracker.load(tmp_path / "n")


def test_pixels_are_those_of_the_film(tmp_path, film, labels):
    """A film twice as large, seen by the network at the same size: pixels double, about the first one's corner."""
    large = [np.repeat(np.repeat(picture(each), 2, 0), 2, 1) for each in film[2][::2]]
    path = write_film(tmp_path / "f.mov", large, film[1][::2])
    given = examples([Film(path)], [Labels(np.arange(40), 2 * (film[2][::2] + 0.5) - 0.5, NAMES)], 40)
    np.testing.assert_allclose(given.points, labels.points, atol=1e-9)
    np.testing.assert_array_equal(given.factor, 2.0)
    assert given.tolerance == pytest.approx(0.02 * 80)


def test_killed_training_and_tracking_go_on_to_the_same(film, labels, tmp_path):
    given = examples([film[0]], [labels], 40)

    def run(progress=None, folder=None):
        keeper = None if folder is None else Checkpoint(folder, {"run": 1}, "train")
        return train(given, steps=30, seed=3, widths=WIDTHS, progress=progress, keeper=keeper).tracker

    straight = run()
    with pytest.raises(Killed):
        run(killer(27, "train"), tmp_path / "train")
    resumed = run(killer(15, "train"), tmp_path / "train")  # what was done before step 20 is not done again
    for name, value in straight.network.state_dict().items():
        assert torch.equal(value, resumed.network.state_dict()[name]), name
    assert straight.calibration == resumed.calibration

    def track(progress=None):
        return track_film(film[0], straight, progress, Checkpoint(tmp_path / "track", {"run": 1}, "track"))[1]

    with pytest.raises(Killed):
        track(killer(70, "track"))
    np.testing.assert_array_equal(track(killer(60, "track")), track_film(film[0], straight)[1])


def test_a_maps_peak_is_found_to_a_fraction_of_a_cell():
    points = torch.tensor([[[20.3, 11.7], [33.1, 30.9]], [[1.0, 2.2], [38.4, 3.0]]], dtype=torch.float64)
    target = targets(points, (20, 20), 2.0)
    torch.testing.assert_close(target.sum((-1, -2)), torch.ones(2, 2, dtype=torch.float64))
    places, mass = peaks(target.clamp(min=1e-30).log())
    torch.testing.assert_close(places[0], points[0], atol=0.01, rtol=0)  # those of the second are cut by the border
    assert mass.min() > 0.99
    assert (targets(torch.tensor([[[float("nan"), 3.0], [500.0, 3.0]]]), (20, 20), 2.0) == 0).all()


def test_confidence_is_a_probability():
    """Of points that are right as often as a logistic law says, its parameters come back."""
    rng = np.random.default_rng(0)
    mass = rng.uniform(0.01, 0.99, 20_000)
    within = rng.random(20_000) < platt(mass, 0.7, -0.4)
    assert fit_platt(mass, within) == pytest.approx((0.7, -0.4), abs=0.06)  # three standard errors
    a, b = fit_platt(np.full(20, 0.95), np.ones(20, bool))
    assert platt(np.array([0.95]), a, b)[0] == pytest.approx(21 / 22, abs=0.005)  # twenty right ones prove no more
    assert fit_platt(np.empty(0), np.empty(0, bool)) == (1.0, 0.0)


def test_labels_that_cannot_be_used(film, labels):
    source = film[0]
    few = labels.chosen(np.arange(3))
    with pytest.raises(InputError, match="3 labelled pictures are too few"):
        examples([source], [few], 40)
    for moved in (labels.points * 3, labels.points - [15.0, 0.0], labels.points - [0.0, -40.0]):
        words = r"of picture \d+ lies outside its pictures of 40 × 40 px, at \(.*\): are the labels another film's"
        with pytest.raises(InputError, match=words):
            examples([source], [Labels(labels.frames, moved, NAMES)], 40)
    with pytest.raises(InputError, match="no picture 81"):
        examples([source], [Labels(labels.frames + 3, labels.points, NAMES)], 40)
    hidden = labels.points.copy()
    hidden[:, 1] = np.nan
    with pytest.raises(InputError, match="'wrist' is not labelled in any picture"):
        examples([source], [Labels(labels.frames, hidden, NAMES)], 40)
    with pytest.raises(InputError, match="from 16 to 4096 px"):
        examples([source], [labels], 8)

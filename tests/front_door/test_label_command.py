"""Which pictures are offered for labels, and the command `invdyn label`."""

import numpy as np
import pytest
from filmed import NAMES, SHOULDER, picture, swinging, write_film

from invdyn.label_server import LabelServer
from invdyn.recordings import InputError
from invdyn.recordings.tracking.choose import different, surprising
from invdyn.recordings.tracking.film import Film
from invdyn.recordings.tracking.heatmap import HeatmapTracker
from invdyn.recordings.tracking.labels import Labels, read_labels, write_labels
from invdyn.recordings.tracking.unet import UNet
from invdyn.surprise import surprise


def test_different_pictures_are_chosen(tmp_path):
    """Of long pauses in three poses, one picture each; then what is labelled is left alone."""
    poses = [SHOULDER + np.array(each) for each in (((0, 10), (0, 19)), ((10, 0), (19, 0)), ((-10, 0), (-10, 9)))]
    order = [0] * 10 + [1] * 5 + [2] * 2
    film = Film(write_film(tmp_path / "f.mov", [picture(poses[i]) for i in order], np.arange(17) / 30))
    chosen = different(film, 3)
    assert sorted(order[number] for number in chosen) == [0, 1, 2]
    assert order[different(film, 1, [0, 11])[0]] == 2
    assert len(different(film, 99, [3])) == 16
    with pytest.raises(InputError, match="all of its pictures are labelled"):
        different(film, 1, range(17))


def test_surprising_pictures_are_chosen(make_posterior):
    idata = make_posterior(2, 60, missing=True)
    usual = surprise(idata)
    observed = idata["observed_data"]["position"]
    observed.loc[{"time": observed["time"][[10, 11, 40]]}] += 2.0  # outliers
    found = surprise(idata)
    assert set(np.argsort(-found)[:3]) == {10, 11, 40}
    same = np.delete(np.arange(60), [10, 11, 40])
    np.testing.assert_array_equal(found[same], usual[same])
    numbers = np.arange(60) + 100
    assert surprising(found, numbers, 2) in ([110, 140], [111, 140])  # of two that are near, one
    assert 140 not in surprising(found, numbers, 2, {140})
    assert surprising(np.full(60, -np.inf), numbers, 2) == []


def test_the_command_labels_and_continues(tmp_path, monkeypatch, run):
    swinging(tmp_path / "f.mov", 20)
    monkeypatch.chdir(tmp_path)

    def user(server):
        both = enumerate([[1.0, 2.0], [3.0, 4.0]])
        changes = [[i, p, point, 0] for p, point in both for i in range(len(server.shared.numbers))]
        server.take({"since": 0, "changes": changes})

    monkeypatch.setattr(LabelServer, "serve_forever", user)
    call = ("label", "f.mov", "--out", "l.csv", "--count", "3", "--set", "browser=no")
    outcome = run(*call)
    assert outcome.exit_code == 2
    assert outcome.stderr.startswith("error: expected --keypoints, the joints to label")
    outcome = run(*call, "--keypoints", "elbow, wrist")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.startswith("3 pictures to label: http://127.0.0.1:")
    outcome = run(*call)
    assert outcome.stdout.endswith("6 labelled pictures\nlabels     l.csv\n")
    assert len(read_labels(tmp_path / "l.csv")) == 6
    HeatmapTracker(UNet(2, (8,)), NAMES, (20, 20), [9.0] * 3, [9.0] * 3, widths=(8,)).save("n.safetensors")
    shown = []
    monkeypatch.setattr(LabelServer, "serve_forever", lambda server: shown.extend(server.suggested))
    assert run(*call, "--network", "n.safetensors").exit_code == 0
    assert np.array(shown).shape == (3, 2, 2)
    assert (np.array(shown) < 41).all()
    outcome = run(*call, "--keypoints", "hand")
    assert outcome.exit_code == 2
    assert "labels of elbow, wrist are there" in outcome.stderr


@pytest.mark.long
def test_labels_of_a_larger_film_are_not_continued(tmp_path, run):
    swinging(tmp_path / "film.mov", 5)
    write_labels(Labels(np.array([2]), np.full((1, 2, 2), 55.0), NAMES), tmp_path / "l.csv")
    before = (tmp_path / "l.csv").read_bytes()
    said = run("label", tmp_path / "film.mov", "--out", tmp_path / "l.csv", "--set", "browser=no")
    assert said.exit_code == 2
    assert "l.csv: elbow of picture 2 lies outside its pictures of 40 × 40 px, at (55, 55)" in said.stderr
    assert (tmp_path / "l.csv").read_bytes() == before

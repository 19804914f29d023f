"""`invdyn train` and `invdyn track`: files out, and one line for any mistake."""

from importlib import import_module

import numpy as np
import pytest
from filmed import NAMES, joints, picture, stick, swinging
from PIL import Image

from invdyn.inference import load_posterior, pooled
from invdyn.overlay import Overlay
from invdyn.recordings import InputError, Recording, load
from invdyn.recordings.tracking.film import Film
from invdyn.recordings.tracking.heatmap import HeatmapTracker
from invdyn.recordings.tracking.labels import Labels, write_labels

TRAIN = ("train", "f.mov", "--labels", "l.csv", "--out", "n.safetensors", "--set", "size=40", "--steps", "90")
TRACK = ("track", "f.mov", "--tracker", "n.safetensors", "--out", "t.csv")


@pytest.fixture(scope="module")
def shared(tmp_path_factory, run):
    """A folder with a film, its labels, and a network."""
    folder = tmp_path_factory.mktemp("film")
    times, points = swinging(folder / "f.mov", 80)
    write_labels(Labels(np.arange(0, 80, 2), points[::2], NAMES), folder / "l.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        outcome = run(*TRAIN)
    assert outcome.exit_code == 0, outcome.output
    return folder, times, points, outcome


@pytest.fixture
def folder(shared, tmp_path, monkeypatch):
    for name in ("f.mov", "l.csv", "n.safetensors"):
        (tmp_path / name).write_bytes((shared[0] / name).read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_train_says_how_good_it_is(shared):
    lines = shared[3].stdout.splitlines()
    assert lines[0] == "40 labelled pictures of elbow, wrist"
    assert lines[1].startswith("on 10 labels held out: median error 0.")
    assert lines[-1] == "network    n.safetensors"


def test_tracks_are_a_recording(folder, shared, run):
    outcome = run(*TRACK, "--checkpoint", "kept")
    assert outcome.exit_code == 0, outcome.output
    assert "elbow          found in 100.0% of 80 pictures" in outcome.stdout
    recording = load("t.csv", units="px", scale=0.01)
    np.testing.assert_allclose(recording.time, shared[1], atol=1e-9)
    errors = np.linalg.norm(recording.keypoints - 0.01 * shared[2] * [1, -1], axis=-1)
    assert np.median(errors) < 0.01  # a pixel
    assert ((recording.confidence > 0) & (recording.confidence < 1)).all()
    first = (folder / "t.csv").read_bytes()
    assert run(*TRACK, "--checkpoint", "kept").exit_code == 0  # most of it is there
    assert (folder / "t.csv").read_bytes() == first


def words(call, **changes):
    """The call with other values of its options, or without them."""
    call = list(call)
    for option, value in changes.items():
        at = call.index(f"--{option}")
        call[at : at + 2] = [] if value is None else [f"--{option}", value]
    return call


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (words(TRACK, tracker=None), "f.mov: what is to be tracked?"),
        ([*TRACK, "--arm", "left"], "--arm is --tracker now, and --tracker is given too"),
        ([*TRACK, "--set", "person=left"], "person says whose arm --tracker left or right tracks"),
        ([*words(TRACK, tracker=None), "--tracker", "both"], "--tracker both: No such file"),
        ([*words(TRACK, tracker=None), "--tracker", "left", "--set", "person=me"], "person is left, right, largest"),
        (words(TRACK, tracker="l.csv"), "l.csv: not a network of `invdyn train`"),
        (words(TRACK, tracker="no.safetensors"), "--tracker no.safetensors: No such file"),
        (words(TRACK, out="f.mov"), "f.mov: this output would overwrite an input"),
        (words(TRACK, out="no/t.csv"), "--out no/t.csv: cannot write: the folder does not exist"),
        (["track", "l.csv", *TRACK[2:]], "l.csv: not a film that can be decoded"),
        (["track", "no.mp4", *TRACK[2:]], "no.mp4: no such file"),
        (words(TRAIN, labels="no.csv"), "--labels no.csv: No such file"),
        (words(TRAIN, labels="f.mov"), "f.mov: a film has no keypoints yet: run `invdyn track`"),
        ([*TRAIN, "--labels", "l.csv"], "1 films and 2 files of labels"),
        ([*TRAIN, "--set", "size=8"], "a network's pictures are from 16 to 4096 px, got 8"),
        (words(TRAIN, steps="0"), "Invalid value for '--steps'"),
        (words(TRAIN, out="l.csv"), "l.csv: this output would overwrite an input"),
    ],
)
def test_bad_input_is_one_line(folder, run, contents, call, message):
    before = contents(folder)
    outcome = run(*call)
    assert outcome.exit_code == 2, outcome.output
    assert outcome.stderr.startswith(f"error: {message}")
    assert outcome.stderr.count("\n") == 1
    assert contents(folder) == before


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("frame,elbow_x,elbow_y\n0,1,2\n1,3,4\n", "2 labelled pictures are too few"),
        ("frame,elbow_x,elbow_y\n" + "".join(f"{n},1,2\n" for n in range(78, 84)), "f.mov: there is no picture 80"),
        (
            "frame,elbow_x,elbow_y\n" + "".join(f"{n},100,2\n" for n in range(9)),
            "f.mov: elbow of picture 0 lies outside its",
        ),
        ("frame,elbow_x\n1,2\n", "l.csv: column 'elbow_y': expected 'frame'"),
        ("frame,elbow_x,elbow_y\n1,x,2\n", "l.csv: row 1 (line 2), column 'elbow_x': 'x' is not a number"),
        ("", "l.csv: the file is empty"),
    ],
)
def test_bad_labels_are_one_line(folder, run, content, message):
    (folder / "l.csv").write_text(content)
    outcome = run(*TRAIN)
    assert outcome.exit_code == 2
    assert outcome.stderr.startswith(f"error: {message}")


def test_the_checkpoint_of_another_run(folder, run):
    call = [*words(TRAIN, steps="20"), "--checkpoint", "kept"]
    assert run(*call).exit_code == 0
    outcome = run(*call, "--seed", "3")
    assert outcome.exit_code == 2
    assert outcome.stderr.startswith("error: kept: the checkpoint of another run: seed 0 there, 3 here")


INFER = ("infer", "f.mov", "--body", "arm.toml", "--tracker", "n.safetensors", "--scale", "0.01", "--out", "arm.nc")


@pytest.mark.long
def test_infer_reads_from_a_film(folder, shared, run):
    (folder / "arm.toml").write_text(stick(0.01))
    outcome = run(*INFER, "--method", "laplace", "--out", "arm.gif", "--filters", "2", "--particles", "8")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.splitlines()[-1] == "tracks     arm.tracks.csv"
    idata = load_posterior("arm.nc")
    found = pooled(idata)["angle"].mean("sample").values
    truth = joints(shared[1])[0] - [np.pi / 2, 0]
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.05  # rad: half a pixel of ten
    with Image.open("arm.gif") as film:
        assert film.n_frames > 20


def test_infer_keeps_what_was_tracked(folder, run, quick_inference, monkeypatch):
    (folder / "arm.toml").write_text(stick(0.01))
    assert run(*INFER, "--checkpoint", "kept").exit_code == 0
    first = (folder / "arm.tracks.csv").read_bytes()
    assert {path.suffix for path in (folder / "kept.tracking").iterdir()} == {".json", ".safetensors"}
    seen = []
    track = HeatmapTracker.track
    monkeypatch.setattr(HeatmapTracker, "track", lambda self, rgb: seen.append(1) or track(self, rgb))
    assert run(*INFER, "--checkpoint", "kept").exit_code == 0
    assert len(seen) == 80 - 64
    assert (folder / "arm.tracks.csv").read_bytes() == first
    assert quick_inference[0]["recording"].length_unit == "m"


def test_diagnose_takes_a_film(folder, shared, run, monkeypatch):
    (folder / "arm.toml").write_text(stick(0.01))
    given = []

    def diagnose(**arguments):
        given.append(arguments)
        raise InputError("seen enough")

    # The package has a function of that name, too.
    monkeypatch.setattr(import_module("invdyn.diagnosis.diagnose"), "diagnose", diagnose)
    call = words(["diagnose", *INFER[1:]], out="found")
    outcome = run(*call, "--zero-torque", "--frames", "10:60")
    assert outcome.stderr.endswith("error: seen enough\n"), outcome.output
    recording = given[0]["recording"]
    np.testing.assert_allclose(recording.time, shared[1][10:60], atol=1e-9)
    off = recording.keypoints - 0.01 * shared[2][10:60] * [1, -1]
    assert np.median(np.linalg.norm(off, axis=-1)) < 0.01  # m, a pixel
    assert recording.confidence is not None
    assert given[0]["passive"] is True
    assert (folder / "found.tracks.csv").exists()
    for option, message in (
        (["--held-out", "f.mov"], "f.mov: expected another recording of the same arm for --held-out"),
        (["--set", "tracks=n.safetensors"], "n.safetensors: this output would overwrite an input"),
        (["--arm", "left"], "--arm is --tracker now, and --tracker is given too"),
        (["--calibration", "c.toml"], "--calibration is of several cameras"),
    ):
        outcome = run(*call, *option)
        assert outcome.exit_code == 2
        assert outcome.stderr.startswith(f"error: {message}")


def test_an_overlay_lies_on_the_film(folder, shared, make_posterior):
    """For any scale and base: what was observed is drawn where it was tracked."""
    idata = make_posterior(2, 80, frame_interval=1 / 30)
    observed = idata["observed_data"]["position"].transpose("time", "keypoint", "space").values
    origin = 15 + np.cumsum(np.full((80, 2), 0.1), 0)
    pixels = origin[:, None] + 7.0 * observed * [1, -1] + [2.0, 1.0]
    tracks = Recording(shared[1], np.concatenate([origin[:, None], pixels], 1), ("base", "elbow", "wrist"))
    overlay = Overlay(Film("f.mov"), tracks, idata)
    assert overlay.scale == pytest.approx(7.0)
    np.testing.assert_allclose(overlay.pixels(observed), pixels, atol=1e-6)
    (first, later) = overlay.pictures(np.array([3, 60]), (0, 0, 40, 40))
    np.testing.assert_array_equal(first, picture(shared[2][3]))
    np.testing.assert_array_equal(later, picture(shared[2][60]))
    (part,) = overlay.pictures(np.array([60]), (5, 8, 25, 40))
    np.testing.assert_array_equal(part, later[8:40, 5:25])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (words(INFER, tracker=None), "f.mov: what is to be tracked?"),
        (words(INFER, scale=None), "f.mov: a film has pixels, the body has metres: pass --scale"),
        ([*INFER, "--fps", "30"], "f.mov: a film has pixels and its own times: leave --fps out"),
        ([*INFER, "--units", "px"], "f.mov: a film has pixels and its own times: leave --units out"),
        (
            ["infer", "l.csv", *INFER[2:], "--fps", "30"],
            "l.csv: this is a table of one camera's keypoints: leave --tracker out, which is for a film",
        ),
        ([*INFER, "--map", "arm.toml"], "f.mov: a film has pixels and its own times: leave --map out, which is for"),
        (words(INFER, body="other.toml"), "the body's keypoint 'hand' is not tracked; tracked are elbow, wrist"),
        (words(INFER, tracker="arm.toml"), "arm.toml: not a network of `invdyn train`"),
        ([*INFER, "--set", "tracks=l.csv/t.csv"], "l.csv/t.csv: cannot write"),
        ([*INFER, "--set", "tracks=n.safetensors"], "n.safetensors: this output would overwrite an input"),
        ([*INFER, "--set", "tracks=arm.nc"], "arm.nc: two outputs have this name"),
    ],
)
def test_bad_films_are_one_line(folder, run, contents, call, message):
    (folder / "arm.toml").write_text(stick(0.01))
    (folder / "other.toml").write_text(stick(0.01).replace("wrist", "hand"))
    before = contents(folder)
    outcome = run(*call)
    assert outcome.exit_code == 2, outcome.output
    assert outcome.stderr.startswith(f"error: {message}")
    assert contents(folder) == before

"""`invdyn calibrate` and `invdyn triangulate`: files out, and one line for any mistake."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import ring, swinging

from invdyn.recordings import Recording, read_keypoint_csv, read_table, write_keypoint_csv
from invdyn.recordings.cameras.camera import Calibration
from invdyn.recordings.cameras.formats import read_calibration
from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.toml_cameras import write_calibration

BODY = """
name = "arm"
[[links]]
name = "upper_arm"
joint = "shoulder"
tip = "elbow"
length = 0.3
mass = 0.5
"""
NAMES = ("shoulder", "elbow", "wrist")
POINTS = swinging(30)
TIME = np.arange(30) / 30
CAMERAS = ring(3)


@pytest.fixture
def films(tmp_path, monkeypatch):
    """Working directory with tracks of three cameras, a calibration, and one that is not metric."""
    rng = np.random.default_rng(0)
    for camera in CAMERAS:
        pixels = project(camera, POINTS) + rng.standard_normal((30, 3, 2))
        if camera.name == "cam2":
            pixels[5:8, 2] = np.nan
        write_keypoint_csv(Recording(TIME, pixels, NAMES, np.full((30, 3), 0.9)), tmp_path / f"{camera.name}.csv")
    write_calibration(CAMERAS, tmp_path / "calibration.toml")
    write_calibration(CAMERAS.scaled(3.0, metric=False), tmp_path / "unknown.toml")
    monkeypatch.chdir(tmp_path)
    return tmp_path


TRIANGULATE = (
    "triangulate",
    "cam1.csv",
    "cam2.csv",
    "cam3.csv",
    "--calibration",
    "calibration.toml",
    "--out",
    "arm.csv",
)


def test_triangulate(films, run):
    outcome = run(*TRIANGULATE, "--errors", "e.csv", "--set", "sd=sd.csv", "--calibration-out", "c.toml")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.splitlines()[0].split() == [
        "camera", "keypoint", "pixels", "median", "90", "%", "u", "v", "outliers",
    ]  # fmt: skip
    assert "100.0% of all points are known" in outcome.stdout
    recording = read_keypoint_csv(films / "arm.csv")
    assert recording.keypoint_names == NAMES
    error = recording.keypoints - POINTS
    assert np.sqrt(np.mean(error**2)) < 0.004  # 1 px is 3 mm here
    sds, _ = read_table(films / "sd.csv")
    assert list(sds)[:3] == ["time", "shoulder_x_sd", "shoulder_y_sd"]
    scaled = error[:, 0, 0] / sds["shoulder_x_sd"]
    assert 0.6 < np.sqrt(np.mean(scaled**2)) < 1.5
    assert (films / "e.csv").read_text().count("\n") == 1 + 3 * 4
    assert read_calibration(films / "c.toml").metric


def test_triangulate_scales_what_is_not_metric(films, run):
    call = ("triangulate", "cam3=cam3.csv", "cam1=cam1.csv", "--calibration", "unknown.toml", "--out", "arm.csv")
    outcome = run(*call, "--length", "shoulder:elbow=0.3", "--length", "elbow:wrist=0.25")
    assert outcome.exit_code == 0, outcome.output
    assert "multiplied by 0.33" in outcome.stdout
    assert np.abs(read_keypoint_csv(films / "arm.csv").keypoints - POINTS).max() < 0.05


def test_triangulate_refines_and_turns(films, run):
    outcome = run(
        *TRIANGULATE, "--refine", "--estimate", "focal", "--set", "up=y", "--set", "noise=1.5", "--set", "offset=cam2=0"
    )
    assert outcome.exit_code == 0, outcome.output
    assert "scale of 1.50 px" in outcome.stdout


def test_triangulate_finds_offsets_and_knows_a_bodys_links(films, run):
    call = ("triangulate", "cam1.csv", "cam2.csv", "--calibration", "unknown.toml", "--out", "arm.csv")
    lengths = ("--length", "upper_arm=0.3", "--body", "arm.toml")
    (films / "arm.toml").write_text(BODY)
    outcome = run(*call, *lengths, "--find-offsets", "0.1")
    assert outcome.exit_code == 0, outcome.output
    # They do run together, which is found to a few ms.
    (said,) = [line for line in outcome.stdout.splitlines() if "times of cam2 are taken as they are" in line]
    best, _, sd = said.partition(": ")[2].split()[:3]
    assert abs(float(best)) < 3 * float(sd) < 0.02
    assert "multiplied by 0.33" in outcome.stdout


BAD = {
    "one camera": (("triangulate", "cam1.csv", *TRIANGULATE[4:]), "two cameras or more"),
    "no file": (("triangulate", "cam1.csv", "cam2=none.csv", *TRIANGULATE[4:]), "none.csv"),
    "another camera": (("triangulate", "cam1.csv", "cam9=cam2.csv", *TRIANGULATE[4:]), "no camera 'cam9'"),
    "no camera's name": (("triangulate", "cam1.csv", "left.csv", *TRIANGULATE[4:]), "which camera"),
    "a camera twice": (("triangulate", "cam1.csv", "cam1=cam2.csv", *TRIANGULATE[4:]), "has two files"),
    "no calibration": ((*TRIANGULATE[:5], "none.toml", *TRIANGULATE[6:]), "none.toml"),
    "a calibration that is none": ((*TRIANGULATE[:5], "cam1.csv", *TRIANGULATE[6:]), "kind of calibration"),
    "a unit that it says": ((*TRIANGULATE, "--set", "unit=mm"), "its own unit"),
    "no unit": ((*TRIANGULATE[:5], "unknown.toml", *TRIANGULATE[6:]), "--length"),
    "a length in words": ((*TRIANGULATE, "--length", "forearm=0.3"), "FROM:TO=METRES"),
    "a length of nothing": ((*TRIANGULATE, "--length", "elbow:hand=0.3"), "no keypoint 'hand'"),
    "two kinds of length": (
        (*TRIANGULATE, "--length", "elbow:wrist=0.3", "--set", "baseline=cam1:cam2=1"),
        "pass one kind, not both",
    ),
    "a distance of no camera": ((*TRIANGULATE, "--set", "baseline=cam1:cam9=1"), "no camera 'cam9'"),
    "a link of no body": ((*TRIANGULATE, "--length", "shin=0.3", "--body", "paper_planar_arm"), "no link 'shin'"),
    "two kinds of offset": ((*TRIANGULATE, "--set", "offset=cam2=0", "--find-offsets", "0.1"), "choose one"),
    "an offset in words": ((*TRIANGULATE, "--set", "offset=cam2=late"), "CAMERA=SECONDS"),
    "an offset of no camera": ((*TRIANGULATE, "--set", "offset=cam9=1"), "cam9"),
    "an offset past the film": ((*TRIANGULATE[:3], *TRIANGULATE[4:], "--set", "offset=cam2=99"), "films overlap"),
    "up in words": ((*TRIANGULATE, "--set", "up=north"), "up is one of"),
    "a lens without poses": ((*TRIANGULATE, "--estimate", "focal"), "choose both"),
    "an unknown part": ((*TRIANGULATE, "--refine", "--estimate", "iris"), "unknown part of a lens"),
    "over the tracks": ((*TRIANGULATE[:-1], "cam1.csv"), "overwrite"),
    "nowhere": ((*TRIANGULATE[:-1], "nowhere/arm.csv"), "nowhere"),
    "frame rate given twice": ((*TRIANGULATE, "--fps", "30"), "--fps"),
}
CALIBRATE = ("calibrate", "cam1=pictures", "--board", "checkerboard:8x5", "--square", "0.03", "--out", "c.toml")
BAD_BOARDS = {
    "no folder": (CALIBRATE, "pictures"),
    "no images": ((CALIBRATE[0], "cam1=.", *CALIBRATE[2:]), "no images"),
    "no film": ((CALIBRATE[0], "cam1=cam1.csv", *CALIBRATE[2:]), "not a film"),
    "a camera twice": ((CALIBRATE[0], "cam1=.", "cam1=..", *CALIBRATE[2:]), "two films"),
    "a board in words": ((*CALIBRATE[:3], "chess", *CALIBRATE[4:]), "checkerboard:9x6"),
    "millimetres": ((*CALIBRATE[:5], "30", *CALIBRATE[6:]), "metres"),
}


@pytest.mark.parametrize(
    ("arguments", "named"),
    [*BAD.values(), *BAD_BOARDS.values()],
    ids=[*BAD.keys(), *(f"board: {k}" for k in BAD_BOARDS)],
)
def test_bad_calls_end_with_one_line(films, run, contents, arguments, named):
    before = contents(films)
    outcome = run(*arguments)
    assert outcome.exit_code == 2, outcome.output
    assert not outcome.stdout
    (line,) = outcome.stderr.splitlines()
    assert line.startswith("error: ")
    assert named in line
    assert contents(films) == before


def test_tracks_and_cameras_that_do_not_fit_end_with_one_line(films, run, contents):
    one_place = tuple(replace(c, rotation=np.eye(3), translation=np.zeros(3)) for c in CAMERAS)
    write_calibration(Calibration(one_place, metric=True), films / "one_place.toml")
    folding = tuple(replace(c, distortion=[-40.0, 0, 0, 0, 0]) for c in CAMERAS)
    write_calibration(Calibration(folding, metric=True), films / "folding.toml")
    whole = (films / "cam2.csv").read_text().splitlines()
    (films / "short_cam2.csv").write_text("\n".join(whole[:-3]) + "\n")
    before = contents(films)
    for files, calibration, named in (
        (("cam1.csv", "cam2.csv"), "one_place.toml", "have the same position"),
        (("cam1.csv", "cam2.csv"), "folding.toml", "folds the picture"),
        (("cam1.csv", "short_cam2.csv"), "calibration.toml", "27 rows, the first camera 30"),
    ):
        outcome = run("triangulate", *files, "--calibration", calibration, "--out", "arm.csv")
        assert outcome.exit_code == 2, outcome.output
        (line,) = outcome.stderr.splitlines()
        assert named in line
        assert contents(films) == before


def test_calibrate(films, run):
    """Three pictures of a board are too few, and the camera is named; a whole calibration is another test's."""
    pytest.importorskip("cv2")
    from PIL import Image

    (films / "board").mkdir()
    squares = np.kron(np.indices((8, 11)).sum(0) % 2 * 200 + 20, np.ones((30, 30))).astype(np.uint8)
    for number in range(3):
        Image.fromarray(np.pad(squares[30:-30, 30:-30], 60, constant_values=220)).save(
            films / "board" / f"{number}.png"
        )
    outcome = run("calibrate", "left=board", "--board", "checkerboard:8x5", "--square", "0.03", "--out", "c.toml")
    assert outcome.exit_code == 2
    assert "'left': the board was found in 3 pictures, expected 5 or more" in outcome.stderr
    assert not (films / "c.toml").exists()


def test_calibrate_writes_what_it_found_and_says_it(films, run, monkeypatch):
    import invdyn.recordings.cameras as room
    from invdyn.recordings.cameras.intrinsics import Intrinsics

    def found(sources, board, every, progress):
        assert {name: str(path) for name, path in sources.items()} == {"cam1": "a.mp4", "cam2": "b.mp4"}
        assert (board.columns, board.rows, board.marker, every) == (7, 5, 0.02, 3)
        progress(2, 2, "boards")
        lenses = {
            camera.name: Intrinsics(camera.matrix, camera.distortion, camera.size, 0.2, np.array([1.5, 1.5]), 17)
            for camera in CAMERAS
        }
        return replace(CAMERAS, error=0.25), lenses

    pytest.importorskip("cv2")
    monkeypatch.setattr(room, "calibrate", found)
    call = (
        "calibrate",
        "cam1=a.mp4",
        "cam2=b.mp4",
        "--board",
        "charuco:7x5",
        "--square",
        "0.03",
        "--set",
        "marker=0.02",
    )
    outcome = run(*call, "--set", "every=3", "--out", "c.toml")
    assert outcome.exit_code == 0, outcome.output
    assert outcome.stdout.splitlines()[1].split()[:6] == ["cam1", "17", "0.200", "1100.0", "±", "1.5"]
    assert "3 together: 0.250 px" in outcome.stdout
    assert read_calibration(films / "c.toml").names == CAMERAS.names


@pytest.mark.filterwarnings("default")
def test_exchanged_files_are_reported(films, run):
    crossed = ("triangulate", "cam1=cam2.csv", "cam2=cam1.csv", "cam3=cam3.csv", "--calibration", "calibration.toml")
    outcome = run(*crossed, "--out", "arm.csv")
    assert outcome.exit_code == 0, outcome.output
    (line,) = [line for line in outcome.stderr.splitlines() if line.startswith("warning: ")]
    assert "if cam1 and cam2 have each other's tracks: exchange these two files" in line

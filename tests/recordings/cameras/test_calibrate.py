"""Lenses and poses from pictures of boards that known cameras took: rays through known lenses onto a drawn board."""

import io
import os
import zlib
from functools import cache

import numpy as np
import pytest
from scenes import looking, picture_of
from scipy.spatial.transform import Rotation

from invdyn.recordings import InputError
from invdyn.recordings.cameras.boards import Board
from invdyn.recordings.cameras.calibrate import calibrate, grey_pictures
from invdyn.recordings.cameras.intrinsics import fit_intrinsics
from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.rig import fit_rig

pytest.importorskip("cv2")

SIZE = (640, 480)
DISTORTION = (-0.15, 0.06, 0.001, -0.0008, 0.0)
SQUARE = 0.06
FINE = 50  # pixels of a drawn square
CHECKERBOARD = Board("checkerboard", 8, 5, SQUARE)
CHARUCO = Board("charuco", 7, 5, SQUARE, 0.044)
POSES = 12


@cache
def cameras(count=2):
    """The same ones again and again: rays of their pixels are kept."""
    places = [(0.0, -0.8, 0.0), (0.45, -0.7, 0.1), (-0.4, -0.72, -0.05)]
    target = (0.0, 0.0, 0.0)
    return tuple(
        looking(f"cam{c + 1}", place, target, focal=620.0 + 20 * c, distortion=DISTORTION, size=SIZE)
        for c, place in enumerate(places[:count])
    )


def drawn(board):
    """Texture, and function of places on the board (m) to its pixels."""
    if board.kind == "charuco":
        size = (board.columns * FINE, board.rows * FINE)
        return board.charuco.generateImage(size), lambda at: at / SQUARE * FINE - 0.5
    dark = np.indices((board.rows + 1, board.columns + 1)).sum(0) % 2 == 0
    texture = np.kron(np.where(dark, 20, 235), np.ones((FINE, FINE))).astype(np.uint8)
    margin = np.pad(texture, FINE, constant_values=235)
    return margin, lambda at: (at / SQUARE + 2) * FINE - 0.5


def poses(board, count=POSES, tilt=0.6, seed=0):
    """The board held up in front of the cameras (they look along y), its middle near the origin."""
    rng = np.random.default_rng(seed)
    upright = Rotation.from_matrix([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # its z away from the cameras, its y down
    middle = board.corners.mean(0)
    for _ in range(count):
        turn = (Rotation.from_rotvec(rng.uniform(-tilt, tilt, 3) * [1, 0.4, 1]) * upright).as_matrix()
        yield turn, rng.uniform(-0.06, 0.06, 3) * [1, 2, 1] - turn @ middle


def pictures(board, camera, **options):
    texture, place = drawn(board)
    return [picture_of(camera, texture, place, pose) for pose in poses(board, **options)]


@pytest.mark.parametrize("board", [CHECKERBOARD, CHARUCO], ids=lambda board: board.kind)
def test_corners_are_where_they_are(board):
    camera, _ = cameras()
    for picture, (turn, place) in zip(pictures(board, camera, count=3), poses(board, 3), strict=True):
        found = board.find(picture)
        seen = np.isfinite(found).all(-1)
        assert seen.mean() > 0.9
        miss = np.linalg.norm(found - project(camera, board.corners @ turn.T + place), axis=-1)
        assert np.nanmax(miss) < 0.6  # squares of some 35 px, one of a ChArUco board near a marker's edge
        assert np.nanmean(miss) < 0.2
    assert board.find(np.full((480, 640), 128, np.uint8)) is None


def test_a_checkerboard_upside_down_keeps_its_numbers():
    camera, _ = cameras()
    texture, place = drawn(CHECKERBOARD)
    turn, at = next(poses(CHECKERBOARD))
    half = np.diag([-1.0, -1.0, 1.0])
    middle = turn @ CHECKERBOARD.corners.mean(0) + at
    turned = turn @ half
    pose = (turned, middle - turned @ CHECKERBOARD.corners.mean(0))
    found = CHECKERBOARD.find(picture_of(camera, texture, place, pose))
    miss = np.linalg.norm(found - project(camera, CHECKERBOARD.corners @ turned.T + pose[1]), axis=-1)
    assert miss.max() < 0.35


def write_film(path, frames):
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(str(path), SIZE, pix_fmt_in="gray", fps=10, codec="ffv1")
    writer.send(None)
    for frame in frames:
        writer.send(np.ascontiguousarray(frame))
    writer.close()


def damaged_images():
    """A picture that is cut, one whose second chunk is broken, one that says it has 10¹⁰ px, a text."""
    from PIL import Image

    stored = io.BytesIO()
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (40, 40), dtype=np.uint8)).save(stored, "png")
    whole = stored.getvalue()
    huge = b"IHDR" + (10**5).to_bytes(4) * 2 + whole[24:29]
    huge += zlib.crc32(huge).to_bytes(4)
    yield whole[:900]
    yield whole[:41] + b"\xff" * 60 + whole[101:]
    yield whole[:37] + b"\0\0\0" + whole[40:]
    yield whole[:12] + huge + whole[33:]
    yield b"text"


def test_damaged_pictures_are_told_with_their_file(tmp_path):
    for number, content in enumerate(damaged_images()):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "1.png").write_bytes(content)
        with pytest.raises(InputError, match=r"1\.png: not an image that can be read \(") as caught:
            list(grey_pictures(folder))
        assert "\n" not in str(caught.value)


def test_a_film_or_picture_that_is_a_pipe_is_not_read(tmp_path):
    (tmp_path / "folder").mkdir()
    for path, source in (("film.mp4", "film.mp4"), ("folder/1.png", "folder")):
        os.mkfifo(tmp_path / path)
        with pytest.raises(OSError, match="a device or a pipe"):
            list(grey_pictures(tmp_path / source))


def test_films_of_two_cameras_give_lenses_and_poses(tmp_path):
    """Also the film and the folder: one camera filmed, the other took pictures."""
    from PIL import Image

    one, two = cameras()
    blank = np.full((SIZE[1], SIZE[0]), 128, np.uint8)
    first = pictures(CHARUCO, one)
    write_film(tmp_path / "one.mkv", first)
    (tmp_path / "two").mkdir()
    second = pictures(CHARUCO, two)
    second[4] = blank
    for number, picture in enumerate(second):
        Image.fromarray(picture).save(tmp_path / "two" / f"{number:03}.png")
    steps = []
    calibration, lenses = calibrate(
        {"cam1": tmp_path / "one.mkv", "cam2": tmp_path / "two"},
        CHARUCO,
        every=1,
        progress=lambda done, total, what: steps.append((done, total, what)),
    )
    assert steps[-1] == (2, 2, "boards")
    assert calibration.metric
    assert calibration.error < 0.15
    assert lenses["cam2"].pictures == POSES - 1
    for camera, true in zip(calibration, (one, two), strict=True):
        assert camera.size == SIZE
        # Twelve small pictures: the fit's own standard deviation is near 1 px.
        np.testing.assert_allclose(camera.focal, true.focal, atol=6)
        np.testing.assert_allclose(camera.center, true.center, atol=6)
        # What counts is where rays go.
        ours, theirs = (each.focal[0] * _bent(each) for each in (camera, true))
        assert np.abs(ours - theirs).max() < 12
    assert calibration.baseline("cam1", "cam2") == pytest.approx(np.linalg.norm(one.position - two.position), abs=4e-3)
    np.testing.assert_allclose(calibration.cameras[1].rotation, two.rotation @ one.rotation.T, atol=0.012)


def _bent(camera):
    from invdyn.recordings.cameras.projection import Lens

    return Lens.of(camera).distort(np.linspace(-0.3, 0.3, 5)[:, None] * [1, 0.7])[0]


def corners_of(board, count=2, noise=0.05, tilt=0.6, many=20):
    """Corners as the cameras see them, without pictures: camera → moment → pixels."""
    rng = np.random.default_rng(5)
    held = list(poses(board, many, tilt))
    return {
        camera.name: {
            m: project(camera, board.corners @ turn.T + place) + noise * rng.standard_normal((len(board.corners), 2))
            for m, (turn, place) in enumerate(held)
        }
        for camera in cameras(count)
    }


def test_a_chain_of_cameras_hangs_on_the_first():
    found = corners_of(CHECKERBOARD, 3)
    found["cam1"] = {m: found["cam1"][m] for m in range(10)}
    found["cam3"] = {m: found["cam3"][m] for m in range(10, 20)}
    found["cam2"][2] = found["cam2"][2][::-1]  # one that was numbered from the other end
    lenses = {name: fit_intrinsics(name, CHECKERBOARD, each, SIZE) for name, each in found.items()}
    calibration = fit_rig(CHECKERBOARD, lenses, found)
    true = cameras(3)
    for camera, other in zip(calibration, true, strict=True):
        rotation = other.rotation @ true[0].rotation.T
        np.testing.assert_allclose(camera.rotation, rotation, atol=5e-3)
        position = true[0].rotation @ (other.position - true[0].position)
        np.testing.assert_allclose(camera.position, position, atol=5e-3)


def test_the_stated_spread_of_a_focal_length_is_right():
    errors = []
    true, _ = cameras()
    held = list(poses(CHECKERBOARD, 15))
    for seed in range(12):
        rng = np.random.default_rng(seed)
        found = {
            m: project(true, CHECKERBOARD.corners @ turn.T + place) + 0.2 * rng.standard_normal((40, 2))
            for m, (turn, place) in enumerate(held)
        }
        lens = fit_intrinsics("one", CHECKERBOARD, found, SIZE)
        errors.append((lens.matrix[0, 0] - true.focal[0]) / lens.focal_sd[0])
    # Root mean square of 12 standard normals: between .56 and 1.44 in 99 of 100.
    assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_a_board_that_never_tilts_is_refused():
    found = corners_of(CHECKERBOARD, 1, noise=0.3, tilt=0.005)["cam1"]
    with pytest.raises(InputError, match=r"'cam1'.*tilt the board"):
        fit_intrinsics("cam1", CHECKERBOARD, found, SIZE)
    with pytest.raises(InputError, match="found in 3 pictures"):
        fit_intrinsics("cam1", CHECKERBOARD, {m: found[m] for m in range(3)}, SIZE)


def test_cameras_that_never_meet_are_refused():
    found = corners_of(CHECKERBOARD)
    lenses = {name: fit_intrinsics(name, CHECKERBOARD, each, SIZE) for name, each in found.items()}
    found["cam1"] = {m: found["cam1"][m] for m in range(10)}
    found["cam2"] = {m: found["cam2"][m] for m in range(8, 20)}
    with pytest.raises(InputError, match="together with 'cam1' at 2 moments"):
        fit_rig(CHECKERBOARD, lenses, found)
    even = Board("checkerboard", 8, 6, SQUARE)
    with pytest.raises(InputError, match="looks the same rotated"):
        fit_rig(even, lenses, found)


def test_boards_in_words():
    assert Board.parse("checkerboard:8x5", SQUARE) == CHECKERBOARD
    assert Board.parse("charuco:7x5", SQUARE, 0.044) == CHARUCO
    for text, named in (
        ("chess:8x5", "unknown board"),
        ("checkerboard", "inner corners"),
        ("checkerboard:2x5", "3 columns"),
        ("charuco:axb", "inner corners"),
    ):
        with pytest.raises(InputError, match=named):
            Board.parse(text, SQUARE)
    for square, marker, named in ((0.0, None, "positive"), (25, None, "metres"), (0.03, 0.04, "smaller")):
        with pytest.raises(InputError, match=named):
            Board.parse("charuco:7x5", square, marker)
    with pytest.raises(InputError, match="unknown dictionary"):
        Board.parse("charuco:7x5", SQUARE, dictionary="DICT_9")


def test_pictures_that_cannot_be_had(tmp_path):
    from PIL import Image

    (tmp_path / "empty").mkdir()
    (tmp_path / "text.mp4").write_text("no film")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "a.png").write_text("no image")
    (tmp_path / "mixed").mkdir()
    for name, size in (("a", (8, 6)), ("b", (9, 6))):
        Image.new("L", size).save(tmp_path / "mixed" / f"{name}.png")
    for name, named in (
        ("empty", "no images"),
        ("text.mp4", "not a film"),
        ("broken", "not an image"),
        ("mixed", "8 × 6"),
    ):
        with pytest.raises(InputError, match=named):
            list(grey_pictures(tmp_path / name))
    with pytest.raises(FileNotFoundError):
        list(grey_pictures(tmp_path / "none.mp4"))

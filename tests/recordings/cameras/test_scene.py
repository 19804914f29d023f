"""From files of tracks to a recording in space: names, times, offsets, scale, which way is up."""

import numpy as np
import pytest
from scenes import moved, ring, swinging

from invdyn.recordings import InputError, Recording, write_keypoint_csv
from invdyn.recordings.cameras.camera import Calibration
from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.reprojection import csv_text, table
from invdyn.recordings.cameras.scene import UP, Length, reconstruct
from invdyn.recordings.cameras.views import at_one_time, match_names, read_tracks

NAMES = ("shoulder", "elbow", "wrist")
FRAMES, RATE = 40, 20.0
POINTS = swinging(FRAMES)
TIME = np.arange(FRAMES) / RATE


def write_tracks(folder, calibration, points=POINTS, time=TIME, names=NAMES, noise=0.0, seed=0):
    """A CSV of tracks for each camera; camera → file."""
    rng, files = np.random.default_rng(seed), {}
    for camera in calibration:
        pixels = project(camera, points)
        pixels = pixels + noise * rng.standard_normal(pixels.shape)
        files[camera.name] = folder / f"{camera.name}.csv"
        write_keypoint_csv(Recording(time, pixels, names, np.full(pixels.shape[:2], 0.9)), files[camera.name])
    return files


def read_views(files, calibration, offsets=None):
    return at_one_time(read_tracks(files, calibration), calibration, offsets)


def test_there_and_back(tmp_path):
    calibration = ring(3)
    views = read_views(write_tracks(tmp_path, calibration), calibration)
    scene = reconstruct(views, scale=1.0, name="arm")
    np.testing.assert_allclose(scene.recording.keypoints, POINTS, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(scene.recording.time, TIME)
    assert scene.recording.keypoint_names == NAMES
    assert (scene.factor, scene.recording.name) == (1.0, "arm")
    np.testing.assert_allclose(scene.recording.confidence, 0.9)
    assert scene.sd.shape == POINTS.shape


def test_keypoints_may_stand_in_another_order(tmp_path):
    calibration = ring(2)
    files = write_tracks(tmp_path, calibration)
    other = write_tracks(tmp_path, calibration.select(["cam2"]), POINTS[:, ::-1], names=NAMES[::-1])
    scene = reconstruct(read_views(files | other, calibration), scale=1.0)
    np.testing.assert_allclose(scene.recording.keypoints, POINTS, rtol=0, atol=1e-9)


def test_a_stated_length_makes_it_metric(tmp_path):
    calibration = ring(3)
    files = write_tracks(tmp_path, calibration)
    unknown = calibration.scaled(7.0, metric=False)
    views = read_views(files, unknown)
    with pytest.raises(InputError, match="does not state the unit of its lengths: pass its unit"):
        reconstruct(views)
    by_arm = reconstruct(views, lengths=[Length("shoulder", "elbow", 0.3), Length.parse("elbow:wrist=.25")], scale=1.0)
    by_cameras = reconstruct(views, baseline=Length("cam1", "cam2", calibration.baseline("cam1", "cam2")), scale=1.0)
    for scene in (by_arm, by_cameras):
        np.testing.assert_allclose(scene.recording.keypoints, POINTS, rtol=0, atol=1e-8)
        assert scene.factor == pytest.approx(1 / 7)
        assert scene.calibration.metric
        assert scene.calibration.baseline("cam1", "cam3") == pytest.approx(calibration.baseline("cam1", "cam3"))
        # The spread is one of metres, too.
        np.testing.assert_allclose(scene.sd, reconstruct(read_views(files, calibration), scale=1.0).sd, rtol=1e-6)


@pytest.mark.parametrize("axis", UP)
def test_the_named_axis_points_up(tmp_path, axis):
    """A scene whose frame has another axis up comes out as it went in, but for a turn about the vertical."""
    assert np.linalg.det(UP[axis]) == pytest.approx(1)
    direction = (-1 if axis[0] == "-" else 1) * np.eye(3)["xyz".index(axis[-1])]
    np.testing.assert_array_equal(UP[axis] @ direction, [0, 0, 1])
    calibration = ring(2)
    turned = calibration.rotated(UP[axis].T)  # in its frame `axis` is what was z
    views = read_views(write_tracks(tmp_path, calibration), turned)
    scene = reconstruct(views, up=axis, scale=1.0)
    np.testing.assert_allclose(scene.recording.keypoints[..., 2], POINTS[..., 2], rtol=0, atol=1e-9)
    for camera, original in zip(scene.calibration, calibration, strict=True):
        np.testing.assert_allclose(project(camera, scene.recording.keypoints), project(original, POINTS), atol=1e-6)


def test_an_offset_is_taken_away(tmp_path):
    calibration = ring(3)
    fine = swinging(10 * FRAMES - 9)  # ten times as often
    files = write_tracks(tmp_path, calibration, fine[::10])
    # Camera 2 opens .3 frames later, and its clock runs 1 s ahead.
    files |= write_tracks(tmp_path, calibration.select(["cam2"]), fine[3::10], TIME[:-1] + 0.3 / RATE + 1.0)
    with pytest.raises(InputError, match=r"'cam2' has 39 rows, the first camera 40: .*--set offset=cam2=SECONDS"):
        read_views(files, calibration)
    views = read_views(files, calibration, offsets={"cam2": 1.0})
    assert np.isnan(views.pixels[0, 1]).all()
    scene = reconstruct(views, scale=1.0)
    # Linear between frames 1/20 s apart: up to h²/8 of an acceleration near 10 m/s², a third of it after averaging.
    assert np.nanmax(np.abs(scene.recording.keypoints - fine[::10])) < 4e-3
    wrong = reconstruct(read_views(files, calibration, offsets={"cam2": 1.03}), scale=1.0)
    assert wrong.rows[-1].median > 3 * scene.rows[-1].median


def test_gaps_are_not_filled(tmp_path):
    calibration = ring(2)
    files = write_tracks(tmp_path, calibration)
    points, time = np.delete(POINTS, [10, 11], 0), np.delete(TIME, [10, 11])
    files |= write_tracks(tmp_path, calibration.select(["cam2"]), points, time)
    views = read_views(files, calibration, offsets={"cam2": 0.0})
    assert np.isnan(views.pixels[:, 1]).all((1, 2)).nonzero()[0].tolist() == [10, 11]
    scene = reconstruct(views, scale=1.0)
    assert np.isnan(scene.recording.keypoints).all((1, 2)).nonzero()[0].tolist() == [10, 11]
    assert (scene.recording.confidence[10] == 0).all()


def test_refined_poses_explain_the_pixels(tmp_path):
    calibration = ring(3)
    views = read_views(write_tracks(tmp_path, calibration, noise=0.5), moved(calibration))
    as_given, refined = reconstruct(views), reconstruct(views, refine=True, lengths=[Length("shoulder", "elbow", 0.3)])
    assert refined.scale < as_given.scale / 3
    forearm = np.linalg.norm(np.diff(refined.recording.keypoints[:, 1:], axis=1), axis=-1)
    assert np.median(forearm) == pytest.approx(0.25, abs=2e-3)


def test_errors_of_a_camera_that_is_off_show_in_its_rows(tmp_path):
    calibration = ring(4)
    files = write_tracks(tmp_path, calibration, noise=1.0)
    views = read_views(files, calibration)
    views.pixels[:, 2, 1] += [0, 12]
    rows = {(row.camera, row.keypoint): row for row in reconstruct(views).rows}
    assert len(rows) == 4 * 4
    worst = rows["cam3", "elbow"]
    assert worst.pixels == FRAMES
    assert worst.v == pytest.approx(12, abs=2)
    assert abs(rows["cam1", "wrist"].v) < 1
    # Noise of 1 px in the plane: the median distance is 1.18, less what the points take up.
    assert 0.6 < rows["cam1", "wrist"].median < 1.2
    lines = csv_text(list(rows.values())).splitlines()
    assert lines[0] == "camera,keypoint,pixels,median,q90,u,v,outliers"
    assert len(lines) == 17
    assert len(table(list(rows.values())).splitlines()) == 17


def test_files_are_given_to_cameras():
    names = ("cam1", "cam2", "cam12")
    assert list(match_names(["b/cam2.csv", "cam12.csv", "cam1=x.csv"], names)) == ["cam2", "cam12", "cam1"]
    assert list(match_names(["arm_cam2_tracks.csv"], ("cam1", "cam2"))) == ["cam2"]
    with pytest.raises(InputError, match=r"arm_cam12\.csv: which camera"):
        match_names(["arm_cam12.csv"], ("cam1", "cam2"))
    with pytest.raises(InputError, match=r"x\.csv: which camera"):
        match_names(["x.csv"], names)
    with pytest.raises(InputError, match="no camera 'cam9'"):
        match_names(["cam9=x.csv"], names)
    with pytest.raises(InputError, match="has two files"):
        match_names(["cam1=x.csv", "cam1.csv"], names)


def test_lengths_in_words():
    assert Length.parse("a:b=0.5") == Length.parse(" a : b = 0.5 ") == Length("a", "b", 0.5)
    for text in ("a:b", "a=0.5", "a:a=1", "a:b=-1", "a:b=nan", "a:b=long", ":b=1", "a: =1", "a: a=1"):
        with pytest.raises(InputError, match="FROM:TO=METRES"):
            Length.parse(text)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda t: Recording(t.time, t.keypoints / 1000, t.keypoint_names), "look like metres"),
        (lambda t: Recording(t.time, t.keypoints + 2000, t.keypoint_names), "lie outside the 1280 × 960 px"),
        (lambda t: Recording(t.time, t.keypoints, ("shoulder", "elbow", "hand")), "keypoint 'hand'"),
        (lambda t: Recording(t.time[:-1], t.keypoints[:-1], t.keypoint_names), "39 rows, the first camera 40"),
        (lambda t: Recording(t.time + 0.02, t.keypoints, t.keypoint_names), r"\+0.02 s off"),
        (lambda t: Recording(t.time, t.keypoints, t.keypoint_names, np.full((40, 3), 60.0)), "between 0 and 1"),
        (
            lambda t: Recording(t.time, np.concatenate([t.keypoints, t.keypoints[..., :1]], -1), t.keypoint_names),
            "three coordinates",
        ),
    ],
    ids=["metres", "another size", "another name", "fewer rows", "later", "percent", "in space"],
)
def test_tracks_that_do_not_fit(tmp_path, change, named):
    calibration = ring(2)
    files = write_tracks(tmp_path, calibration)
    tracks = Recording(TIME, project(calibration.cameras[1], POINTS), NAMES)
    write_keypoint_csv(change(tracks), files["cam2"])
    with pytest.raises(InputError, match=named) as caught:
        read_views(files, calibration)
    assert "\n" not in str(caught.value)


def test_other_things_that_do_not_fit(tmp_path):
    calibration = ring(2)
    files = write_tracks(tmp_path, calibration)
    with pytest.raises(InputError, match="two cameras or more, got 1"):
        read_views({"cam1": files["cam1"]}, calibration)
    with pytest.raises(InputError, match="offset of camera 'cam7'"):
        read_views(files, calibration, offsets={"cam7": 0.1})
    folding = Calibration(tuple(ring(2, distortion=(-40.0, 0, 0, 0, 0))), metric=True)
    with pytest.raises(InputError, match="folds the picture"):
        read_views(files, folding)
    views = read_views(files, calibration)
    with pytest.raises(InputError, match="up is one of"):
        reconstruct(views, up="north")
    with pytest.raises(InputError, match="no keypoint 'hand'"):
        reconstruct(views, lengths=[Length("hand", "elbow", 0.3)])
    with pytest.raises(InputError, match="pass one kind, not both"):
        reconstruct(views, lengths=[Length("wrist", "elbow", 0.3)], baseline=Length("cam1", "cam2", 1.0))
    with pytest.raises(InputError, match="choose both"):
        reconstruct(views, intrinsics=["focal"])

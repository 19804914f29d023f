"""Calibrations of five programs: small files of the same kind, files by the programs themselves, and what is none."""

import json
import os

import numpy as np
import pytest
from scenes import looking, ring, swinging

from invdyn.recordings import InputError
from invdyn.recordings.cameras.camera import Calibration
from invdyn.recordings.cameras.formats import read_calibration
from invdyn.recordings.cameras.opencv import read_storage
from invdyn.recordings.cameras.projection import project
from invdyn.recordings.cameras.toml_cameras import write_calibration

ANIPOSE = """
[cam_0]
name = "left"
size = [ 640, 480,]
matrix = [ [ 800.0, 0.0, 320.0,], [ 0.0, 810.0, 240.0,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.1, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 0.0, 0.0, 0.0,]
translation = [ 0.0, 0.0, 0.0,]
[cam_1]
name = "right"
size = [ 640, 480,]
matrix = [ [ 800.0, 0.0, 320.0,], [ 0.0, 810.0, 240.0,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.1, 0.0, 0.0, 0.0, 0.0,]
rotation = [ 0.0, 1.5707963267948966, 0.0,]
translation = [ 100.0, 0.0, 0.0,]
[metadata]
adjusted = false
error = 0.31
"""
QUALISYS = """<?xml version='1.0'?>
<calibration type="regular"><cameras>
<camera active="1" avg-residual="0.5" model="none" serial="one" viewrotation="0">
<fov_video bottom="1079" left="10" right="1929" top="0"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="1" r23="0" r31="0" r32="0" r33="1" x="1000" y="2000" z="3000"/>
<intrinsic centerPointU="61440" centerPointV="34560" focalLengthU="64000" focalLengthV="64640" skew="0"
 radialDistortion1="-0.1" radialDistortion2="0.02" radialDistortion3="0.003" tangentalDistortion1="0.001"
 tangentalDistortion2="0.002"/>
</camera>
<camera active="0" model="none" serial="off" viewrotation="0"/>
</cameras></calibration>
"""
YAML = """%YAML:1.0
---
calibration_time: "Thu 01 Jan 2026 10:00:00"
nr_of_frames: 12
image_width: 640
image_height: 480
# flags: +zero_tangent_dist
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 8.0000000000000000e+02, 0., 320., 0.,
       810., 240., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -1.0e-01, 2.0e-02, 0., 0., -.5 ]
"""


def same(one, other):
    assert one.names == other.names
    assert one.metric == other.metric
    for a, b in zip(one, other, strict=True):
        for field in ("matrix", "distortion", "rotation", "translation"):
            # A rotation goes through a vector and back.
            np.testing.assert_allclose(getattr(a, field), getattr(b, field), rtol=0, atol=2e-15 * 2000)
        assert (a.size, a.fisheye) == (b.size, b.fisheye)


@pytest.mark.parametrize("metric", [True, False])
def test_our_own_file_reads_back(tmp_path, metric):
    fish = looking('a "fish" \\ eye', (1, 1, 1), distortion=(0.1, 0.2, 0.3, 0.4), fisheye=True, size=(8, 6))
    calibration = Calibration((*ring(3).cameras, fish), metric, error=0.25)
    write_calibration(calibration, tmp_path / "calibration.toml")
    again = read_calibration(tmp_path / "calibration.toml")
    same(again, calibration)
    assert again.error == 0.25


def test_a_file_of_aniposelib_has_the_unit_that_is_said(tmp_path):
    (tmp_path / "c.toml").write_text(ANIPOSE)
    unknown, millimetres = read_calibration(tmp_path / "c.toml"), read_calibration(tmp_path / "c.toml", "mm")
    assert unknown.names == ("left", "right")
    assert (unknown.metric, millimetres.metric) == (False, True)
    assert unknown.baseline("left", "right") == pytest.approx(100)
    assert millimetres.baseline("left", "right") == pytest.approx(0.1)
    assert unknown.error == 0.31
    np.testing.assert_allclose(unknown.cameras[1].rotation, [[0, 0, 1], [0, 1, 0], [-1, 0, 0]], atol=1e-15)


def test_a_file_of_pose2sim_is_in_metres(tmp_path):
    text = ANIPOSE.replace("0.0, 0.0, 0.0, 0.0,]", "0.0, 0.0, 0.0]").replace(
        "translation", "fisheye = false\ntranslation"
    )
    (tmp_path / "c.toml").write_text(text)
    assert read_calibration(tmp_path / "c.toml").metric
    with pytest.raises(InputError, match="says its own unit"):
        read_calibration(tmp_path / "c.toml", "mm")


def test_pose2sims_own_file(data_folder):
    calibration = read_calibration(data_folder / "sports2d" / "Calib_demo.toml")
    (camera,) = calibration
    assert calibration.metric
    assert camera.size == (1768, 994)
    assert np.linalg.norm(camera.position) == pytest.approx(np.linalg.norm([-3.5101, 1.7079, 10.0]), abs=1e-3)


def test_qualisys_by_hand(tmp_path):
    (tmp_path / "c.qca.txt").write_text(QUALISYS)
    calibration = read_calibration(tmp_path / "c.qca.txt")
    (camera,) = calibration
    assert calibration.metric
    assert camera.size == (1920, 1080)
    np.testing.assert_allclose(camera.matrix, [[1000, 0, 950], [0, 1010, 540], [0, 0, 1]])
    np.testing.assert_allclose(camera.distortion, [-0.1, 0.02, 0.001, 0.002, 0.003])
    np.testing.assert_allclose(camera.position, [1, 2, 3])
    # It looks along −z of the scene, with y up: below it, to its right and upwards is right and up in the picture.
    u, v = project(camera, np.array([1.1, 2.1, 1.0]))
    assert u > 950
    assert v < 540


def test_qualisys_own_file_and_a_triangulation_of_its_films(data_folder):
    folder = data_folder / "multiview_walker"
    calibration = read_calibration(folder / "Calib.qca.txt")
    assert calibration.names == ("cam01", "cam02", "cam03", "cam04")
    points = np.genfromtxt(folder / "triangulated_mediapipe_arm3d_m.csv", delimiter=",", skip_header=1)[:, 1:]
    points = points.reshape(-1, 8, 3)
    for camera in calibration:
        tracks = np.genfromtxt(folder / f"{camera.name}_mediapipe2d.csv", delimiter=",", skip_header=1)[:, 1:]
        miss = np.linalg.norm(project(camera, points) - tracks.reshape(-1, 8, 3)[..., :2], axis=-1)
        assert np.nanmedian(miss) < 25  # 10 to 17: the tracker's; a wrong law of the file would be off by 100 s


def test_opencv_yaml_by_hand(tmp_path):
    (tmp_path / "front.yml").write_text(YAML)
    (camera,) = read_calibration(tmp_path / "front.yml")
    assert camera.name == "front"
    assert camera.size == (640, 480)
    np.testing.assert_allclose(camera.matrix, [[800, 0, 320], [0, 810, 240], [0, 0, 1]])
    np.testing.assert_allclose(camera.distortion, [-0.1, 0.02, 0, 0, -0.5])


@pytest.mark.parametrize("suffix", ["yml", "json"])
def test_opencvs_own_writer(tmp_path, suffix):
    cv2 = pytest.importorskip("cv2")
    calibration = ring(2)
    one, two = calibration
    turn = two.rotation @ one.rotation.T
    path = tmp_path / f"stereo.{suffix}"
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, values in (
        ("M1", one.matrix),
        ("D1", one.distortion[None]),
        ("M2", two.matrix),
        ("D2", two.distortion[None]),
        ("R", turn),
        ("T", (two.translation - turn @ one.translation)[:, None]),
    ):
        file.write(name, np.ascontiguousarray(values))
    file.release()
    read = read_calibration(path, "m")
    assert read.metric
    # Seen from camera 1 the scene is what it was.
    points = swinging(5)
    np.testing.assert_allclose(
        project(read.cameras[1], points @ one.rotation.T + one.translation), project(two, points), atol=1e-9
    )


def test_several_files_of_opencv_need_poses(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.yml").write_text(YAML)
    with pytest.raises(InputError, match="has no pose of the camera"):
        read_calibration([tmp_path / "a.yml", tmp_path / "b.yml"])
    pose = "R: !!opencv-matrix\n   rows: 3\n   cols: 1\n   dt: d\n   data: [ 0., 0., 0.1 ]\nT: [ 1., 2, 3. ]\n"
    for name in ("a", "b"):
        (tmp_path / f"{name}.yml").write_text(YAML + pose)
    read = read_calibration([tmp_path / "a.yml", tmp_path / "b.yml"], "cm")
    assert read.names == ("a", "b")
    np.testing.assert_allclose(read.cameras[1].translation, [0.01, 0.02, 0.03])


CAMERA_INFO = """image_width: 1280
image_height: 960
camera_name: left
camera_matrix:
  rows: 3
  cols: 3
  data: [520.0, 0.0, 642.0, 0.0, 521.0, 479.0, 0.0, 0.0, 1.0]
distortion_model: MODEL
distortion_coefficients:
  rows: 1
  cols: 4
  data: [-0.012, 0.031, -0.018, 0.004]
"""


@pytest.mark.parametrize(
    ("model", "fisheye"),
    [
        ("equidistant", True),
        ("fisheye", True),
        ("plumb_bob", False),
        ("rational_polynomial", False),
        ('""', False),
    ],
)
def test_ros_names_the_law_of_a_lens(tmp_path, model, fisheye):
    (tmp_path / "left.yaml").write_text(CAMERA_INFO.replace("MODEL", model))
    (camera,) = read_calibration(tmp_path / "left.yaml", "m")
    assert camera.fisheye is fisheye
    assert camera.distortion[:4].tolist() == [-0.012, 0.031, -0.018, 0.004]


@pytest.mark.parametrize("model", ["thin_prism", "3", "[1, 2]"])
def test_another_law_of_a_lens_is_refused_by_name(tmp_path, model):
    (tmp_path / "left.yaml").write_text(CAMERA_INFO.replace("MODEL", model))
    words = r"expected distortion_model as one of plumb_bob, .*equidistant, fisheye, got "
    with pytest.raises(InputError, match=words) as error:
        read_calibration(tmp_path / "left.yaml", "m")
    assert model.strip("[]").split(",")[0] in str(error.value)


@pytest.mark.parametrize("flag", [0, 1])
def test_opencv_flags_a_fisheye_and_a_byte_order_mark_is_nothing(tmp_path, flag):
    text = CAMERA_INFO.replace("distortion_model: MODEL", f"fisheye_model: {flag}")
    (tmp_path / "left.yml").write_text(f"\ufeff{text}", encoding="utf-8")
    (camera,) = read_calibration(tmp_path / "left.yml", "m")
    assert camera.fisheye is bool(flag)


HUGE = "9" * 400
DEEP = "a = " + "[" * 5000 + "]" * 5000
POSE2SIM = ANIPOSE.replace("rotation =", "fisheye = false\nrotation =")
BAD = {
    "no TOML": ("c.toml", "[cam", "expected a calibration in TOML"),
    "no camera": ("c.toml", "[arm]\nlength = 1\n", "no camera in it"),
    "no translation": ("c.toml", ANIPOSE.replace("translation = [ 100", "shift = [ 100"), "'translation' is missing"),
    "a name twice": ("c.toml", ANIPOSE.replace("right", "left"), "two cameras are called 'left'"),
    "another unit": ("c.toml", ANIPOSE + 'unit = "inch"\n', "unit must be"),
    "rational lens": ("c.toml", ANIPOSE.replace("0.0, 0.0, 0.0, 0.0,]", "0, 0, 0, 0, 1, 2, 3]"), "Brown's law has 5"),
    "deep TOML": ("c.toml", DEEP, "nested too deep"),
    "5000 digits": ("c.toml", f"a = {HUGE * 13}", "integer too long"),
    "an error of 400 digits": ("c.toml", ANIPOSE.replace("0.31", HUGE), "error must be in px"),
    "a focal length of 400 digits": ("c.toml", ANIPOSE.replace("800.0", HUGE), "matrix must be numbers"),
    "a rotation of 400 digits": ("c.toml", ANIPOSE.replace("1.5707963267948966", HUGE), "rotation must be numbers"),
    "a name of 5000 digits": ("c.toml", ANIPOSE.replace('"left"', f"0x{HUGE * 13}"), "too long to be one"),
    "a size without end": ("c.toml", ANIPOSE.replace("640,", "inf,"), "size has a value that is not finite"),
    "a huge size": ("c.toml", ANIPOSE.replace("640,", "1e7,"), "expected size as width and height"),
    "units in a list": ("c.toml", ANIPOSE + 'unit = ["m"]\n', "unit must be"),
    "ragged distortions": ("c.toml", POSE2SIM.replace("[ -0.1, 0.0,", "[ [-0.1], 0.0,"), "distortion must be numbers"),
    "ragged distortions in JSON": (
        "c.json",
        '{"K": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "D": [[1], 2]}',
        "distortion must",
    ),
    "ragged T in JSON": (
        "c.json",
        '{"K": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "D": [0], "R": [0, 0, 0], "T": [[1], 2]}',
        "translation must be numbers",
    ),
    "400 digits in JSON": ("c.json", f'{{"K": [{HUGE}], "D": [0]}}', "matrix must be numbers"),
    "a rotation of huge numbers": (
        "c.qca.txt",
        QUALISYS.replace('r11="1"', 'r11="1e200"'),
        "rotation has a value beyond",
    ),
    "an edge that is none": ("c.qca.txt", QUALISYS.replace('bottom="1079"', 'bottom="nan"'), "size has a value that"),
    "an edge without end": ("c.qca.txt", QUALISYS.replace('left="10"', 'left="inf"'), "not finite"),
    "another encoding": (
        "c.qca.txt",
        QUALISYS.replace("'1.0'", "'1.0' encoding='big5'"),
        "Qualisys calibration in XML",
    ),
    "no encoding": ("c.qca.txt", QUALISYS.replace("'1.0'", "'1.0' encoding='foo'"), "expected a Qualisys"),
    "no XML": ("c.qca.txt", "camera one", "expected a Qualisys calibration in XML"),
    "an entity": ("c.qca.txt", '<!DOCTYPE a [<!ENTITY b "c">]><calibration/>', "defines entities"),
    "other XML": ("c.xml", "<opencv_storage/>", "got <opencv_storage>"),
    "a rotated view": ("c.qca.txt", QUALISYS.replace('viewrotation="0"', 'viewrotation="90"'), "rotated by 90"),
    "a word": ("c.qca.txt", QUALISYS.replace('"64000"', '"wide"'), "focalLengthU is 'wide'"),
    "no intrinsic": ("c.qca.txt", QUALISYS.replace("<intrinsic", "<lens"), "is missing"),
    "YAML with a tag": ("c.yml", "%YAML:1.0\n---\na: !!python/object:os.system 1\n", "line 3"),
    "YAML with an alias": ("c.yml", "%YAML:1.0\n---\nb: &b 1\na: *b\n", "line 4.* an alias"),
    "YAML of 2 MB": ("c.yml", YAML + "# and more\n" * 200_000, "at most 1 MiB"),
    "an open list": ("c.yml", "%YAML:1.0\n---\na: [ 1, 2\n", "expected ',' or ']'"),
    "another YAML": ("c.yml", "- a\n- b\n", "line 1"),
    "no matrix": ("c.yml", "%YAML:1.0\n---\nwidth: 3\n", "no camera in it"),
    "short data": ("c.yml", YAML.replace("rows: 3", "rows: 4"), "'camera_matrix' is no matrix"),
    "broken JSON": ("c.json", '{"camera_matrix": ', "broken JSON"),
    "unknown suffix": ("c.mat", "", "cannot tell the kind"),
}


@pytest.mark.parametrize(("name", "text", "named"), BAD.values(), ids=BAD.keys())
def test_bad_files_are_told_in_one_line(tmp_path, name, text, named):
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=named) as caught:
        read_calibration(tmp_path / name)
    assert "\n" not in str(caught.value)


def test_entities_are_refused_in_any_encoding(tmp_path):
    text = "<?xml version='1.0' encoding='utf-16'?><!DOCTYPE a [<!ENTITY b \"one\">]>"
    text += QUALISYS.split("?>")[1].replace('"one"', '"&b;"')
    (tmp_path / "c.qca.txt").write_bytes(text.encode("utf-16"))
    with pytest.raises(InputError, match="defines entities"):
        read_calibration(tmp_path / "c.qca.txt")


@pytest.mark.parametrize("suffix", [".toml", ".qca.txt", ".yml", ".json", ".mat"])
def test_what_is_no_ordinary_file_is_not_read(tmp_path, suffix):
    os.mkfifo(tmp_path / f"pipe{suffix}")
    (tmp_path / f"zeros{suffix}").symlink_to("/dev/zero")
    for name, what in {"pipe": "a device or a pipe", "zeros": "a device or a pipe", "a\0b": "no path may hold"}.items():
        with pytest.raises(OSError, match=what):
            read_calibration(tmp_path / f"{name}{suffix}")


@pytest.mark.parametrize(("name", "text"), [("c.toml", ANIPOSE), ("c.qca.txt", QUALISYS), ("c.yml", YAML)])
def test_a_damaged_file_is_read_or_told(tmp_path, name, text):
    """Cut anywhere, or with some characters replaced: a calibration or one line, never a traceback."""
    rng, messages = np.random.default_rng(0), []
    for _ in range(150):
        letters = list(text[: rng.integers(1, len(text))] if rng.random() < 0.3 else text)
        for _ in range(rng.integers(1, 6)):
            letters[rng.integers(len(letters))] = '0a[]="<-.:e\n #!'[rng.integers(15)]
        (tmp_path / name).write_text("".join(letters))
        try:
            assert len(read_calibration(tmp_path / name)) > 0
        except InputError as error:
            messages.append(str(error))
    assert len(messages) > 50
    assert not [message for message in messages if "\n" in message]


def test_a_unit_must_be_known(tmp_path):
    (tmp_path / "c.toml").write_text(ANIPOSE)
    with pytest.raises(InputError, match="unknown unit 'inch'"):
        read_calibration(tmp_path / "c.toml", "inch")


def test_nested_blocks_and_texts(tmp_path):
    text = '%YAML:1.0\n---\nouter:\n   inner:\n      a: 1\n      b: "x: y"\n   c: [ .5, -.Inf, .Nan ]\nd: -2.e-1\n'
    (tmp_path / "c.yml").write_text(text)
    tree = read_storage(tmp_path / "c.yml")
    assert tree["outer"]["inner"] == {"a": 1.0, "b": "x: y"}
    np.testing.assert_equal(tree["outer"]["c"], [0.5, -np.inf, np.nan])
    assert tree["d"] == -0.2
    (tmp_path / "c.json").write_text(json.dumps({"outer": {"a": 1}, "d": [[1, 2], [3, 4]]}))
    assert read_storage(tmp_path / "c.json")["d"].shape == (2, 2)

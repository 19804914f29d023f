import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from invdyn.recordings import InputError, Recording, load, read_keypoint_csv, write_keypoint_csv

HEADER = "time,elbow_x,elbow_y,wrist_x,wrist_y"
ROWS = ["0,0.3,0,0.5,0", "0.1,0.3,0.1,0.5,0.1", "0.2,0.3,0.2,0.5,0.2"]


def write(tmp_path, *lines: str):
    path = tmp_path / "rec.csv"
    path.write_text("\n".join(lines) + "\n")
    return path


cells = st.one_of(st.just(np.nan), st.floats(-1e3, 1e3, allow_subnormal=True))


@st.composite
def recordings(draw) -> Recording:
    T, P, S, K = (
        draw(st.integers(2, 6)),
        draw(st.integers(1, 3)),
        draw(st.integers(2, 3)),
        draw(st.integers(1, 2)),
    )
    steps = draw(arrays(float, T, elements=st.floats(1e-6, 10)))
    keypoints = draw(arrays(float, (T, P, S), elements=cells))
    keypoints[0] = draw(arrays(float, (P, S), elements=st.floats(-1, 1)))  # every keypoint is seen once
    angles = draw(st.none() | arrays(float, (T, K), elements=st.floats(-4, 4)))
    torques = draw(st.none() | arrays(float, (T, K), elements=st.floats(-9, 9)))
    confidence = draw(st.none() | arrays(float, (T, P), elements=st.floats(0, 1)))
    names = tuple(f"joint_{k}" for k in range(K)) if angles is not None or torques is not None else ()
    points = tuple(f"point_{p}" for p in range(P))
    return Recording(np.cumsum(steps), keypoints, points, confidence, angles, torques, names)


@given(recording=recordings())
@settings(max_examples=60)
def test_round_trip_is_exact(tmp_path_factory, recording):
    path = tmp_path_factory.mktemp("csv") / "recording.csv"
    write_keypoint_csv(recording, path)
    back = read_keypoint_csv(path)
    for field in ("time", "keypoints", "confidence", "angles", "torques"):
        expected, got = getattr(recording, field), getattr(back, field)
        assert (expected is None) == (got is None), field
        if expected is not None:
            np.testing.assert_array_equal(got, expected)
    assert back.keypoint_names == recording.keypoint_names
    assert back.joint_names == recording.joint_names


def test_empty_cells_are_missing_and_commands_are_held(tmp_path):
    path = write(
        tmp_path,
        "time,wrist_x,wrist_y,wrist_likelihood,shoulder_torque,elbow_angle",
        "0,0.1,0.2,0.9,1.5,",
        "0.001,,,,,0.5",
        "0.002,,,,-2,",
    )
    recording = load(path)
    assert np.isnan(recording.keypoints[1:]).all()
    np.testing.assert_array_equal(recording.torques[:, 0], [1.5, 1.5, -2.0])
    assert recording.joint_names == ("shoulder", "elbow")
    assert np.isnan(recording.torques[:, 1]).all()  # the elbow's command is not known
    np.testing.assert_array_equal(recording.angles[:, 1], [np.nan, 0.5, np.nan])
    np.testing.assert_array_equal(recording.confidence[:, 0], [0.9, np.nan, np.nan])


def test_irregular_times_are_kept(tmp_path):
    recording = load(write(tmp_path, HEADER, ROWS[0], "0.9,0.3,0,0.5,0", "1.0,0.3,0,0.5,0"))
    np.testing.assert_array_equal(recording.time, [0.0, 0.9, 1.0])


def test_a_body_gives_the_order_and_the_base_may_be_there(tmp_path):
    path = write(
        tmp_path,
        "time,wrist_x,wrist_y,shoulder_x,shoulder_y,elbow_x,elbow_y",
        "0,3,3,1,1,2,2",
        "1,3,3,1,1,2,2",
    )
    recording = load(path, keypoints=("elbow", "wrist"), base="shoulder")
    assert recording.keypoint_names == ("shoulder", "elbow", "wrist")
    np.testing.assert_array_equal(recording.keypoints[0], [[0, 0], [1, 1], [2, 2]])  # less the shoulder's place
    assert load(path, keypoints=("elbow", "wrist")).keypoint_names == ("elbow", "wrist")


def test_a_byte_order_mark_and_spaces_do_not_matter(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("\ufeff" + HEADER.replace(",", ", ") + "\r\n" + "\r\n".join(ROWS) + "\r\n\r\n", encoding="utf-8")
    assert load(path).num_frames == 3


BAD = {
    "empty file": ([], "empty"),
    "header only": ([HEADER], "only a header"),
    "one frame": ([HEADER, ROWS[0]], "at least 2 frames"),
    "duplicate time": ([HEADER, ROWS[0], ROWS[1], ROWS[1]], r"repeats at row 3 \(line 4\)"),
    "backward time": ([HEADER, ROWS[1], ROWS[0]], r"backwards at row 2 \(line 3\)"),
    "missing time": ([HEADER, ROWS[0], "," + ROWS[1].split(",", 1)[1]], "time is nan at row 2"),
    "infinite value": (
        [HEADER, ROWS[0], "0.1,0.3,inf,0.5,0"],
        r"row 2 \(line 3\), column 'elbow_y' is infinite",
    ),
    "text": (
        [HEADER, ROWS[0], "0.1,0.3,none,0.5,0"],
        r"row 2 \(line 3\), column 'elbow_y': 'none' is not a number",
    ),
    "short row": ([HEADER, ROWS[0], "0.1,0.3"], "row 2 .* has 2 cells, the header has 5"),
    "no time": (["t,wrist_x,wrist_y", "0,1,1", "1,1,1"], "no column 'time'"),
    "two clocks": (["frame,time,wrist_x,wrist_y", "0,0,1,1", "1,1,1,1"], "'time' and 'frame': leave one"),
    "frame misspelt": (["Frame,wrist_x,wrist_y", "0,1,1", "1,1,1"], "rename 'Frame'"),
    "time misspelt": (["Time,wrist_x,wrist_y", "0,1,1", "1,1,1"], "rename 'Time'"),
    "twice": (["time,wrist_x,wrist_x", "0,1,1", "1,1,1"], "'wrist_x' twice"),
    "nameless": (["time,,wrist_y", "0,1,1", "1,1,1"], "without a name"),
    "no y": (["time,wrist_x", "0,1", "1,1"], "'wrist_y' is missing"),
    "half 3-D": (["time,a_x,a_y,a_z,b_x,b_y", "0,1,1,1,1,1", "1,1,1,1,1,1"], "'b_z' is missing"),
    "unknown column": (
        ["time,wrist_x,wrist_y,wrist_lik", "0,1,1,1", "1,1,1,1"],
        "'wrist_lik'.*'wrist_likelihood'",
    ),
    "two likelihoods": (["time,a_x,a_y,a_vis,a_likelihood", "0,1,1,1,1", "1,1,1,1,1"], "one likelihood of 'a'"),
    "a log of one joint": (["time,position", "0,1", "1,1"], "'position' of a robot's log: pass --map"),
    "a log's column": (["time,hip_position", "0,1", "1,1"], "'hip_position' of a robot's log: pass --map"),
    "plain column": (["time,wrist_x,wrist_y,speed", "0,1,1,1", "1,1,1,1"], "unknown column 'speed'"),
    "orphan likelihood": (["time,a_x,a_y,b_likelihood", "0,1,1,1", "1,1,1,1"], "no 'b_x'"),
    "late command": (
        ["time,a_x,a_y,s_torque", "0,1,1,", "1,1,1,2"],
        "'s_torque' has no value in its first row",
    ),
    "all missing": (["time,a_x,a_y,b_x,b_y", "0,1,1,,", "1,1,1,,"], "keypoint 'b' is missing in every frame"),
    "nothing": (["time,a_x,a_y", "0,,", "1,,"], "nothing is observed"),
    "semicolons": (["time;a_x;a_y", "0;1;1", "1;1;1"], "separated by commas, these are by ';'"),
    "tabs": (["time\ta_x\ta_y", "0\t1\t1", "1\t1\t1"], "separated by commas"),
}


@pytest.mark.parametrize("word", ["likelihood", "vis", "Confidence", "score"])
def test_a_trackers_word_for_a_likelihood_is_read(tmp_path, word):
    path = write(tmp_path, f"time,a_x,a_y,a_{word}", "0,1,1,.25", "1,1,1,")
    assert read_keypoint_csv(path).confidence.tolist() == [[0.25], [pytest.approx(np.nan, nan_ok=True)]]


def test_numbers_of_frames_are_no_seconds(tmp_path):
    path = tmp_path / "rec.csv"
    path.write_text("frame,wrist_x,wrist_y\n0,1,1\n1,1,1\n")
    assert read_keypoint_csv(path, fps=50).time.tolist() == [0.0, 0.02]
    with pytest.raises(InputError, match="'frame' numbers the frames of a film: pass --fps"):
        read_keypoint_csv(path)


@pytest.mark.parametrize(("lines", "words"), BAD.values(), ids=BAD.keys())
def test_bad_files_get_one_clear_line(tmp_path, lines, words):
    path = write(tmp_path, *lines) if lines else tmp_path / "rec.csv"
    path.touch()
    with pytest.raises(InputError, match=words) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert len(str(caught.value).splitlines()) == 1


def test_the_bodys_names_are_compared(tmp_path):
    path = write(tmp_path, "time,elbow_x,elbow_y,hand_x,hand_y", "0,1,1,1,1", "1,1,1,1,1")
    with pytest.raises(InputError, match=r"'wrist' is missing: the file has elbow, hand"):
        load(path, keypoints=("elbow", "wrist"))
    assert load(path, keypoints=("elbow",)).keypoint_names == ("elbow",)  # as of every other format
    path = write(tmp_path, HEADER + ",knee_torque", *(row + ",1" for row in ROWS))
    with pytest.raises(InputError, match=r"joints \(knee\) are not the body's \(shoulder, elbow\)"):
        load(path, joints=("shoulder", "elbow"))


@pytest.mark.parametrize("junk", [b"\x89PNG\r\n\x1a\n\xff\xfe", b"time,a_x\n\x00\x00\x00,1\n", b"\xff" * 100])
def test_binary_junk_is_not_a_table(tmp_path, junk):
    path = tmp_path / "rec.csv"
    path.write_bytes(junk)
    with pytest.raises(InputError, match="not a text table"):
        load(path)


def test_only_metres_are_written(tmp_path):
    recording = Recording([0.0, 1.0], np.zeros((2, 1, 2)), ("wrist",), length_unit="px")
    with pytest.raises(InputError, match="metres"):
        write_keypoint_csv(recording, tmp_path / "rec.csv")
    assert list(tmp_path.iterdir()) == []

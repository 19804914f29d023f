import numpy as np
import pytest

from invdyn.recordings import InputError, load

HEADER = "track,frame_idx,instance.score,hip.x,hip.y,hip.score,toe.x,toe.y,toe.score\n"
ROWS = "ada,3,.9,10,20,.8,30,40,.7\nbob,2,.9,11,21,.8,31,41,.7\nada,0,.9,12,22,.8,,,\nada,4,.9,14,24,.8,34,44,.6\n"


def test_one_track_with_frames_left_out(tmp_path):
    (tmp_path / "rec.csv").write_text(HEADER + ROWS)
    recording = load(tmp_path / "rec.csv", units="px", fps=20, individual="ada")
    assert recording.keypoint_names == ("hip", "toe")
    np.testing.assert_allclose(recording.time, [0, 0.15, 0.2])
    np.testing.assert_allclose(recording.keypoint("hip"), [[12, -22], [10, -20], [14, -24]])
    np.testing.assert_allclose(recording.keypoint("toe"), [[np.nan, np.nan], [30, -40], [34, -44]])
    np.testing.assert_allclose(recording.confidence[:, 1], [np.nan, 0.7, 0.6])


def test_a_lone_animal_needs_no_name(tmp_path):
    (tmp_path / "rec.csv").write_text(HEADER + ROWS.replace("ada", "").replace("bob,2,", ",7,"))
    assert load(tmp_path / "rec.csv", units="px", fps=20).num_frames == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEADER + ROWS, "several individuals: choose one of ada, bob"),
        (HEADER + ROWS.replace("ada,4", "ada,3"), "frame 3 comes twice for track 'ada': track the animals first"),
        (HEADER, "only a header"),
        (HEADER.replace("hip.y", "hip.z") + ROWS, "not a SLEAP analysis csv"),
        (HEADER + ROWS.replace("20", "up"), "'up' is not a number"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, text, words):
    (tmp_path / "rec.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        load(tmp_path / "rec.csv", units="px", fps=20, individual=None if "several" in words else "ada")

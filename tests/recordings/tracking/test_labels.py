"""Labels of every kind of file mean the same pictures and pixels."""

import numpy as np
import pytest

from invdyn.recordings import InputError
from invdyn.recordings.tracking.labels import Labels, read_labels, write_labels

POINTS = np.array([[[1.5, 2.0], [3.0, 4.25]], [[5.0, 6.0], [np.nan, np.nan]], [[7.0, 8.0], [9.0, 10.0]]])
LABELS = Labels(np.array([3, 10, 12]), POINTS, ("elbow", "wrist"))
OURS = "frame,elbow_x,elbow_y,wrist_x,wrist_y\n12,7,8,9,10\n3,1.5,2,3,4.25\n10,5,6,,\n"
HEADER = "scorer,{0}me,me,me,me\nbodyparts,{0}elbow,elbow,wrist,wrist\ncoords,{0}x,y,x,y\n"
COLLECTED = HEADER.format("") + (
    "labeled-data/film/img003.png,1.5,2,3,4.25\nlabeled-data/film/img010.png,5,6,,\nlabeled-data/film/img012.png,7,8,9,10\n"
)
IN_THREE = HEADER.format(",,") + (
    "labeled-data,film,img003.png,1.5,2,3,4.25\nlabeled-data,film,img010.png,5,6,,\n"
    "labeled-data,film,img012.png,7,8,9,10\n"
)
TRACKS = (
    "scorer,n,n,n,n,n,n\nbodyparts,elbow,elbow,elbow,wrist,wrist,wrist\ncoords,x,y,likelihood,x,y,likelihood\n"
    "3,1.5,2,.9,3,4.25,.9\n10,5,6,.9,,,\n12,7,8,.9,9,10,.8\n"
)
SLEAP = (
    "track,frame_idx,instance.score,elbow.x,elbow.y,elbow.score,wrist.x,wrist.y,wrist.score\n"
    ",3,.9,1.5,2,.9,3,4.25,.9\n,10,.9,5,6,.9,,,\n,12,.9,7,8,.9,9,10,.9\n"
)


@pytest.mark.parametrize("text", [OURS, COLLECTED, IN_THREE, TRACKS, SLEAP])
def test_every_kind_is_read(tmp_path, text):
    (tmp_path / "l.csv").write_text(text)
    labels = read_labels(tmp_path / "l.csv")
    assert labels.names == LABELS.names
    np.testing.assert_array_equal(labels.frames, LABELS.frames)
    np.testing.assert_array_equal(labels.points, POINTS)


def test_labels_are_written_and_joined(tmp_path):
    newer = Labels(np.array([10, 11]), POINTS[[2, 0]], LABELS.names)
    write_labels(LABELS.joined(newer), tmp_path / "l.csv")
    labels = read_labels(tmp_path / "l.csv")
    np.testing.assert_array_equal(labels.frames, [3, 10, 11, 12])
    np.testing.assert_array_equal(labels.points[1], POINTS[2])
    np.testing.assert_array_equal(labels.seen.all(-1), True)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (OURS.replace("wrist_y", "wrist_z"), "column 'wrist_"),
        (OURS.replace("12,", "3,"), "picture 3 is labelled twice"),
        (OURS.replace("12,", "12.5,"), "must be a whole one"),
        (OURS.replace("12,", "-12,"), "must be a whole one"),
        (OURS.replace("12,", "1e300,"), "must be a whole one"),
        (COLLECTED.replace("img012", f"img{2**63}"), "must be a whole one"),
        (OURS.replace("7,8", "7e9,8"), "lies beyond any picture"),
        ("frame,elbow_x,elbow_y\n1,,\n", "nothing is labelled"),
        ("frame\n1\n", "no keypoint: expected columns"),
        ("time,elbow_x,elbow_y\n0,1,2\n1,1,2\n", "expected labels: a column 'frame'"),
        (COLLECTED.replace("img010", "last"), "expected an image whose name ends"),
        (COLLECTED.replace("coords", "scores"), "not a DeepLabCut csv"),
    ],
)
def test_what_are_no_labels(tmp_path, text, message):
    (tmp_path / "l.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_labels(tmp_path / "l.csv")

"""Trajectories of Vicon Nexus's ASCII export."""

import numpy as np
import pytest

from invdyn.recordings import InputError, load
from invdyn.recordings.formats.registry import recognise

DEVICES = "Devices\n1000\n,,EMG - V\nFrame,Sub Frame,1\n,,V\n1,0,0.1\n1,1,0.2\n\n"
TRACKS = "\n".join(
    [
        "Trajectories",
        "100",
        ",,Ada:LELB,,,Ada:LWRI,,,",
        "Frame,Sub Frame,X,Y,Z,X,Y,Z",
        ",,mm,mm,mm,mm,mm,mm",
        "5,0,-391.9,-618.1,173.4,-378.6,-619.1,171.4",
        "6,0,-391.8,-618.2,173.5,,,",
        "7,0,-391.7,-618.3,173.6,-378.5,-619.0,171.5",
    ]
)
EXPECTED = np.array(
    [
        [[-0.3919, -0.6181, 0.1734], [-0.3786, -0.6191, 0.1714]],
        [[-0.3918, -0.6182, 0.1735], [np.nan] * 3],
        [[-0.3917, -0.6183, 0.1736], [-0.3785, -0.6190, 0.1715]],
    ]
)
TWO = TRACKS.replace("Ada:LWRI", "Bob:LWRI")
FASTER = TRACKS.replace("X,Y,Z,X,Y,Z", "X,Y,Z,X',Y',Z',X,Y,Z").replace("Ada:LELB,,,", "Ada:LELB,,,,,,")
FASTER = FASTER.replace("mm,mm,mm,mm,mm,mm", "mm,mm,mm,mm/s,mm/s,mm/s,mm,mm,mm")
FASTER = FASTER.replace("173.4,", "173.4,1,2,3,").replace("173.5,", "173.5,1,2,3,").replace("173.6,", "173.6,1,2,3,")


@pytest.mark.parametrize(
    "text",
    [
        TRACKS + "\n",
        DEVICES + TRACKS + "\n\nModel Outputs\n100\n,,Ada:LElbowAngles,,\n",
        TRACKS.replace(",", ";").replace("Trajectories", "Trajectories;;;;;;;"),
        TRACKS.replace(",", "\t"),
        FASTER,
    ],
)
def test_trajectories_are_read_in_metres_at_their_own_rate(tmp_path, text):
    (tmp_path / "walk.csv").write_text(text)
    assert recognise(tmp_path / "walk.csv") == "nexus"
    recording = load(tmp_path / "walk.csv")
    assert recording.keypoint_names == ("LELB", "LWRI")
    np.testing.assert_allclose(recording.keypoints, EXPECTED)
    np.testing.assert_allclose(recording.time, [0.04, 0.05, 0.06])
    for options, words in [({"fps": 100}, "leave --fps out"), ({"units": "mm"}, "leave --units out")]:
        with pytest.raises(InputError, match=words):
            load(tmp_path / "walk.csv", **options)


def test_one_of_several_subjects_is_chosen(tmp_path):
    (tmp_path / "walk.csv").write_text(TWO)
    assert load(tmp_path / "walk.csv", individual="Ada").keypoint_names == ("LELB",)
    with pytest.raises(InputError, match="choose one of Ada, Bob"):
        load(tmp_path / "walk.csv")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (DEVICES, "without the section Trajectories"),
        (TRACKS.replace("100", "fast"), "rows a second in the line below Trajectories, got 'fast'"),
        (TRACKS.replace("Z,X", "W,X"), "marker 'Ada:LELB' has columns X, Y, W: expected X, Y and Z"),
        (TRACKS.replace(",,mm,mm", ",,in,mm"), "units of markers are in, mm: expected"),
        (TRACKS.replace("-618.1", "?"), r"row 1 \(line 6\), column 'LELB Y': '\?' is not a number"),
        (TRACKS.replace("Ada:LELB", "").replace("Ada:LWRI", ""), "no marker is named"),
    ],
)
def test_damage_is_one_line(tmp_path, text, words):
    (tmp_path / "walk.csv").write_text(text)
    with pytest.raises(InputError, match=words) as error:
        load(tmp_path / "walk.csv")
    assert len(str(error.value).splitlines()) == 1

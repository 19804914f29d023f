import numpy as np
import pytest

from invdyn.recordings import InputError, Recording, load, write_keypoint_csv
from invdyn.recordings.naming import nearest, of_one_side, same_letters


def test_names_alike_differ_in_case_and_separators_alone():
    assert same_letters("Left Elbow", ["wrist", "left_elbow"]) == "left_elbow"
    assert same_letters("elbow", ["elbow", "elbows"]) is None
    assert nearest("Knee", ["keen", "knee"]) == "knee"
    assert nearest("wirst", ["elbow", "wrist"]) == "wrist"
    assert nearest("x", []) is None
    assert nearest("hand", ["shoulder", "elbow"]) is None


def test_no_name_is_offered_that_is_unlike_or_taken(tmp_path):
    with pytest.raises(InputError, match="'wrist' is missing: the file has shoulder, elbow, hand; rename one of them"):
        load(film(tmp_path, "shoulder", "elbow", "hand"), units="px", fps=30, keypoints=("elbow", "wrist"))
    with pytest.raises(InputError, match=r"'elbow_b' is missing: .* \(closest: 'Elbow B'\)"):
        load(film(tmp_path, "elbow", "Elbow B"), units="px", fps=30, keypoints=("elbow", "elbow_b"))
    (tmp_path / "rec.csv").write_text("time,elbow_x,elbow_y,hand_x,hand_y\n0,0,0,.3,0\n.1,0,0,.3,0\n")
    with pytest.raises(InputError, match="'wrist' is missing: the file has elbow, hand; rename"):
        load(tmp_path / "rec.csv", keypoints=("elbow", "wrist"))


def film(tmp_path, *names):
    lines = [",".join(["scorer", *["net"] * (2 * len(names))])]
    lines.append(",".join(["bodyparts", *(name for name in names for _ in "xy")]))
    lines.append(",".join(["coords", *["x", "y"] * len(names)]))
    lines += [
        ",".join([str(t), *(f"{90 + 7 * t + 40 * p + axis}" for p in range(len(names)) for axis in (0, 1))])
        for t in range(4)
    ]
    (tmp_path / "rec.csv").write_text("\n".join(lines) + "\n")
    return tmp_path / "rec.csv"


def test_a_base_named_alike_is_offered_and_one_that_is_not_tracked_is_told(tmp_path):
    options = {"units": "px", "fps": 30, "keypoints": ("toe",), "base": "left_hip"}
    with pytest.raises(InputError, match="keypoint 'Left hip' differs from the first joint's name, 'left_hip'"):
        load(film(tmp_path, "Left hip", "toe"), **options)
    with pytest.warns(UserWarning, match=r"base 'left_hip' is not tracked \(the file has pelvis, toe\)"):
        assert load(film(tmp_path, "pelvis", "toe"), **options).keypoint_names == ("toe",)
    with pytest.raises(InputError, match=r"'toe' is missing: .*closest: 'Toe'"):
        load(film(tmp_path, "left_hip", "Toe"), **options)


def test_the_projects_own_file_offers_the_base_too(tmp_path):
    (tmp_path / "rec.csv").write_text("time,Hip_x,Hip_y,toe_x,toe_y\n0,0,0,.3,0\n.1,0,0,.3,0\n")
    with pytest.raises(InputError, match="'Hip' differs from the first joint's name, 'hip'"):
        load(tmp_path / "rec.csv", keypoints=("toe",), base="hip")
    with pytest.warns(UserWarning, match=r"base 'Hipp' is not tracked \(the file has Hip, toe\)"):
        load(tmp_path / "rec.csv", keypoints=("toe",), base="Hipp")


SIDES = ("R.Shoulder", "L.Shoulder", "R.Elbow", "L.Elbow", "R.Wrist", "L.Wrist", "R.Wrist.Ulnar")


@pytest.mark.parametrize(
    ("known", "base", "found"),
    [
        (SIDES, "R.Shoulder", {"R.Elbow": "elbow", "R.Wrist": "wrist"}),
        (SIDES, "L.Shoulder", {"L.Elbow": "elbow", "L.Wrist": "wrist"}),
        (
            ("right_shoulder", "right_elbow", "left_elbow", "right_wrist"),
            "right_shoulder",
            ("right_elbow", "right_wrist"),
        ),
        (("shoulder_L", "elbow_L", "elbow_R", "wrist_L"), "shoulder_L", ("elbow_L", "wrist_L")),
        (("R.Shoulder", "R.Elbow", "L.Wrist"), "R.Shoulder", {}),  # one of the two is of the other side
        (("R.Shoulder", "R.Elbow", "r elbow", "R.Wrist"), "R.Shoulder", {}),  # nothing says which elbow
        (("R.Acromion", "R.Elbow", "R.Wrist"), "R.Acromion", ("R.Elbow", "R.Wrist")),
        (("rshoulder", "lshoulder", "relbow", "lelbow", "rwrist", "lwrist"), "rshoulder", ("relbow", "rwrist")),
        (("RShoulder", "RElbow", "LElbow", "RWrist"), "RShoulder", ("RElbow", "RWrist")),
        ((*SIDES, "Rump"), "Rump", {}),  # it begins with R, and is of no side
        (("LowerBack", "LElbow", "LWrist"), "LowerBack", {}),
    ],
)
def test_keypoints_of_the_bases_side_are_found(known, base, found):
    expected = found if isinstance(found, dict) else dict(zip(found, ("elbow", "wrist"), strict=True))
    assert of_one_side(("elbow", "wrist"), known, base) == expected


def test_a_body_takes_its_keypoints_of_one_side(tmp_path):
    path, asked = film(tmp_path, *SIDES[:4]), {"units": "mm", "fps": 30, "keypoints": ("elbow",)}
    with pytest.warns(UserWarning, match="elbow is 'L.Elbow', as the base is 'L.Shoulder'"):
        recording = load(path, base="L.Shoulder", **asked)
    assert recording.keypoint_names == ("L.Shoulder", "elbow")
    plain = load(path, base="L.Shoulder", **asked | {"keypoints": ("L.Elbow",)})
    np.testing.assert_array_equal(recording.keypoints, plain.keypoints)
    with (
        pytest.warns(UserWarning, match="is not tracked"),
        pytest.raises(InputError, match=r"rename one of them, or pass --set base=NAME, the first joint's"),
    ):
        load(path, base="shoulder", **asked)
    ours = tmp_path / "ours.csv"
    write_keypoint_csv(Recording([0.0, 0.1], np.random.default_rng(0).normal(size=(2, 4, 2)), SIDES[:4]), ours)
    with pytest.warns(UserWarning, match="elbow is 'R.Elbow', as the base is 'R.Shoulder'"):
        assert load(ours, base="R.Shoulder", keypoints=("elbow",)).keypoint_names == ("R.Shoulder", "elbow")

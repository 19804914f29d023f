import errno

import pytest

from invdyn.recordings import FORMATS, InputError, load
from invdyn.recordings.formats.registry import recognise

GOOD = "time,wrist_x,wrist_y\n0,0,0\n1,0,1\n"


def test_formats_are_recognised(tmp_path):
    import h5py

    headers = {
        "csv": GOOD,
        "deeplabcut": "scorer,a\nbodyparts,b\n",
        "anipose": "fnum,a_x,M_00,center_0\n",
    }
    for kind, text in headers.items():
        (tmp_path / "rec.csv").write_text(text)
        assert recognise(tmp_path / "rec.csv") == kind
    for kind, keys in {"sleap": ("tracks", "node_names"), "deeplabcut": ("df_with_missing",)}.items():
        with h5py.File(tmp_path / "rec.h5", "w") as file:
            for key in keys:
                file[key] = [0.0]
        assert recognise(tmp_path / "rec.h5") == kind
    for suffix, kind in {"slp": "sleap", "nwb": "nwb", "trc": "trc"}.items():
        assert recognise(tmp_path / f"rec.{suffix}") == kind
    assert recognise(tmp_path / "rec.csv", "lightningpose") == "lightningpose"


def test_formats_that_are_not(tmp_path):
    (tmp_path / "rec.xlsx").write_text("")
    with pytest.raises(InputError, match=r"cannot tell the format from the suffix '.xlsx'.*--set format"):
        load(tmp_path / "rec.xlsx")
    with pytest.raises(InputError, match=r"unknown format 'deeplabcat'.*closest: deeplabcut"):
        load(tmp_path / "rec.xlsx", format="deeplabcat")


@pytest.mark.parametrize(
    ("shape", "words"),
    [
        ((6, 1, 3, 3), "SLEAP-Anipose does not say which keypoint is which: write its tracks as a table"),
        ((1, 2, 3, 6), "SLEAP analysis file without node_names.*: export it again"),
    ],
)
def test_tracks_without_names_are_refused_by_what_they_are(tmp_path, shape, words):
    import h5py

    with h5py.File(tmp_path / "points3d.h5", "w") as file:
        file.create_dataset("tracks", shape, "f8")
    with pytest.raises(InputError, match=words):
        load(tmp_path / "points3d.h5", units="mm", fps=30)


def test_every_format_has_a_title_and_only_the_contract_is_read_by_the_loader():
    assert [kind for kind, form in FORMATS.items() if form.read is None] == ["csv"]
    assert len({form.title for form in FORMATS.values()}) == len(FORMATS)


def test_missing_files_folders_and_permissions(tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file") as caught:
        load(tmp_path / "none.csv")
    assert caught.value.filename == str(tmp_path / "none.csv")
    with pytest.raises(FileNotFoundError, match="did you mean 'human-arm'"):
        load("humn-arm")
    (tmp_path / "folder.csv").mkdir()
    with pytest.raises(IsADirectoryError):
        load(tmp_path / "folder.csv")
    with pytest.raises(IsADirectoryError):
        load(tmp_path)


def test_a_file_that_may_not_be_read(tmp_path, monkeypatch):
    (tmp_path / "rec.csv").write_text(GOOD)

    def refuse(path, *args, **kwargs):  # chmod would not stop root
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    monkeypatch.setattr("builtins.open", refuse)
    with pytest.raises(PermissionError, match="Permission denied"):
        load(tmp_path / "rec.csv")


def test_the_csv_has_its_own_times(tmp_path):
    (tmp_path / "rec.csv").write_text(GOOD)
    assert load(tmp_path / "rec.csv").name == "rec"
    with pytest.raises(InputError, match="their own times: leave --fps out"):
        load(tmp_path / "rec.csv", fps=30)


@pytest.mark.parametrize("units", [None, "frames", "mm,frames"])
def test_numbers_of_frames_become_times_by_the_frame_rate(tmp_path, units):
    (tmp_path / "rec.csv").write_text(GOOD.replace("time", "frame"))
    assert load(tmp_path / "rec.csv", units=units, fps=20).time.tolist() == [0.0, 0.05]
    with pytest.raises(InputError, match="do not say their frame rate: pass --fps"):
        load(tmp_path / "rec.csv", units=units)


def test_a_column_of_times_may_hold_numbers_of_frames(tmp_path):
    (tmp_path / "rec.csv").write_text(GOOD)
    assert load(tmp_path / "rec.csv", units="frames", fps=20).time.tolist() == [0.0, 0.05]
    with pytest.raises(InputError, match="leave --fps out, or add --units frames"):
        load(tmp_path / "rec.csv", fps=20)


def test_joints_are_put_in_the_bodys_order(tmp_path):
    (tmp_path / "rec.csv").write_text("time,b_angle,a_angle,a_torque\n0,1,2,3\n1,1,2,3\n")
    recording = load(tmp_path / "rec.csv", joints=("a", "b"))
    assert recording.joint_names == ("a", "b")
    assert recording.angles[0].tolist() == [2.0, 1.0]
    assert recording.torques[0, 0] == 3.0

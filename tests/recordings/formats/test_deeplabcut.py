import warnings

import numpy as np
import pandas as pd
import pytest

from invdyn.recordings import InputError, load

FRAMES, POINTS = 6, ("shoulder", "elbow", "wrist")


def table(animals: tuple[str, ...] = (), seed: int = 0) -> pd.DataFrame:
    """A DeepLabCut table: px of the order of 100, likelihood in [0, 1], one point lost in one frame."""
    levels = [["net"], *([animals] if animals else []), POINTS, ["x", "y", "likelihood"]]
    names = ["scorer", *(["individuals"] if animals else []), "bodyparts", "coords"]
    columns = pd.MultiIndex.from_product(levels, names=names)
    values = np.random.default_rng(seed).uniform(50, 150, (FRAMES, len(columns)))
    values[:, 2::3] /= 200
    values[3, :2] = np.nan
    return pd.DataFrame(values, columns=columns)


def save_h5(frame: pd.DataFrame, path):
    pytest.importorskip("tables")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        frame.to_hdf(path, key="df_with_missing", mode="w")
    return path


def test_csv_keeps_gaps_and_likelihood_and_turns_up(tmp_path):
    frame = table()
    frame.to_csv(tmp_path / "rec.csv")
    recording = load(tmp_path / "rec.csv", units="px", fps=30)
    values = frame.to_numpy().reshape(FRAMES, 3, 3)
    np.testing.assert_allclose(recording.keypoints, values[..., :2] * [1, -1])
    np.testing.assert_allclose(recording.confidence, values[..., 2])
    np.testing.assert_allclose(recording.time, np.arange(FRAMES) / 30)
    assert recording.keypoint_names == POINTS
    assert np.isnan(recording.keypoints[3, 0]).all()
    assert np.isfinite(recording.keypoints).sum() == FRAMES * 6 - 2


def test_h5_and_csv_say_the_same(tmp_path):
    table().to_csv(tmp_path / "rec.csv")
    by_csv = load(tmp_path / "rec.csv", units="px", fps=25)
    by_h5 = load(save_h5(table(), tmp_path / "rec.h5"), units="px", fps=25)
    np.testing.assert_allclose(by_h5.keypoints, by_csv.keypoints)
    np.testing.assert_allclose(by_h5.confidence, by_csv.confidence)
    assert by_h5.keypoint_names == by_csv.keypoint_names


@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_one_of_several_animals_is_chosen(tmp_path, suffix):
    path, frame = tmp_path / f"rec{suffix}", table(("ada", "bob"))
    frame.to_csv(path) if suffix == ".csv" else save_h5(frame, path)
    recording = load(path, units="px", fps=30, individual="bob")
    np.testing.assert_allclose(recording.keypoint("wrist")[:, 0], frame["net", "bob", "wrist", "x"])
    with pytest.raises(InputError, match="several individuals: choose one of ada, bob"):
        load(path, units="px", fps=30)
    with pytest.raises(InputError, match="no individual 'eve'"):
        load(path, units="px", fps=30, individual="eve")


@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_unique_points_belong_to_every_animal(tmp_path, suffix):
    both = table(("ada", "single"))
    columns = [c for c in both.columns if (c[1] == "ada") == (c[2] != "shoulder")]
    path, frame = tmp_path / f"rec{suffix}", both[columns]
    frame.to_csv(path) if suffix == ".csv" else save_h5(frame, path)
    for individual in (None, "ada"):
        recording = load(path, units="px", fps=30, individual=individual)
        assert recording.keypoint_names == ("elbow", "wrist", "shoulder")
        np.testing.assert_allclose(recording.keypoint("shoulder")[:, 0], frame["net", "single", "shoulder", "x"])
        relative = load(path, units="px", fps=30, individual=individual, keypoints=("wrist",), base="shoulder")
        expected = recording.keypoint("wrist") - np.nanmedian(recording.keypoint("shoulder"), 0)
        np.testing.assert_allclose(relative.keypoint("wrist"), expected)
    assert load(path, units="px", fps=30, individual="single").keypoint_names == ("shoulder",)


def test_an_animals_own_point_wins_over_a_unique_one_of_its_name(tmp_path):
    frame = table(("ada", "bob", "single"))
    frame.to_csv(tmp_path / "rec.csv")
    recording = load(tmp_path / "rec.csv", units="px", fps=30, individual="bob")
    np.testing.assert_allclose(recording.keypoint("wrist")[:, 0], frame["net", "bob", "wrist", "x"])
    with pytest.raises(InputError, match=r"several individuals: choose one of ada, bob \(--set individual=NAME\)"):
        load(tmp_path / "rec.csv", units="px", fps=30)


def test_some_keypoints_are_kept_in_the_bodys_order(tmp_path):
    table().to_csv(tmp_path / "rec.csv")
    recording = load(tmp_path / "rec.csv", units="px", fps=30, keypoints=("wrist", "elbow"))
    assert recording.keypoint_names == ("wrist", "elbow")
    np.testing.assert_allclose(recording.confidence[:, 0], table()["net", "wrist", "likelihood"])
    with pytest.raises(InputError, match=r"'wirst' is missing.*closest: 'wrist'"):
        load(tmp_path / "rec.csv", units="px", fps=30, keypoints=("elbow", "wirst"))


def test_units_and_frame_rate_are_asked_for(tmp_path):
    table().to_csv(tmp_path / "rec.csv")
    for options, words in [
        ({"fps": 30}, "do not say their units: pass --units px"),
        ({"fps": 30, "units": "deg"}, "pass --units px"),
        ({"units": "px"}, "do not say their frame rate: pass --fps"),
        ({"units": "px", "fps": 0}, "--fps must be positive"),
        ({"units": "m", "fps": 30}, "look like pixels"),
    ]:
        with pytest.raises(InputError, match=words):
            load(tmp_path / "rec.csv", **options)


def test_a_keypoint_never_seen_is_named(tmp_path):
    frame = table()
    frame.loc[:, ("net", "elbow", ["x", "y"])] = np.nan
    frame.to_csv(tmp_path / "rec.csv")
    with pytest.raises(InputError, match="'elbow' is missing in every frame"):
        load(tmp_path / "rec.csv", units="px", fps=30)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("scorer,n,n\nbodyparts,a,a\n", "not a DeepLabCut csv"),
        ("scorer,n,n\nbodyparts,a,a\ncoords,x,y\n", "only a header"),
        ("scorer,n\nbodyparts,a\ncoords,x\n0,1\n1,1\n", "a has no column 'y'"),
        ("scorer,n,n\nbodyparts,a,a\ncoords,x,y\n0,1,1\n1,one,1\n", r"row 2 \(line 5\), column 'a x': 'one'"),
        ("scorer,n,n\nbodyparts,a,a\ncoords,x,y\nimg01.png,1,1\nimg02.png,1,1\n", "labelled images"),
        ("scorer,n,n\nbodyparts,a,a\ncoords,x,y\n0,1,1\n0,1,1\n", "time repeats"),
    ],
)
def test_broken_csv(tmp_path, text, words):
    (tmp_path / "rec.csv").write_text(text)
    with pytest.raises(InputError, match=words):
        load(tmp_path / "rec.csv", units="px", fps=30)


def test_broken_h5(tmp_path):
    path = save_h5(table(), tmp_path / "rec.h5")
    whole = path.read_bytes()
    for content in (whole[: len(whole) // 2], b"", b"junk" * 100):
        path.write_bytes(content)
        with pytest.raises(InputError, match="expected an HDF5 file that can be read") as caught:
            load(path, units="px", fps=30)
        assert len(str(caught.value).splitlines()) == 1
    frame = pd.DataFrame({"a": [1.0, 2.0]})
    with pytest.raises(InputError, match="no levels bodyparts"):
        load(save_h5(frame, path), units="px", fps=30)

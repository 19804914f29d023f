"""Files written by the package `movement` itself, read back through `load`."""

import sys
import warnings

import numpy as np
import pytest

from invdyn.recordings import InputError, load

FRAMES, POINTS, FPS = 6, ("shoulder", "elbow", "wrist"), 25.0


@pytest.fixture(scope="module")
def movement():
    show = warnings.showwarning
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        io = pytest.importorskip("movement.io")
    warnings.showwarning = show
    return io


@pytest.fixture
def tracks(movement):
    """A dataset of two animals, px, with one point lost in one frame."""
    rng = np.random.default_rng(1)
    position = rng.uniform(10, 90, (FRAMES, 2, len(POINTS), 2))
    position[2, :, 0, 1] = np.nan
    return movement.load_poses.from_numpy(
        np.moveaxis(position, (0, 1, 2, 3), (0, 3, 2, 1)),
        np.moveaxis(rng.uniform(0, 1, (FRAMES, 2, len(POINTS))), (0, 1, 2), (0, 2, 1)),
        individual_names=["ada", "bob"],
        keypoint_names=list(POINTS),
        fps=FPS,
    )


def save(movement, kind: str, tracks, path):
    from movement.io import save_poses

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        writers = {
            "dlc.csv": lambda: save_poses.to_dlc_file(tracks, path, split_individuals=False),
            "dlc.h5": lambda: save_poses.to_dlc_file(tracks, path, split_individuals=False),
            "lp.csv": lambda: save_poses.to_lp_file(tracks, path),  # one file an animal
            "sleap.h5": lambda: save_poses.to_sleap_analysis_file(tracks, path),
        }
        writers[kind]()
    if kind == "lp.csv":
        path.with_stem(f"{path.stem}_ada").rename(path)


@pytest.mark.parametrize("kind", ["dlc.csv", "dlc.h5", "lp.csv", "sleap.h5"])
def test_reads_what_movement_writes(tmp_path, movement, tracks, kind):
    path = tmp_path / kind
    save(movement, kind, tracks, path)
    chosen = None if kind == "lp.csv" else "ada"
    recording = load(path, units="px", fps=FPS, individual=chosen)
    ada = tracks.sel(individuals="ada")
    expected = ada.position.transpose("time", "keypoints", "space").to_numpy()
    np.testing.assert_allclose(recording.keypoints, expected * [1, -1], rtol=1e-6)
    np.testing.assert_allclose(
        recording.confidence, ada.confidence.transpose("time", "keypoints").to_numpy(), rtol=1e-6
    )
    np.testing.assert_allclose(recording.time, np.arange(FRAMES) / FPS)
    assert recording.keypoint_names == POINTS
    assert recording.length_unit == "px"


@pytest.mark.parametrize("software", ["lightningpose"])
def test_two_readers_of_one_header_agree(tmp_path, movement, tracks, software):
    save(movement, "lp.csv", tracks, tmp_path / "rec.csv")
    ours = load(tmp_path / "rec.csv", units="px", fps=FPS)
    theirs = load(tmp_path / "rec.csv", units="px", fps=FPS, format=software)
    np.testing.assert_allclose(ours.keypoints, theirs.keypoints)
    np.testing.assert_allclose(ours.confidence, theirs.confidence)


def test_sleap_labels(tmp_path, movement):
    sleap_io = pytest.importorskip("sleap_io")
    skeleton = sleap_io.Skeleton(nodes=list(POINTS))
    video = sleap_io.Video(filename="film.mp4", open_backend=False)
    track = sleap_io.Track("ada")
    points = np.random.default_rng(2).uniform(10, 90, (FRAMES, len(POINTS), 2))
    frames = [
        sleap_io.LabeledFrame(
            video=video,
            frame_idx=t,
            instances=[
                sleap_io.PredictedInstance.from_numpy(
                    points[t],
                    point_scores=np.full(3, 0.8),
                    score=0.9,
                    skeleton=skeleton,
                    track=track,
                )
            ],
        )
        for t in range(FRAMES)
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        labels = sleap_io.Labels(frames, videos=[video], skeletons=[skeleton], tracks=[track])
        sleap_io.save_slp(labels, str(tmp_path / "rec.slp"))
    recording = load(tmp_path / "rec.slp", units="px", fps=FPS)
    np.testing.assert_allclose(recording.keypoints, points * [1, -1], rtol=1e-6)
    np.testing.assert_allclose(recording.confidence, 0.8, rtol=1e-6)


def test_nwb_has_its_own_times(tmp_path, movement, tracks):
    from movement.io import save_poses

    pynwb = pytest.importorskip("pynwb")
    path = tmp_path / "rec.nwb"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        file = save_poses.to_nwb_file(tracks.sel(individuals=["ada"]))
        with pynwb.NWBHDF5IO(str(path), "w") as store:
            store.write(file)
    recording = load(path, units="px", keypoints=POINTS)
    np.testing.assert_allclose(np.diff(recording.time), 1 / FPS)
    expected = tracks.sel(individuals="ada").position.transpose("time", "keypoints", "space").to_numpy()
    np.testing.assert_allclose(recording.keypoints, expected * [1, -1], rtol=1e-6)
    with pytest.raises(InputError, match="their own times: leave --fps out"):
        load(path, units="px", fps=FPS)


def test_anipose_is_three_dimensional_and_in_millimetres(tmp_path, movement):
    points = np.random.default_rng(3).uniform(-100, 100, (FRAMES, len(POINTS), 3))
    others = ["fnum", *(f"center_{i}" for i in range(3)), *(f"M_{i}{j}" for i in range(3) for j in range(3))]
    header, rows = [], [[] for _ in range(FRAMES)]
    for p, name in enumerate(POINTS):
        header += [f"{name}_{end}" for end in ("x", "y", "z", "error", "ncams", "score")]
        for t in range(FRAMES):
            rows[t] += [*points[t, p], 0.1, 2, 0.9]
    lines = [",".join(header + others)]
    lines += [",".join(f"{v}" for v in [*row, t, *np.zeros(12)]) for t, row in enumerate(rows)]
    (tmp_path / "rec.csv").write_text("\n".join(lines) + "\n")
    recording = load(tmp_path / "rec.csv", units="mm", fps=FPS, keypoints=POINTS)
    np.testing.assert_allclose(recording.keypoints, points / 1000)  # not turned: it has no image axis
    assert recording.length_unit == "m"
    with pytest.raises(InputError, match="three coordinates"):
        load(tmp_path / "rec.csv", units="px", fps=FPS)


def test_broken_files_give_one_line_and_no_log(tmp_path, movement, capfd):
    for name in ("rec.slp", "rec.nwb"):
        path = tmp_path / name
        path.write_bytes(b"junk" * 50)
        fps = FPS if name == "rec.slp" else None
        with pytest.raises(InputError, match="that can be read") as caught:
            load(path, units="px", fps=fps)
        assert len(str(caught.value).splitlines()) == 1
        assert str(path) in str(caught.value)
    assert capfd.readouterr().err == ""


def test_missing_files_and_folders(tmp_path, movement):
    (tmp_path / "folder.slp").mkdir()
    with pytest.raises(IsADirectoryError):
        load(tmp_path / "folder.slp", units="px", fps=FPS)


def test_importing_movement_leaves_warnings_alone(tmp_path, movement, tracks):
    save(movement, "lp.csv", tracks, tmp_path / "rec.csv")
    before = warnings.showwarning
    load(tmp_path / "rec.csv", units="px", fps=FPS, format="lightningpose")
    assert warnings.showwarning is before


def test_the_missing_extra_is_named(tmp_path, monkeypatch):
    (tmp_path / "rec.slp").write_bytes(b"")
    monkeypatch.setitem(sys.modules, "movement", None)
    monkeypatch.setitem(sys.modules, "movement.io", None)
    with pytest.raises(InputError, match=r"pip install 'invdyn\[tracks\]'"):
        load(tmp_path / "rec.slp", units="px", fps=FPS)

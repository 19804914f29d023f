"""NWB files with pose estimates, in the layouts of ndx-pose 0.1 and of later versions."""

import h5py
import numpy as np
import pytest

from invdyn.outputs import OutputFiles
from invdyn.recordings import InputError, Recording, load, write_nwb

POINTS = ("shoulder", "elbow", "wrist")
TRACKS = np.random.default_rng(4).uniform(10, 90, (6, 3, 2))
STAMPS = np.array([3.0, 3.04, 3.08, 3.20, 3.24, 3.28])
"""s, with pictures missing."""


def write(path, *, version="0.1", animals=("PoseEstimation",), prefix="", conversion=1.0, damage=None):
    """A file as h5py shows what pynwb writes, with the groups that are read; ``damage`` changes the last series."""
    with h5py.File(path, "w") as store:
        for number, animal in enumerate(animals):
            estimate = store.create_group(f"processing/behavior/{animal}")
            estimate.attrs["neurodata_type"] = "PoseEstimation"
            if version == "0.1":
                estimate["nodes"] = list(POINTS)
            else:
                if number == 0:
                    store["processing/behavior/Skeletons/arm/nodes"] = list(POINTS)
                estimate["skeleton"] = h5py.SoftLink("/processing/behavior/Skeletons/arm")
            for p, name in enumerate(POINTS):
                series = estimate.create_group(f"{prefix}{name.capitalize() if prefix else name}")
                series.attrs["neurodata_type"] = "PoseEstimationSeries"
                series["data"] = TRACKS[:, p] + number
                series["data"].attrs["conversion"] = conversion
                series["confidence"] = np.full(6, 0.5 + 0.1 * p)
                if version == "0.1" and p == 0:
                    series["timestamps"] = STAMPS
                elif version == "0.1":
                    series["timestamps"] = h5py.SoftLink(f"{estimate.name}/{prefix}{_first(prefix)}/timestamps")
                else:
                    series["starting_time"] = 3.0
                    series["starting_time"].attrs["rate"] = 25.0
        if damage is not None:
            damage(series)
    return path


def _first(prefix):
    return POINTS[0].capitalize() if prefix else POINTS[0]


@pytest.mark.parametrize("version", ["0.1", "0.2"])
@pytest.mark.parametrize("prefix", ["", "PoseEstimationSeries"])
def test_every_version_is_read_in_the_nodes_order(tmp_path, version, prefix):
    recording = load(write(tmp_path / "rec.nwb", version=version, prefix=prefix), units="px")
    assert recording.keypoint_names == POINTS
    np.testing.assert_allclose(recording.keypoints, TRACKS * [1, -1])
    np.testing.assert_allclose(recording.confidence, np.tile([0.5, 0.6, 0.7], (6, 1)))
    np.testing.assert_allclose(recording.time, STAMPS if version == "0.1" else 3 + np.arange(6) / 25)


def test_one_of_several_animals_is_chosen_and_numbers_are_converted(tmp_path):
    path = write(tmp_path / "rec.nwb", animals=("ada", "bob"), conversion=0.1)
    recording = load(path, units="px", individual="bob")
    np.testing.assert_allclose(recording.keypoints, 0.1 * (TRACKS + 1) * [1, -1])
    with pytest.raises(InputError, match="several individuals: choose one of ada, bob"):
        load(path, units="px")


def replaced(name, value):
    def damage(series):
        if name in series:
            del series[name]
        series[name] = value

    return damage


DAMAGE = {
    "other times": (replaced("timestamps", STAMPS + 1), "seen at different times"),
    "fewer rows": (replaced("data", TRACKS[:3, 0]), r"has shape \(3, 2\): expected \(6, 2\)"),
    "text": (replaced("confidence", ["a"] * 6), "confidence holds no numbers"),
    "another file's data": (replaced("data", h5py.ExternalLink("other.h5", "/data")), "data lies in another file"),
    "no data": (lambda series: series.pop("data"), "expected an NWB file that can be read"),
}


@pytest.mark.parametrize("what", DAMAGE)
def test_what_cannot_be_used_is_one_line(tmp_path, what):
    damage, words = DAMAGE[what]
    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["data"] = TRACKS[:, 0]
    with pytest.raises(InputError, match=words) as error:
        load(write(tmp_path / "rec.nwb", damage=damage), units="px")
    assert str(tmp_path / "rec.nwb") in str(error.value)


def test_no_pose_and_no_size_that_a_file_only_claims(tmp_path):
    with h5py.File(tmp_path / "rec.nwb", "w") as store:
        store["acquisition/x"] = [1.0]
    with pytest.raises(InputError, match="no pose estimates"):
        load(tmp_path / "rec.nwb", units="px")

    def huge(series):
        del series["data"]
        series.create_dataset("data", (2**40, 2), "f8", chunks=(1024, 2))

    with pytest.raises(InputError, match=r"expected at most|declare"):
        load(write(tmp_path / "rec.nwb", damage=huge), units="px")


@pytest.mark.long
def test_torques_are_next_to_their_pose_as_pynwb_reads_them(tmp_path):
    pynwb = pytest.importorskip("pynwb")
    torque = np.random.default_rng(0).normal(size=(6, 2))
    moments = STAMPS, torque, torque - 1, torque + 1, ("elbow", "rail"), {"rail"}
    given = Recording(STAMPS, np.where(TRACKS > 80, np.nan, TRACKS) / 100, POINTS)
    write_nwb(tmp_path / "out.nwb", {"arm": moments}, {"arm": given})
    assert pynwb.validate(path=tmp_path / "out.nwb") == []
    with pynwb.NWBHDF5IO(str(tmp_path / "out.nwb"), "r") as store:
        module = store.read().processing["arm"]
        found = {
            name: (each.data[()], each.unit, each.timestamps[()])
            for name, each in module.data_interfaces.items()
            if "torque" in name
        }
    assert len(found) == 6
    for k, (joint, unit) in enumerate((("elbow", "N·m"), ("rail", "N"))):
        for suffix, column in zip(("", "_q05", "_q95"), moments[1:4], strict=True):
            values, stated, times = found[f"{joint}_torque{suffix}"]
            np.testing.assert_array_equal(values, column[:, k])
            np.testing.assert_array_equal(times, STAMPS)
            assert stated == unit
    pose = load(tmp_path / "out.nwb", units="m")
    order = [pose.keypoint_names.index(name) for name in POINTS]  # by name, as nothing says their order
    np.testing.assert_array_equal(pose.keypoints[:, order], given.keypoints)


def test_nwb_is_refused_before_the_work_without_its_library(tmp_path, monkeypatch):
    monkeypatch.setattr("invdyn.recordings.formats.nwb_torques.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"\.nwb needs `pip install 'invdyn\[tracks\]'`"):
        OutputFiles((tmp_path / "p.nc", tmp_path / "t.nwb")).check()


@pytest.mark.long
def test_names_with_slash_and_colon_and_units_of_pixels_are_written(tmp_path):
    pynwb = pytest.importorskip("pynwb")
    torque = np.zeros((6, 2))
    moments = STAMPS, torque, torque, torque, ("walker/hip", "walker_hip"), set()
    names = tuple(f"Subject01:{name}" for name in POINTS)
    given = Recording(STAMPS, TRACKS, names, length_unit="px")
    unit = "kg·(px)²/s²"
    write_nwb(tmp_path / "out.nwb", {"a/b:c": moments}, {"a/b:c": given}, unit)
    with pynwb.NWBHDF5IO(str(tmp_path / "out.nwb"), "r") as store:
        found = store.read().processing["a_b_c"].data_interfaces
        assert {name for name in found if name.endswith("_torque")} == {"walker_hip_torque", "walker_hip_2_torque"}
        assert {each.unit for name, each in found.items() if "torque" in name} == {unit}
    pose = load(tmp_path / "out.nwb", units="px")
    assert set(pose.keypoint_names) == {name.replace(":", "_") for name in names}

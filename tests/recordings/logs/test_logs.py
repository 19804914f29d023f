"""One log, written as each kind of file by that kind's own library, and read as the same recording."""

import json

import numpy as np
import pytest
from log_files import ANGLE, EFFORT, JOINTS, STATE, TIME, bag, lerobot, mcap
from log_files import LEROBOT as MAPPING

from invdyn.recordings import InputError
from invdyn.recordings.logs import LogMap, recordings_of

LEROBOT = LogMap.of(MAPPING)


@pytest.mark.parametrize(("made", "name"), [(bag, "bag"), (mcap, "log.mcap")])
def test_joint_states_need_no_mapping(tmp_path, made, name):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    (logged,) = recordings_of(made(tmp_path / name), JOINTS)
    recording = logged.recording
    np.testing.assert_allclose(recording.time, TIME, atol=1e-6)  # float64 has 0.2 µs left of seconds since 1970
    np.testing.assert_array_equal(recording.angles, ANGLE)
    np.testing.assert_array_equal(recording.torques, EFFORT)
    assert recording.joint_names == JOINTS


def test_a_bags_own_definitions_are_not_compiled(tmp_path, monkeypatch):
    store = pytest.importorskip("rosbags.typesys.store")
    path = bag(tmp_path / "bag")

    def compiled(*_):
        raise AssertionError("a definition from the bag would run as Python")

    monkeypatch.setattr(store.Typestore, "register", compiled)
    (logged,) = recordings_of(path, JOINTS)
    np.testing.assert_array_equal(logged.recording.angles, ANGLE)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("made", [bag, mcap])
def test_a_damaged_log_is_read_or_one_line(tmp_path, made, seed):
    pytest.importorskip("rosbags")
    pytest.importorskip("mcap")
    path = made(tmp_path / "log.mcap")
    file = path if path.is_file() else next(path.glob("*.db3"))
    content, rng = bytearray(file.read_bytes()), np.random.default_rng(seed)
    if seed % 3 == 0:
        content = content[: rng.integers(len(content))]
    for place in rng.integers(len(content), size=seed if seed % 3 else 0):
        content[place] = rng.integers(256)
    file.write_bytes(content)
    told = ""
    try:
        recordings_of(path, JOINTS)
    except InputError as error:
        told = str(error)
    assert "\n" not in told


def test_a_data_set_has_episodes_names_and_targets(tmp_path):
    pytest.importorskip("pyarrow")
    path = lerobot(tmp_path / "set")
    first, second = recordings_of(path, JOINTS, LEROBOT)
    np.testing.assert_allclose(first.recording.angles, ANGLE)
    np.testing.assert_allclose(second.recording.angles, 2 * ANGLE)
    np.testing.assert_allclose(first.targets, ANGLE + 0.1)
    assert first.recording.torques is None
    (only,) = recordings_of(path, JOINTS, LEROBOT, [1])
    assert only.recording.name == second.recording.name
    with pytest.raises(InputError, match="no episode 2; it has 2"):
        recordings_of(path, JOINTS, LEROBOT, [2])


@pytest.mark.parametrize(
    ("name", "values", "says"),
    [
        ("timestamp", ["soon"] * 12, "no column of numbers 'timestamp'"),
        ("timestamp", [np.nan] * 12, "no row of track 'observation.state.shoulder.pos' has a time"),
        ("episode_index", ["first"] * 12, "the number of an episode in each row"),
        ("episode_index", [0.0] * 11 + [np.inf], "the number of an episode in each row"),
    ],
)
def test_a_data_set_whose_columns_are_no_numbers(tmp_path, name, values, says):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = lerobot(tmp_path / "set")
    file = next(path.glob("data/**/*.parquet"))
    whole = parquet.read_table(file)
    parquet.write_table(whole.set_column(whole.column_names.index(name), name, [values]), file)
    with pytest.raises(InputError, match=says):
        recordings_of(path, JOINTS, LEROBOT)


def test_a_data_set_whose_files_differ(tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = lerobot(tmp_path / "set")
    file = next(path.glob("data/**/*.parquet"))
    parquet.write_table(parquet.read_table(file).drop_columns("action"), file.with_name("file-001.parquet"))
    with pytest.raises(InputError, match=r"set: expected 'action\.shoulder\.pos' in all of its files"):
        recordings_of(path, JOINTS, LEROBOT)


def test_what_says_too_much_is_no_error_of_ours(tmp_path):
    """Nested without end: names of a data set are then numbers; a mapping and a bag are one line."""
    pytest.importorskip("pyarrow")
    path = lerobot(tmp_path / "set")
    (path / "meta" / "info.json").write_text("[" * 100_000)
    with pytest.raises(InputError, match=r"the log has .*observation\.state\.0"):
        recordings_of(path, JOINTS, LEROBOT)
    (tmp_path / "map.toml").write_text("time = " + "[" * 5000)
    with pytest.raises(InputError, match=r"map\.toml: expected a mapping, got TOML nested too deep"):
        LogMap.load(tmp_path / "map.toml")
    pytest.importorskip("rosbags")
    path = bag(tmp_path / "bag")
    (path / "metadata.yaml").write_text("[" * 500)
    with pytest.raises(InputError, match="expected a ROS 2 bag that can be read"):
        recordings_of(path, JOINTS)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (STATE, {"name": 5, "position": [1]}),
        (STATE, {"header": {"stamp": {"sec": "soon"}}, "name": ["elbow"], "position": [1]}),
        (STATE, {"header": {"stamp": {"sec": 1, "nanosec": [0]}}, "name": ["elbow"], "position": [1]}),
        (STATE, {"header": {"stamp": {"sec": 10**400}}, "name": ["elbow"], "position": [1]}),
        (STATE, {"name": ["elbow"], "position": [None]}),
        (STATE, {"name": ["elbow"], "position": [10**400]}),
        ("trajectory_msgs/msg/JointTrajectory", {"points": {"a": 1}}),
        ("std_msgs/msg/Float64MultiArray", {}),
    ],
)
def test_json_that_is_no_message(tmp_path, kind, message):
    pytest.importorskip("rosbags")
    writer = pytest.importorskip("mcap.writer")
    with (tmp_path / "log.mcap").open("wb") as file:
        log = writer.Writer(file)
        log.start()
        channel = log.register_channel("/arm", "json", log.register_schema(kind, "jsonschema", b"{}"))
        log.add_message(channel, 1, json.dumps(message).encode(), 1)
        log.finish()
    with pytest.raises(InputError, match=rf"log\.mcap: .*a message of /arm is no {kind} \("):
        recordings_of(tmp_path / "log.mcap", JOINTS)


def table(path, rows):
    path.write_text("t,q1,q2,i2\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return path


MAP = {
    "time": "t",
    "time_unit": "ms",
    "joints": {
        "shoulder": {"angle": "q1"},
        "elbow": {
            "angle": {"track": "q2", "unit": "deg", "sign": -1, "zero": 0.5},
            "torque": {"track": "i2", "unit": "mA", "gear": 50, "constant": 0.1, "sign": -1},
        },
    },
}


def test_a_mapping_says_unit_sign_zero_gear_and_constant(tmp_path):
    path = table(tmp_path / "log.csv", [(0, 0.1, 90, 200), (20, 0.2, 180, 400), (40, 0.3, 0, 0)])
    (logged,) = recordings_of(path, JOINTS, LogMap.of(MAP))
    np.testing.assert_allclose(logged.recording.time, [0, 0.02, 0.04])
    np.testing.assert_allclose(logged.recording.angles[:, 0], [0.1, 0.2, 0.3])
    np.testing.assert_allclose(logged.recording.angles[:, 1], 0.5 - np.radians([90, 180, 0]))
    np.testing.assert_allclose(logged.recording.torques[:, 1], [-1.0, -2.0, 0.0])
    assert np.isnan(logged.recording.torques[:, 0]).all()


def test_rows_twice_out_of_order_and_lost_ones(tmp_path):
    rows = [(40, 0.3, 0, 3), (0, 0.1, 0, 1), (20, "", 0, ""), (0, 9, 9, 9), (60, 0.4, 0, 4)]
    (logged,) = recordings_of(table(tmp_path / "log.csv", rows), JOINTS, LogMap.of(MAP))
    np.testing.assert_allclose(logged.recording.time, [0, 0.02, 0.04, 0.06])
    # the first of two counts, what was lost stays lost, and a command is held
    np.testing.assert_allclose(logged.recording.angles[:, 0], [0.1, np.nan, 0.3, 0.4])
    np.testing.assert_allclose(logged.recording.torques[:, 1] / -5e-3, [1, 1, 3, 4])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"time_unit": "weeks"}, "time_unit: expected one of s"),
        ({"time_unit": []}, "time_unit: expected one of s"),
        ({"time": []}, "time: expected the name of a column"),
        ({"joints": {}}, "expected tables"),
        ({"joints": {"elbow": {"angle": {"track": "q2", "unit": "turns"}}}}, "expected one of rad"),
        ({"joints": {"elbow": {"angle": {"track": "q2", "unit": {}}}}}, "expected one of rad"),
        ({"joints": {"elbow": {"angle": {"track": "q2", "zero": 10**400}}}}, "zero as a number"),
        ({"joints": {"elbow": {"angle": {"track": "q2", "sign": 2}}}}, "expected sign as 1 or -1"),
        ({"joints": {"elbow": {"angel": "q2"}}}, "unknown key 'angel'"),
        ({"joints": {"elbow": {"angle": {"track": "q2", "zero": "x"}}}}, "zero as a number"),
        ({"joints": {"wrist": {"angle": "q2"}}}, "joint 'wrist', the robot has shoulder, elbow"),
        ({"joints": {"elbow": {"angle": "q9"}}}, "no track 'q9'; the log has q1, q2, i2"),
    ],
)
def test_what_makes_no_sense_is_said_in_one_line(tmp_path, change, says):
    path = table(tmp_path / "log.csv", [(0, 0.1, 0, 1), (20, 0.1, 0, 1)])
    with pytest.raises(InputError, match=says) as told:
        recordings_of(path, JOINTS, LogMap.of(MAP | change))
    assert "\n" not in str(told.value)


def test_files_that_are_none(tmp_path):
    for name, content in (("a.mcap", b"nothing"), ("a.parquet", b"nothing"), ("a.bin", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=r"a\.(mcap|parquet|bin): "):
            recordings_of(tmp_path / name, JOINTS, LEROBOT)
    with pytest.raises(FileNotFoundError):
        recordings_of(tmp_path / "none.csv", JOINTS)


# -- columns that are not needed ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("column", "values"), [("mode", ["IDLE", "RUN", ""]), ("stop", ["False", "True", "True"]), ("", ["0", "1", "2"])]
)
def test_columns_that_are_not_mapped_do_not_matter(tmp_path, column, values):
    header, *rows = table(tmp_path / "log.csv", [(0, 0.1, 9, 1), (20, 0.2, 9, 1), (40, 0.3, 9, 1)]).read_text().split()
    lines = [f"{cell},{row}" for cell, row in zip([column, *values], [header, *rows], strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    (logged,) = recordings_of(tmp_path / "log.csv", JOINTS, LogMap.of(MAP))
    np.testing.assert_allclose(logged.recording.angles[:, 0], [0.1, 0.2, 0.3])


def test_columns_that_are_mapped_matter(tmp_path):
    (tmp_path / "log.csv").write_text("t,q1,q2,i2,q2\n0,1,2,3,4\n1,1,2,3,4\n")
    with pytest.raises(InputError, match="the header has column 'q2' twice"):
        recordings_of(tmp_path / "log.csv", JOINTS, LogMap.of(MAP))
    (tmp_path / "log.csv").write_text("t,q1,q2,i2\n0,1,RUN,3\n1,1,2,3\n")
    with pytest.raises(InputError, match=r"row 1 \(line 2\), column 'q2': 'RUN' is not a number"):
        recordings_of(tmp_path / "log.csv", JOINTS, LogMap.of(MAP))


def features(path, state):
    """A parquet file of these states, a row each, beside a target."""
    parquet = pytest.importorskip("pyarrow.parquet")
    pyarrow = pytest.importorskip("pyarrow")
    rows = {"timestamp": 0.02 * np.arange(len(state)), "observation.state": state}
    parquet.write_table(pyarrow.table(rows), path)
    return path


BY_NUMBER = {joint: {"angle": f"observation.state.{k}"} for k, joint in enumerate(JOINTS)}


@pytest.mark.parametrize("first", [[], None, [1.0], [1.0, 2.0, 3.0], [None, None]])
def test_an_odd_first_row_loses_no_feature(tmp_path, first):
    path = features(tmp_path / "log.parquet", [first, [0.1, 0.2], [0.3, None], [0.5, 0.6]])
    (logged,) = recordings_of(path, JOINTS, LogMap.of({"joints": BY_NUMBER}))
    np.testing.assert_allclose(logged.recording.angles, [[np.nan] * 2, [0.1, 0.2], [0.3, np.nan], [0.5, 0.6]])


def test_true_and_false_are_no_angles(tmp_path):
    path = features(tmp_path / "log.parquet", [[True, False]] * 5)
    with pytest.raises(InputError, match=r"angle: no track 'observation\.state\.0'"):
        recordings_of(path, JOINTS, LogMap.of({"joints": BY_NUMBER}))


def test_two_entries_of_one_name(tmp_path):
    pytest.importorskip("pyarrow")
    path = lerobot(tmp_path / "set")
    named = {name: {"names": ["elbow.pos", "elbow.pos"]} for name in ("observation.state", "action")}
    (path / "meta" / "info.json").write_text(json.dumps({"features": named}))
    with pytest.raises(InputError, match=r"two entries of 'observation\.state' are called 'elbow\.pos'"):
        recordings_of(path, JOINTS, LEROBOT)

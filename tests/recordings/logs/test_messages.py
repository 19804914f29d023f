"""Messages of ROS logs: their clocks, topics, encodings, and a bag's own folder."""

import json

import numpy as np
import pytest
from log_files import ANGLE, EFFORT, JOINTS, STATE, TIME, bag, joint_states

from invdyn.recordings import InputError
from invdyn.recordings.limits import Limits
from invdyn.recordings.logs import LogMap, recordings_of


def ros_log(path, *topics):
    """An MCAP of topics, each with its name, type, encoding, and messages' times of logging (ns) with their bytes."""
    from mcap.writer import Writer

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        for topic, kind, encoding, sent in topics:
            channel = writer.register_channel(topic, encoding, writer.register_schema(kind, "ros2msg", b""))
            for logged, content in sent:
                writer.add_message(channel, logged, bytes(content), logged)
        writer.finish()
    return path


def states(stamps, logged=1_700_000_000):
    """Messages of JointState with these stamps, s, one every 20 ms by the recorder; every angle is the row's number."""
    stores = pytest.importorskip("rosbags.typesys")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    return [((logged * 10**9) + 20_000_000 * k, joint_states(t, k, store)) for k, t in enumerate(stamps)]


@pytest.mark.parametrize(
    ("stamps", "rows"),
    [
        ((0, 0.02, 0.04, 0.06), [0, 1, 2, 3]),  # a simulation starts at 0
        ((0, 0, 0, 41.2, 41.22, 41.24), [3, 4, 5]),  # before the first message of the clock
        ((0, 1_700_000_000, 1_700_000_000.02, 1_700_000_000.04), [1, 2, 3]),
        ((0, 0, 0, 0), [0, 1, 2, 3]),  # no stamps at all: the recorder's times
    ],
)
@pytest.mark.filterwarnings("ignore:.*messages have the time stamp 0:UserWarning")
def test_stamps_are_used_for_a_whole_topic(tmp_path, stamps, rows):
    pytest.importorskip("mcap")
    path = ros_log(tmp_path / "log.mcap", ("/joint_states", STATE, "cdr", states(stamps)))
    (logged,) = recordings_of(path, JOINTS)
    np.testing.assert_array_equal(logged.recording.angles[:, 0], rows)
    np.testing.assert_allclose(logged.recording.time, 0.02 * np.arange(len(rows)), atol=1e-6)


def test_messages_before_the_clock_are_reported(tmp_path):
    pytest.importorskip("mcap")
    path = ros_log(tmp_path / "log.mcap", ("/joint_states", STATE, "cdr", states((0, 0, 7, 7.02, 7.04))))
    with pytest.warns(UserWarning, match="/joint_states: 2 of 5 messages have the time stamp 0"):
        recordings_of(path, JOINTS)


def test_two_clocks_are_one_line(tmp_path):
    """A topic with stamps of a simulation, and one with the recorder's times."""
    pytest.importorskip("mcap")
    topics = [("/a", STATE, "cdr", states(0.02 * np.arange(5))), ("/b", STATE, "cdr", states([0] * 5))]
    path = ros_log(tmp_path / "log.mcap", *topics)
    joints = {"shoulder": {"angle": "/a.shoulder.position"}, "elbow": {"angle": "/b.elbow.position"}}
    with pytest.raises(InputError, match=r"its times jump from 0\.08 to 1\.7e\+09"):
        recordings_of(path, JOINTS, LogMap.of({"joints": joints}))


def trajectory(sec):
    """A message in JSON that wants all joints at 9 rad."""
    point = {"positions": [9.0, 9.0]}
    stamp = {"sec": sec, "nanosec": 0}
    return json.dumps({"header": {"stamp": stamp}, "joint_names": JOINTS, "points": [point]}).encode()


def test_a_trajectory_is_no_measurement(tmp_path):
    pytest.importorskip("mcap")
    targets = ("/arm/joint_trajectory", "trajectory_msgs/msg/JointTrajectory", "json", [(5, trajectory(1))])
    own = ("/joint_states", STATE, "cdr", states((1, 1.02, 1.04)))
    (logged,) = recordings_of(ros_log(tmp_path / "log.mcap", targets, own), JOINTS)
    np.testing.assert_array_equal(logged.recording.angles[:, 0], [0, 1, 2])


def test_two_topics_that_say_the_same_are_named(tmp_path):
    pytest.importorskip("mcap")
    topics = [(topic, STATE, "cdr", states((1, 1.02, 1.04))) for topic in ("/joint_states", "/original")]
    path = ros_log(tmp_path / "log.mcap", *topics)
    with pytest.raises(InputError) as refusal:
        recordings_of(path, JOINTS)
    assert str(refusal.value).endswith(
        "the angle of joint 'shoulder' is in 2 tracks, '/joint_states.shoulder.position' and "
        "'/original.shoulder.position': say which by --map, "
        '[joints.shoulder] angle = "/joint_states.shoulder.position"'
    )


def test_messages_of_ros_1_are_read(tmp_path):
    pytest.importorskip("mcap")
    stores = pytest.importorskip("rosbags.typesys")
    store = stores.get_typestore(stores.Stores.ROS1_NOETIC)
    kinds, sent = store.types, []
    for k, t in enumerate(TIME):
        stamp = kinds["builtin_interfaces/msg/Time"](7, round(t * 1e9))
        header = kinds["std_msgs/msg/Header"](seq=k, stamp=stamp, frame_id="")
        message = kinds[STATE](header, list(JOINTS), ANGLE[k], np.zeros(0), EFFORT[k])
        sent.append((k, store.serialize_ros1(message, STATE)))
    path = ros_log(tmp_path / "log.mcap", ("/joint_states", "sensor_msgs/JointState", "ros1", sent))
    (logged,) = recordings_of(path, JOINTS)
    np.testing.assert_allclose(logged.recording.time, TIME, atol=1e-9)
    np.testing.assert_array_equal(logged.recording.angles, ANGLE)
    np.testing.assert_array_equal(logged.recording.torques, EFFORT)


def test_what_is_not_read_is_named(tmp_path):
    pytest.importorskip("mcap")
    path = ros_log(
        tmp_path / "log.mcap",
        ("/image", "sensor_msgs/msg/Image", "cdr", [(1, b"")]),
        ("/joint_states", STATE, "protobuf", [(1, b"")]),
        ("/own", "my_msgs/msg/JointState", "cdr", [(1, b"")]),
    )
    with pytest.raises(InputError) as refusal:
        recordings_of(path, JOINTS)
    for name in ("sensor_msgs/msg/Image (cdr)", f"{STATE} (protobuf)", "my_msgs/msg/JointState (cdr)"):
        assert name in str(refusal.value)


@pytest.mark.parametrize("kind", ["a\nb", "\x1b[31mred", "a\r\nb"])
def test_names_out_of_a_file_stay_in_one_line(tmp_path, kind):
    """Neither a type nor a topic's name moves the cursor of a terminal."""
    pytest.importorskip("mcap")
    other = ros_log(tmp_path / "log.mcap", ("/other", kind, "cdr", [(1, b"")]))
    named = ros_log(tmp_path / "named.mcap", (kind, STATE, "cdr", states((1, 1.02))))
    for path, mapping in ((other, None), (named, {"joints": {"elbow": {"angle": "q"}}})):
        with pytest.raises(InputError) as refusal:
            recordings_of(path, JOINTS, None if mapping is None else LogMap.of(mapping))
        assert str(refusal.value).isprintable()


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
@pytest.mark.parametrize("mode", ["FILE", "MESSAGE", "NONE"])
def test_a_bag_of_any_storage_and_compression(tmp_path, storage, mode):
    bags = pytest.importorskip("rosbags.rosbag2")
    stores = pytest.importorskip("rosbags.typesys")
    store = stores.get_typestore(stores.Stores.ROS2_HUMBLE)
    path = tmp_path / "bag"
    plugin = bags.StoragePlugin.MCAP if storage == "mcap" else bags.StoragePlugin.SQLITE3
    writer = bags.Writer(path, version=8, storage_plugin=plugin)
    if mode != "NONE":
        writer.set_compression(bags.CompressionMode[mode], bags.CompressionFormat.ZSTD)
    with writer:
        connection = writer.add_connection("/joint_states", STATE, typestore=store)
        for stamp, message in states((1, 1.02, 1.04)):
            writer.write(connection, stamp, message)
    (logged,) = recordings_of(path, JOINTS)
    np.testing.assert_array_equal(logged.recording.angles[:, 0], [0, 1, 2])


@pytest.mark.parametrize("name", ["a#b", "a?b", "50%25", "..%2Fx", "a b"])
def test_a_name_is_taken_as_it_stands(tmp_path, name):
    pytest.importorskip("rosbags")
    path = bag(tmp_path / "bag").rename(tmp_path / name)
    file = next(path.glob("*.db3")).rename(path / f"{name}.db3")
    whole = path / "metadata.yaml"
    whole.write_text(whole.read_text().replace("bag.db3", f"'{file.name}'"))
    (logged,) = recordings_of(path, JOINTS)
    np.testing.assert_array_equal(logged.recording.angles, ANGLE)


@pytest.mark.parametrize("how", ["decoded", "linked"])
def test_a_database_outside_of_the_folder_is_not_read(tmp_path, how):
    pytest.importorskip("rosbags")
    path, secret = bag(tmp_path / "bag"), tmp_path / "secret"
    secret.mkdir()
    other = next(path.glob("*.db3")).rename(secret / "s.db3")
    name = "..%2Fsecret%2Fs.db3" if how == "decoded" else "s.db3"
    if how == "linked":
        (path / name).symlink_to(other)
    else:
        (path / name).touch()  # a reader that looks for the name, then decodes it
    whole = path / "metadata.yaml"
    whole.write_text(whole.read_text().replace("bag.db3", f"'{name}'"))
    with pytest.raises(InputError, match=r"expected .*ordinary"):
        recordings_of(path, JOINTS)


def test_a_query_without_end_is_one_line(tmp_path, monkeypatch):
    pytest.importorskip("rosbags")
    path = bag(tmp_path / "bag")
    monkeypatch.setattr("invdyn.recordings.logs.ros_bag.LIMITS", Limits(query_steps=5))
    monkeypatch.setattr("invdyn.recordings.logs.ros_bag.STEPS_BETWEEN_CHECKS", 1)
    with pytest.raises(InputError, match=r"bag\.db3: its tables take more than 5e\+00 steps"):
        recordings_of(path, JOINTS)

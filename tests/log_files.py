"""One short log of two joints, written as each kind of file by that kind's own library."""

import json

import numpy as np

JOINTS = ("shoulder", "elbow")
TIME = np.arange(6) * 0.02
ANGLE = np.stack([0.1 * np.arange(6), -0.2 * np.arange(6)], -1)
EFFORT = np.stack([np.arange(6.0), 1 - np.arange(6.0)], -1)
STATE = "sensor_msgs/msg/JointState"
DEFINITION = """std_msgs/Header header
string[] name
float64[] position
float64[] velocity
float64[] effort
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec"""


def nanoseconds(second: float) -> tuple[int, int]:
    whole = round(second * 1e9)
    return 1_700_000_000 + whole // 10**9, whole % 10**9


def messages(store):
    """Times in ns, and messages in CDR."""
    kinds = store.types
    for t, angle, effort in zip(TIME, ANGLE, EFFORT, strict=True):
        sec, nano = nanoseconds(t)
        header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](sec, nano), "")
        message = kinds[STATE](header, list(JOINTS), angle, np.zeros(0), effort)
        yield sec * 10**9 + nano, store.serialize_cdr(message, STATE)


def joint_states(sec, angle, store):
    """One message in CDR of a stamp in whole seconds, with all angles equal."""
    kinds = store.types
    header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](int(sec), round(sec % 1 * 1e9)), "")
    values = np.full(len(JOINTS), float(angle))
    return store.serialize_cdr(kinds[STATE](header, list(JOINTS), values, np.zeros(0), values), STATE)


def bag(path, storage="sqlite3"):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=8, storage_plugin=plugin) as writer:
        connection = writer.add_connection("/joint_states", STATE, typestore=store)
        for stamp, message in messages(store):
            writer.write(connection, stamp + 500, message)
    return path


def mcap(path):
    from mcap.writer import Writer
    from rosbags.typesys import Stores, get_typestore

    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        schema = writer.register_schema(STATE, "ros2msg", DEFINITION.encode())
        channel = writer.register_channel("/joint_states", "cdr", schema)
        for stamp, message in messages(get_typestore(Stores.ROS2_HUMBLE)):
            writer.add_message(channel, stamp, bytes(message), stamp)
        writer.finish()
    return path


def lerobot(path):
    import pyarrow
    import pyarrow.parquet

    (path / "meta").mkdir(parents=True)
    (path / "data" / "chunk-000").mkdir(parents=True)
    names = [f"{joint}.pos" for joint in JOINTS]
    features = {"observation.state": {"names": names}, "action": {"names": {"motors": names}}}
    (path / "meta" / "info.json").write_text(json.dumps({"features": features}))
    twice = {
        "episode_index": [0] * 6 + [1] * 6,
        "timestamp": np.tile(TIME, 2),
        "observation.state": np.degrees(np.concatenate([ANGLE, 2 * ANGLE])).tolist(),
        "action": np.degrees(np.concatenate([ANGLE + 0.1, ANGLE])).tolist(),
        "task": ["pick"] * 12,
    }
    pyarrow.parquet.write_table(pyarrow.table(twice), path / "data" / "chunk-000" / "file-000.parquet")
    return path


LEROBOT = {
    "joints": {
        joint: {
            "angle": {"track": f"observation.state.{joint}.pos", "unit": "deg"},
            "target": {"track": f"action.{joint}.pos", "unit": "deg"},
        }
        for joint in JOINTS
    }
}
"""The mapping of that data set."""

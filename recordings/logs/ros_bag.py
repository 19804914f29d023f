"""ROS 2 bags: a folder with metadata.yaml, read by `rosbags`, which needs no ROS."""

from pathlib import Path

from ..errors import InputError
from .messages import Collected
from .tracks import Episode, needed


def read_bag(path: Path, time: str | None = None) -> list[Episode]:
    """The tracks of a bag's messages that are known (:mod:`.messages`). Raises InputError for what is no bag."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: {needed('rosbags', 'a ROS 2 bag')}") from error
    found = Collected()
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            for connection, logged, raw in reader.messages():
                if connection.msgtype.rpartition("/")[2] in KINDS:
                    message = reader.deserialize(raw, connection.msgtype)
                    found.add(connection.topic, connection.msgtype, message, 1e-9 * logged)
    except AnyReaderError as error:
        raise InputError(f"{path}: no ROS 2 bag that can be read: {str(error).splitlines()[0]}") from error
    return [found.episode()]


KINDS = ("JointState", "JointTrajectory", "Float64MultiArray", "Float32MultiArray")

"""ROS 2 bags: a folder with metadata.yaml, read by `rosbags`, which needs no ROS.

Messages are read by the definitions that `rosbags` brings along. A bag's own would be compiled to Python and run.
"""

from pathlib import Path

from ..errors import InputError, first_line
from .messages import KINDS, Collected
from .tracks import Episode, needed


def read_bag(path: Path, time: str | None = None) -> list[Episode]:
    """The tracks of a bag's messages that are known (:mod:`.messages`). Raises InputError for what is no bag."""
    try:
        from apsw import Error as DatabaseError  # as rosbags opens a bag's database
        from rosbags.rosbag2 import Reader, ReaderError
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise InputError(f"{path}: {needed('rosbags', 'a ROS 2 bag')}") from error
    found, known = Collected(), get_typestore(Stores.ROS2_HUMBLE)
    try:
        with Reader(path) as reader:
            for connection, logged, raw in reader.messages():
                kind = connection.msgtype
                if kind.rpartition("/")[2] in KINDS and kind in known.types:
                    found.add(connection.topic, kind, known.deserialize_cdr(raw, kind), 1e-9 * logged)
    except (ReaderError, SerdeError, DatabaseError, ValueError, RecursionError) as error:
        raise InputError(f"{path}: no ROS 2 bag that can be read: {first_line(error)}") from error
    return [found.episode()]

"""MCAP files (mcap.dev): ROS 2 messages in CDR, and JSON messages of the same fields.

As in a bag (:mod:`.ros_bag`), messages are read by the definitions that `rosbags` brings along, not by the file's own.
"""

import json
import struct
from pathlib import Path

from ..errors import InputError, first_line
from .messages import KINDS, Collected
from .tracks import Episode, needed


def read_mcap(path: Path, time: str | None = None) -> list[Episode]:
    """The tracks of a file's messages that are known (:mod:`.messages`). Raises InputError for what is no MCAP."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, get_typestore
        from zstandard import ZstdError  # as mcap unpacks its chunks
    except ImportError as error:
        raise InputError(f"{path}: {needed('mcap and rosbags', 'MCAP')}") from error
    found, known = Collected(), get_typestore(Stores.ROS2_HUMBLE)
    try:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                kind = "" if schema is None else schema.name.replace(".", "/")
                if kind.rpartition("/")[2] not in KINDS:
                    continue
                if channel.message_encoding == "json":
                    found.add(channel.topic, kind, json.loads(message.data), 1e-9 * message.log_time)
                elif channel.message_encoding == "cdr" and kind in known.types:
                    found.add(channel.topic, kind, known.deserialize_cdr(message.data, kind), 1e-9 * message.log_time)
    except (McapError, SerdeError, ZstdError, ValueError, EOFError, OSError, RuntimeError, struct.error) as error:
        raise InputError(f"{path}: no MCAP file that can be read: {first_line(error)}") from error
    return [found.episode()]

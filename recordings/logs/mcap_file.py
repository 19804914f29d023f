"""MCAP files (mcap.dev): ROS 2 messages in CDR, and JSON messages of the same fields."""

import json
import struct
from pathlib import Path

from ..errors import InputError, first_line
from .messages import Collected
from .tracks import Episode, needed


def read_mcap(path: Path, time: str | None = None) -> list[Episode]:
    """The tracks of a file's messages that are known (:mod:`.messages`). Raises InputError for what is no MCAP."""
    try:
        from mcap.exceptions import McapError
        from mcap.reader import make_reader
        from mcap_ros2.decoder import DecoderFactory
    except ImportError as error:
        raise InputError(f"{path}: {needed('mcap and mcap-ros2-support', 'MCAP')}") from error
    found, decoders = Collected(), DecoderFactory()
    try:
        with path.open("rb") as file:
            for schema, channel, message in make_reader(file).iter_messages():
                if channel.message_encoding == "json":
                    content = json.loads(message.data)
                else:
                    decode = decoders.decoder_for(channel.message_encoding, schema)
                    content = None if decode is None else decode(message.data)
                if content is not None and schema is not None:
                    kind = schema.name.replace(".", "/")
                    found.add(channel.topic, kind, content, 1e-9 * message.log_time)
    except (McapError, ValueError, EOFError, struct.error) as error:
        raise InputError(f"{path}: no MCAP file that can be read: {first_line(error)}") from error
    return [found.episode()]

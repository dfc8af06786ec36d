"""The door to bags: MCAP files and ROS 2 bags, as messages with stamps. Nothing in them is run."""

import json
from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any, NamedTuple

from mcap.exceptions import McapError
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader, AnyReaderError
from rosbags.typesys import Stores, get_typestore

from simgap.types import RecordingError


class Message(NamedTuple):
    """A message of a topic and when it was received [ns]; fields are attributes, or keys where it was JSON."""

    topic: str
    received_ns: int
    content: Any


def messages(path: Path, topics: Set[str]) -> Iterator[Message]:
    """The messages of these topics, as received; RecordingError where the bag is damaged or lacks one of them."""
    try:
        yield from _mcap(path, topics) if path.is_file() else _ros2(path, topics)
    except RecordingError:
        raise
    except (McapError, AnyReaderError, OSError, ValueError, KeyError, EOFError) as error:
        raise RecordingError(f"{path}: cannot be read as a bag ({type(error).__name__}: {error}). Record or copy it "
                             "again, or leave it out.") from None  # fmt: skip


def _mcap(path: Path, topics: Set[str]) -> Iterator[Message]:
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        if summary is not None:
            _refuse_missing(path, topics, {channel.topic for channel in summary.channels.values()})
        decoders: dict[int, Any] = {}
        for schema, channel, message in reader.iter_messages(topics=sorted(topics)):
            if channel.message_encoding == "json":
                content = json.loads(message.data)
            else:
                if channel.id not in decoders:
                    decoders[channel.id] = DecoderFactory().decoder_for(channel.message_encoding, schema)
                if decoders[channel.id] is None:
                    defined = schema.encoding if schema and schema.encoding else "no language"
                    raise RecordingError(
                        f"{path}: the topic {channel.topic} has messages in {channel.message_encoding}, defined in "
                        f"{defined}; JSON, and ROS 2 messages in cdr with their definitions in ros2msg, as `ros2 bag "
                        "record` writes them, are read. Convert the bag, or record it so."
                    )
                content = decoders[channel.id](message.data)
            yield Message(channel.topic, message.log_time, content)


def _ros2(path: Path, topics: Set[str]) -> Iterator[Message]:
    # Bags of older recorders bring no definitions; ROS's own messages are the same since.
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        _refuse_missing(path, topics, {c.topic for c in reader.connections})
        wanted = [c for c in reader.connections if c.topic in topics]
        for connection, stamp, data in reader.messages(connections=wanted):
            yield Message(connection.topic, stamp, reader.deserialize(data, connection.msgtype))


def _refuse_missing(path: Path, wanted: Set[str], there: Set[str]) -> None:
    missing = sorted(wanted - there)
    if missing:
        raise RecordingError(
            f"{path}: the topic {', '.join(missing)} is missing; there are {', '.join(sorted(there)) or 'none'}. "
            "Mend the mapping file, or leave the bag out."
        )

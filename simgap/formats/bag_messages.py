"""Reads bags, MCAP files and ROS 2 bags, as messages with stamps. Nothing in them is executed."""

import json
from collections.abc import Callable, Iterator, Set
from contextlib import redirect_stderr
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import IO, Any, NamedTuple

import lz4.frame
import zstandard
from mcap.records import Channel, Chunk, McapRecord, Schema
from mcap.records import Message as McapMessage
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from simgap.types import RecordingError

RECORD_LIMIT = 2**30
"""Maximum size of a record of an MCAP file, and of an expanded chunk [bytes]; recorders write a few million."""
_SHOWN = 200  # characters of a library's error in a message


class Message(NamedTuple):
    """A message of a topic, with its receive time [ns]. Its fields are attributes, or keys if it was JSON."""

    topic: str
    received_ns: int
    content: Any


def messages(path: Path, topics: Set[str]) -> Iterator[Message]:
    """The messages of these topics, in any order; RecordingError where the bag is damaged or lacks a topic."""
    read = _mcap(path, topics) if path.is_file() else _ros2(path, topics)
    while True:
        try:
            message = next(read, None)
        except RecordingError:
            raise
        except Exception as error:  # a damaged bag, or a malicious definition, may raise anything
            raise RecordingError(
                f"{path}: cannot be read as a bag ({type(error).__name__}: {first_line(error)}). Record or copy it "
                "again, or leave it out."
            ) from None
        if message is None:
            return
        yield message


def first_line(error: Exception) -> str:
    """The first line of a library's error, shortened."""
    line = next(iter(str(error).splitlines()), "")
    return line if len(line) <= _SHOWN else f"{line[:_SHOWN]}..."


def _mcap(path: Path, topics: Set[str]) -> Iterator[Message]:
    """Read from beginning to end, with or without an index, so that every checksum is verified."""
    decoders: dict[int, Callable[[bytes], Any]] = {}
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    with path.open("rb") as file:
        for record in _records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, McapMessage) and channels[record.channel_id].topic in topics:
                channel = channels[record.channel_id]
                if channel.id not in decoders:
                    decoders[channel.id] = _decoder(path, channel, schemas.get(channel.schema_id))
                yield Message(channel.topic, record.log_time, decoders[channel.id](record.data))
    _refuse_missing(path, topics, {channel.topic for channel in channels.values()})


def _records(file: IO[bytes]) -> Iterator[McapRecord]:
    """Records of a file and of its chunks. The library raises an error where a checksum is wrong or the end missing."""
    reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=RECORD_LIMIT)
    for record in reader.records:
        if isinstance(record, Chunk):
            yield from breakup_chunk(replace(record, compression="", data=_expanded(record)), validate_crc=True)
        else:
            yield record


def _expanded(chunk: Chunk) -> bytes:
    """A chunk's content, limited in size: a small file may expand to more than the memory."""
    if chunk.compression == "zstd":
        data = zstandard.ZstdDecompressor().stream_reader(chunk.data).read(RECORD_LIMIT + 1)
    elif chunk.compression == "lz4":
        data = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=RECORD_LIMIT + 1)
    elif chunk.compression:
        raise ValueError(f"a chunk is compressed with {chunk.compression!r}; known are lz4 and zstd")
    else:
        data = chunk.data
    if len(data) != chunk.uncompressed_size or len(data) > RECORD_LIMIT:
        raise ValueError(f"a chunk has another size than the {chunk.uncompressed_size:,} bytes that it should have, "
                         f"or more than {RECORD_LIMIT:,}")  # fmt: skip
    return data


def _decoder(path: Path, channel: Channel, schema: Schema | None) -> Callable[[bytes], Any]:
    if channel.message_encoding == "json":
        return json.loads
    with redirect_stderr(StringIO()):  # the parser prints what it raises
        decoder = DecoderFactory().decoder_for(channel.message_encoding, schema)
    if decoder is None:
        defined = schema.encoding if schema and schema.encoding else "no language"
        raise RecordingError(
            f"{path}: the topic {channel.topic} has messages in {channel.message_encoding}, defined in {defined}; "
            "JSON, and ROS 2 messages in cdr with their definitions in ros2msg, as `ros2 bag record` writes them, are "
            "read. Convert the bag, or record it so."
        )
    return decoder


def _ros2(path: Path, topics: Set[str]) -> Iterator[Message]:
    # Bags of older recorders hold no definitions; ROS's own messages have not changed since.
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        _refuse_missing(path, topics, {c.topic for c in reader.connections})
        wanted = [c for c in reader.connections if c.topic in topics]
        for connection, stamp, data in reader.messages(connections=wanted):
            if not isinstance(stamp, int):  # SQLite keeps anything in any column
                raise TypeError(f"a message has {type(stamp).__name__} for its time")
            yield Message(connection.topic, stamp, reader.deserialize(data, connection.msgtype))


def _refuse_missing(path: Path, wanted: Set[str], there: Set[str]) -> None:
    missing = sorted(wanted - there)
    if missing:
        raise RecordingError(
            f"{path}: the topic {', '.join(missing)} is missing; there are {', '.join(sorted(there)) or 'none'}. "
            "Mend the mapping file, or leave the bag out."
        )

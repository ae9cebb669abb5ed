"""Reads a recording back, with the `mcap` package of the `eval` extra; also one cut off."""

import json
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from vwnav.errors import SourceError
from vwnav.types import Frame

CAMERA_TOPIC, VEHICLE_TOPIC = "/camera", "/vehicle"
_IMAGE_DATA_FIELD, _FRAME_ID_FIELD = 2, 4  # of foxglove.CompressedImage
_LENGTH_DELIMITED = 2


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """One message: `content` is a mapping, or a `Frame` on the topic /camera."""

    topic: str
    t_s: float
    content: Any


def read_recording(path: Path, topics: frozenset[str] | None = None) -> Generator[Record]:
    """Messages in the order in which they were written.

    Args:
        path: an MCAP file of `Recorder`; of one that was cut off, what is there.
        topics: only these; None is all.

    Raises:
        SourceError: it is missing or no MCAP file, or the mcap package is not installed.
    """
    try:
        from mcap.exceptions import EndOfFile, McapError
        from mcap.records import Channel, Message
        from mcap.stream_reader import StreamReader
    except ImportError as error:
        raise SourceError("reading MCAP needs mcap: pip install 'vwnav[eval]'") from error
    names: dict[int, str] = {}
    try:
        with path.open("rb") as file:
            for record in StreamReader(file).records:
                if isinstance(record, Channel):
                    names[record.id] = record.topic
                elif isinstance(record, Message):
                    topic = names[record.channel_id]
                    if topics is None or topic in topics:
                        yield _decode(topic, record.log_time / 1e9, record.data)
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror}") from error
    except EndOfFile:
        return  # the recorder was killed: everything before has been handed out
    except McapError as error:
        raise SourceError(f"{path} is not an MCAP file, or it is damaged: {error}") from error


class RecordedFrames:
    """A `FrameSource` over the pictures of a recording."""

    def __init__(self, path: Path) -> None:
        self._records = read_recording(path, frozenset({CAMERA_TOPIC}))

    def next_frame(self) -> Frame | None:
        """The next picture, None after the last."""
        record = next(self._records, None)
        return None if record is None else record.content

    def close(self) -> None:
        """Close the file."""
        self._records.close()


def _decode(topic: str, t_s: float, data: bytes) -> Record:
    if topic != CAMERA_TOPIC:
        return Record(topic, t_s, json.loads(data))
    fields = _protobuf_bytes(data)
    image = cv2.imdecode(np.frombuffer(fields[_IMAGE_DATA_FIELD], np.uint8), cv2.IMREAD_UNCHANGED)
    index = int(fields[_FRAME_ID_FIELD])
    return Record(topic, t_s, Frame(t_s, np.asarray(image, np.uint8), index))


def _protobuf_bytes(data: bytes) -> dict[int, bytes]:
    """The length-delimited fields of a message (protobuf wire format); the others do not occur."""
    fields, at = {}, 0
    while at < len(data):
        key, at = _varint(data, at)
        if key & 7 != _LENGTH_DELIMITED:
            raise SourceError("a picture of the recording is damaged")
        length, at = _varint(data, at)
        fields[key >> 3] = data[at : at + length]
        at += length
    return fields


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = data[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if not byte & 0x80:
            return value, at

"""Reads a recording back, with the `mcap` package of the `eval` extra; also one cut off.

A recorder that was killed leaves a file that breaks off within a record. A power cut may leave more
behind what was synced: some pages of 4 kB, and zeros for the others. Both are read to there.
"""

import json
import logging
import os
import struct
from collections.abc import Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np

from vwnav.errors import SourceError
from vwnav.types import Frame

_log = logging.getLogger(__name__)
CAMERA_TOPIC, VEHICLE_TOPIC = "/camera", "/vehicle"
_IMAGE_DATA_FIELD, _FRAME_ID_FIELD = 2, 4  # of foxglove.CompressedImage
_LENGTH_DELIMITED = 2
_END = b"\x89MCAP0\r\n"
_RECORD_HEAD = struct.Struct("<BQ")  # opcode, length of what follows
_LAST_OPCODE = 0x0F

# What damaged bytes may raise in the mcap package, its decompressors, and the decoding here.
_DAMAGE = (
    ValueError, LookupError, TypeError, ArithmeticError, RuntimeError, MemoryError, struct.error,
    cv2.error,
)  # fmt: skip


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
        SourceError: it is missing, damaged or no MCAP file.
    """
    names: dict[int, str] = {}
    with _whatever_it_holds(path):
        from mcap.records import Channel, Message

        for record in _mcap_records(path, chunks_whole=False):
            if isinstance(record, Channel):
                names[record.id] = record.topic
            elif isinstance(record, Message):
                topic = names[record.channel_id]
                if topics is None or topic in topics:
                    yield _decode(topic, record.log_time / 1e9, record.data)


def read_metadata(path: Path) -> dict[str, Any]:
    """What `Recorder` keeps of a whole recording as JSON, by name.

    Raises:
        SourceError: it is missing, damaged or no MCAP file.
    """
    found: dict[str, Any] = {}
    with _whatever_it_holds(path):
        from mcap.records import Metadata

        for record in _mcap_records(path, chunks_whole=True):
            if isinstance(record, Metadata) and "json" in record.metadata:
                found[record.name] = json.loads(record.metadata["json"])
    return found


def is_cut_off(path: Path) -> bool:
    """Whether a recording lacks its end: the recorder was killed, or the disk was full."""
    with path.open("rb") as file:
        file.seek(-min(len(_END), path.stat().st_size), os.SEEK_END)
        return file.read() != _END


class _WholeReads:
    """A file of which a read that goes past `size` gives nothing, instead of half a record."""

    def __init__(self, file: BinaryIO, size: int) -> None:
        self._file = file
        self._size = size

    def read(self, length: int) -> bytes:
        left = self._size - self._file.tell()
        return self._file.read(length) if length <= left else b""


def _mcap_records(path: Path, chunks_whole: bool) -> Generator[Any]:
    """What the mcap package reads, up to where the file breaks off."""
    from mcap.exceptions import EndOfFile, McapError
    from mcap.stream_reader import StreamReader

    cut_off = is_cut_off(path)
    found = False
    try:
        with path.open("rb") as file:
            size = _sound_bytes(file) if cut_off else os.fstat(file.fileno()).st_size
            whole: Any = _WholeReads(file, size)
            reader = StreamReader(whole, emit_chunks=chunks_whole, validate_crcs=not chunks_whole)
            for record in reader.records:
                found = True
                yield record
    except EndOfFile:
        return  # the recorder was killed: everything before has been handed out
    except (McapError, *_DAMAGE) as error:
        if not (cut_off and found):
            raise SourceError(f"{path} is not an MCAP file, or it is damaged: {error}") from error
        _log.warning("%s was cut off while it was written: read to there", path)


def _sound_bytes(file: BinaryIO) -> int:
    """How many bytes a file has from its beginning that are whole records."""
    size = os.fstat(file.fileno()).st_size
    at = len(_END)
    while at + _RECORD_HEAD.size <= size:
        file.seek(at)
        opcode, length = _RECORD_HEAD.unpack(file.read(_RECORD_HEAD.size))
        if not 0 < opcode <= _LAST_OPCODE or at + _RECORD_HEAD.size + length > size:
            break
        at += _RECORD_HEAD.size + length
    file.seek(0)
    return min(at, size)


@contextmanager
def _whatever_it_holds(path: Path) -> Iterator[None]:
    """One clear error for whatever goes wrong: the bytes of a file may be anything."""
    try:
        yield
    except OSError as error:
        raise SourceError(f"cannot read {path}: {error.strerror}") from error
    except _DAMAGE as error:
        raise SourceError(f"{path} is damaged: {error or type(error).__name__}") from error


class RecordedFrames:
    """A `FrameSource` over the images of a recording."""

    def __init__(self, path: Path) -> None:
        self._records = read_recording(path, frozenset({CAMERA_TOPIC}))

    def next_frame(self) -> Frame | None:
        """The next image, None after the last."""
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

"""Whether a video file is whole, by the sizes that its container declares."""

import struct
from pathlib import Path
from typing import BinaryIO

_EBML_MAGIC = b"\x1a\x45\xdf\xa3"
_EBML_SEGMENT = b"\x18\x53\x80\x67"
_ISO_BOXES = {b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"moof", b"uuid", b"sidx"}


def is_cut_off(path: Path) -> bool:
    """True when an MP4/MOV, MKV/WebM or AVI file is shorter than it says; False when unknown."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        file.seek(0)
        if head[:4] == _EBML_MAGIC:
            return _matroska_end(file) > size
        if head[:4] == b"RIFF":
            return 8 + int.from_bytes(head[4:8], "little") > size
        if head[4:8] in _ISO_BOXES:
            return _iso_is_cut_off(file, size)
    return False


def _iso_is_cut_off(file: BinaryIO, size: int) -> bool:
    """ISO/IEC 14496-12, 4.2: boxes of size and type, one after the other, `moov` among them."""
    at, seen = 0, set()
    while at < size:
        file.seek(at)
        header = file.read(16)
        if len(header) < 8:
            return True
        length, kind = struct.unpack_from(">I4s", header)
        seen.add(kind)
        if length == 0:  # to the end of the file
            break
        if length == 1:
            if len(header) < 16:
                return True
            (length,) = struct.unpack_from(">Q", header, 8)
        if length < 8:
            return True
        at += length
    return at > size or b"moov" not in seen


def _matroska_end(file: BinaryIO) -> int:
    """Where the segment ends by RFC 9559; 0 when it was written without a size (live)."""
    at = 0
    while True:
        file.seek(at)
        header = file.read(16)
        if len(header) < 6:
            return 0
        id_length = 9 - header[0].bit_length()
        length_length = 9 - header[id_length].bit_length() if header[id_length] else 9
        if id_length > 4 or length_length > 8:
            return 0
        raw = int.from_bytes(header[id_length : id_length + length_length])
        length = raw & ((1 << 7 * length_length) - 1)
        unknown = length == (1 << 7 * length_length) - 1
        end = at + id_length + length_length + length
        if header[:id_length] == _EBML_SEGMENT:
            return 0 if unknown else end
        at = end

"""What the container of a video file declares: whether the file is whole, how much is in it."""

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO, Literal

_EBML_MAGIC = b"\x1a\x45\xdf\xa3"
_EBML_SEGMENT = b"\x18\x53\x80\x67"
_ISO_BOXES = {b"ftyp", b"moov", b"mdat", b"free", b"skip", b"wide", b"moof", b"uuid", b"sidx"}
_START_CODES = (b"\x00\x00\x00\x01", b"\x00\x00\x01")
_TIMED_MPEG = (b"\x00\x00\x01\xba", b"\x00\x00\x01\xb3")  # program stream, MPEG-1 and 2
_TRIMMED_S = 0.05  # an edit list that leaves out less: a sound's lead, or three pictures at most


def is_bare_stream(path: Path) -> bool:
    """Whether it is H.264, H.265 or MPEG-4 as an encoder puts it out: in no container, so no times.

    Such a file begins with a start code; MPEG-1 and MPEG-2, which begin alike, tell their times or
    their rate.
    """
    with path.open("rb") as file:
        head = file.read(8)
    is_of_another = head.startswith(_TIMED_MPEG) or head[4:] in _ISO_BOXES  # large `mdat` in front
    return head.startswith(_START_CODES) and not is_of_another


def is_cut_off(path: Path) -> bool:
    """True when an MP4/MOV, MKV/WebM or AVI file is shorter than it says; False when unknown.

    A transport stream does not say: one that ends within a packet was cut off.
    """
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
        packet_bytes = _transport_packet_bytes(file)
    return packet_bytes > 0 and size % packet_bytes > 0


def what_is_counted(path: Path) -> Literal["pictures", "periods"] | None:
    """What the number of pictures that is stored in a file counts.

    MP4 and MOV store how many pictures there are; of one that an edit list trims, not all are
    shown. AVI stores how many of its rate's periods there are, with a picture in each or without.
    Others store none: it is then made up of duration and rate, and of sound that lasts longer.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(12)
        if head[:4] == b"RIFF":
            return "periods"
        try:
            if head[4:8] in _ISO_BOXES and _iso_shows_all(file, size):
                return "pictures"
        except (LookupError, ValueError, ArithmeticError, struct.error):
            return None  # of a damaged index nothing is believed
    return None


def _transport_packet_bytes(file: BinaryIO) -> int:
    """188, or a camcorder's 192, by the sync bytes of three; 0 of another container."""
    head = file.read(3 * 192)
    found = [length for length, sync in ((188, 0), (192, 4)) if head[sync::length][:3] == b"GGG"]
    return found[0] if found else 0


def _iso_boxes(file: BinaryIO, at: int, end: int) -> Iterator[tuple[bytes, int, int]]:
    """Type of each box, where its content begins, where it ends (ISO/IEC 14496-12, 4.2).

    One whose size cannot be is the last, and ends beyond `end`.
    """
    while at < end:
        file.seek(at)
        header = file.read(16)
        length, kind = struct.unpack(">I4s", header[:8]) if len(header) >= 8 else (2, b"")
        content = at + 8
        if length == 1 and len(header) == 16:
            (length,) = struct.unpack_from(">Q", header, 8)
            content += 8
        if length == 0:  # to the end
            length = end - at
        at = at + length if length >= content - at else end + 1
        yield kind, content, at


def _iso_is_cut_off(file: BinaryIO, size: int) -> bool:
    """A box that ends beyond the file, or none that is the index."""
    boxes = list(_iso_boxes(file, 0, size))
    return boxes[-1][2] > size or b"moov" not in {kind for kind, _, _ in boxes}


def _iso_contents(file: BinaryIO, at: int, end: int, *kinds: bytes) -> Iterator[tuple[int, int]]:
    """Where the contents of boxes within boxes of these types begin and end."""
    for kind, begin, stop in _iso_boxes(file, at, end):
        if kind == kinds[0] and kinds[1:]:
            yield from _iso_contents(file, begin, stop, *kinds[1:])
        elif kind == kinds[0]:
            yield begin, stop


def _iso_shows_all(file: BinaryIO, size: int) -> bool:
    """False where pictures are counted elsewhere (fragments), or an edit list leaves some out."""
    moovs = list(_iso_contents(file, 0, size, b"moov"))
    fragmented = any(list(_iso_contents(file, *moov, b"mvex")) for moov in moovs)
    return not fragmented and not any(_iso_is_trimmed(file, *moov) for moov in moovs)


def _iso_is_trimmed(file: BinaryIO, at: int, end: int) -> bool:
    """Whether an edit list (ISO/IEC 14496-12, 8.6.6) of a movie leaves out a part of a track."""
    ((movie_at, _),) = _iso_contents(file, at, end, b"mvhd")
    per_s, _ = _iso_scale(file, movie_at)
    for track in _iso_contents(file, at, end, b"trak"):
        ((media_at, _),) = _iso_contents(file, *track, b"mdia", b"mdhd")
        media_per_s, media = _iso_scale(file, media_at)
        for edits in _iso_contents(file, *track, b"edts", b"elst"):
            if media / media_per_s - _iso_edited(file, *edits) / per_s > _TRIMMED_S:
                return True
    return False


def _iso_scale(file: BinaryIO, at: int) -> tuple[int, int]:
    """Units of time in a second, and how many of them `mvhd` or `mdhd` says that it lasts."""
    file.seek(at)
    box = file.read(32)
    form, begin = (">IQ", 20) if box[0] == 1 else (">II", 12)
    per_s, duration = struct.unpack_from(form, box, begin)
    return per_s, duration


def _iso_edited(file: BinaryIO, at: int, end: int) -> int:
    """How long the edits of an `elst` last that show something, in the movie's units."""
    file.seek(at)
    box = file.read(end - at)
    form = struct.Struct(">QqI" if box[0] == 1 else ">IiI")
    whole = (len(box) - 8) // form.size * form.size
    return sum(span for span, media_at, _ in form.iter_unpack(box[8 : 8 + whole]) if media_at >= 0)


def _matroska_end(file: BinaryIO) -> int:
    """Where the segment ends by RFC 9559; 0 when it was written without a size (live)."""
    at = 0
    while True:
        file.seek(at)
        header = file.read(16)
        if len(header) < 6:
            return 0
        id_length = 9 - header[0].bit_length()
        if id_length > 4:
            return 0
        length_length = 9 - header[id_length].bit_length() if header[id_length] else 9
        if length_length > 8:
            return 0
        raw = int.from_bytes(header[id_length : id_length + length_length])
        length = raw & ((1 << 7 * length_length) - 1)
        unknown = length == (1 << 7 * length_length) - 1
        end = at + id_length + length_length + length
        if header[:id_length] == _EBML_SEGMENT:
            return 0 if unknown else end
        at = end

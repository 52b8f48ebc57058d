"""What a picture file says of itself in its first bytes, before anything is decoded."""

from __future__ import annotations

import struct
from dataclasses import dataclass

MIN_SIDE = 64
_BITS_PER_SAMPLE = 258
"""Number of the tag of TIFF."""


@dataclass(frozen=True, slots=True)
class PictureHeader:
    """What a file says of itself: format, size in pixels as stored (before any EXIF turn), whether it ends early, and
    bits of one channel of a pixel.
    """

    format: str
    width: int
    height: int
    truncated: bool
    bits: int = 8

    @property
    def decoded_bytes(self) -> int:
        """Memory that its three channels take once decoded."""
        return 3 * self.width * self.height * -(-max(self.bits, 8) // 8)


def read_header(content: bytes) -> PictureHeader | None:
    """Format, size and completeness from the bytes of a picture file; None for anything that is no known picture."""
    try:
        if content.startswith(b"\xff\xd8\xff"):
            return _jpeg_header(content)
        if content.startswith(b"\x89PNG\r\n\x1a\n"):
            return _png_header(content)
        if content.startswith(b"BM"):
            return _bmp_header(content)
        if content[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            return _tiff_header(content)
        if content[:4] == b"RIFF" and content[8:12] == b"WEBP":
            return _webp_header(content)
    except (struct.error, IndexError):
        return PictureHeader("picture", MIN_SIDE, MIN_SIDE, truncated=True)
    return None


def _jpeg_header(content: bytes) -> PictureHeader:
    position, width, height = 2, MIN_SIDE, MIN_SIDE
    while position + 4 <= len(content):
        if content[position] != 0xFF:
            break
        marker = content[position + 1]
        if marker == 0xFF or marker == 0x01 or 0xD0 <= marker <= 0xD7:  # fill byte, or a marker without a length
            position += 1 if marker == 0xFF else 2
            continue
        (length,) = struct.unpack_from(">H", content, position + 2)
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", content, position + 5)
        if marker == 0xDA:  # in scan data every 0xFF is stuffed, so the end marker stands only at the end
            return PictureHeader("JPEG", width, height, truncated=content.find(b"\xff\xd9", position) < 0)
        position += 2 + length
    return PictureHeader("JPEG", width, height, truncated=True)


def _png_header(content: bytes) -> PictureHeader:
    width, height, bits = struct.unpack_from(">IIB", content, 16)
    position, complete = 8, False
    while position + 12 <= len(content):
        (length,) = struct.unpack_from(">I", content, position)
        complete = content[position + 4 : position + 8] == b"IEND"
        if complete:
            break
        position += 12 + length
    return PictureHeader("PNG", width, height, truncated=not complete, bits=bits)


def _bmp_header(content: bytes) -> PictureHeader:
    offset, header_size = struct.unpack_from("<II", content, 10)
    if header_size == 12:
        width, height, _, bits = struct.unpack_from("<HHHH", content, 18)
        compression = 0
    else:
        width, height, _, bits, compression = struct.unpack_from("<iiHHI", content, 18)
    width, height = abs(width), abs(height)
    needed = offset + height * ((width * bits + 31) // 32 * 4) if compression in (0, 3) else offset
    return PictureHeader("BMP", width, height, truncated=len(content) < needed)


def _tiff_header(content: bytes) -> PictureHeader:
    order = "<" if content[:2] == b"II" else ">"
    if content[2:4] in (b"+\0", b"\0+"):  # BigTIFF
        (offset,) = struct.unpack_from(f"{order}Q", content, 8)
        (count,) = struct.unpack_from(f"{order}Q", content, offset)
        start, size, value_at = offset + 8, 20, 12
    else:
        (offset,) = struct.unpack_from(f"{order}I", content, 4)
        (count,) = struct.unpack_from(f"{order}H", content, offset)
        start, size, value_at = offset + 2, 12, 8
    values, bits = {}, 8
    for index in range(min(count, 1000)):
        tag, kind = struct.unpack_from(f"{order}HH", content, start + index * size)
        if tag in (256, 257):
            (values[tag],) = struct.unpack_from(
                f"{order}{'H' if kind == 3 else 'I'}", content, start + index * size + value_at
            )
        elif tag == _BITS_PER_SAMPLE:
            bits = _first_short(content, order, start + index * size + value_at, value_at // 2)
    if len(values) < 2:
        return PictureHeader("TIFF", MIN_SIDE, MIN_SIDE, truncated=True)
    return PictureHeader("TIFF", values[256], values[257], truncated=False, bits=bits)


def _first_short(content: bytes, order: str, value_at: int, room: int) -> int:
    """First of the 16-bit numbers of a TIFF tag: in the tag itself where they find room (bytes), else elsewhere."""
    letter = "I" if room == 4 else "Q"
    (count,) = struct.unpack_from(f"{order}{letter}", content, value_at - room)
    (at,) = struct.unpack_from(f"{order}{letter}", content, value_at) if 2 * count > room else (value_at,)
    (first,) = struct.unpack_from(f"{order}H", content, at)
    return int(first)


def _webp_header(content: bytes) -> PictureHeader:
    (riff_size,) = struct.unpack_from("<I", content, 4)
    kind = content[12:16]
    if kind == b"VP8X":
        width = int.from_bytes(content[24:27], "little") + 1
        height = int.from_bytes(content[27:30], "little") + 1
    elif kind == b"VP8L":
        (packed,) = struct.unpack_from("<I", content, 21)
        width, height = (packed & 0x3FFF) + 1, (packed >> 14 & 0x3FFF) + 1
    else:
        width, height = (value & 0x3FFF for value in struct.unpack_from("<HH", content, 26))
    return PictureHeader("WebP", width, height, truncated=len(content) < riff_size + 8)

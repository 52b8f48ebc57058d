"""The one door for names that go out: to the file system, a terminal, a spreadsheet, JSON.

Names come from files, archives and other programs and may hold anything: control characters that command a terminal,
marks that turn the direction of text, bytes that are no text, formulas. Where one leaves the program, it is made
harmless here.
"""

from __future__ import annotations

import re
import zlib

_COMMANDING = re.compile("[\x00-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
"""Control characters (C0, C1), line separators, marks of direction (Unicode Standard Annex 9), and halves of surrogate
pairs, which stand for bytes that are no text.
"""
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a spreadsheet takes for the beginning of a formula, as OWASP's page on CSV injection lists it."""
MOST_STEM_BYTES = 200
"""File systems take 255 bytes; the longest ending that is added to a frame's name, and a number, have 40."""


def show(text: str) -> str:
    """A text on one line of a terminal, with everything that would command it as an escape such as ``\\x1b``."""
    return _COMMANDING.sub(lambda found: _escape(found[0]), text)


def _escape(character: str) -> str:
    known = {"\n": "\\n", "\r": "\\r", "\t": "\\t"}
    code = ord(character)
    return known.get(character) or (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}")


def show_json(text: str, only_ascii: bool = False) -> str:
    """JSON text with the same content that commands no terminal, and that one without Unicode can show."""
    escaped = _COMMANDING.sub(lambda found: f"\\u{ord(found[0]):04x}", text)
    return re.sub(r"[^\x00-\x7f]", _escape_json, escaped) if only_ascii else escaped


def _escape_json(found: re.Match[str]) -> str:
    code = ord(found[0])
    if code < 0x10000:
        return f"\\u{code:04x}"
    code -= 0x10000
    return f"\\u{0xD800 + (code >> 10):04x}\\u{0xDC00 + (code & 0x3FF):04x}"


def as_text(name: str) -> str:
    """A name that any encoding can write: bytes that are no text as escapes such as ``\\udce9``."""
    return name.encode("utf-8", "backslashreplace").decode("utf-8")


def as_cell(text: str) -> str:
    """A text for a cell of a table that a spreadsheet opens: shown, never calculated."""
    safe = as_text(text)
    return f"'{safe}" if safe.startswith(_FORMULA) else safe


def picture_name(frame_id: str, path: str | None, time_s: float | None = None) -> str | None:
    """Name of a frame's picture in files of other programs: that of its file, or with the frame's id where pictures of
    several folders have one name, or it is at a time of a video; None where there is no file.
    """
    if time_s is not None or not path:
        return None if time_s is None else f"{frame_id}.jpg"
    name = path.replace("\\", "/").rpartition("/")[2]
    stem, dot, suffix = name.rpartition(".")
    is_other = frame_id != stem and frame_id.endswith(stem)
    return f"{frame_id}{dot}{suffix}" if is_other else name


def from_cell(text: str) -> str:
    """The text of a cell that :func:`as_cell` wrote."""
    return text[1:] if text[:1] == "'" and text[1:].startswith(_FORMULA) else text


def as_stem(name: str) -> str:
    """A name as that of a frame and of its files: neither folders nor commands in it, not too long; never empty."""
    text = _COMMANDING.sub("_", as_text(name)).replace("/", "_")
    if not text.strip(" ."):
        text = text.replace(".", "_").strip() or "frame"
    content = text.encode()
    if len(content) <= MOST_STEM_BYTES:
        return text
    mark = f"-{zlib.crc32(content):08x}"
    return content[: MOST_STEM_BYTES - len(mark)].decode(errors="ignore") + mark

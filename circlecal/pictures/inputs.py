"""What a user may name as inputs: files and folders, patterns, numbered sequences, lists of them, and videos."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from circlecal.errors import InputError
from circlecal.pictures.files import OWN_FOLDERS, PICTURE_SUFFIXES
from circlecal.pictures.remote import is_url

VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts", ".m2ts", ".mts", ".wmv", ".flv"),
    *(".vob", ".mxf", ".ogv", ".3gp"),
)
LIST_SUFFIX = ".txt"
ANNOTATION_SUFFIXES = (".json", ".xml", ".jsonl", ".homographymatrix")
"""Of files that hold annotations, cameras or results."""
_PATTERN = re.compile(r"[*?\[]")
_NUMBER = re.compile(r"%(?:0(\d+))?d")
_TRANSPORT_STREAM_BYTE = b"G"


@dataclass(frozen=True, slots=True)
class Inputs:
    """What was named, each once: pictures, annotation files and folders of them; videos; and pictures by URL."""

    paths: list[Path]
    videos: list[Path]
    urls: list[str]


def expand_inputs(inputs: Sequence[str | Path]) -> Inputs:
    """Everything that was named.

    Understood are pictures, annotation files, videos and folders of them; patterns such as ``day1/*.jpg``; numbered
    sequences such as ``frame_%05d.png``; URLs of pictures; and lists, ``@names`` or ``names.txt``, with one of these
    per line, relative to its folder or the working folder (empty lines and lines with # are passed over).

    Raises
    ------
    InputError
        A pattern, a sequence or a list without a file, or a list that cannot be read.
    """
    paths: list[Path] = []
    videos: list[Path] = []
    urls: list[str] = []
    for given in inputs:
        for path in _expanded(str(given)):
            if isinstance(path, str):
                urls.append(path)
            elif path.is_dir():
                held, others = _held(path)
                videos += held
                if others or not held:
                    paths.append(path)
            elif path.suffix.lower() in VIDEO_SUFFIXES:
                videos.append(path)
            else:
                paths.append(path)
    distinct = list({path.resolve(): path for path in reversed(videos)}.values())[::-1]
    return Inputs(list(dict.fromkeys(paths)), distinct, list(dict.fromkeys(urls)))


def _expanded(text: str, within: bool = False) -> Iterator[Path | str]:
    """Paths, and URLs as text."""
    given = Path(text)
    if is_url(text):
        yield text
    elif text.startswith("@"):
        yield from _listed(Path(text[1:]), within)
    elif given.exists():
        if given.suffix.lower() == LIST_SUFFIX and given.is_file():
            yield from _listed(given, within)
        else:
            yield given
    elif _NUMBER.search(given.name):
        yield from _sequence(given)
    elif _PATTERN.search(text):
        root = Path(given.anchor)
        found = sorted(root.glob(str(given.relative_to(given.anchor))), key=lambda path: _natural(str(path)))
        if not found:
            raise InputError(f"{given}: no file fits this pattern")
        yield from found
    else:
        yield given


def _listed(path: Path, within: bool) -> Iterator[Path | str]:
    if within:
        raise InputError(f"{path}: is a list inside a list; name its files instead")
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: is no list of files: it is not UTF-8 text") from error
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; a list has one path per line") from error
    named = [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not named:
        raise InputError(f"{path}: lists nothing; a list has one path per line")
    for number, line in enumerate(lines, start=1):
        name = line.strip()
        if not name or name.startswith("#"):
            continue
        if is_url(name):
            yield name
            continue
        beside = path.parent / name
        found = beside if beside.exists() or _PATTERN.search(name) or _NUMBER.search(name) else Path(name)
        if path.is_absolute():
            found = found.absolute()
        if not found.exists() and found != beside:
            raise InputError(f"{path}, line {number}: {name}: no such file or folder")
        yield from _expanded(str(found), within=True)


def _sequence(given: Path) -> Iterator[Path]:
    """Files of ``name_%05d.png``, by number."""
    match = _NUMBER.search(given.name)
    if match is None or not given.parent.is_dir():
        raise InputError(f"{given}: no such file or folder")
    digits = f"\\d{{{int(match[1])},}}" if match[1] else "\\d+"
    before, after = given.name[: match.start()], given.name[match.end() :]
    fitting = re.compile(f"{re.escape(before)}({digits}){re.escape(after)}")
    found = [(int(fits[1]), path) for path in given.parent.iterdir() if (fits := fitting.fullmatch(path.name))]
    if not found:
        raise InputError(f"{given}: no file fits this sequence")
    yield from (path for _, path in sorted(found))


def _natural(name: str) -> list[tuple[int, int | str]]:
    """Sorts numbers inside names by their value."""
    return [(0, int(part)) if part.isdigit() else (1, part) for part in re.split(r"([0-9]+)", name) if part]


def _held(folder: Path) -> tuple[list[Path], bool]:
    """Videos of a folder at any depth, and whether it holds pictures or annotations."""
    videos: list[Path] = []
    others = False
    for root, folders, names in os.walk(folder):
        folders[:] = sorted(name for name in folders if not name.startswith(".") and name not in OWN_FOLDERS)
        for name in sorted(names):
            path = Path(root, name)
            suffix = path.suffix.lower()
            if (
                suffix in VIDEO_SUFFIXES
                and not name.startswith(".")
                and (suffix != ".ts" or _is_transport_stream(path))
            ):
                videos.append(path)
            others |= suffix in (*PICTURE_SUFFIXES, *ANNOTATION_SUFFIXES)
    return videos, others


def _is_transport_stream(path: Path) -> bool:
    """Not TypeScript, which has the same suffix."""
    with path.open("rb") as file:
        return file.read(1) == _TRANSPORT_STREAM_BYTE


def absolute_input(text: str) -> str:
    """The same input for a process with another working folder."""
    if is_url(text):
        return text
    return f"@{Path(text[1:]).absolute()}" if text.startswith("@") else str(Path(text).absolute())

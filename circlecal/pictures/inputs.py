"""What a user may name as inputs: files and folders, patterns, numbered sequences, lists of them, and videos."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from circlecal.errors import InputError
from circlecal.files import exists, is_folder, list_folder, open_regular, read_text, real_path
from circlecal.pictures.files import PICTURE_SUFFIXES, natural_order, walk
from circlecal.pictures.remote import is_url, require_url

VIDEO_SUFFIXES = (
    *(".mp4", ".m4v", ".mov", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".ts", ".m2ts", ".mts", ".wmv", ".flv"),
    *(".vob", ".mxf", ".ogv", ".3gp"),
)
LIST_SUFFIX = ".txt"
_PATTERN = re.compile(r"[*?\[]")
_NUMBER = re.compile(r"%(?:0([0-9]{1,9}))?d")
_TRANSPORT_STREAM_BYTE = b"G"
_MAX_LIST_BYTES = 32 << 20
"""Of a list: room for some 300,000 paths."""
_LONGEST_PATH = 4096
"""Of Linux, characters; other systems take fewer."""
_LONGEST_NUMBER = 18
"""Digits of a frame's number."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What was named, each once: pictures, annotation files and folders of them; videos; and pictures by URL."""

    paths: list[Path]
    videos: list[Path]
    urls: list[str]


def expand_inputs(inputs: Sequence[str | Path], annotation_suffixes: Collection[str] = ()) -> Inputs:
    """Everything that was named; a folder of videos is among the paths only where it holds pictures, or files of the
    annotation suffixes.

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
        for path in _expand(str(given)):
            if isinstance(path, str):
                urls.append(path)
            elif is_folder(path):
                files = list(walk(path))
                held = [file for file in files if is_video(file)]
                videos += held
                if not held or any(file.suffix.lower() in (*PICTURE_SUFFIXES, *annotation_suffixes) for file in files):
                    paths.append(path)
            elif path.suffix.lower() in VIDEO_SUFFIXES:
                videos.append(path)
            else:
                paths.append(path)
    distinct = list({real_path(path): path for path in reversed(videos)}.values())[::-1]
    return Inputs(list(dict.fromkeys(paths)), distinct, list(dict.fromkeys(urls)))


def _expand(text: str, within: bool = False) -> Iterator[Path | str]:
    """What a text names: paths, and URLs as text."""
    given = Path(text)
    if len(text) > _LONGEST_PATH:  # patterns take a time that grows with the square of their length
        raise InputError(f"{text[:60]}...: is longer ({len(text)} characters) than any path")
    if is_url(text):
        require_url(text)
        yield text
    elif text.startswith("@"):
        yield from _read_list(Path(text[1:]), within)
    elif exists(given):
        if given.suffix.lower() == LIST_SUFFIX and not is_folder(given):
            yield from _read_list(given, within)
        else:
            yield given
    elif _NUMBER.search(given.name):
        yield from _find_sequence(given)
    elif _PATTERN.search(text):
        root = Path(given.anchor)
        try:
            found = sorted(root.glob(str(given.relative_to(given.anchor))), key=lambda path: natural_order(str(path)))
        except (OSError, ValueError, RecursionError, re.error) as error:
            raise InputError(f"{given}: is no pattern of files: {error}") from error
        if not found:
            _require_readable(given)
            raise InputError(f"{given}: no file fits this pattern")
        yield from found
    else:
        yield given


def _require_readable(pattern: Path) -> None:
    """See that the folder in which the files of a pattern lie can be read, since a search takes it for an empty one.

    Raises
    ------
    InputError
        It cannot.
    """
    fixed = itertools.takewhile(lambda part: not _PATTERN.search(part), pattern.parts[:-1])
    folder = Path(*fixed)
    if is_folder(folder):
        list_folder(folder)


def _read_list(path: Path, within: bool) -> Iterator[Path | str]:
    if within:
        raise InputError(f"{path}: is a list inside a list; name its files instead")
    lines = read_text(path, _MAX_LIST_BYTES).splitlines()
    named = [line.strip() for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not named:
        raise InputError(f"{path}: lists nothing; a list has one path per line")
    for number, line in enumerate(lines, start=1):
        name = line.strip()
        if not name or name.startswith("#"):
            continue
        if is_url(name):
            require_url(name)
            yield name
            continue
        beside = path.parent / name
        is_pattern = bool(_PATTERN.search(name) or _NUMBER.search(name))
        found = beside if is_pattern or exists(beside) else Path(name)
        if path.is_absolute():
            found = found.absolute()
        if not (is_pattern or exists(found)):
            raise InputError(f"{path}, line {number}: {name}: no such file or folder")
        yield from _expand(str(found), within=True)


def _find_sequence(given: Path) -> Iterator[Path]:
    """Files of ``name_%05d.png``, by number."""
    match = _NUMBER.search(given.name)
    if match is None or not is_folder(given.parent):
        raise InputError(f"{given}: no such file or folder")
    width = int(match[1] or 1)
    if width > _LONGEST_NUMBER:
        raise InputError(f"{given}: asks for numbers of {width} digits; at most {_LONGEST_NUMBER}")
    digits = f"[0-9]{{{width},{_LONGEST_NUMBER}}}"
    before, after = given.name[: match.start()], given.name[match.end() :]
    fitting = re.compile(f"{re.escape(before)}({digits}){re.escape(after)}")
    found = [(int(fits[1]), path) for path in list_folder(given.parent) if (fits := fitting.fullmatch(path.name))]
    if not found:
        raise InputError(f"{given}: no file fits this sequence")
    yield from (path for _, path in sorted(found))


def is_video(path: Path) -> bool:
    """Whether a file is a video by its suffix, which TypeScript shares with transport streams."""
    suffix = path.suffix.lower()
    if suffix != ".ts":
        return suffix in VIDEO_SUFFIXES
    try:
        with open_regular(path) as descriptor:
            return os.read(descriptor, 1) == _TRANSPORT_STREAM_BYTE
    except InputError:
        return False


def absolute_input(text: str) -> str:
    """An input as a process with another working folder must name it."""
    if is_url(text):
        return text
    return f"@{Path(text[1:]).absolute()}" if text.startswith("@") else str(Path(text).absolute())

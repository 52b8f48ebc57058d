"""Which picture a frame of an annotation file is of, by the path that the file names."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable
from urllib.parse import unquote

_UPLOAD_MARK = re.compile(r"(?<=/)[0-9a-f]{8}-(?=[^/]+$)")
_DEEPEST = 8
"""Folders of a path that are compared; more would only cost time."""


def picture_path(name: str) -> str:
    """Path of a picture that a file names, as its owner knows it.

    Addresses lose what follows the name. Of Label Studio's the local files (``/data/local-files/?d=pics%2Fa.jpg``) are
    what they serve, and uploads (``/data/upload/1/ab12cd34-a.jpg``) lose the mark that it puts before their names.
    """
    path, _, query = name.replace("\\", "/").partition("?")
    if path.endswith("local-files/") and query.startswith("d="):
        return unquote(query[2:].partition("&")[0]).replace("\\", "/")
    if "://" not in path:
        path = name.replace("\\", "/")
    return _UPLOAD_MARK.sub("", path) if "/upload/" in path else path


def path_parts(name: str) -> tuple[str, ...]:
    """Folders and name of a path of whichever system, without drives, and without steps up out of a folder."""
    parts = name.replace("\\", "/").split("/")
    return tuple(part for part in parts if part.strip(".") and not part.endswith(":"))[-_DEEPEST:]


def path_endings(name: str) -> list[str]:
    """A path and what is left of it without its first folders, the longest first."""
    parts = path_parts(name)
    return ["/".join(parts[k:]) for k in range(len(parts))]


def shared_endings(names: Iterable[str]) -> frozenset[str]:
    """Endings that paths of several pictures have, so that they name none of them."""
    paths = {picture_path(name) for name in names}
    counts = Counter(ending for path in paths for ending in path_endings(path))
    return frozenset(ending for ending, count in counts.items() if count > 1)


def shared_depth(first: tuple[str, ...], second: tuple[str, ...]) -> int:
    """How many parts at their ends two paths have in common."""
    alike = [a == b for a, b in zip(reversed(first), reversed(second), strict=False)]
    return alike.index(False) if False in alike else len(alike)

"""Pictures named by a URL: ``http(s)://`` by the standard library, ``s3://``, ``gs://`` and the like by fsspec."""

from __future__ import annotations

import http.client
import re
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Sequence
from pathlib import PurePosixPath

from circlecal.errors import InputError, MissingExtraError
from circlecal.pictures.files import distinct_names

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_SECONDS = 60
_MOST_BYTES = 1 << 30


def is_url(text: str) -> bool:
    """Whether a text is a URL and not a path."""
    return _URL.match(text) is not None


def url_names(urls: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Ids of frames that URLs name: the last part of the path without its suffix, distinct among each other."""
    stems = [PurePosixPath(urllib.parse.unquote(urllib.parse.urlsplit(url).path)).stem or "frame" for url in urls]
    return distinct_names([*taken, *stems])[len(taken) :]


def read_url(url: str) -> bytes:
    """Content of a URL.

    Raises
    ------
    InputError
        It cannot be fetched.
    MissingExtraError
        Neither http nor https, and fsspec is not installed.
    """
    try:
        if url.lower().startswith(("http://", "https://")):
            with urllib.request.urlopen(url, timeout=_SECONDS) as answer:
                return bytes(answer.read(_MOST_BYTES))
        return _read_by_fsspec(url)
    except urllib.error.HTTPError as error:
        raise InputError(f"{url}: cannot be fetched: {error.code} {error.reason}") from error
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        raise InputError(f"{url}: cannot be fetched: {' '.join(str(reason).split())}") from error


def _read_by_fsspec(url: str) -> bytes:
    try:
        import fsspec
    except ImportError as error:
        raise MissingExtraError("fsspec", "distributed") from error
    try:
        with fsspec.open(url, "rb") as file:
            return bytes(file.read(_MOST_BYTES))
    except ImportError as error:  # fsspec's own line names the package of this protocol
        raise InputError(f"{url}: cannot be fetched: {error}") from error

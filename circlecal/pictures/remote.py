"""Pictures named by a URL: ``http(s)://`` by the standard library, what fsspec knows of :data:`PROTOCOLS` by it."""

from __future__ import annotations

import http.client
import ipaddress
import re
import socket
import time
import urllib.error
import urllib.parse
import urllib.request
from collections.abc import Sequence
from pathlib import PurePosixPath
from typing import IO, Any

from circlecal.errors import InputError, MissingExtraError
from circlecal.files import size_in_words
from circlecal.pictures.files import distinct_names
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig, suggest_limit

_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
_WEB = ("http", "https")
PROTOCOLS = (*_WEB, "s3", "gs", "az", "file")
"""All others are refused: among those that fsspec knows are archives, caches and shells on other machines."""
_RESUMPTIONS = 3
"""How often the rest of a picture is asked for after its connection ended early."""
_BLOCK = 1 << 16


def is_url(text: str) -> bool:
    """Whether a text is a URL and not a path."""
    return _URL.match(text) is not None


def require_url(url: str) -> None:
    """See that a URL is one that :func:`read_url` fetches.

    Raises
    ------
    InputError
        Another protocol, one URL inside another, no host, or no URL at all.
    """
    try:
        parts = urllib.parse.urlsplit(url)
        named = parts.hostname or ""
        _ = parts.port
    except ValueError as error:
        raise InputError(f"{url}: is no URL: {error}") from error
    protocol = parts.scheme.lower()
    if protocol not in PROTOCOLS:
        raise InputError(f"{url}: {protocol}:// is not read; known: {', '.join(f'{p}://' for p in PROTOCOLS)}")
    if "::" in url.replace(parts.netloc, "", 1):
        raise InputError(f"{url}: is a chain of URLs, which is not read; copy the picture to a folder")
    if protocol != "file" and not named:
        raise InputError(f"{url}: names no server; a URL looks like https://server/picture.jpg")
    if any(ord(character) <= 0x20 for character in url) and protocol in _WEB:
        raise InputError(f"{url}: holds a space or a control character; write it as %20 and the like")


def url_names(urls: Sequence[str], taken: Sequence[str] = ()) -> list[str]:
    """Ids of frames that URLs name: the last part of the path without its suffix, distinct among each other."""
    stems = [PurePosixPath(urllib.parse.unquote(urllib.parse.urlsplit(url).path)).stem or "frame" for url in urls]
    return distinct_names([*taken, *stems])[len(taken) :]


def read_url(url: str, limits: LimitsConfig = DEFAULT_LIMITS) -> bytes:
    """Content of a URL.

    A server may send it on to another address, but not from the public network to a private one and not to another
    protocol. What ends early is resumed.

    Raises
    ------
    InputError
        It cannot be fetched, in the time and size that the limits allow.
    MissingExtraError
        Neither http nor https, and fsspec is not installed.
    """
    require_url(url)
    try:
        return _read_by_http(url, limits) if url.lower().startswith("http") else _read_by_fsspec(url, limits)
    except urllib.error.HTTPError as error:
        raise InputError(f"{url}: cannot be fetched: {error.code} {error.reason}") from error
    except TimeoutError as error:
        limit = f"not there after {limits.server_seconds:g} s; raise limits.server_seconds or try again"
        raise InputError(f"{url}: cannot be fetched: {limit}") from error
    except (OSError, ValueError, http.client.HTTPException) as error:
        reason = getattr(error, "reason", None) or error
        if isinstance(reason, TimeoutError):
            reason = f"no connection after {limits.server_seconds:g} s; raise limits.server_seconds or try again"
        raise InputError(f"{url}: cannot be fetched: {' '.join(str(reason).split())}") from error


class _Redirection(urllib.request.HTTPRedirectHandler):
    """Follows a server to another address, unless that leads behind the user's back into a private network."""

    def __init__(self, from_private: bool) -> None:
        self._from_private = from_private

    def redirect_request(
        self, req: urllib.request.Request, fp: IO[bytes], code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        parts = urllib.parse.urlsplit(newurl)
        if parts.scheme.lower() not in _WEB:
            raise ValueError(f"the server sends on to {newurl}, which is neither http nor https")
        if not self._from_private and _is_private(parts.hostname or ""):
            raise ValueError(f"the server sends on to {newurl}, a private address")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _is_private(host: str) -> bool:
    """Whether a host is on this machine or in a private network; True where its address cannot be found."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except (OSError, UnicodeError):
        return True
    return any(not ipaddress.ip_address(str(entry[4][0]).partition("%")[0]).is_global for entry in found)


def _read_by_http(url: str, limits: LimitsConfig) -> bytes:
    end = time.monotonic() + limits.server_seconds
    host = urllib.parse.urlsplit(url).hostname or ""
    opener = urllib.request.build_opener(_Redirection(_is_private(host)))
    content = bytearray()
    for _ in range(1 + _RESUMPTIONS):
        asked = {"Range": f"bytes={len(content)}-"} if content else {}
        with opener.open(urllib.request.Request(url, headers=asked), timeout=limits.server_seconds) as answer:
            if answer.status != http.HTTPStatus.PARTIAL_CONTENT:
                content.clear()
            stated = answer.headers.get("Content-Length", "")
            expected = len(content) + int(stated) if stated.isdigit() else None
            if expected is not None and expected > limits.max_bytes:
                raise ValueError(_too_large(limits))
            while block := _read_block(answer):
                content += block
                if len(content) > limits.max_bytes:
                    raise ValueError(_too_large(limits))
                if time.monotonic() > end:
                    raise TimeoutError
        if expected is None or len(content) >= expected:
            return bytes(content)
    raise ValueError(f"the connection ended after {len(content)} of {expected} bytes, again and again")


def _read_block(answer: Any) -> bytes:
    """The next bytes of an answer as they come; none where the connection ends."""
    try:
        return bytes(answer.read1(_BLOCK))
    except (http.client.IncompleteRead, ConnectionError):
        return b""


def _too_large(limits: LimitsConfig) -> str:
    return f"it has more than {size_in_words(limits.max_bytes)}; {suggest_limit('max_bytes')}"


def _read_by_fsspec(url: str, limits: LimitsConfig) -> bytes:
    try:
        import fsspec
    except ImportError as error:
        raise MissingExtraError("fsspec", "distributed") from error
    try:
        with fsspec.open(url, "rb") as file:
            content = bytes(file.read(limits.max_bytes + 1))
    except ImportError as error:  # fsspec's own line names the package of this protocol
        raise InputError(f"{url}: cannot be fetched: {error}") from error
    if len(content) > limits.max_bytes:
        raise ValueError(_too_large(limits))
    return content

"""Port and token of a folder's page, kept between starts: a page that is open goes on when its server is started again.

They are kept for this user alone, in ``circlecal`` below ``XDG_STATE_HOME`` (else ``~/.local/state``), not among the
annotations, which people share.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
import secrets
from dataclasses import asdict, dataclass
from pathlib import Path

_TOKEN = re.compile(r"[\w-]{32}")
_TOKEN_BYTES = 24


@dataclass(frozen=True, slots=True)
class PageAddress:
    """Where a page is served: its port, 0 for any free one, and the first part of its path, which nobody else knows."""

    port: int
    token: str


def make_address() -> PageAddress:
    """An address that nobody had before."""
    return PageAddress(0, secrets.token_urlsafe(_TOKEN_BYTES))


def recall_address(folder: Path, part: str | None) -> PageAddress | None:
    """The address at which the page of a folder's annotations, or of a part of it, was served last; None where none is
    known.
    """
    try:
        told = json.loads(_file_of(folder, part).read_text(encoding="utf-8"))
        found = PageAddress(told["port"], told["token"])
    except (OSError, ValueError, KeyError, TypeError, RuntimeError):
        return None
    is_sound = isinstance(found.port, int) and 0 < found.port < 65536 and isinstance(found.token, str)
    return found if is_sound and _TOKEN.fullmatch(found.token) else None


def keep_address(folder: Path, part: str | None, address: PageAddress) -> None:
    """Remember an address; where nothing can be written, the next start has another one."""
    with contextlib.suppress(OSError, RuntimeError):
        path = _file_of(folder, part)
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            json.dump(asdict(address), file)


def _file_of(folder: Path, part: str | None) -> Path:
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    name = os.fsencode(folder.absolute()) + b"\0" + (part or "").encode()
    return Path(state) / "circlecal" / f"workbench-{hashlib.sha256(name).hexdigest()[:16]}.json"

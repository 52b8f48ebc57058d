"""Files that appear whole or not at all."""

from __future__ import annotations

import contextlib
import errno
import os
import tempfile
from collections.abc import Iterable
from pathlib import Path

from circlecal.errors import InputError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file through a temporary one beside it, so that a reader, a crash or a full disk never meets half of it.

    Raises
    ------
    InputError
        One line with the file and what the system said; the old file, if any, is untouched.
    """
    write_atomic_parts(path, (content,))


def write_atomic_parts(path: Path, parts: Iterable[bytes]) -> None:
    """The same for content that comes in parts and need not fit into memory.

    Raises
    ------
    InputError
        As :func:`write_atomic`.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name[:100]}.", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            for part in parts:
                file.write(part)
            file.flush()
            os.fsync(file.fileno())
        Path(temporary).chmod(0o666 & ~_umask())
        Path(temporary).replace(path)
    except OSError as error:
        if temporary is not None:
            with contextlib.suppress(OSError):
                Path(temporary).unlink()
        raise write_error(path, error) from error
    except BaseException:
        if temporary is not None:
            with contextlib.suppress(OSError):
                Path(temporary).unlink()
        raise


def write_error(path: Path, error: OSError) -> InputError:
    """The error for a file that cannot be written."""
    mend = "free space or choose another --out" if error.errno in _FULL else "choose another --out"
    return InputError(f"{path}: cannot be written: {error.strerror or error}; {mend}")


def _umask() -> int:
    current = os.umask(0o022)
    os.umask(current)
    return current

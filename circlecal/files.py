"""Files that appear whole or not at all, and whether a file or folder that a run was given is still the one it was."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from circlecal.errors import InputError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_BLOCK = 1 << 20


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file through a temporary one beside it, so that a reader, a crash or a full disk never meets half of it.

    Raises
    ------
    InputError
        One line with the file and what the system said; the old file, if any, is untouched.
    """
    write_atomic_parts(path, (content,))


def write_atomic_parts(path: Path, parts: Iterable[bytes]) -> None:
    """Write a file as :func:`write_atomic` does, from parts that need not fit into memory together.

    Raises
    ------
    InputError
        As :func:`write_atomic`.
    """
    with replacement(path) as temporary, temporary.open("wb") as file:
        for part in parts:
            file.write(part)
        file.flush()
        os.fsync(file.fileno())


@contextlib.contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """An empty file beside a path, to be written to; it takes the path's place when the block is left without an error.

    Raises
    ------
    InputError
        One line with the file and what the system said; the old file, if any, is untouched.
    """
    temporary: Path | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.name[:100]}.", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except OSError as error:
        raise write_error(path, error) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()


def write_error(path: Path, error: OSError) -> InputError:
    """The error for a file that cannot be written."""
    mend = "free space or choose another --out" if error.errno in _FULL else "choose another --out"
    return InputError(f"{path}: cannot be written: {error.strerror or error}; {mend}")


def prepare_folder(out: Path) -> Path:
    """Make an output folder, so that a run fails before the first frame and not after it.

    Raises
    ------
    InputError
        The folder cannot be made or not be written to.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
        probe = out / ".circlecal-write-test"
        probe.touch()
        probe.unlink()
    except FileExistsError as error:
        raise InputError(f"{out}: is a file, not a folder; choose another --out") from error
    except OSError as error:
        raise write_error(out, error) from error
    return out


def _umask() -> int:
    current = os.umask(0o022)
    os.umask(current)
    return current


def fingerprint(path: Path) -> str:
    """Digest of a file's content, or of the names and sizes of all files in a folder.

    Raises
    ------
    InputError
        It cannot be read.
    """
    digest = hashlib.sha256()
    try:
        if path.is_dir():
            for name, size in sorted(_sizes(path, "")):
                digest.update(f"{name}\0{size}\0".encode(errors="surrogateescape"))
        else:
            with path.open("rb") as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; check its permissions") from error
    return digest.hexdigest()


def _sizes(folder: Path, prefix: str) -> Iterator[tuple[str, int]]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _sizes(Path(entry.path), f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", entry.stat().st_size

"""The one door for files: reading what comes from outside, writing files that appear whole or not at all.

Whatever a name or a file can be (a pipe, a device, an endless or a missing file, a name that no file can have, links
that lead in a circle) is one line that names it, never a hang and never more memory than the limit says.
"""

from __future__ import annotations

import codecs
import contextlib
import csv
import errno
import filecmp
import hashlib
import os
import stat
import tempfile
import time
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from circlecal.errors import InputError, OutputError

_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_BLOCK = 1 << 20
MAX_BYTES = 256 << 20
"""The largest file that is read as a whole, unless the caller says otherwise: an uncompressed picture of 8K has 100 MB,
the annotations of a season some tens.
"""
_DELIMITERS = (",", ";", "\t")
"""Of tables: spreadsheets write semicolons where numbers have a decimal comma, and tabs into what they call text."""
_MOST_NAME_BYTES = 100
"""Of a file's name that the temporary file beside it repeats; file systems take 255 bytes."""
_TEMPORARY = ".circlecal-"
"""In the name of a temporary file, between that of its target and what makes it unique."""
_LEFT_OVER_S = 60.0
"""Age from which on a temporary file that nobody has locked was left over: one is locked a moment after it is made."""


def file_size(path: str | Path) -> int | None:
    """Size of a regular file, bytes; None where there is none."""
    try:
        status = Path(path).stat()
    except (OSError, ValueError):
        return None
    return status.st_size if stat.S_ISREG(status.st_mode) else None


def are_different(first: str | Path, second: str | Path, *, by_content: bool = False) -> bool:
    """Whether two paths name different files: of different sizes, or by content too, which takes time for videos.

    False for what was copied, and for what is missing.
    """
    try:
        one, other = Path(first).stat(), Path(second).stat()
        are_files = stat.S_ISREG(one.st_mode) and stat.S_ISREG(other.st_mode)
        if not are_files or os.path.samestat(one, other):
            return False
        if one.st_size != other.st_size:
            return True
        return by_content and not filecmp.cmp(first, second, shallow=False)
    except (OSError, ValueError):
        return False


def read_file(path: str | Path, most_bytes: int = MAX_BYTES, raise_limit: str = "split it or scale it down") -> bytes:
    """Content of a regular file from outside.

    Parameters
    ----------
    path : path
        The file.
    most_bytes : int
        A larger file is refused before it is read.
    raise_limit : str
        What the user can do about a larger one.

    Raises
    ------
    InputError
        No file can have this name; missing, a folder, a pipe or a device, unreadable, or too large; links that lead in
        a circle.
    """
    with open_regular(path) as descriptor:
        size = os.fstat(descriptor).st_size
        content = b""
        if size <= most_bytes:
            with os.fdopen(os.dup(descriptor), "rb") as file:
                try:
                    content = file.read(most_bytes + 1)  # it may grow, and files of /proc tell no size
                except OSError as error:
                    raise _unreadable(path, error) from error
        if max(size, len(content)) > most_bytes:
            raise InputError(f"{path}: has more than {size_in_words(most_bytes)}; {raise_limit}")
    return content


def read_text(path: str | Path, most_bytes: int = MAX_BYTES) -> str:
    """UTF-8 text of a regular file from outside, without a byte order mark; line ends as they are.

    Raises
    ------
    InputError
        As :func:`read_file`, or no UTF-8.
    """
    try:
        return read_file(path, most_bytes).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        where = f"{error.reason} at byte {error.start}"
        raise InputError(f"{path}: cannot be read: is not UTF-8 text ({where}); save it as UTF-8") from error


def read_lines(path: str | Path, start: int = 0) -> Iterator[bytes]:
    """Lines of a regular file from a byte on, with their ends; the last one may have none.

    Raises
    ------
    InputError
        As :func:`read_file`, or a line that is longer than a file may be.
    """
    with open_regular(path) as descriptor, os.fdopen(os.dup(descriptor), "rb") as file:
        file.seek(start)
        try:
            while line := file.readline(MAX_BYTES + 1):
                if len(line) > MAX_BYTES:
                    raise InputError(f"{path}: has a line of more than {size_in_words(MAX_BYTES)}")
                yield line
        except OSError as error:
            raise _unreadable(path, error) from error


def decode_table(content: bytes, name: str) -> str:
    """Text of a CSV table: UTF-8, or the UTF-16 with a byte order mark that spreadsheets write; line ends as they are.

    Raises
    ------
    InputError
        It is neither, with the line.
    """
    encoding = "utf-16" if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)) else "utf-8-sig"
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        number = 1 + content.count(b"\n", 0, error.start)
        found = f"{error.reason}, 0x{content[error.start]:02x}"
        raise InputError(f"{name}, line {number}: is not UTF-8 text ({found}); save the table as UTF-8") from error


@dataclass(frozen=True, slots=True)
class Table:
    """A CSV table that is read row by row.

    Attributes
    ----------
    columns : tuple of str
        Names of all columns, as they are written.
    places : dict of str to int
        Where the columns are that were wanted.
    delimiter : str
        What separates the cells.
    rows : iterator of (int, list of str)
        Line numbers and all cells; short rows end in empty ones.
    """

    columns: tuple[str, ...]
    places: dict[str, int]
    delimiter: str
    rows: Iterator[tuple[int, list[str]]]


def read_table(lines: Iterable[str], name: str, columns: Sequence[str]) -> Iterator[tuple[int, dict[str, str]]]:
    """Line numbers and rows of a CSV table, with the columns that are wanted; cells that a row lacks are empty.

    Parameters and errors as for :func:`open_table`.
    """
    table = open_table(lines, name, columns)
    for number, cells in table.rows:
        yield number, {column: cells[place] for column, place in table.places.items()}


def open_table(lines: Iterable[str], name: str, columns: Sequence[str], further: Sequence[str] = ()) -> Table:
    """A CSV table by its first line; cells are separated by commas, or by semicolons or tabs as in its first line.

    Parameters
    ----------
    lines : iterable of str
        Of the table with their ends, the first with the names of its columns, in any order among others.
    name : str
        Named in errors.
    columns : sequence of str
        That must be there; one that differs in capitals or by blanks around it is taken where none is exact.
    further : sequence of str
        That may be there.

    Raises
    ------
    InputError
        A column is missing or there twice, or the lines, also later ones, are no table.
    """
    others = iter(lines)
    first = next(others, "")
    delimiter = _find_delimiter(first, columns)
    table = csv.reader(chain((first,), others), delimiter=delimiter)
    rows = _read_rows(table, name)
    _, named = next(rows, (1, []))
    places = {column: _find_column(named, column) for column in (*columns, *further)}
    for column, found in places.items():
        if len(found) > 1 or (not found and column in columns):
            what = f"has {'two columns' if found else 'no column'} {column!r}"
            wanted = f"name the columns {', '.join(columns)}, separated by commas, semicolons or tabs"
            raise InputError(f"{name}, line 1: {what}; {wanted}")
    padded = ((number, cells + [""] * (len(named) - len(cells))) for number, cells in rows)
    return Table(tuple(named), {column: found[0] for column, found in places.items() if found}, delimiter, padded)


def _find_delimiter(first: str, columns: Sequence[str]) -> str:
    """What separates the names of columns in the first line of a table; a comma where that line has not all of them."""
    for delimiter in _DELIMITERS:
        names = {_fold(cell.strip().strip('"')) for cell in first.split(delimiter)}
        if all(_fold(column) in names for column in columns):
            return delimiter
    return _DELIMITERS[0]


def _find_column(names: Sequence[str], column: str) -> list[int]:
    """Places of the columns of a name, else of those that differ in capitals or blanks only."""
    exact = [place for place, found in enumerate(names) if found == column]
    return exact or [place for place, found in enumerate(names) if _fold(found) == _fold(column)]


def _fold(name: str) -> str:
    return name.strip().casefold()


def _read_rows(table: Any, name: str) -> Iterator[tuple[int, list[str]]]:
    """Line numbers and cells of the rows of a CSV reader that have any."""
    try:
        for cells in table:
            if cells:
                yield table.line_num, cells
    except csv.Error as error:
        raise InputError(f"{name}, line {table.line_num}: is no CSV table: {error}; save it as CSV again") from error


@contextlib.contextmanager
def open_regular(path: str | Path) -> Iterator[int]:
    """Descriptor of a regular file; opening never waits, as it would for the other end of a pipe.

    Raises
    ------
    InputError
        As :func:`read_file`.
    """
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    try:
        descriptor = os.open(path, flags)
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error
    try:
        kind = os.fstat(descriptor).st_mode
        if stat.S_ISDIR(kind):
            raise InputError(f"{path}: cannot be read: is a folder, not a file")
        if not stat.S_ISREG(kind):
            raise InputError(
                f"{path}: cannot be read: is no regular file but a pipe or a device; copy its content into a file"
            )
        yield descriptor
    finally:
        os.close(descriptor)


def require_regular(path: str | Path) -> None:
    """See that a file which a library is going to read is one that :func:`read_file` would open.

    Raises
    ------
    InputError
        As :func:`read_file`.
    """
    with open_regular(path):
        pass


def exists(path: Path) -> bool:
    """Whether there is such a file or folder; False also for names that no file can have."""
    return _mode(path) is not None


def is_file(path: Path) -> bool:
    """Whether there is such a file that is no folder, pipe or device."""
    mode = _mode(path)
    return mode is not None and stat.S_ISREG(mode)


def is_folder(path: Path) -> bool:
    """Whether there is such a folder."""
    mode = _mode(path)
    return mode is not None and stat.S_ISDIR(mode)


def list_folder(folder: Path) -> list[Path]:
    """What lies in a folder, in the order of names.

    Raises
    ------
    InputError
        The folder cannot be read.
    """
    try:
        return sorted(folder.iterdir(), key=lambda entry: entry.name)
    except OSError as error:
        raise _unreadable(folder, error) from error


def find_files(folder: Path, suffixes: Collection[str]) -> list[Path]:
    """Files of some suffixes in a folder and in those below it, in the order of their paths.

    Raises
    ------
    InputError
        The folder cannot be read.
    """
    list_folder(folder)  # one that cannot be read would seem to be empty
    return sorted(path for path in folder.rglob("*") if path.suffix in suffixes and is_file(path))


def _mode(path: Path) -> int | None:
    try:
        return path.stat().st_mode
    except (OSError, ValueError):
        return None


def require_input(path: Path) -> None:
    """See that there is such a file or folder.

    Raises
    ------
    InputError
        There is none, or there can be none of this name; links that lead in a circle.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError) as error:
        raise InputError(f"{path}: no such file or folder") from error
    except (OSError, ValueError) as error:
        raise _unreadable(path, error) from error


def real_path(path: Path) -> Path:
    """The path without links, also of what does not exist; one that cannot be followed as it is given."""
    try:
        return path.resolve()
    except (OSError, ValueError, RuntimeError):
        return path.absolute()


def _unreadable(path: str | Path, error: Exception) -> InputError:
    number = getattr(error, "errno", None)
    if number == errno.ENOENT:
        return InputError(f"{path}: cannot be read: no such file")
    if number == errno.ENAMETOOLONG:
        name = str(path)
        return InputError(f"{name[:60]}...: cannot be read: the name is too long ({len(name)} characters)")
    if number == errno.ELOOP:
        return InputError(f"{path}: cannot be read: its links lead in a circle")
    if isinstance(error, ValueError):  # NUL
        return InputError(f"{path}: cannot be read: no file can have this name ({error})")
    told = getattr(error, "strerror", None) or str(error)
    return InputError(f"{path}: cannot be read: {told}; check its permissions")


def size_in_words(count: int) -> str:
    """A number of bytes for people."""
    for unit, factor in (("GB", 1 << 30), ("MB", 1 << 20), ("KB", 1 << 10)):
        if count >= factor:
            return f"{count / factor:.4g} {unit}"
    return f"{count} bytes"


def remove_file(path: Path) -> None:
    """Take a file away; nothing where it is missing.

    Raises
    ------
    OutputError
        The folder cannot be written to.
    """
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise write_error(path, error) from error


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
    held: int | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        held, name = tempfile.mkstemp(prefix=f".{_short_name(path)}{_TEMPORARY}", dir=path.parent)
        temporary = Path(name)
        held = _hold(held)
        yield temporary
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(path)
    except (OSError, ValueError) as error:
        raise write_error(path, error) from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink()
        if held is not None:
            os.close(held)


def _hold(descriptor: int) -> int | None:
    """Lock a new temporary file, by which others know that it is in use; None after closing it where there are no such
    locks.
    """
    is_locked = False
    with contextlib.suppress(OSError):
        is_locked = lock_file(descriptor)
    if not is_locked:
        os.close(descriptor)
    return descriptor if is_locked else None


def lock_file(descriptor: int) -> bool:
    """Lock an open file until it is closed or its process ends; False on systems that cannot.

    Raises
    ------
    OSError
        Another process has it, or the file system knows no locks.
    """
    try:
        import fcntl
    except ImportError:  # not on Windows
        return False
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    return True


def remove_left_over(folder: Path) -> None:
    """Take away the temporary files that killed processes left in a folder; those of living ones are new or locked."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.startswith(".") and _TEMPORARY in entry.name and entry.is_file(follow_symlinks=False):
                with contextlib.suppress(OSError), open_regular(entry.path) as descriptor:
                    is_old = os.fstat(descriptor).st_mtime < time.time() - _LEFT_OVER_S
                    if is_old and lock_file(descriptor):
                        Path(entry.path).unlink()


def _short_name(path: Path) -> str:
    """The beginning of a file's name, short enough that a longer name with it still fits a file system."""
    return os.fsdecode(os.fsencode(path.name)[:_MOST_NAME_BYTES])


def write_error(path: Path, error: Exception, place: str = "folder") -> OutputError:
    """The error for a file or folder that cannot be written; ``place`` is what the user may choose otherwise."""
    is_full = getattr(error, "errno", 0) in _FULL or "disk is full" in str(error)  # as SQLite says it
    mend = f"{'free space or ' * is_full}choose another {place}"
    return OutputError(f"{path}: cannot be written: {getattr(error, 'strerror', None) or error}; {mend}")


def prepare_folder(out: Path, option: str = "--out") -> Path:
    """Make an output folder, so that a run fails before the first frame and not after it.

    Parameters
    ----------
    out : Path
        The folder.
    option : str
        What it was named by on the command line, for messages.

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
        raise folder_error(out, error, option) from error
    except (OSError, ValueError) as error:
        raise write_error(out, error, option) from error
    remove_left_over(out)
    return out


def folder_error(folder: Path, error: FileExistsError, option: str = "--out") -> OutputError:
    """The error for a folder that cannot be made, since something else has its name or that of a folder above it."""
    there = Path(error.filename or folder)
    if not there.is_symlink():
        return OutputError(f"{there}: is a file, not a folder; choose another {option}")
    told = f"is a link to {there.readlink()}, and no such folder can be reached"
    return OutputError(f"{there}: {told}; make that folder, remove the link, or choose another {option}")


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
        if is_folder(path):
            for name, size in sorted(_sizes(path, "")):
                digest.update(f"{name}\0{size}\0".encode(errors="surrogateescape"))
        else:
            with open_regular(path) as descriptor:
                while block := os.read(descriptor, _BLOCK):
                    digest.update(block)
    except OSError as error:
        raise _unreadable(path, error) from error
    return digest.hexdigest()


def _sizes(folder: Path, prefix: str) -> Iterator[tuple[str, int]]:
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_dir(follow_symlinks=False):
                yield from _sizes(Path(entry.path), f"{prefix}{entry.name}/")
            else:
                yield f"{prefix}{entry.name}", file_size(entry.path) or 0

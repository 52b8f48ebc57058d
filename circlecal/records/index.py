"""Which frames a results file holds and how they ended, found without reading the file: a small SQLite database.

Lines of results are large (tens of kilobytes), their number has no limit. The index has one short row per line, is held
by SQLite on the disk, and so takes the same memory for a hundred frames and for a million.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import astuple, fields
from pathlib import Path

from circlecal.records.summary import FrameSummary

_VERSION = 4
_PAGE = 1000
_LAST_ID = "\U0010ffff" * 4
"""After every id."""
_COLUMNS = tuple(column.name for column in fields(FrameSummary))


class ResultIndex:
    """Rows by frame id, and how much of the results file they cover.

    Parameters
    ----------
    path : Path
        The database. One that is damaged, of another version, or on a disk that SQLite cannot lock is replaced by one
        that lives as long as this object.
    """

    def __init__(self, path: Path) -> None:
        self._database = _open(path)
        self._page: dict[str, tuple[str, str | None]] = {}
        self._page_ends = ("", "")
        self._page_size = 1

    def close(self) -> None:
        """Keep what was added."""
        with suppress(sqlite3.Error):
            self._database.commit()
        self._database.close()

    def clear(self) -> None:
        """Forget everything."""
        self._database.execute("DELETE FROM frames")
        self._database.execute("DELETE FROM covered")
        self._database.commit()

    def read_coverage(self) -> tuple[int, str | None]:
        """Bytes of the results file that the rows stand for, and the configuration digest of them all."""
        found = self._database.execute("SELECT bytes, digest FROM covered").fetchone()
        return (0, None) if found is None else (int(found[0]), str(found[1]))

    def add(self, rows: Iterable[FrameSummary], end: int, digest: str) -> None:
        """Take in rows; the file is covered up to byte ``end`` with them. Kept for good at :meth:`commit`."""
        marks = ", ".join("?" * len(_COLUMNS))
        self._page_ends = ("", "")
        self._database.executemany(f"INSERT OR REPLACE INTO frames VALUES ({marks})", map(astuple, rows))
        self._database.execute("INSERT OR REPLACE INTO covered VALUES (0, ?, ?)", (end, digest))

    def commit(self) -> None:
        """Keep what was added, whatever happens to this process."""
        self._database.commit()

    def find(self, frame_id: str) -> tuple[str, str | None] | None:
        """Status and code of a frame; None where it has no row.

        Frames are mostly asked for in the order of their ids, so what follows one is read with it.
        """
        first, last = self._page_ends
        if not first <= frame_id <= last or not first:
            self._read_page(frame_id)
        return self._page.get(frame_id)

    def _read_page(self, frame_id: str) -> None:
        in_order = frame_id > self._page_ends[1]
        self._page_size = min(2 * self._page_size, _PAGE) if in_order else 1
        query = "SELECT id, status, code FROM frames WHERE id >= ? ORDER BY id LIMIT ?"
        rows = self._database.execute(query, (frame_id, self._page_size)).fetchall()
        self._page = {name: (status, code) for name, status, code in rows}
        self._page_ends = frame_id, rows[-1][0] if len(rows) == self._page_size else _LAST_ID

    def annotations(self) -> dict[str, str]:
        """Digests of the annotations that were used, by the id of the frame."""
        rows = self._database.execute("SELECT id, annotation FROM frames WHERE annotation IS NOT NULL")
        return {str(name): str(digest) for name, digest in rows}

    def masks(self) -> dict[str, str]:
        """The mask beside each picture with its size, by the id of the frame; nothing where there was none. Frames of
        which that is not known are left out.
        """
        rows = self._database.execute("SELECT id, mask FROM frames WHERE mask IS NOT NULL")
        return {str(name): str(mask) for name, mask in rows}

    def __len__(self) -> int:
        return int(self._database.execute("SELECT count(*) FROM frames").fetchone()[0])

    def rows(self) -> Iterator[FrameSummary]:
        """All rows in the order of their ids, read in pages: whoever stops half-way, as Ctrl-C does, leaves nothing
        open that must be closed before the database.
        """
        last, query = "", "SELECT * FROM frames WHERE id > ? ORDER BY id LIMIT ?"
        while page := [FrameSummary(*row) for row in self._database.execute(query, (last, _PAGE)).fetchall()]:
            yield from page
            last = page[-1].id


def _open(path: Path) -> sqlite3.Connection:
    for attempt in (str(path), str(path), ""):
        database = None
        try:
            database = sqlite3.connect(attempt)
            # one writer at a time holds the lock of the results; a lost row is read from the results again
            database.execute("PRAGMA locking_mode = EXCLUSIVE")
            database.execute("PRAGMA synchronous = OFF")
            if database.execute("PRAGMA user_version").fetchone()[0] not in (0, _VERSION):
                raise sqlite3.DatabaseError("of another version")
            kinds = {c.name: "REAL" for c in fields(FrameSummary) if "float" in str(c.type)} | {
                "case": "INTEGER",
                "width_px": "INTEGER",
            }
            columns = ", ".join(f'"{name}" {kinds.get(name, "TEXT")}' for name in _COLUMNS)
            database.execute(f"CREATE TABLE IF NOT EXISTS frames ({columns}, PRIMARY KEY (id)) WITHOUT ROWID")
            database.execute("CREATE TABLE IF NOT EXISTS covered (one INTEGER PRIMARY KEY, bytes INTEGER, digest TEXT)")
            if len(database.execute("PRAGMA table_info(frames)").fetchall()) != len(_COLUMNS):
                raise sqlite3.DatabaseError("of another version")
            database.execute(f"PRAGMA user_version = {_VERSION}")
            database.commit()
            return database
        except sqlite3.Error:
            if database is not None:
                database.close()
            with suppress(OSError):
                path.unlink(missing_ok=True)
    raise sqlite3.OperationalError("no temporary database can be opened")

"""Annotations on the disk: one file per frame, written whole at every change, never over a newer one."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path

from circlecal.errors import InputError
from circlecal.files import write_atomic, write_error
from circlecal.formats.annotation import Annotation, annotation_bytes, annotation_path, parse_annotation

LOCK_NAME = ".lock"
"""Held while a frame is compared and written: several servers may have one folder."""


class NewerError(Exception):
    """Somebody else, such as another window, saved the frame meanwhile."""

    def __init__(self, current: Annotation) -> None:
        super().__init__(f"{current.id}: was changed elsewhere (revision {current.revision})")
        self.current = current


class AnnotationStore:
    """The annotations of a folder.

    Parameters
    ----------
    folder : path
        Where; made when the first annotation is saved.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._lock = threading.Lock()

    def path(self, frame_id: str) -> Path:
        """The file of a frame."""
        return annotation_path(self.folder, frame_id)

    def read(self, frame_id: str) -> Annotation | None:
        """The annotation of a frame; None where there is none.

        Raises
        ------
        InputError
            The file is damaged or cannot be read.
        """
        path = self.path(frame_id)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from error
        try:
            return parse_annotation(path, content)
        except InputError as error:
            raise InputError(f"{error}; mend the file or move it away") from error

    def save(self, annotation: Annotation, base: int, *, touched: bool = True) -> Annotation:
        """Write a changed annotation, with the time of the change; one that says what its file says stays as it is.

        Parameters
        ----------
        annotation : Annotation
            The new content.
        base : int
            Revision that it was made from, 0 where there was none.
        touched : bool
            Whether a person says anything in it; what says nothing is kept and not used.

        Returns
        -------
        Annotation
            As it was written, with its revision.

        Raises
        ------
        NewerError
            The file has another revision.
        InputError
            It cannot be written.
        """
        with self._lock, _hold_lock(self.folder / LOCK_NAME):
            current = self.read(annotation.id)
            if (0 if current is None else current.revision) != base:
                if current is None:
                    current = annotation.model_copy(update={"revision": 0})
                raise NewerError(current)
            if current is None and not touched:
                return annotation.model_copy(update={"touched": False})
            judged = touched, annotation.confirmed
            if current is not None and current.says_what(annotation) and (current.touched, current.confirmed) == judged:
                return current
            now = datetime.now(UTC).isoformat(timespec="seconds")
            saved = annotation.model_copy(update={"revision": base + 1, "touched": touched, "changed_at": now})
            write_atomic(self.path(annotation.id), annotation_bytes(saved))
            return saved

    def known(self) -> set[str]:
        """Names of the files that there are."""
        return {path.name for path in self.folder.glob("*.json")} if self.folder.is_dir() else set()


@contextlib.contextmanager
def _hold_lock(path: Path) -> Iterator[None]:
    """Wait for a lock that other processes wait for too; a file system without locks has none.

    Raises
    ------
    InputError
        The folder cannot be made or not be written to.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise write_error(path.parent, error) from error
    try:
        with contextlib.suppress(ImportError, OSError):  # not on Windows
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)

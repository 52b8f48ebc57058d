"""The frames' own pictures, from the files that the records name, or what the run wrote of them."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from circlecal.errors import InputError
from circlecal.files import file_size, is_file
from circlecal.overlay.canvas import Picture
from circlecal.pictures.files import OVERLAY_SUFFIX, PICTURE_SUFFIXES, read_image
from circlecal.pictures.video import pictures_at
from circlecal.report.reading import FrameRow

_log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Originals:
    """Where the frames' pictures are looked for.

    Attributes
    ----------
    results : path
        Folder of the run, for its overlay pictures.
    frames : path or None
        Folder that the pictures and videos moved to.
    """

    results: Path
    frames: Path | None

    def decode(self, rows: Sequence[FrameRow]) -> Iterator[Picture | None]:
        """Pictures of the frames that come from videos, None for any other; each video is gone through once."""
        for path, of_path in itertools.groupby(rows, key=lambda row: row.path if row.time_s is not None else None):
            frames = list(of_path)
            yield from self._of_video(Path(path), frames) if path else itertools.repeat(None, len(frames))

    def picture(
        self, row: FrameRow, decoded: Picture | None, size: tuple[int, int] | None
    ) -> tuple[Picture | None, bool]:
        """The frame, and whether the calibration is drawn in; None where it cannot be had.

        Parameters
        ----------
        row : FrameRow
            The frame.
        decoded : (H, W, 3) uint8 or None
            Its picture from a video.
        size : (2,) tuple of int or None
            Width and height of the calibrated frame; a picture of another size is another picture.
        """
        for picture in (decoded, *map(_readable, self._files(row))):
            if picture is not None and size in (None, picture.shape[1::-1]):
                return picture, False
        return _readable(self.results / f"{row.id}{OVERLAY_SUFFIX}"), True

    def _of_video(self, path: Path, rows: Sequence[FrameRow]) -> Iterator[Picture | None]:
        video = next(filter(is_file, self._find_moved(path)), path)
        size, found = file_size(video), 0
        if size is not None and any(row.bytes not in (None, size) for row in rows):
            _log.warning("%s: has changed since its frames were calibrated; their pictures are left out", video)
        else:
            try:
                for picture in pictures_at(video, [row.time_s or 0.0 for row in rows]):
                    found += 1
                    yield picture
            except InputError as error:
                _log.info("%s", error)
        yield from itertools.repeat(None, len(rows) - found)

    def _files(self, row: FrameRow) -> Iterator[Path]:
        if not row.path or row.time_s is not None:
            return
        path = Path(row.path)
        if path.suffix.lower() in PICTURE_SUFFIXES:
            yield from self._find_moved(path)
            return
        for name in dict.fromkeys((path.stem, Path(row.id).name)):  # an annotation; its picture is named like it
            for suffix in PICTURE_SUFFIXES:
                yield from self._find_moved(path.with_name(name + suffix))

    def _find_moved(self, path: Path) -> list[Path]:
        return [path] if self.frames is None else [self.frames / path.name, self.frames / path, path]


def _readable(path: Path) -> Picture | None:
    try:
        return read_image(path) if is_file(path) else None
    except (InputError, OSError, ValueError) as error:
        _log.info("%s", error)
        return None

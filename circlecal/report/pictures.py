"""Pictures of the report: the frame, its thumbnail and its radar, from the frame's file or what the run wrote."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from enum import IntFlag
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.formats.atomic import write_error
from circlecal.formats.images import OVERLAY_SUFFIX, PICTURE_SUFFIXES, read_image
from circlecal.overlay.radar import warp_to_field
from circlecal.report.drawings import Scene, draw_on_thumbnail, plan_layer, points_layer, template_layer
from circlecal.report.reading import FrameRow

Picture = NDArray[np.uint8]

THUMBNAIL_WIDTH = 320
PER_FOLDER = 1000
"""Files of one kind in one folder."""
_RADAR_PX_PER_M = 5.0
_QUALITY = 82

_log = logging.getLogger(__name__)


class Media(IntFlag):
    """What the report has of a frame; the page's script knows the same numbers."""

    THUMBNAIL = 1
    FRAME = 2
    TEMPLATE = 4
    POINTS = 8
    RADAR = 16
    PLAN = 32
    DRAWN = 64
    """The frame is the run's overlay picture, with the drawing in it."""


KINDS = {
    Media.THUMBNAIL: ("thumbnails", "jpg"),
    Media.FRAME: ("frames", "jpg"),
    Media.TEMPLATE: ("template", "svg"),
    Media.POINTS: ("points", "svg"),
    Media.RADAR: ("radar", "jpg"),
    Media.PLAN: ("plan", "svg"),
}
"""Folder and suffix of each kind of file."""


@dataclass(frozen=True, slots=True)
class PictureSource:
    """Where the frames' pictures are looked for.

    Attributes
    ----------
    results : path
        Folder of the run, for its overlay pictures.
    frames : path or None
        Folder that the frames moved to.
    width : int
        Largest width of the pictures in the report.
    """

    results: Path
    frames: Path | None
    width: int

    def of(self, row: FrameRow, size: tuple[int, int] | None) -> tuple[Picture | None, bool]:
        """The frame (True: the run's overlay of it, with the drawing in it); None where neither can be had."""
        for path in self._candidates(row):
            picture = _readable(path)
            if picture is not None and (size is None or picture.shape[1::-1] == size):
                return picture, False
        return _readable(self.results / f"{row.id}{OVERLAY_SUFFIX}"), True

    def _candidates(self, row: FrameRow) -> list[Path]:
        if not row.path or row.time_s is not None:
            return []
        path = Path(row.path)
        paths = [path]
        if (
            path.suffix.lower() not in PICTURE_SUFFIXES
        ):  # an annotation: the picture is named like it, or like the frame
            names = dict.fromkeys((path.stem, Path(row.id).name))
            paths = [path.with_name(name + suffix) for name in names for suffix in PICTURE_SUFFIXES]
        moved = [] if self.frames is None else [self.frames / part for p in paths for part in (p.name, p)]
        return [*moved, *paths]


def _readable(path: Path) -> Picture | None:
    try:
        return read_image(path) if path.is_file() else None
    except (InputError, OSError, ValueError) as error:
        _log.info("%s", error)
        return None


def media_path(out: Path, kind: Media, index: int) -> Path:
    """File of a kind for the frame at a position of the run."""
    folder, suffix = KINDS[kind]
    return out / folder / f"{index // PER_FOLDER:03d}" / f"{index:06d}.{suffix}"


def write_media(out: Path, index: int, row: FrameRow, scene: Scene | None, source: PictureSource) -> Media:
    """Write the pictures and drawings of one frame; return which there are.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    written = Media(0)
    size = None if scene is None else (scene.width, scene.height)
    picture, drawn = source.of(row, size)
    if picture is not None:
        thumbnail = _scaled(picture, THUMBNAIL_WIDTH)
        if scene is not None and not drawn:
            thumbnail = draw_on_thumbnail(thumbnail, scene)
        _write_jpeg(media_path(out, Media.THUMBNAIL, index), thumbnail)
        _write_jpeg(media_path(out, Media.FRAME, index), _scaled(picture, source.width))
        written |= Media.THUMBNAIL | Media.FRAME | (Media.DRAWN if drawn else Media(0))
    if scene is None:
        return written
    layers = {Media.PLAN: plan_layer(scene)}
    if not drawn or picture is None:
        layers |= {Media.TEMPLATE: template_layer(scene), Media.POINTS: points_layer(scene)}
        if picture is not None and scene.accepted and scene.view is not None and scene.template is not None:
            radar = warp_to_field(picture, scene.view, scene.template, _RADAR_PX_PER_M)[0]
            _write_jpeg(media_path(out, Media.RADAR, index), radar)
            written |= Media.RADAR
    for kind, content in layers.items():
        if content is not None:
            write_file(media_path(out, kind, index), content.encode())
            written |= kind
    return written


def _scaled(picture: Picture, width: int) -> Picture:
    share = width / picture.shape[1]
    if share >= 1.0:
        return picture
    size = width, max(1, round(picture.shape[0] * share))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def _write_jpeg(path: Path, picture: Picture) -> None:
    content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1]
    write_file(path, content.tobytes())


def write_file(path: Path, content: bytes) -> None:
    """Write a file of the report; not atomic, since the report's page is written last.

    Raises
    ------
    InputError
        It cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except OSError as error:
        raise write_error(path, error) from error

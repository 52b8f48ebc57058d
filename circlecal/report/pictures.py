"""Files of one frame in the report: the picture, its thumbnail, its radar, and the drawings over them."""

from __future__ import annotations

from enum import IntFlag
from pathlib import Path

import cv2
import numpy as np

from circlecal.files import write_error
from circlecal.overlay.canvas import Picture
from circlecal.overlay.radar import warp_to_field
from circlecal.report.drawings import Scene, draw_on_thumbnail, other_layer, plan_layer, points_layer, template_layer

THUMBNAIL_WIDTH = 320
PER_FOLDER = 1000
"""Files of one kind in one folder."""
_RADAR_PX_PER_M = 5.0
_QUALITY = 82


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
    OTHER = 128
    """The template as the other run's camera draws it."""


KINDS = {
    Media.THUMBNAIL: ("thumbnails", "jpg"),
    Media.FRAME: ("frames", "jpg"),
    Media.TEMPLATE: ("template", "svg"),
    Media.POINTS: ("points", "svg"),
    Media.RADAR: ("radar", "jpg"),
    Media.PLAN: ("plan", "svg"),
    Media.OTHER: ("other", "svg"),
}
"""Folder and suffix of each kind of file."""


def media_path(out: Path, kind: Media, index: int) -> Path:
    """File of a kind for the frame at a position of the run."""
    folder, suffix = KINDS[kind]
    return out / folder / f"{index // PER_FOLDER:03d}" / f"{index:06d}.{suffix}"


def write_media(
    out: Path,
    index: int,
    scene: Scene | None,
    picture: Picture | None,
    *,
    drawn: bool,
    width: int,
    other: Scene | None = None,
) -> Media:
    """Write the pictures and drawings of one frame; return which there are.

    Parameters
    ----------
    out, index : Path, int
        Folder of the report, and position of the frame in the run.
    scene : Scene or None
        What its record lets draw.
    picture, drawn : (H, W, 3) uint8 or None, bool
        The frame, and whether the calibration is drawn in.
    width : int
        Largest width of the picture.
    other : Scene, optional
        What the other run's record lets draw.

    Raises
    ------
    InputError
        A file cannot be written.
    """
    written = Media(0)
    if picture is not None:
        aspect = 1.0 if scene is None else scene.aspect
        thumbnail = _scale(picture, THUMBNAIL_WIDTH, aspect)
        if scene is not None and not drawn:
            thumbnail = draw_on_thumbnail(thumbnail, scene)
        _write_jpeg(media_path(out, Media.THUMBNAIL, index), thumbnail)
        _write_jpeg(media_path(out, Media.FRAME, index), _scale(picture, width, aspect))
        written |= Media.THUMBNAIL | Media.FRAME | (Media.DRAWN if drawn else Media(0))
    if scene is None:
        return written
    layers = {Media.PLAN: plan_layer(scene), Media.OTHER: None if other is None else other_layer(other)}
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


def _scale(picture: Picture, width: int, aspect: float) -> Picture:
    """A picture as it is seen, with square pixels where its own are ``aspect`` times as wide as high, and no wider than
    ``width``.
    """
    shown = picture.shape[1] * aspect
    share = min(width / shown, 1.0)
    size = max(1, round(shown * share)), max(1, round(picture.shape[0] * share))
    if size == picture.shape[1::-1]:
        return picture
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

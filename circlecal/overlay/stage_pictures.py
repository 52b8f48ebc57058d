"""One picture per stage, and a sheet of them all."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import cv2
import numpy as np

from circlecal.field import FieldTemplate
from circlecal.overlay.canvas import Canvas, Picture, wrap
from circlecal.overlay.derived import (
    camera_picture,
    correspondences_picture,
    homography_picture,
    verdict_picture,
)
from circlecal.overlay.frame_overlay import check_size
from circlecal.overlay.measured import cues_picture, edges_picture, ellipse_picture, mask_picture, rays_picture
from circlecal.overlay.palette import WHITE
from circlecal.pictures.files import LAST_STAGE
from circlecal.results import FrameCalibration

_LEAST_WIDTH = 1280.0
_LARGEST_ZOOM = 8
_CELL_WIDTH = 800
_FEW = 4
"""So many pictures stand two in a row, and larger."""
_PAPER = 18


def stage_pictures(image: Picture, calibration: FrameCalibration, template: FieldTemplate) -> dict[str, Picture]:
    """Draw what every stage found, for refused frames too.

    Parameters
    ----------
    image : (H, W, 3) uint8
        The frame, BGR.
    calibration : FrameCalibration
        Complete or not.
    template : FieldTemplate
        The field that it was calibrated with.

    Returns
    -------
    dict
        Pictures by name, from ``"01-mask"`` to ``"09-verdict"``, in order, without the stages that were not reached.
        Small frames are enlarged; a strip above each picture holds the facts and the legend.

    Raises
    ------
    ValueError
        Where the picture has another size than the calibrated frame.
    """
    check_size(image, calibration)
    c, circle, zoom = calibration, calibration.circle_name, _zoom_of(image)
    a = c.attempt
    mask, edges, rays, fits, cues = a.mask, a.edges, a.rays, a.ellipses, a.cues
    found, plane, camera = a.correspondences, a.homography, a.camera
    stages: dict[str, Callable[[], Picture] | None] = {
        "01-mask": None if mask is None else lambda: mask_picture(image, mask, zoom),
        "02-edges": None if edges is None else lambda: edges_picture(image, edges, zoom),
        "03-rays": None if rays is None else lambda: rays_picture(image, rays, zoom),
        "04-ellipse": None if fits is None or not fits.all() else lambda: ellipse_picture(image, fits, zoom),
        "05-cues": None if cues is None else lambda: cues_picture(image, cues, zoom),
        "06-correspondences": None if found is None else lambda: correspondences_picture(image, found, zoom),
        "07-homography": None
        if plane is None
        else lambda: homography_picture(image, plane, found, template, circle, zoom),
        "08-camera": None if camera is None else lambda: camera_picture(image, camera, c, template, zoom),
        LAST_STAGE: lambda: verdict_picture(image, c, template, zoom),
    }
    return {name: draw() for name, draw in stages.items() if draw is not None}


def contact_sheet(pictures: Mapping[str, Picture], title: str) -> Picture:
    """Put pictures into a grid, three in a row, or two where there are few, with their names and a title.

    Parameters
    ----------
    pictures : mapping of str to (H, W, 3) uint8
        Pictures by name, e.g. of :func:`stage_pictures`; sizes may differ.
    title : str
        Written above the grid.

    Returns
    -------
    uint8 array
        BGR, 2448 pixels wide.
    """
    columns = 3 if len(pictures) > _FEW else max(1, min(2, len(pictures)))
    gap, size = 12, 22.0
    width = 3 * _CELL_WIDTH + 4 * gap
    cell_width = (width - (columns + 1) * gap) // columns
    names = list(pictures)
    rows = [names[start : start + columns] for start in range(0, len(names), columns)]
    lines = wrap(title, 1.3 * size, width - 4 * gap)
    head = Canvas(np.full((round(len(lines) * 2.2 * size + 2 * gap), width, 3), _PAPER, np.uint8))
    for number, line in enumerate(lines):
        head.text(line, 2 * gap, gap + 2.2 * size * number, WHITE, 1.3 * size, halo=False)
    strips = [head.picture]
    for row in rows:
        cells = [_cell(name, pictures[name], size, cell_width) for name in row]
        height = max(cell.shape[0] for cell in cells)
        strip = np.full((height + gap, width, 3), _PAPER, np.uint8)
        for column, cell in enumerate(cells):
            left = gap + column * (cell_width + gap)
            strip[: cell.shape[0], left : left + cell_width] = cell
        strips.append(strip)
    return np.ascontiguousarray(np.vstack(strips))


def _cell(name: str, picture: Picture, size: float, width: int) -> Picture:
    """A picture at the cell's width, or centred where it is higher than wide, below its name."""
    scale = min(width / picture.shape[1], 1.2 * width / picture.shape[0])
    shape = (max(1, round(picture.shape[1] * scale)), max(1, round(picture.shape[0] * scale)))
    small = cv2.resize(picture, shape, interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    caption = round(2.0 * size)
    cell = np.full((shape[1] + caption, width, 3), _PAPER, np.uint8)
    left = (width - shape[0]) // 2
    cell[caption:, left : left + shape[0]] = small
    Canvas(cell).text(name, 4, 0.5 * size, WHITE, size, halo=False)
    return cell


def _zoom_of(image: Picture) -> int:
    """Whole enlargement that makes a small frame as large as the pictures of a full one need to be."""
    width = np.sqrt(image.shape[0] * image.shape[1] * 16.0 / 9.0)
    return int(np.clip(np.ceil(_LEAST_WIDTH / width), 1, _LARGEST_ZOOM))

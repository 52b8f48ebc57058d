"""The radar picture: the frame warped to the field plane, the template drawn over it."""

from __future__ import annotations

import cv2
import numpy as np

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array, Mask
from circlecal.overlay.canvas import Canvas, Picture
from circlecal.overlay.frame_overlay import check_size
from circlecal.overlay.palette import CIRCLE, TEMPLATE
from circlecal.results import FrameCalibration

_BORDER_M = 3.0
_LEAST_BORDER_SHARE = 1 / 3
"""Of that border, which is left beside a field that is larger than its template's."""
_UNSEEN = (52, 44, 40)
_LARGEST_PX = 4096
_COARSE = 6
_NOWHERE = -1e4


def draw_radar(
    image: Picture, calibration: FrameCalibration, template: FieldTemplate, px_per_m: float = 10.0
) -> Picture | None:
    """Warp a frame to the field plane, over the whole field and a border.

    Parameters
    ----------
    image : (H, W, 3) uint8
        The frame, BGR.
    calibration : FrameCalibration
        Its calibration.
    template : FieldTemplate
        The field that it was calibrated with.
    px_per_m : float
        Resolution; lowered where the picture would be wider than 4096 pixels.

    Returns
    -------
    uint8 array or None
        x to the right, y downwards, as seen from the main camera's side; what the frame does not show is plain.
        None for a refused frame.

    Raises
    ------
    ValueError
        Where the picture has another size than the calibrated frame, or the resolution is not positive.
    """
    check_size(image, calibration)
    if not (np.isfinite(px_per_m) and px_per_m > 0):
        raise ValueError(f"px_per_m must be positive, not {px_per_m}")
    view = calibration.view
    if view is None or calibration.status != "calibrated":
        return None
    warped, half, scale = warp_to_field(image, view, template, px_per_m)
    canvas = Canvas(warped)
    for name, polyline in view.markings(template).items():
        color = CIRCLE if name == calibration.circle_name else TEMPLATE
        canvas.polyline((polyline + half) * scale - 0.5, color, 1.4)
    return canvas.picture


def warp_to_field(
    image: Picture, view: FieldView, template: FieldTemplate, px_per_m: float
) -> tuple[Picture, Array, float]:
    """The frame as seen from above, over the whole field and a border.

    Returns
    -------
    picture : uint8 array
        What the frame does not show is plain.
    half : (2,) array
        Half the length and width that the picture covers, metres; the field's origin is in its middle.
    px_per_m : float
        The resolution, lowered where the picture would be wider than 4096 pixels.
    """
    half = radar_half(template, view)
    scale = min(px_per_m, _LARGEST_PX / float(2 * half.max()))
    width, height = np.maximum(np.round(2 * half * scale), 1).astype(int)
    grid = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1) / scale - half
    near = _find_visible_cells(view, grid)
    lookup = np.full((height, width, 2), _NOWHERE, np.float32)
    lookup[near] = np.nan_to_num(view.project(grid[near]), nan=_NOWHERE)
    warped = cv2.remap(
        image, lookup[..., 0], lookup[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=_UNSEEN
    )
    return np.ascontiguousarray(warped, dtype=np.uint8), half, scale


def _find_visible_cells(view: FieldView, grid: Array) -> Mask:
    """Which points of a grid (H, W, 2) the frame may show: a coarse look, widened by two of its cells."""
    coarse = grid[::_COARSE, ::_COARSE]
    wide = cv2.dilate(view.shows(view.project(coarse)).astype(np.uint8), np.ones((5, 5), np.uint8))
    return np.asarray(np.kron(wide, np.ones((_COARSE, _COARSE), np.uint8))[: grid.shape[0], : grid.shape[1]] > 0)


def radar_half(template: FieldTemplate, view: FieldView | None = None) -> Array:
    """Half the length and width (2,) of what a radar picture covers, metres: the template's field and a border, in
    which other sizes have room, and more where the view has a field that needs it.
    """
    border = _BORDER_M * min(1.0, template.length_m / 60.0)
    half = np.array([template.length_m, template.width_m]) / 2
    growth_m = np.zeros(2) if view is None else view.growth_m / 2
    return half + np.maximum(border, growth_m + _LEAST_BORDER_SHARE * border)

"""From the camera's picture to the file: enlarged, framed by bars, colour thinned out, compressed; truth follows."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.synthetic.scene import Delivery
from circlecal.synthetic.truth import Truth

Picture = NDArray[np.uint8]

_BLUR_OF_BARS = 0.03
_BAR_DIMMING = 0.55


def deliver(image: Picture, truth: Truth, delivery: Delivery) -> tuple[Picture, Truth]:
    """Picture (H, W, 3) as it is stored, and its truth in stored pixels."""
    if delivery.size is not None:
        image, truth = _resize(image, truth, delivery.size)
    if any(delivery.bars_px):
        image, truth = _add_borders(image, truth, delivery)
    if delivery.chroma_step > 1:
        image = _thin_color(image, delivery.chroma_step)
    if delivery.block_quality is not None:
        image = _compress(image, delivery.block_quality)
    return image, truth


def weave(top_field: Picture, bottom_field: Picture) -> Picture:
    """Interlaced frame: the even rows of one picture, the odd rows of the one a fiftieth of a second later."""
    frame = top_field.copy()
    frame[1::2] = bottom_field[1::2]
    return frame


def stretch(camera: Camera, width: int, height: int) -> Camera:
    """A view stored at another size; other proportions make its pixels oblong."""
    scale = np.array([width / camera.width, height / camera.height])
    return replace(
        camera,
        width=width,
        height=height,
        focal_px=camera.focal_px * scale,
        principal_point_px=(camera.principal_point_px + 0.5) * scale - 0.5,
    )


def cut_out(camera: Camera, first_px: tuple[int, int], width: int, height: int) -> Camera:
    """A view of which a part is kept, from a column and a row on; the lens points where it did."""
    share = width / camera.width
    return replace(
        camera,
        width=width,
        height=height,
        principal_point_px=camera.principal_point_px - first_px,
        kappa=camera.kappa * (share**2, share**4),
    )


def _resize(image: Picture, truth: Truth, size: tuple[int, int]) -> tuple[Picture, Truth]:
    scale = np.array([size[0] / truth.camera.width, size[1] / truth.camera.height])
    larger = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC if scale[0] > 1 else cv2.INTER_AREA)
    classes = cv2.resize(truth.classes, size, interpolation=cv2.INTER_NEAREST)
    return np.asarray(larger, dtype=np.uint8), _move_truth(
        truth, stretch(truth.camera, *size), scale, 0.5 * scale - 0.5, np.asarray(classes, dtype=np.uint8)
    )


def _add_borders(image: Picture, truth: Truth, delivery: Delivery) -> tuple[Picture, Truth]:
    left, top, right, bottom = delivery.bars_px
    height, width = image.shape[0] + top + bottom, image.shape[1] + left + right
    around = (top, bottom, left, right, cv2.BORDER_CONSTANT)
    framed: NDArray[Any] = cv2.copyMakeBorder(image, *around, value=[float(v) for v in delivery.bar_bgr])
    if delivery.blurred_bars:
        # the picture itself, enlarged until it fills the frame, out of focus and dimmed
        factor = max(width / image.shape[1], height / image.shape[0])
        small = cv2.resize(image, (width // 8, height // 8), interpolation=cv2.INTER_AREA)
        wide = cv2.resize(small, None, fx=factor, fy=factor)
        y, x = (wide.shape[0] - height // 8) // 2, (wide.shape[1] - width // 8) // 2
        wide = wide[max(y, 0) : max(y, 0) + height // 8, max(x, 0) : max(x, 0) + width // 8]
        fill = cv2.GaussianBlur(wide, (0, 0), _BLUR_OF_BARS * width / 8)
        fill = cv2.resize(fill, (width, height)) * _BAR_DIMMING
        inner = framed[top : top + image.shape[0], left : left + image.shape[1]].copy()
        framed = fill.astype(np.uint8)
        framed[top : top + image.shape[0], left : left + image.shape[1]] = inner
    shift = np.array([left, top], dtype=np.float64)
    camera = replace(
        truth.camera,
        width=width,
        height=height,
        principal_point_px=truth.camera.principal_point_px + shift,
        # the coefficients count in half-widths of the whole frame
        kappa=truth.camera.kappa * (width / truth.camera.width) ** np.array([2.0, 4.0]),
    )
    classes = np.asarray(cv2.copyMakeBorder(truth.classes, *around, value=[0.0]), dtype=np.uint8)
    return np.asarray(framed, dtype=np.uint8), _move_truth(truth, camera, np.ones(2), shift, classes)


def _move_truth(truth: Truth, camera: Camera, scale: Array, shift: Array, classes: NDArray[np.uint8]) -> Truth:
    """Truth after ``pixel * scale + shift``."""
    x0, y0, x1, y1 = truth.picture_box_px
    low, high = (np.array(corner) * scale + shift for corner in ((x0 - 0.5, y0 - 0.5), (x1 + 0.5, y1 + 0.5)))
    box = (float(low[0] + 0.5), float(low[1] + 0.5), float(high[0] - 0.5), float(high[1] - 0.5))
    return replace(
        truth,
        camera=camera,
        imaged_center_px=truth.imaged_center_px * scale + shift,
        imaged_center_undistorted_px=truth.imaged_center_undistorted_px * scale + shift,
        halfway_px=truth.halfway_px * float(np.sqrt(np.prod(scale))),
        others_px=tuple(length * float(np.sqrt(np.prod(scale))) for length in truth.others_px),
        picture_box_px=box,
        classes=classes,
    )


def _thin_color(image: Picture, step: int) -> Picture:
    """Colour at one sample per ``step`` columns and two rows, as video carries it; brightness stays."""
    height, width = image.shape[:2]
    ycc = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    color = cv2.resize(ycc[..., 1:], (max(1, width // step), max(1, height // 2)), interpolation=cv2.INTER_AREA)
    ycc[..., 1:] = cv2.resize(color, (width, height), interpolation=cv2.INTER_LINEAR)
    return np.asarray(cv2.cvtColor(ycc, cv2.COLOR_YCrCb2BGR), dtype=np.uint8)


def _compress(image: Picture, quality: int) -> Picture:
    """Blocks and ringing of a coder with 8 x 8 cosine transforms at a low rate."""
    _, content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])
    return np.asarray(cv2.imdecode(content, cv2.IMREAD_COLOR), dtype=np.uint8)

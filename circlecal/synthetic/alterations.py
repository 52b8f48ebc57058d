"""Pictures that no camera can have taken, or of no field at all: their lines and circles are not those of a template.

A picture mirrored from left to right is none of them: a field is its own mirror image, and a mirrored camera sees it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.synthetic.scene import Alteration
from circlecal.synthetic.truth import Truth

Picture = NDArray[np.uint8]

ALTERATIONS: tuple[Alteration, ...] = tuple(kind for kind in get_args(Alteration) if kind)
_FINE = 4
_SHIFT = 2**_FINE


def alter(image: Picture, truth: Truth, kind: Alteration, rng: np.random.Generator) -> tuple[Picture, Truth]:
    """The picture (H, W, 3) turned by 180 degrees, mirrored from top to bottom, with its quarters in another order, or
    replaced by a ring and lines on green; its truth says that nothing can be calibrated.
    """
    if kind == "upside_down":
        altered = image[::-1, ::-1]
    elif kind == "mirrored":
        altered = image[::-1]
    elif kind == "shuffled":
        altered = _shuffle_quarters(image, rng)
    elif kind == "drawn":
        altered = _draw_ring(image, rng)
    else:
        return image, truth
    nothing = replace(
        truth,
        kind=kind,
        center_mark="not_painted",
        visible_circle_deg=0.0,
        halfway_px=0.0,
        others_px=(),
        classes=np.zeros_like(truth.classes),
    )
    return np.ascontiguousarray(altered), nothing


def _shuffle_quarters(image: Picture, rng: np.random.Generator) -> Picture:
    """Each quarter in another one's place: one of the nine orders without a fixed quarter."""
    height, width = image.shape[0] // 2, image.shape[1] // 2
    corners = [(0, 0), (0, width), (height, 0), (height, width)]
    order = np.arange(4)
    while (order == np.arange(4)).any():
        order = rng.permutation(4)
    altered = image.copy()
    for (row, column), k in zip(corners, order, strict=True):
        y, x = corners[k]
        altered[row : row + height, column : column + width] = image[y : y + height, x : x + width]
    return altered


def _draw_ring(image: Picture, rng: np.random.Generator) -> Picture:
    """An ellipse and a line through its middle, sometimes more lines, in white on plain green."""
    height, width = image.shape[:2]
    green = np.array([rng.uniform(20, 90), rng.uniform(90, 160), rng.uniform(20, 100)])
    sheet = np.tile(green, (height, width, 1)) + rng.normal(0.0, rng.uniform(0.0, 6.0), (height, width, 1))
    altered = np.clip(sheet, 0, 255).astype(np.uint8)
    middle = np.array([width, height]) * rng.uniform((0.3, 0.3), (0.7, 0.7))
    half = np.array([rng.uniform(0.12, 0.4) * width, 0.0])
    half[1] = half[0] * rng.uniform(0.15, 0.8)
    wide = max(1, round(rng.uniform(2.0, 7.0) * width / 1920.0))
    box = (tuple(float(v) for v in middle), tuple(float(v) for v in 2.0 * half), float(rng.normal(0.0, 6.0)))
    cv2.ellipse(altered, box, (235, 240, 238), wide, cv2.LINE_AA)
    for k in range(1 + int(rng.integers(0, 3))):
        turn = rng.uniform(0.0, np.pi)
        along = np.array([np.cos(turn), np.sin(turn)]) * rng.uniform(0.5, 2.0) * half[0]
        at = middle if k == 0 else middle + rng.uniform(-1.5, 1.5, 2) * half
        first, last = (tuple(np.rint(_SHIFT * end).astype(int).tolist()) for end in (at - along, at + along))
        cv2.line(altered, first, last, (235, 240, 238), wide, cv2.LINE_AA, _FINE)
    return np.asarray(cv2.GaussianBlur(altered, (0, 0), 0.8), dtype=np.uint8)

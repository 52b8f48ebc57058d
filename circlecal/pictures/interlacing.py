"""Interlaced video: the odd rows of a frame are a fiftieth of a second younger than the even ones.

While the camera turns, every marking that runs down the picture is seen twice, and its edges look like combs. Both
halves of the rows become one picture again where each is moved half the way to the other.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array

ROWS = 48
"""Rows of the picture in which combs are looked for."""
COMBED = (0.62, 0.45)
"""Covariance of second differences, one and two columns apart, between neighbouring rows over that between every other
row. One picture has about 0.35, since it changes more over two rows than over one, and noise has none at two columns;
combed ones have more in both.
"""
LEAST_MOTION_PX = 1.0
"""Smaller motions harm little, and noise has them too."""
STEPS, SMOOTHING_PX = (30, 1e-3), 5
"""Of the alignment of both halves: most steps with the gain at which it stops, and the width of its smoothing."""


def measure_row_motion(brightness: NDArray[np.uint8]) -> Array | None:
    """How the odd rows of a picture (H, W) are displaced against the even ones: an affinity (2, 3) from places among
    the even rows to the same places among the odd ones, in columns and rows of half the picture; None for one picture.
    """
    height, width = brightness.shape
    if height < 64 or width < 64 or not _is_combed(brightness):
        return None
    even, odd = (np.ascontiguousarray(brightness[k : 2 * (height // 2) : 2], np.float32) for k in (0, 1))
    between = even.copy()
    between[:-1] = 0.5 * (even[:-1] + even[1:])
    (shift, _), _ = cv2.phaseCorrelate(between, odd, cv2.createHanningWindow((width, len(odd)), cv2.CV_32F))
    start = np.array([[1.0, 0.0, shift], [0.0, 1.0, 0.0]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, *STEPS)
    whole = np.full(odd.shape, 255, np.uint8)
    try:
        _, found = cv2.findTransformECC(between, odd, start, cv2.MOTION_AFFINE, criteria, whole, SMOOTHING_PX)
    except cv2.error:  # the two halves have nothing in common
        return None
    motion = np.asarray(found, np.float64)
    moved = abs(float(motion[0] @ (width / 2, len(odd) / 2, 1.0)) - width / 2)
    return motion if LEAST_MOTION_PX < moved < 0.25 * width else None


def remove_combs(image: NDArray[np.uint8], motion: Array) -> NDArray[np.uint8]:
    """The picture (H, W, 3) of the moment between its even and its odd rows, which ``motion`` tells apart."""
    half = motion.copy()
    half[:, :2] -= np.eye(2)
    half *= 0.5
    whole = image.copy()
    for first, sign in ((0, -1.0), (1, 1.0)):
        step = sign * half
        step[:, :2] += np.eye(2)
        rows = image[first::2]
        whole[first::2] = cv2.warpAffine(
            rows,
            step,
            (rows.shape[1], rows.shape[0]),
            flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )
    return whole


def join_fields(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The BGR picture (H, W, 3) of one moment: of an interlaced frame the one between its fields, else the frame."""
    motion = measure_row_motion(image[..., 1])
    return image if motion is None else remove_combs(image, motion)


def _is_combed(brightness: NDArray[np.uint8]) -> bool:
    rows = np.linspace(0, brightness.shape[0] - 5, ROWS).astype(np.int64)
    a, b, c, e = (brightness[rows + k].astype(np.int16) for k in (0, 1, 2, 4))
    near, far = (second.astype(np.float32) for second in (a - 2 * b + c, a - 2 * c + e))
    return all(
        float(np.vdot(near[:, lag:], near[:, :-lag])) > least * float(np.vdot(far[:, lag:], far[:, :-lag]))
        for lag, least in enumerate(COMBED, 1)
    )

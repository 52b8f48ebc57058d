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
ALIGNED_WIDTH_PX = 640
"""Halves that are at least twice as wide are aligned with so many of their columns joined."""
STEEPEST = 60.0
"""Of the changes along rows by which halves are aligned, gray levels over two columns, eight times: the score, which
stands still, counts no more than the stands.
"""
FARTHEST_SHARE = 0.25
"""Of the width by which the halves may be displaced."""


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
    joined = max(1, width // ALIGNED_WIDTH_PX)
    size = (width // joined, len(odd))
    reduced = (cv2.resize(half, size, interpolation=cv2.INTER_AREA) for half in (between, odd))
    seen, moved = (_change_along_rows(np.asarray(half, np.float32)) for half in reduced)
    start = np.array([[1.0, 0.0, _shift_of_rows(seen, moved)], [0.0, 1.0, 0.0]], np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, *STEPS)
    whole = np.full(moved.shape, 255, np.uint8)
    try:
        _, found = cv2.findTransformECC(seen, moved, start, cv2.MOTION_AFFINE, criteria, whole, SMOOTHING_PX)
    except cv2.error:  # the two halves have nothing in common
        return None
    factor = width / size[0]
    enlarge = np.array([[factor, 0.0, 0.5 * (factor - 1.0)], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    motion = np.asarray((enlarge @ np.vstack([found, [0.0, 0.0, 1.0]]) @ np.linalg.inv(enlarge))[:2], np.float64)
    moved_px = abs(float(motion[0] @ (width / 2, len(odd) / 2, 1.0)) - width / 2)
    return motion if LEAST_MOTION_PX < moved_px < FARTHEST_SHARE * width else None


def _change_along_rows(half: NDArray[np.float32]) -> NDArray[np.float32]:
    """Change of the brightness (h, w) along rows.

    Brightness itself has broad patches of grass and stands that look the same under any small motion: aligned by it,
    halves that a pan displaces by 9 to 17 px came out 8 to 18 % nearer, and beyond 14 px mostly at 2 to 3. Changes in
    the outer quarters count less, since a black border stands still there over the whole height.
    """
    change = np.clip(cv2.Sobel(half, cv2.CV_32F, 1, 0, ksize=3), -STEEPEST, STEEPEST)
    return np.asarray(change * np.minimum(2.0 * np.hanning(half.shape[1]), 1.0), np.float32)


def _shift_of_rows(first: NDArray[np.float32], second: NDArray[np.float32]) -> float:
    """By how many columns the rows of one picture (h, w) lie beside those of another, all rows together."""
    width = first.shape[1]
    farthest = int(FARTHEST_SHARE * width)
    count = cv2.getOptimalDFTSize(width + farthest)
    one, other = (np.fft.rfft(half, count, axis=1) for half in (first, second))
    alike = np.fft.irfft((np.conj(one) * other).sum(axis=0), count)
    shifts = np.arange(-farthest, farthest + 1)
    return float(shifts[int(np.argmax(alike[shifts]))])


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

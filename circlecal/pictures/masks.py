"""Segmentation masks: finding the one of a frame, and decoding every form of it to SoccerNet class ids.

Understood are binary masks (0/1 or 0/full, 8 or 16 bit), single-channel SoccerNet class ids and the SoccerNet palette
(the colours of the public baseline, also as a PNG with a palette). Any size; rescaled to the frame, nearest neighbour.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.errors import InputError
from circlecal.files import is_file, is_folder
from circlecal.pictures.files import MASK_FOLDER, MASK_SUFFIX, PICTURE_SUFFIXES, PictureFile, decode, read_picture_bytes
from circlecal.pictures.limits import DEFAULT_LIMITS, LimitsConfig
from circlecal.results import CIRCLE_ID

CLASS_COUNT = 28
PALETTE_RGB: dict[tuple[int, int, int], int] = {
    (0, 0, 0): 0,
    (127, 0, 0): 1,
    (102, 102, 102): 2,
    (0, 0, 127): 3,
    (86, 32, 39): 4,
    (48, 77, 0): 5,
    (14, 97, 100): 6,
    (0, 0, 255): 7,
    (255, 127, 0): 8,
    (0, 255, 255): 9,
    (255, 255, 200): 10,
    (165, 255, 0): 11,
    (155, 119, 45): 12,
    (86, 32, 139): 13,
    (196, 120, 153): 14,
    (166, 36, 52): 15,
    (255, 255, 0): 18,
    (255, 0, 255): 19,
    (0, 255, 150): 20,
    (0, 230, 0): 21,
    (230, 0, 0): 22,
    (0, 150, 255): 23,
    (254, 173, 225): 24,
    (87, 72, 39): 25,
    (122, 0, 255): 26,
    (255, 255, 255): 27,
    (128, 128, 128): 27,
    (153, 23, 153): 28,
}
"""Class id by colour; the classes 16 and 17 (unknown) are black like the background, 27 has two colours."""

_MAX_MARKED_SHARE = 0.5
"""Of the pixels: markings are thin lines, so a mask that marks more is inverted, or none."""
_EXTREME_SHARE, _EXTREME_LEVELS = 0.99, 16
"""A binary mask with soft edges has at least this share of its pixels within so many of 255 levels of black or white;
photographs and maps of probabilities have grey throughout.
"""
_MIN_SIDE = 16
"""Pixels; masks of networks are a few times smaller than pictures, which have at least 64."""

_log = logging.getLogger(__name__)


def find_mask(frame: PictureFile, given: Path | None) -> Path | None:
    """Mask file of a frame.

    Parameters
    ----------
    frame : PictureFile
        The frame.
    given : path or None
        Mask file, or a folder with masks named like the frames (``x.png`` or ``x.mask.png``, in the same subfolders or
        flat, or by id). None: ``x.mask.png`` beside the frame, else ``masks/x.png``, else there is no mask.

    Raises
    ------
    InputError
        ``given`` does not exist, or is a folder without a mask for this frame.
    """
    stem = frame.stem
    if given is None and frame.url is not None:
        return None
    if given is None:
        beside = (frame.path.with_name(f"{stem}{MASK_SUFFIX}"), *_in_folder(frame.path.parent / MASK_FOLDER, stem))
        return next((path for path in beside if is_file(path)), None)
    if is_file(given):
        return given
    if not is_folder(given):
        raise InputError(f"{given}: no such mask file or folder")
    names = dict.fromkeys((frame.mask_stem, frame.id, stem))
    found = next((path for name in names for path in _in_folder(given, name) if is_file(path)), None)
    if found is None:
        raise InputError(f"{given}: no mask for {frame.label}; looked for {stem}.png and {stem}{MASK_SUFFIX}")
    return found


def _in_folder(folder: Path, name: str) -> tuple[Path, ...]:
    return (folder / f"{name}.png", folder / f"{name}{MASK_SUFFIX}", *(folder / f"{name}{s}" for s in PICTURE_SUFFIXES))


def read_mask(path: Path, width: int, height: int, limits: LimitsConfig = DEFAULT_LIMITS) -> NDArray[np.uint8]:
    """Class ids (height, width) of a mask file.

    Raises
    ------
    InputError
        No picture, all white, or values that are no mask's; one line that says what was found.
    """
    stored = decode(path, read_picture_bytes(path, _MIN_SIDE, limits), cv2.IMREAD_UNCHANGED)
    return as_class_ids(stored, width, height, str(path))


def as_class_ids(mask: NDArray[Any], width: int, height: int, name: str) -> NDArray[np.uint8]:
    """Class ids (height, width), uint8, from a mask array: (H, W) of any integer type or bool, or BGR(A) of 8 bit; at
    least 16 pixels on each side.

    Raises
    ------
    InputError
        As :func:`read_mask`.
    """
    if mask.ndim == 3 and mask.shape[2] == 1:
        mask = mask[:, :, 0]
    if mask.ndim in (2, 3) and min(mask.shape[:2]) < _MIN_SIDE:
        raise InputError(
            f"{name}: has only {mask.shape[1]} x {mask.shape[0]} pixels; at least {_MIN_SIDE} on each side are needed"
        )
    if mask.ndim == 2:
        classes = _from_one_channel(mask, name)
    elif mask.ndim == 3 and mask.shape[2] in (3, 4):
        classes = _from_colours(mask, name)
    else:
        raise InputError(f"{name}: a mask has 1, 3 or 4 channels, not shape {mask.shape}")
    _require_thin(classes, name)
    if classes.shape == (height, width):
        return classes
    if abs(classes.shape[1] * height / (classes.shape[0] * width) - 1) > 0.02:
        _log.warning("%s: mask of %d x %d stretched to the frame's %d x %d", name, *classes.shape[::-1], width, height)
    return np.asarray(cv2.resize(classes, (width, height), interpolation=cv2.INTER_NEAREST_EXACT), dtype=np.uint8)


def _from_one_channel(mask: NDArray[Any], name: str) -> NDArray[np.uint8]:
    if mask.dtype == np.bool_:
        return np.where(mask, np.uint8(CIRCLE_ID), np.uint8(0))
    if not np.issubdtype(mask.dtype, np.integer):
        raise InputError(f"{name}: a mask holds integers, not {mask.dtype}")
    values = np.unique(mask)
    if values[0] < 0:
        raise InputError(f"{name}: a mask holds no negative values, but {values[0]} was found")
    marked = values[values > 0]
    if marked.size == 0:  # a network found nothing
        return np.zeros(mask.shape, np.uint8)
    if marked.size == 1 and not 2 <= marked[0] <= CLASS_COUNT:
        return np.where(mask > 0, np.uint8(CIRCLE_ID), np.uint8(0))
    if marked[-1] <= CLASS_COUNT:
        return mask.astype(np.uint8)
    return _from_soft_mask(mask, values, name)


def _from_soft_mask(mask: NDArray[Any], values: NDArray[Any], name: str) -> NDArray[np.uint8]:
    """Binary mask with soft edges or compression noise: nearly all pixels are nearly black or nearly white."""
    full = 255 if values[-1] <= 255 else 65535
    margin = _EXTREME_LEVELS * full // 255
    extreme = (mask <= margin) | (mask >= full - margin)
    if np.mean(extreme) < _EXTREME_SHARE or values[-1] < full - margin:
        raise InputError(
            f"{name}: {values.size} grey values up to {values[-1]} found; "
            f"a mask is binary or holds SoccerNet class ids 0..{CLASS_COUNT}"
        )
    return np.where(mask > full // 2, np.uint8(CIRCLE_ID), np.uint8(0))


def _from_colours(mask: NDArray[Any], name: str) -> NDArray[np.uint8]:
    if mask.dtype == np.uint16:
        mask = (mask // (257 if mask.max(initial=0) > 255 else 1)).astype(np.uint8)
    if mask.dtype != np.uint8:
        raise InputError(f"{name}: a colour mask has 8 or 16 bit, not {mask.dtype}")
    colours = mask[:, :, :3]
    if mask.shape[2] == 4:
        colours = np.where(mask[:, :, 3:] < 128, np.uint8(0), colours)
    grey = bool(np.all(colours == colours[:, :, :1]))
    keys = colours.astype(np.uint32) @ np.array([1, 1 << 8, 1 << 16], dtype=np.uint32)
    found, inverse, counts = np.unique(keys, return_inverse=True, return_counts=True)
    palette = {(r << 16) | (g << 8) | b: number for (r, g, b), number in PALETTE_RGB.items()}
    known = all(int(key) in palette for key in found)
    only_white = set(found.tolist()) <= {0, 0xFFFFFF}
    if grey and (only_white or not known):
        return _from_one_channel(colours[:, :, 0], name)
    if not known:
        raise InputError(f"{name}: {_unknown_colours(found, counts, palette)}")
    lookup = np.array([palette[int(key)] for key in found], dtype=np.uint8)
    return lookup[inverse.reshape(keys.shape)]


def _unknown_colours(found: NDArray[Any], counts: NDArray[Any], palette: dict[int, int]) -> str:
    unknown = np.array([int(key) not in palette for key in found])
    share = counts[unknown].sum() / counts.sum()
    key = int(found[unknown][np.argmax(counts[unknown])])
    return (
        f"{np.count_nonzero(unknown)} colours ({share:.1%} of the pixels) are not of the SoccerNet palette, "
        f"e.g. RGB ({key >> 16}, {key >> 8 & 255}, {key & 255}); save the mask as PNG with class ids or palette"
    )


def _require_thin(classes: NDArray[np.uint8], name: str) -> None:
    share = float(np.count_nonzero(classes)) / classes.size
    if share == 1.0 and np.ptp(classes) == 0:
        raise InputError(f"{name}: is all white: every pixel is marked; a mask is zero where there is no marking")
    if share > _MAX_MARKED_SHARE:
        raise InputError(f"{name}: marks {share:.0%} of the picture; markings are thin lines: is the mask inverted?")

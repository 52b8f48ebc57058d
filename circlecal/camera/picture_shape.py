"""What the size of a picture tells of its camera: one of a shape that no camera takes was cut out of a larger one,
whose middle nobody knows, and sizes of standard television have pixels that are not square.
"""

from __future__ import annotations

import numpy as np

WHOLE_SD_PX = 15.0
"""Standard deviation of the principal point about the middle of a whole picture, pixels at 1920 px width. Of the
cameras of eight real clips, which all their frames tell to 1 to 3 px, it lies 18 px rms off.
"""
CUT_SD_PX = 250.0
"""That of a picture that was cut along both sides, pixels at 1920 px width: the rms along its width where 55 to 100 %
of the larger picture's are left and every place of the cut is alike.
"""
CUT_WIDTH_SQUARE = 0.62
"""Mean square of the share of the width that is left of such a picture, where 55 to 100 % are, all alike."""
SHAPES = (16 / 9, 4 / 3, 3 / 2, 5 / 4, 16 / 10, 11 / 9, 9 / 16, 3 / 4, 2 / 3)
"""Width over height of the pictures that cameras take, television keeps, and telephones show upright. Those of the
cinema are not among them: what has one was mostly cut, or has a width of video, which tells that.
"""
SHAPE_TOLERANCE = 0.01
"""How far a picture may be from them, as a share: 398 x 224 and 854 x 480 are 16:9. Of 82 real frames three are
farther, 1.9 % or more, all of them pictures of a part of a screen.
"""
USUAL_SHAPE = 16 / 9
"""Of the picture that one of a standard width or height was cut out of."""
WIDTHS = (640, 720, 768, 854, 960, 1024, 1280, 1440, 1600, 1920, 2048, 2560, 3840, 4096)
HEIGHTS = (360, 480, 540, 576, 720, 900, 1080, 1152, 1440, 2160)
"""Pixels of pictures of video and of screens: one that has kept such a side was cut along the other only."""
OBLONG_SIZES = (
    (720, 576), (704, 576), (720, 480), (704, 480), (352, 288), (352, 240), (176, 144), (1408, 1152)
)  # fmt: skip
"""Sizes in pixels, width and height, in which standard television and its halves are stored: never with square pixels,
whatever the file tells. Pictures of other sizes that were squeezed cannot be told by their size.
"""
SHOWN_SHAPES = (16 / 9, 4 / 3)
"""Width over height of what such a picture shows, either as likely as the other."""


def is_oblong(width: int, height: int) -> bool:
    """Whether a picture has a size of television whose pixels are not square."""
    return (width, height) in OBLONG_SIZES


def list_aspects(width: int, height: int) -> tuple[float, ...]:
    """Widths of a pixel over its height that a picture of this size may have, the wider one first: one of wide and one
    of old television for its sizes, and 1 for all others.
    """
    if not is_oblong(width, height):
        return (1.0,)
    return tuple(shape * height / width for shape in SHOWN_SHAPES)


def usual_log_aspect(width: int, height: int) -> tuple[float, float]:
    """Mean and standard deviation of the logarithm of a pixel's width over its height, where nothing but the size of
    its picture is known.
    """
    logs = np.log(list_aspects(width, height))
    return float(logs.mean()), float(logs.std())


def is_cut(width: int, height: int) -> bool:
    """Whether a picture has the shape of none that a camera takes, so that it is a part of a larger one; upright ones
    as high as a video are, too.
    """
    if is_oblong(width, height):
        return False
    apart = min(abs(width / height / shape - 1.0) for shape in SHAPES)
    return apart > SHAPE_TOLERANCE or (width < height and height in HEIGHTS)


def usual_point_sd(width: int, height: int) -> tuple[float, float]:
    """Standard deviations of the principal point about the middle of a picture of which nothing else is known, along
    its width and its height, in its own pixels.
    """
    unit = width / 1920.0
    whole, cut = WHOLE_SD_PX * unit, CUT_SD_PX * unit
    if not is_cut(width, height):
        return whole, whole
    lost_width, lost_height = USUAL_SHAPE * height - width, width / USUAL_SHAPE - height
    if width in WIDTHS and lost_height > 0.0:
        return whole, _with_cut(whole, lost_height)
    if height in HEIGHTS and lost_width > 0.0:
        return _with_cut(whole, lost_width), whole
    return cut, cut


def square_of_width_left(width: int, height: int) -> float:
    """Square of the share of the larger picture's width that is left of a picture of which nothing else is known: on
    the average where the share is not known, 1 for whole pictures.

    Distortion in half-widths of the picture is that share times what it is in half-widths of the larger one.
    """
    if not is_cut(width, height) or (width in WIDTHS and width > USUAL_SHAPE * height):
        return 1.0
    if height in HEIGHTS and width < USUAL_SHAPE * height:
        return (width / (USUAL_SHAPE * height)) ** 2
    return CUT_WIDTH_SQUARE


def _with_cut(whole: float, lost: float) -> float:
    """Standard deviation along a side that was shortened by so many pixels, anywhere at its two ends."""
    return float(np.hypot(whole, lost / np.sqrt(12.0)))

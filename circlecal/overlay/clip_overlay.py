"""Pictures of an overlay video: the field template through the camera of each frame, and a strip that tells of it."""

from __future__ import annotations

import math

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.overlay.canvas import Canvas, Picture
from circlecal.overlay.palette import REFUSED, TEMPLATE, WHITE
from circlecal.overlay.template_lines import draw_template

_TEXT = 0.75
"""Height of the strip's text, of that of other overlays."""


def draw_clip_frame(
    image_bgr: Picture,
    view: FieldView | None,
    template: FieldTemplate,
    circle: str,
    time_s: float,
    facts: list[str],
    most_sigma_px: float,
) -> Picture:
    """Draw the field template over a frame, and a strip with its time and a few words.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
        The frame.
    view : FieldView or None
        Where the field is seen; None for a refused frame, over which nothing is drawn.
    template, circle : FieldTemplate, str
        The field, and the circle in its own colour.
    time_s : float
        Time in the video, seconds.
    facts : list of str
        What the strip tells behind the time.
    most_sigma_px : float
        Standard deviation, pixels at 1920 px width, beyond which a marking is dashed: nothing tells where it is.
    """
    canvas = Canvas.of(image_bgr)
    if view is not None:
        most_px = most_sigma_px * image_bgr.shape[1] / 1920.0
        draw_template(canvas, view, template, circle, most_sigma_px=most_px)
    height = _TEXT * canvas.text_px
    top = canvas.height - 2.6 * height
    canvas.shade(0, top, canvas.width, canvas.height)
    left = canvas.text(_clock(time_s), 1.2 * height, top + 0.8 * height, WHITE, height, halo=False) + 3.0 * height
    canvas.text("  ".join(facts), left, top + 0.8 * height, REFUSED if view is None else TEMPLATE, height, halo=False)
    return canvas.picture


def _clock(time_s: float) -> str:
    minutes, seconds = divmod(math.floor(time_s * 100.0 + 0.5) / 100.0, 60.0)
    return f"{int(minutes):d}:{seconds:05.2f}"

"""How well the markings of a field lie where it puts them, when each is measured anew where the field was laid: fields
of two leagues cover the same paint, a few decimetres beside it in one of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.field import Circle
from circlecal.field.view import FieldView
from circlecal.pipeline.placed_view import count_carrying, settle_view
from circlecal.pipeline.setting import Scene, Setting, lighten_markings
from circlecal.results import Attempt, CameraFit

NEAR_PX = 0.5
"""Residual of a marking that counts half, pixels at 1920 px width, with painters' errors on top of it: right cameras of
rendered rinks have 0.2 to 0.7, those of the other league 0.5 to 3 and at most as many markings.
"""


def measure_agreement(
    setting: Setting, scene: Scene, attempt: Attempt, circle: Circle, view: FieldView, fewest: int = 0
) -> float:
    """How many markings lie where a field puts them that was laid over the picture, the nearer the more: see
    :func:`count_agreeing`; none where no camera settles there that is believed.

    Parameters
    ----------
    setting : Setting
        With the field that was laid as its template.
    scene, attempt : Scene, Attempt
        The picture, and the attempt from which its mask and edges are taken.
    circle, view : Circle, FieldView
        The circle of the field that is taken for the seen one, and where the field was laid.
    fewest : int
        Markings that must carry the camera at least: a circle, a line and a spot fit fields of other sizes by chance.
    """
    mask, edges = attempt.mask, attempt.edges
    if mask is None or edges is None:
        return 0.0
    told = replace(setting, circle=circle)
    seen = Attempt(mask=replace(mask, halfway=None), edges=edges, circle_name=circle.name)
    settled = settle_view(told, scene, lighten_markings(scene.marked, mask, circle), seen, view)
    if settled is None or settled.camera is None or not settled.is_calibrated:
        return 0.0
    return count_agreeing(settled.camera) if count_carrying(settled) >= fewest else 0.0


def count_agreeing(camera: CameraFit) -> float:
    """How many markings lie where a camera puts them, each counted by its residual: 1 at none, half at
    :data:`NEAR_PX` and painters' errors together.
    """
    near_px = NEAR_PX * camera.view.camera.width / 1920.0
    keys = list(camera.residuals_px)
    off_px = np.array([camera.residuals_px[key] for key in keys])
    allowed_px = np.hypot(near_px, [camera.painted_sigma_px.get(key, 0.0) for key in keys])
    return float(np.sum(1.0 / (1.0 + (off_px / allowed_px) ** 2)))

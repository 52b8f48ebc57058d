"""Whether a predicted circle is painted nearly everywhere, however faintly."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.camera.parameters import fitted_model, project
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.paint.matched_filter import CLEAR, LEAST_WIDTH_PX, SAMPLES, SECTORS, sectors_standing_out
from circlecal.results import CameraFit

__all__ = ["painted_all_round", "painted_sectors"]

LEAST_SHARE, LEAST_SECTORS = 0.75, 18
"""A circle is painted with this share of its sectors, if the picture shows three quarters of them (no arc of another
marking is as long, and ellipses stitched from other lines and streaks have half of them at most).
"""


def painted_all_round(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> bool:
    """Whether paint shows nearly everywhere along the predicted circle; the parameters are those of
    :func:`painted_sectors`.
    """
    sectors = painted_sectors(picture, fit, template, circle)
    return len(sectors) >= LEAST_SECTORS and float(np.mean(sectors > CLEAR)) >= LEAST_SHARE


def painted_sectors(picture: NDArray[np.uint8], fit: CameraFit, template: FieldTemplate, circle: Circle) -> Array:
    """By how many standard deviations the paint stands out in each sector of the circle that the picture shows.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        Says where the circle is.
    template, circle : FieldTemplate, Circle
        The field and the circle.

    Returns
    -------
    (K,) array
        At most :data:`SECTORS` of them, in order.
    """
    model = fitted_model(fit, circle)
    angle = (np.arange(SECTORS * SAMPLES) + 0.5) * (2 * np.pi / (SECTORS * SAMPLES))
    outward = np.stack([np.cos(angle), np.sin(angle)])
    ring = np.asarray(circle.center) + template.radius(circle, "center") * outward.T
    seen = project(fit.theta[None], ring[None], model)
    along = seen.along(-outward[None, 1], outward[None, 0])[0].T
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
    across = np.abs((seen.along(outward[None, 0], outward[None, 1])[0].T * normals).sum(axis=-1))
    width = np.maximum(template.marking_width_m * across, LEAST_WIDTH_PX * model.width / 1920.0)
    places = np.where(seen.depth[0][:, None] > 0, seen.pixels[0], -1.0)
    return sectors_standing_out(picture, places, width[:, None] * normals)

"""The rim of a logo that fills a circle, measured where a view puts it."""

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.paint.along_curve import RaysConfig
from circlecal.pipeline.logo_rims import measure_logo_rims


@pytest.mark.parametrize("logo_m", [4.4, 4.53, 4.57])
def test_a_circle_that_a_logo_fills_is_measured_by_its_rim(logo_m):
    """It ends at either edge of the line, so that no point is surer than half of that, or leaves a gap to it."""
    rink, scale = load_field("ice-hockey-nhl"), 40.0
    circle = rink.circle_by_name["centre_circle"]
    seen_from = FieldView(PlaneCamera(640, 480, np.array([[scale, 0.0, 320.0], [0.0, scale, 240.0], [0.0, 0.0, 1.0]])))
    outer = rink.radius(circle, "outer")
    picture = np.full((480, 640, 3), 220, np.uint8)
    for radius, ink in (
        (outer, (190, 150, 150)),
        (outer - rink.marking_width_m, (220, 220, 220)),
        (logo_m, (90, 60, 160)),
    ):
        cv2.circle(picture, (16 * 320, 16 * 240), round(16 * scale * radius), ink, cv2.FILLED, cv2.LINE_AA, 4)
    given = seen_from, rink, [circle], None, RaysConfig()
    (found,) = measure_logo_rims(cv2.GaussianBlur(picture, (0, 0), 1.0), *given)
    assert (found.circle, found.edge) == ("centre_circle", "outer")
    off = np.linalg.norm(found.points_px - (320.0, 240.0), axis=1) / scale - outer
    assert np.abs(np.median(off)) < 0.6 * rink.marking_width_m  # which is 2 px, and as much blurred
    assert found.sigma_px.min() >= 0.45 * scale * rink.marking_width_m
    assert measure_logo_rims(np.full_like(picture, 220), *given) == ()

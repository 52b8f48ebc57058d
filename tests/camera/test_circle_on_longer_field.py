"""A circle at one end of a field whose length is estimated lies elsewhere than on the template."""

import numpy as np
import pytest

from circlecal.camera.options import CameraConfig
from circlecal.field import load_field
from circlecal.formats.cameras import CalibratedFrame, derive_shapes
from circlecal.observations import CirclePoints, LinePoints, Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
ARC = SOCCER.circle_by_name["penalty_arc_right"]
GROWTH_M, SIGMA_PX = -8.0, 0.2
CENTER_M = np.array([ARC.center[0] + GROWTH_M / 2.0, ARC.center[1]])
CAMERA = aim_camera(np.array([30.0, 55.0, -14.0]), np.array([28.0, 0.0, 0.0]), 1500.0, 0.0, 1920, 1080)


@pytest.fixture(scope="module")
def fit():
    rng = np.random.default_rng(0)

    def seen(points_m):
        pixels = CAMERA.project(points_m) + rng.normal(0.0, SIGMA_PX, (len(points_m), 2))
        return pixels[((pixels > 0) & (pixels < (1920, 1080))).all(axis=1)]

    def circle(name, center_m, start_deg=0.0, end_deg=360.0):
        angle = np.radians(np.linspace(start_deg, end_deg, 150))
        ring = SOCCER.radius(SOCCER.circle_by_name[name], "center") * np.c_[np.cos(angle), np.sin(angle)]
        points = seen(center_m + ring)
        return CirclePoints(name, "center", points, np.full(len(points), SIGMA_PX))

    def line(name):
        drawn = SOCCER.line_by_name[name]
        shift = SOCCER.line_shift(drawn)
        points = seen(np.linspace(*(SOCCER.line_ends(drawn) + GROWTH_M * shift[1]), 200))
        return LinePoints(name, points, np.full(len(points), SIGMA_PX))

    circles = circle(ARC.name, CENTER_M, ARC.start_deg, ARC.end_deg), circle("centre_circle", np.zeros(2))
    names = "halfway_line", "big_rect_right_main", "big_rect_right_top", "big_rect_right_bottom", "side_line_right"
    observations = Observations(1920, 1080, circles, tuple(map(line, names)))
    options = CameraConfig(distortion="none", crown_shape="flat", principal_point_sd_px=0)
    return estimate_camera(observations, SOCCER, ARC, options)


def test_its_centre_and_points_are_where_they_are_seen(fit):
    assert fit.field_size.length_m == pytest.approx(SOCCER.length_m + GROWTH_M, abs=0.4)
    sd = np.sqrt(np.diag(fit.imaged_center_covariance))
    assert (np.abs(fit.imaged_center_px - CAMERA.project(CENTER_M[None])[0]) < 4.0 * sd).all() and sd.max() < 1.0
    for point in fit.derived_points:
        np.testing.assert_allclose(point.image_px, CAMERA.project(point.field_m[None])[0], atol=1.0)
    np.testing.assert_allclose(fit.derived_points[0].field_m, CENTER_M + np.array([ARC.radius_m, 0.0]), atol=0.2)


def test_shapes_for_other_programs_are_where_they_are_seen(fit):
    shapes = derive_shapes(CalibratedFrame("a", 1920, 1080, fit.view, SOCCER, ARC)).shapes
    (centre,) = (shape for shape in shapes if shape.label.endswith("centre"))
    np.testing.assert_allclose(centre.points_px, CAMERA.project(CENTER_M[None]), atol=1.0)


def test_a_view_has_the_circle_where_it_draws_it(fit):
    angle = np.radians(np.linspace(ARC.start_deg, ARC.end_deg, 20))
    placed = fit.view.circle_points(ARC, "center", angle, SOCCER)
    off = placed[:, None] - fit.view.markings(SOCCER)[ARC.name]
    assert np.linalg.norm(off, axis=-1).min(axis=1).max() < 0.2

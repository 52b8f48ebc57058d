"""Markings of a field measured where a view puts them: enough of a line, and the rim of a logo."""

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.pipeline import template_markings
from circlecal.pipeline.template_markings import measure_logo_rims
from circlecal.results import LineCue, Segment
from circlecal.stages.rays import RaysConfig


@pytest.mark.parametrize(("count", "is_seen"), [(60, True), (17, False)])
def test_a_line_is_seen_where_enough_of_its_places_are(count, is_seen):
    places = np.stack([np.linspace(100.0, 400.0, count), np.full(count, 50.0)], axis=-1)
    cue = LineCue(
        "goal_line_left", np.array([0.0, 1.0, -50.0]), places, np.full(count, 0.1), Segment(places[0], places[-1]), 0.0
    )
    whole = Segment(np.array([90.0, 50.0]), np.array([410.0, 50.0]))
    assert template_markings._is_seen(cue, whole) is is_seen
    longer = Segment(np.array([90.0, 50.0]), np.array([1200.0, 50.0]))
    assert not template_markings._is_seen(cue, longer)


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

"""Every marking of a field, measured where a view puts it."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.surface import FLAT
from circlecal.paint.along_curve import RaysConfig
from circlecal.paint.local_energy import local_energy
from circlecal.paint.profiles import to_gray
from circlecal.pipeline import template_markings
from circlecal.pipeline.template_markings import measure_straight_markings
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.renderer import render
from circlecal.synthetic.scene import Scene
from tests.stages.conftest import paint_field


def test_a_line_that_a_lens_bends_is_measured_along_its_curve():
    """A barrel lens bends the line across the picture by 60 px; 5 cm of paint are up to 30 px wide."""
    field = load_field("robocup")
    line = field.line_by_name["halfway_line"]
    camera = aim_camera(np.array([-1.0, 0.0, -1.0]), np.array([0.2, 0.0, 0.0]), 700.0, 0.0, 1280, 720, -0.12)
    picture = to_gray(paint_field(camera, field))
    (seen,) = measure_straight_markings(picture, FieldView(camera, FLAT), field, (line,), None, 1.5, RaysConfig())
    assert seen.line == line.name
    bend = seen.points_px[:, 1] if np.ptp(seen.points_px[:, 0]) > 600 else seen.points_px[:, 0]
    assert np.ptp(bend) > 10.0
    ground = camera.back_project(seen.points_px, FLAT)
    assert np.abs(ground[:, 0]).max() < 0.1 * field.marking_width_m


@pytest.mark.parametrize(("count", "is_seen"), [(60, True), (17, False)])
def test_a_line_is_seen_where_enough_of_its_places_are(count, is_seen):
    points = np.stack([np.linspace(100.0, 400.0, count), np.full(count, 50.0)], axis=-1)
    whole, longer = (np.array([[90.0, 50.0], [end, 50.0]]) for end in (410.0, 1200.0))
    assert template_markings._is_seen(points, whole, 0.5) is is_seen
    assert not template_markings._is_seen(points, longer, 0.5)


def test_a_broad_line_is_measured_where_it_is_one_band():
    """Where edges are bands the hog line of a curling sheet was measured at one of its edges, 5 cm off."""
    field = load_field("curling")
    line = field.line_by_name["hog_line_left"]
    (x, _), _ = field.line_ends(line)
    camera = aim_camera(np.array([x + 1.0, 17.0, -9.0]), np.array([x, 0.0, 0.0]), 1700.0, 0.0, 1280, 720)
    rng = np.random.default_rng(3)
    picture = render(Scene(camera, field, FLAT, sample_config("ice", rng, 1280).clean()), rng).image
    gray, energy = to_gray(picture), local_energy(picture)
    off = {}
    for name, plain in (("bands", None), ("plain", ~gray)):
        given = energy, FieldView(camera, FLAT), field, (line,), None, 1.5, RaysConfig()
        (seen,) = measure_straight_markings(*given, plain=plain)
        off[name] = np.median(camera.back_project(seen.points_px, FLAT)[:, 0]) - x
    assert abs(off["plain"]) < 0.005 < 0.03 < abs(off["bands"])

"""Painted discs: a curling house."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.surface import FLAT
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.paint import paint_layers
from circlecal.synthetic.sampling import sample_scene


def test_a_disc_is_filled_up_to_its_rim_and_lies_under_the_lines():
    template = load_field("curling")
    house = template.circle_by_name["twelve_foot_left"]
    (x, y), radius = house.center, house.radius_m
    camera = aim_camera(np.array([x, y + 7.0, -5.0]), np.array([x, y, 0.0]), 300.0, 0.0, 320, 180)
    layers = paint_layers(camera, template, FLAT, template.marking_width_m)
    names = [layer.name for layer in layers]
    assert names.index("twelve_foot_left") < names.index("eight_foot_left") < names.index("button_left")
    assert names.index("button_left") < names.index("tee_line_left")
    layer = layers[names.index("twelve_foot_left")]
    ground = camera.back_project(np.stack([layer.columns, layer.rows], axis=-1).astype(float), FLAT)
    distance = np.hypot(*(ground - (x, y)).T)
    assert (layer.coverage[distance < 0.95 * radius] > 0.99).all()
    assert (layer.coverage[distance > 1.05 * radius] < 0.01).all()
    area = layer.coverage.sum()
    middle = camera.project(np.array([[x, y, 0.0]]))[0]
    assert area > 500
    assert layer.coverage[np.argmin(np.hypot(layer.columns - middle[0], layer.rows - middle[1]))] > 0.99


def test_a_line_that_is_wider_than_the_others_is_painted_so():
    """The hog line has 4 inches, the others half an inch: all were painted 5 cm wide."""
    template = load_field("curling")
    line = template.line_by_name["hog_line_left"]
    x = template.line_ends(line)[0, 0]
    camera = aim_camera(np.array([x, 0.0, -5.0]), np.array([x, 0.01, 0.0]), 1000.0, 0.0, 320, 180)
    (layer,) = (one for one in paint_layers(camera, template, FLAT, 0.0127) if one.name == line.name)
    row = layer.rows == 90
    assert layer.coverage[row].sum() / 200.0 == pytest.approx(template.paint_width(line), abs=0.002)


def test_a_sheet_of_curling_has_nothing_of_a_rink():
    """Its centre line was 30 cm wide, its house lay under a crease and adverts, and its lines were 5 cm wide."""
    template = load_field("curling")
    scene = sample_scene("ice", np.random.default_rng(1), 640, 360, template)
    assert (scene.extras, scene.decals, dict(scene.widths_m)) == ((), (), {})
    assert scene.config.marking_width_m == template.marking_width_m
    rink = sample_scene("ice", np.random.default_rng(1), 640, 360)
    assert rink.extras and rink.decals and rink.widths_m

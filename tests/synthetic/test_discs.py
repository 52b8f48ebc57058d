"""Painted discs: a curling house."""

import numpy as np

from circlecal.field import load_field
from circlecal.geometry.surface import FLAT
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.paint import paint_layers


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

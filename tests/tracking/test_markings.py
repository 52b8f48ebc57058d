"""What is taken for the paint of a marking."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.geometry.camera_parameters import INDEX, project
from circlecal.tracking.frame_paint import residuals_of
from circlecal.tracking.markings import Places, grow_places, place_markings, template_curves
from circlecal.tracking.one_line import keep_one_line
from circlecal.tracking.seen_paint import measure_markings
from tests.tracking.scenes import HEAD, measure_ideal, template, tripod


@pytest.mark.parametrize(("beside", "is_two"), [(4, False), (20, True)])
def test_boards_behind_a_line_are_not_the_line(beside: int, is_two: bool) -> None:
    rng = np.random.default_rng(1)
    marking = np.repeat([0, 2], 40)
    # the camera is off by 3 px at one end of each line and not at the other
    offset = np.tile(np.linspace(0.0, 3.0, 40), 2) + rng.normal(0.0, 0.2, 80)
    offset[10 : 10 + beside] -= 6.0
    on = rng.random(80) > 0.1
    kept, is_double = keep_one_line(on, offset, marking, 2.5, 3)
    assert is_double.tolist() == [is_two, False, False]
    np.testing.assert_array_equal(kept[40:], on[40:])
    assert not kept[10 : 10 + beside].any()
    assert kept[:10].any() != is_two


@pytest.mark.parametrize(("blur_px", "missing"), [((0.0, 0.0), 1), ((4.0, 0.0), 1), ((14.0, 0.0), 0), ((0.0, 14.0), 1)])
def test_paint_that_a_pan_smears_need_not_be_seen(blur_px: tuple[float, float], missing: int) -> None:
    grass = np.random.default_rng(2).normal(90.0, 3.0, (360, 640)).astype(np.uint8)
    along = np.arange(20.0, 340.0, 8.0)
    count = len(along)
    pixels = np.column_stack([np.full(count, 300.0), along])
    places = Places(
        np.zeros(count, np.int_), np.zeros((count, 2)), pixels, np.tile([1.0, 0.0], (count, 1)), np.full(count, 6.0),
        np.full(count, 50.0), np.zeros(count), np.zeros((count, 1)),
    )  # fmt: skip
    measured, _ = measure_markings(grass, places, np.ones(count), 1.0, 1, np.array(blur_px))
    assert measured.missing == missing


def test_circles_bend_in_the_picture_as_their_places_do_and_lines_do_not() -> None:
    drawn, camera = template_curves(template()), tripod()
    theta = camera.model.thetas(HEAD[None] + np.array([0.0, 0.35, -0.02]), camera.mean)[0]
    places = place_markings(drawn, theta, camera.model.projection, 0.12)
    on_circle = places.marking == np.flatnonzero(drawn.is_circle)[0]
    assert np.count_nonzero(on_circle) > 60
    assert (places.curvature[drawn.radius[places.marking] == 0] == 0.0).all()
    angle = np.arctan2(*places.field_m[on_circle].T[::-1])
    turned = [drawn.radius[places.marking[on_circle]][:, None] * np.stack([np.cos(a), np.sin(a)], axis=-1)
              for a in (angle - 0.02, angle, angle + 0.02)]  # fmt: skip
    number = places.marking[on_circle]
    before, here, after = (
        project(theta[None], grow_places(drawn, number, points, theta)[None], camera.model.projection).pixels[0]
        for points in turned
    )
    bent = ((after - 2.0 * here + before) * places.normals[on_circle]).sum(axis=1)
    exact = bent / (((after - before) / 2.0) ** 2).sum(axis=1)
    told = places.curvature[on_circle]
    assert np.count_nonzero(told) > 0.9 * len(told)
    # at the tips of the ellipse neighbours are a third of its bend apart
    is_flat = (told != 0) & (np.abs(exact) < 0.005)
    assert np.count_nonzero(is_flat) > 40
    np.testing.assert_allclose(told[is_flat], exact[is_flat], rtol=0.06)


def test_where_a_halfway_line_ends_moves_none_of_the_paint_on_it() -> None:
    # seen through a lens that bends it; as a share of the line, a place would slide along it
    drawn, camera = template_curves(template()), tripod()
    head = np.array([np.log(2200.0), -0.01, 1.38])
    measured = measure_ideal(head, np.zeros(2), 0.1, np.random.default_rng(3))
    theta = camera.model.thetas(head[None], camera.mean)[0]
    theta[INDEX["kappa_1"]] = -0.1
    away, _ = residuals_of(measured, drawn, theta, camera.model.projection)
    theta[INDEX["breadth"]] = -20.0
    narrower, by_theta = residuals_of(measured, drawn, theta, camera.model.projection)
    on_line = measured.marking == drawn.names.index("halfway_line")
    assert np.count_nonzero(on_line) > 20
    np.testing.assert_array_equal(narrower[on_line], away[on_line])
    assert (by_theta[on_line, INDEX["breadth"]] == 0.0).all()


def test_places_follow_the_sizes_of_the_field_as_their_derivatives_say() -> None:
    drawn, camera = template_curves(template()), tripod()
    model = camera.model.projection
    theta = camera.model.thetas(HEAD[None] + np.array([0.0, -0.1, 0.0]), camera.mean)[0]
    theta[[INDEX["length"], INDEX["breadth"]]] = [-5.0, 3.0]
    places = place_markings(drawn, theta, model, 0.12)
    assert len(set(places.marking)) > 4
    for size in ("length", "breadth"):
        step = np.zeros(len(theta))
        step[INDEX[size]] = 0.01
        after, before = (
            project(t[None], grow_places(drawn, places.marking, places.field_m, t)[None], model).pixels[0]
            for t in (theta + step, theta - step)
        )
        moved = ((after - before) * places.normals).sum(axis=1) / 0.02
        np.testing.assert_allclose(places.by_theta[:, INDEX[size]], moved, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("broader_m", [-20.0, 20.0])
def test_goals_hide_as_much_of_their_line_on_fields_of_any_width(broader_m: float) -> None:
    drawn, camera = template_curves(template()), tripod()
    theta = camera.model.thetas(HEAD[None] + np.array([0.0, -0.15, 0.0]), camera.mean)[0]
    theta[INDEX["breadth"]] = broader_m
    places = place_markings(drawn, theta, camera.model.projection, 0.12, spacing_px=1.0)
    on_line = places.marking == drawn.names.index("side_line_left")
    grown = grow_places(drawn, places.marking[on_line], places.field_m[on_line], theta)
    assert 5.0 < np.abs(grown[:, 1]).min() < 5.7

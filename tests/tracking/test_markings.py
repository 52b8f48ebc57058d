"""What is taken for the paint of a marking."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.field.loading import field_names
from circlecal.field.view import FieldView
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, ProjectionModel, project, theta_of
from circlecal.geometry.projective import Array
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.optics import motion_kernel
from circlecal.synthetic.paint import paint_layers
from circlecal.tracking.frame_paint import residuals_of
from circlecal.tracking.markings import Places, grow_places, place_markings, template_curves
from circlecal.tracking.one_line import keep_one_line
from circlecal.tracking.seen_paint import BESIDE_BIAS_PX, measure_markings
from tests.tracking.scenes import HEAD, measure_ideal, template, tripod

CIRCLE_HEAD = HEAD + np.array([0.8, 0.35, -0.02])
"""Sees the centre circle large."""


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
        np.full(count, 50.0), np.zeros(count), np.zeros(count), np.zeros((count, 1)),
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
    np.testing.assert_allclose(places.curvature[on_circle], exact, rtol=0.02, atol=1e-4)


def circle_places() -> tuple[Places, Array]:
    """Places on the centre circle, seen large, and the camera (P,)."""
    drawn, camera = template_curves(template()), tripod()
    theta = camera.model.thetas(CIRCLE_HEAD[None], camera.mean)[0]
    places = place_markings(drawn, theta, camera.model.projection, template().marking_width_m)
    return places.take(np.flatnonzero(drawn.is_circle[places.marking])), theta


def test_the_middle_between_the_edges_of_a_curve_lies_inside_it() -> None:
    drawn, model = template_curves(template()), tripod().model.projection
    places, theta = circle_places()
    radius, center = drawn.radius[places.marking][:, None], drawn.center[places.marking]
    slant = places.field_m - center
    angle = np.arctan2(slant[:, 1], slant[:, 0])[:, None] + np.linspace(-0.04, 0.04, 2001)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    crossings = []
    for side in (-0.5, 0.5):
        edge = center[:, None] + (radius + side * template().marking_width_m)[..., None] * ring
        away = project(theta[None], edge.reshape(1, -1, 2), model).pixels.reshape(edge.shape) - places.pixels[:, None]
        along = away[..., 0] * places.normals[:, None, 1] - away[..., 1] * places.normals[:, None, 0]
        across = (away * places.normals[:, None]).sum(axis=-1)
        crossings.append(np.take_along_axis(across, np.abs(along).argmin(axis=1)[:, None], axis=1)[:, 0])
    middles = (crossings[0] + crossings[1]) / 2.0
    assert np.abs(middles).max() > 0.04
    np.testing.assert_allclose(places.offset_middles(np.zeros(2)), middles, rtol=0.1, atol=0.004)


@pytest.mark.parametrize("blur_px", [1.0, 1.5])
def test_blurred_paint_of_a_curve_is_measured_on_the_curve(blur_px: float) -> None:
    places, _ = circle_places()
    view = tripod().view(CIRCLE_HEAD, np.zeros((3, 3)))
    picture = np.full((720, 1280), 90.0)
    for layer in paint_layers(view.camera, template(), view.surface, 0.12, elements=template().circles):
        picture[layer.rows, layer.columns] += 80.0 * layer.coverage
    gray = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), blur_px)
    seen, at = measure_markings(gray, places, np.full(len(places.pixels), 0.3), 1280 / 1920, 23)
    shown = places.take(at)
    off = ((seen.points_px - shown.pixels) * seen.normals).sum(axis=1) * np.sign(shown.curvature)
    tips = np.abs(shown.curvature) > 0.002
    corrected = ((shown.offset_middles(np.zeros(2)) + shown.shift_by_blur(blur_px**2)) * np.sign(shown.curvature))[tips]
    assert np.count_nonzero(tips) > 20
    assert corrected.mean() > 0.01
    assert abs(off[tips].mean()) < 0.4 * corrected.mean()


@pytest.mark.parametrize("growth_m", [(0.0, 0.0), (-13.0, -9.0), (4.0, 6.0)])
def test_markings_end_where_a_field_of_another_size_ends(growth_m: tuple[float, float]) -> None:
    drawn, camera = template_curves(template()), tripod()
    sized = FieldView(camera.view(HEAD, np.zeros((3, 3))).camera, growth_m=np.array(growth_m)).markings(template())
    theta = np.zeros(len(PARAMETERS))
    theta[[INDEX["length"], INDEX["breadth"]]] = growth_m
    for number, name in enumerate(drawn.names):
        marking = np.full(2, number)
        ends = grow_places(drawn, marking, drawn.places(marking, np.array([0.0, 1.0]), theta), theta)
        np.testing.assert_allclose(ends, sized[name][[0, -1]], atol=1e-9)


def test_places_are_looked_for_up_to_the_end_of_the_field_as_it_is() -> None:
    drawn, camera = template_curves(template()), tripod()
    theta = camera.model.thetas(HEAD[None] + np.array([-0.7, 0.35, 0.1]), camera.mean)[0]
    on_halfway = drawn.names.index("halfway_line")
    for broader_m in (-10.0, 0.0, 10.0):
        theta[INDEX["breadth"]] = broader_m
        places = place_markings(drawn, theta, camera.model.projection, 0.12)
        nearest_m = places.field_m[places.marking == on_halfway, 1].max()
        assert nearest_m == pytest.approx((template().width_m + broader_m) / 2.0, abs=1.5)


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


@pytest.mark.parametrize("way_px", [0.0, 30.0])
def test_paint_beside_another_marking_is_doubtful_as_far_as_that_is_smeared(way_px: float) -> None:
    # a line from left to right, and one that ends at its middle from above
    along, down = np.arange(20.0, 400.0, 8.0), np.arange(22.0, 208.0, 8.0)
    pixels = np.concatenate([np.column_stack([along, np.full_like(along, 210.0)]),
                             np.column_stack([np.full_like(down, 212.0), down])])  # fmt: skip
    is_level = np.arange(len(pixels)) < len(along)
    normals = np.where(is_level[:, None], [0.0, 1.0], [1.0, 0.0])
    count = len(pixels)
    places = Places(
        np.where(is_level, 0, 1), np.zeros((count, 2)), pixels, normals, np.full(count, 4.0), np.full(count, 50.0),
        np.zeros(count), np.zeros(count), np.zeros((count, 1)),
    )  # fmt: skip
    picture = np.full((360, 640), 90, np.uint8)
    picture[208:213] = 150
    picture[:210, 210:215] = 150
    picture = cv2.GaussianBlur(picture, (0, 0), 0.8)
    if way_px:
        picture = np.asarray(cv2.filter2D(picture, -1, motion_kernel(way_px, 0.0)), np.uint8)
    seen, at = measure_markings(picture, places, np.full(count, 0.5), 1.0, 2, np.array([way_px, 0.0]))
    doubtful = np.zeros(count, np.bool_)
    doubtful[at] = seen.bias_px >= BESIDE_BIAS_PX
    reached = np.abs(pixels[:, 0] - 212.0)
    shown = np.isin(np.arange(count), at)
    assert doubtful[is_level & shown & (reached < 4.0 + way_px / 2.0)].all()
    assert not doubtful[is_level & shown & (reached > 30.0 + way_px / 2.0)].any()
    assert np.count_nonzero(is_level & shown & ~doubtful) > 20


def test_the_sharp_line_at_a_corner_is_not_the_smeared_one() -> None:
    # a smeared line from above, whose lowest places show a line that is seen sharp
    down = np.arange(24.0, 200.0, 8.0)
    count = len(down)
    pixels = np.column_stack([np.full(count, 300.0), down])
    places = Places(
        np.zeros(count, np.int_), np.zeros((count, 2)), pixels, np.tile([1.0, 0.0], (count, 1)), np.full(count, 4.0),
        np.full(count, 50.0), np.zeros(count), np.zeros(count), np.zeros((count, 1)),
    )  # fmt: skip
    picture = np.full((360, 640), 90.0)
    picture[:, 296:305] = 130.0
    is_sharp = down > 180.0
    picture[178:, 292:305] = 90.0
    picture[178:, 300:303] = 150.0
    gray = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.8), np.uint8)
    _, at = measure_markings(gray, places, np.full(count, 0.5), 1.0, 1, np.array([6.0, 0.0]))
    shown = np.isin(np.arange(count), at)
    assert shown[down < 160.0].all()
    assert not shown[is_sharp].any()


def test_wide_lines_of_a_rink_are_as_wide_as_their_template_says() -> None:
    rink = load_field("ice-hockey-nhl")
    drawn = template_curves(rink)
    camera = aim_camera(np.array([2.0, 40.0, -14.0]), np.array([4.0, 0.0, 0.0]), 1500.0, 0.0, 1280, 720)
    model = ProjectionModel(1280, 720)
    places = place_markings(drawn, theta_of(camera, model), model, 0.05)
    width_m = places.width_px / places.scale_px_m
    wide = [drawn.names.index(name) for name in ("centre_line", "blue_line_left", "blue_line_right")]
    is_wide = np.isin(places.marking, wide)
    assert is_wide.any() and not is_wide.all()
    np.testing.assert_allclose(width_m[is_wide], rink.line_by_name["centre_line"].width_m)
    np.testing.assert_allclose(width_m[~is_wide], 0.05)


def test_curves_move_with_the_field_as_its_template_says() -> None:
    # the middle of a circle at 0.6 m beside the middle of the field belongs to one end
    circle = load_field("soccer").circles[0].model_copy(update={"name": "beside", "center": (0.6, 0.0)})
    other = load_field("soccer").model_copy(update={"circles": (*load_field("soccer").circles, circle)})
    for field in (other, *(load_field(name) for name in field_names())):
        np.testing.assert_array_equal(template_curves(field).shifts, field.outlines[2])
    assert template_curves(other).shifts[1, 1, 0] == 0.5

"""Residuals of points on circles and lines, and their derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.residuals import (
    FixedPoints,
    circle_curve,
    curve_points,
    curve_residuals,
    line_curve,
    sample_feet,
    stack_curves,
)
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, project
from circlecal.geometry.surface import Surface
from circlecal.observations import MarkingKey

from .conftest import STEPS, central_differences, random_thetas

MODEL = ProjectionModel(1920, 1080, Surface("parabola"))
SOCCER = load_field("soccer")


def curves_near(theta, offset_px, rng, model=MODEL):
    """Both edges of the circle, an arc that moves with an end of the field, halfway line, a touchline and a penalty
    area's line, seen ``offset_px`` beside.
    """
    parts = []
    for edge, by_width, bloom in (("outer", 0.0, 1.0), ("inner", -1.0, -1.0), ("center", -0.5, 0.0)):
        radius = SOCCER.radius(SOCCER.circles[0], edge)
        parts.append(
            circle_curve(MarkingKey(edge), np.zeros((20, 2)), np.full(20, 0.7), np.zeros(2), radius, by_width, bloom)
        )
    arc = SOCCER.circle_by_name["penalty_arc_left"]
    center, shift = np.array([-8.0, 3.0]), SOCCER.place_shift(arc.center)
    parts.append(
        circle_curve(
            MarkingKey("arc"), np.zeros((9, 2)), np.full(9, 0.7), center, SOCCER.radius(arc, "center"), 0, 0, shift
        )
    )
    for name in ("halfway_line", "side_line_top", "big_rect_left_main"):
        line = SOCCER.line_by_name[name]
        parts.append(
            line_curve(name, np.zeros((9, 2)), np.full(9, 0.4), SOCCER.line_ends(line), SOCCER.line_shift(line))
        )
    curves = stack_curves(parts)
    straight = curves.radius == 0
    feet = np.where(straight, rng.uniform(20, 45, len(straight)), rng.uniform(0, 2 * np.pi, len(straight)))
    field, _ = curve_points(curves, feet[None], theta[None])
    pixels = project(theta[None], field, model).pixels[0]
    return replace(curves, points_px=pixels + rng.uniform(-offset_px, offset_px, pixels.shape)), feet


@pytest.mark.parametrize("shape", ["parabola", "roof", "flat"])
def test_jacobian_equals_central_differences(shape):
    """The foot parameters follow the camera: the derivative is the whole one, of the distance to the marking."""
    model = ProjectionModel(1920, 1080, Surface(shape))
    rng = np.random.default_rng(1)
    for theta in random_thetas(2, rng):
        curves, feet = curves_near(theta, 0.0, rng, model)

        def residuals(t, curves=curves, feet=feet):
            return curve_residuals(curves, t[None], feet[None], model, updates=12).values[0]

        found = curve_residuals(curves, theta[None], feet[None], model, updates=12).jacobian[0]
        numeric = central_differences(residuals, theta, STEPS)
        # points of a roof near its ridge change sides under a step
        away = np.ones(len(found), dtype=bool)
        if shape == "roof":
            away = np.abs(curve_points(curves, feet[None], theta[None])[0][0, :, 1]) > 1.0
        for name, k in INDEX.items():
            scale = max(1.0, float(np.abs(numeric[:, k]).max()))
            assert np.abs(found[away, k] - numeric[away, k]).max() < 2e-5 * scale, name


def test_sizes_of_the_markings_enter_where_they_should():
    rng = np.random.default_rng(2)
    theta = random_thetas(1, rng)[0]
    curves, feet = curves_near(theta, 0.0, rng)
    J = curve_residuals(curves, theta[None], feet[None], MODEL).jacobian[0]

    def moves(name, parameter):
        return bool(np.abs(J[curves.group == curves.keys.index(MarkingKey(name)), INDEX[parameter]]).max() > 1e-9)

    expected = {
        "width": {"inner", "center", "side_line_top", "big_rect_left_main"},
        "bloom": {"outer", "inner"},
        "length": {"big_rect_left_main", "arc"},
        "breadth": {"side_line_top"},
    }
    for parameter, names in expected.items():
        assert {key.name for key in curves.keys if moves(key.name, parameter)} == names, parameter


def test_bloom_moves_the_edges_outwards_by_itself():
    rng = np.random.default_rng(3)
    theta = random_thetas(1, rng)
    theta[0, INDEX["bloom"]] = 0.0
    curves, feet = curves_near(theta[0], 0.0, rng)
    bloomed = theta.copy()
    bloomed[0, INDEX["bloom"]] = 0.25
    values = curve_residuals(curves, bloomed, feet[None], MODEL).values[0] * curves.sigma_px
    for group, expected in enumerate([-0.25, 0.25, 0.0, 0.0, 0.0, 0.0, 0.0]):
        np.testing.assert_allclose(values[curves.group == group], expected, atol=1e-9)


def test_residual_is_the_distance_to_the_nearest_point_positive_outside():
    rng = np.random.default_rng(4)
    theta = random_thetas(1, rng)
    theta[0, INDEX["bloom"]] = 0.0
    curves, feet = curves_near(theta[0], 3.0, rng)
    found = curve_residuals(curves, theta, feet[None], MODEL, updates=15)
    sweep = np.linspace(-0.05, 0.05, 2001)
    values = found.values[0] * curves.sigma_px
    for k in range(0, len(values), 5):
        straight = curves.radius[k] == 0
        near = (found.feet[0, k] + sweep * (20.0 if straight else 1.0))[None]
        one = curves.select(np.full(len(sweep), k))
        field, _ = curve_points(one, near, theta)
        pixels = project(theta, field, MODEL).pixels[0]
        distance = np.linalg.norm(pixels - curves.points_px[k], axis=-1).min()
        assert abs(values[k]) == pytest.approx(distance, abs=2e-3)
    circles = curves.group < 3
    center = project(theta, np.zeros((1, 1, 2)), MODEL).pixels[0, 0]
    field, _ = curve_points(curves, found.feet, theta)
    rim = project(theta, field, MODEL).pixels[0]
    further = np.linalg.norm(curves.points_px - center, axis=1) > np.linalg.norm(rim - center, axis=1)
    clear = circles & (np.abs(values) > 0.5)
    assert clear.sum() > 20
    assert np.mean((values > 0)[clear] == further[clear]) > 0.95


def test_sampled_feet_find_the_nearest_piece_from_afar():
    rng = np.random.default_rng(5)
    theta = random_thetas(1, rng)
    curves, feet = curves_near(theta[0], 0.0, rng)
    found = sample_feet(curves, theta, MODEL, samples=72)
    circles = curves.radius > 0
    turn = np.angle(np.exp(1j * (found[0] - feet)))[circles]
    assert np.abs(turn).max() < 2 * np.pi / 72
    assert np.abs(found[0] - feet)[~circles].max() < 110 / 71
    settled = curve_residuals(curves, theta, found, MODEL, updates=6).feet[0]
    np.testing.assert_allclose(np.exp(1j * settled)[circles], np.exp(1j * feet)[circles], atol=1e-5)


def test_points_behind_the_camera_are_told():
    rng = np.random.default_rng(6)
    theta = random_thetas(1, rng)
    curves, feet = curves_near(theta[0], 0.0, rng)
    assert not curve_residuals(curves, theta, feet[None], MODEL).behind.any()
    away = theta.copy()
    away[0, 1] += np.pi
    assert curve_residuals(curves, away, feet[None], MODEL, updates=0).behind.any()


def test_fixed_points_and_their_jacobian():
    rng = np.random.default_rng(7)
    theta = random_thetas(1, rng)[0]
    field = rng.uniform(-10, 10, (4, 2))
    pixels = project(theta[None], field[None], MODEL).pixels[0]
    shift = np.zeros((4, 3, 2))
    shift[0, 1, 0], shift[1, 2, 1] = 0.5, -0.5
    keys = tuple(MarkingKey(name) for name in "abcd")
    # the sizes of the field are 0 where these points are seen
    theta[[INDEX[name] for name in ("width", "length", "breadth")]] = 0.0
    points = FixedPoints(field, pixels + [[1.0, -2.0]] * 4, np.full(4, 2.0), keys, shift=shift)

    def residuals(t):
        return curve_residuals(stack_curves([]), t[None], np.zeros((1, 0)), MODEL, 0, points)

    found = residuals(theta)
    np.testing.assert_allclose(found.values[0].reshape(4, 2), [[0.5, -1.0]] * 4, atol=1e-9)
    numeric = central_differences(lambda t: residuals(t).values[0], theta, STEPS)
    np.testing.assert_allclose(found.jacobian[0], numeric, atol=1e-5 * np.abs(numeric).max())
    by_length, by_breadth = (found.jacobian[0][:, INDEX[name]].reshape(4, 2) for name in ("length", "breadth"))
    assert by_length.any(axis=1).tolist() == [True, False, False, False]
    assert by_breadth.any(axis=1).tolist() == [False, True, False, False]


def test_hypotheses_may_have_points_of_their_own():
    """Each camera compares its own points with the markings, as if it were alone."""
    rng = np.random.default_rng(4)
    thetas = random_thetas(2, rng)
    (one, feet), (other, others) = (curves_near(theta, 2.0, rng) for theta in thetas)
    rows = ("points_px", "sigma_px", "origin", "direction", "shift")
    both = replace(one, **{name: np.stack([getattr(curves, name) for curves in (one, other)]) for name in rows})
    fixed = FixedPoints(np.array([[9.0, 4.0]]), np.array([[700.0, 400.0]]), np.ones(1), (MarkingKey("corner"),))
    found = curve_residuals(both, thetas, np.stack([feet, others]), MODEL, points=fixed)
    second = curve_residuals(both.hypotheses(np.array([1])), thetas[1:], others[None], MODEL, points=fixed)
    for k, (curves, start) in enumerate(((one, feet), (other, others))):
        alone = curve_residuals(curves, thetas[k : k + 1], start[None], MODEL, points=fixed)
        assert found.values[k] == pytest.approx(alone.values[0], rel=1e-9, abs=1e-9)
        assert found.jacobian[k] == pytest.approx(alone.jacobian[0], rel=1e-9, abs=1e-9)
    assert second.values[0] == pytest.approx(found.values[1], rel=1e-9, abs=1e-9)


def test_stacking_keeps_the_order_and_nothing_is_something():
    rng = np.random.default_rng(8)
    curves, _ = curves_near(random_thetas(1, rng)[0], 0.0, rng)
    assert [str(key) for key in curves.keys] == [
        "outer", "inner", "center", "arc", "halfway_line", "side_line_top", "big_rect_left_main",
    ]  # fmt: skip

    assert np.bincount(curves.group).tolist() == [20, 20, 20, 9, 9, 9, 9]
    empty = stack_curves([])
    assert empty.points_px.shape == (0, 2)
    assert empty.keys == ()

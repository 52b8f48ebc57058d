"""Approximations: their error without noise is held from both sides, so that neither a mistake nor a mend hides."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.projective import apply_homography
from circlecal.observations import Observations
from circlecal.solvers import solve_by_name
from circlecal.solvers.chum_matas import ellipse_match, first_order_homography, iterate
from circlecal.solvers.primitives import separate_circles

from .conftest import circle_under, error_px, hockey, scenario_view, soccer

APPROXIMATE = {
    "great_axis": ("true_centre", 60.0, 150.0),
    "footyvision": ("true_centre", 20.0, 90.0),
    "tvcalib_like": ("true_centre", 0.5, 80.0),
}
PAIR = ("faceoff_left_top", "faceoff_left_bottom")


@pytest.mark.parametrize("solver", APPROXIMATE)
def test_error_without_noise(solver, main_cameras):
    scenario, low, high = APPROXIMATE[solver]
    template, circle = soccer()
    errors = []
    for camera in main_cameras:
        seen = scenario_view(scenario, camera)
        errors.append(
            error_px(solve_by_name(solver, seen, template, circle, np.random.default_rng(0)), camera, template)
        )
    assert low < np.median(errors) < high


def test_great_axis_is_right_where_camera_and_axis_agree():
    """Seen along the halfway line from far away, an ellipse's great axis nearly is the diameter."""
    template, circle = soccer()
    H = np.array([[40.0, 0.0, 960.0], [0.0, 12.0, 540.0], [0.0, 0.0, 1.0]])
    seen = scenario_like(H, template)
    found = solve_by_name("great_axis", seen, template, circle, np.random.default_rng(0))
    grid = np.array([[-20.0, -10.0], [15.0, 5.0], [0.0, 12.0]])
    assert apply_homography(found.H_image_field, grid) == pytest.approx(apply_homography(H, grid), abs=1e-6)


def scenario_like(H, template):
    from .conftest import central_view

    return central_view(H, template, mark=False)


def test_great_axis_and_footyvision_agree_where_neither_mark_nor_parallel_is_seen(main_cameras):
    template, circle = soccer()
    seen = scenario_view("unknown_centre", main_cameras[0])
    first, second = (
        solve_by_name(name, seen, template, circle, np.random.default_rng(0)).H_image_field
        for name in ("great_axis", "footyvision")
    )
    assert first == pytest.approx(second, rel=1e-6, abs=1e-9)


def perspective(strength):
    tilt = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [strength * 0.002, -strength * 0.012, 1.0]])
    return np.array([[30.0, 6.0, 1500.0], [-2.0, 14.0, 560.0], [0.0, 0.0, 1.0]]) @ tilt


def first_order_error(H, template, circle):
    seen = Observations(1920, 1080, tuple(circle_under(H, name, template) for name in PAIR))
    matches = [ellipse_match(c) for c in separate_circles(seen, template, np.random.default_rng(0))]
    start = first_order_homography(matches)
    corners = np.array([[-30.0, -15.0], [-15.0, -15.0], [-30.0, 15.0], [-15.0, 15.0]])
    distances = [
        np.linalg.norm(apply_homography(found, corners) - apply_homography(H, corners), axis=1).mean()
        for found in (start, iterate(start, matches))
    ]
    return distances


def test_first_order_expansion_is_exact_for_affine_maps_and_loses_with_perspective():
    template, circle = hockey()
    errors = [first_order_error(perspective(s), template, circle) for s in (0.0, 0.25, 0.5, 1.0)]
    first = [e[0] for e in errors]
    assert first[0] < 1e-9
    assert first[0] < first[1] < first[2] < first[3]
    assert 1.8 < first[2] / first[1] < 3.0
    assert 2.0 < first[3] < 12.0
    assert max(e[1] for e in errors) < 1e-8


def test_first_order_error_goes_with_the_square_of_the_size():
    errors = []
    for radius in (4.5, 2.25, 1.125):
        template = load_field("ice-hockey", {"circle_radius": radius})
        errors.append(first_order_error(perspective(0.5), template, None)[0])
    assert 3.0 < errors[0] / errors[1] < 5.0
    assert 3.5 < errors[1] / errors[2] < 4.5

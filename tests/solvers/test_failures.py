"""Degenerate input comes back as a failure with its reason; nothing is raised but for a wrong name."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from circlecal.errors import ConfigError
from circlecal.geometry.circular_sections import circular_sections
from circlecal.geometry.projective import apply_homography
from circlecal.observations import CirclePoints, Keypoint, LinePoints, MarkPoint, Observations
from circlecal.solvers import (
    load_intrinsics_solver,
    load_solver,
    solve_by_name,
    solver_names,
)

from .conftest import SIGMA, central_view, circle_under, halfway_under, scenario_view, soccer

NOTHING = Observations(1920, 1080)


@pytest.fixture
def camera(main_cameras):
    return main_cameras[0]


def code(solver, seen):
    result = solve_by_name(solver, seen, *soccer(), np.random.default_rng(0))
    assert (result.H_image_field is None) == (result.code != "ok") == bool(result.reason)
    return result.code


@pytest.mark.parametrize("solver", solver_names())
def test_nothing_seen(solver):
    assert code(solver, NOTHING) not in ("ok", "degenerate")


@pytest.mark.parametrize("solver", solver_names())
def test_collinear_points_and_too_few_points(solver, camera):
    seen = central_view(camera.homography, soccer()[0])
    flat = np.stack([np.linspace(100, 900, 24), np.linspace(200, 500, 24)], axis=-1)
    given = (flat, flat[:3], np.full((24, 2), np.nan))
    for points in given[1:] if solver == "tvcalib_like" else given:  # a camera may see the circle from its plane
        spoilt = tuple(replace(c, points_px=points, sigma_px=np.full(len(points), SIGMA)) for c in seen.circles)
        assert code(solver, replace(seen, circles=spoilt, lines=())) != "ok"


@pytest.mark.parametrize("solver", solver_names())
def test_a_line_without_direction_and_points_without_noise(solver, camera):
    seen = central_view(camera.homography, soccer()[0])
    one_pixel = tuple(
        replace(line, points_px=np.tile([[640.0, 360.0]], (len(line.points_px), 1))) for line in seen.lines
    )
    assert code(solver, replace(seen, lines=one_pixel)) == "degenerate"
    for sigma, found in ((0.0, "degenerate"), (np.nan, "not_finite"), (np.inf, "not_finite")):
        lines = tuple(replace(line, sigma_px=np.full(len(line.points_px), sigma)) for line in seen.lines)
        circles = tuple(replace(circle, sigma_px=np.full(len(circle.points_px), sigma)) for circle in seen.circles)
        marks = tuple(replace(mark, sigma_px=sigma) for mark in seen.marks)
        for spoilt in ({"lines": lines}, {"circles": circles}, {"marks": marks}):
            assert code(solver, replace(seen, **spoilt)) == found


def test_reasons_of_central_views(camera):
    template, _ = soccer()
    H = camera.homography
    marked, bare = central_view(H, template), central_view(H, template, mark=False)
    one_edge = central_view(H, template, edges=("outer",))
    no_line = replace(marked, lines=())
    assert code("magera_case1", bare) == "no_center"
    assert code("magera_case1", no_line) == "no_line"
    assert code("magera_case2", marked) == "no_point"
    assert code("magera_case3", one_edge) == "needs_two_edges"
    assert code("magera_case3", no_line) == "no_line"
    assert code("alvarez_caselles", bare) == "no_point_on_line"
    assert code("footyvision", no_line) == "no_line"
    assert code("gupta", replace(bare, lines=())) == "no_matches"
    assert code("chen_wu", one_edge) == "needs_two_edges"
    assert code("pnl_like", bare) == "too_few_keypoints"
    assert code("tvcalib_like", replace(one_edge, lines=(), marks=())) == "needs_two_markings"
    assert code("circlecal", no_line) == "rotation_free"
    for name in ("chum_matas", "huang_self_polar"):
        assert code(name, marked) == "needs_two_circles"  # both edges of one circle are concentric


def test_points_of_the_circle_itself_tell_alvarez_nothing(camera):
    bare = central_view(camera.homography, soccer()[0], mark=False)
    rim = [0.0, 9.15]
    point = Keypoint("rim", np.array(rim), apply_homography(camera.homography, rim), SIGMA)
    assert code("alvarez_caselles", replace(bare, keypoints=(point,))) == "no_point_on_line"


@pytest.mark.parametrize("noise_px", [0.0, 1.0])
@pytest.mark.parametrize("field_m", [(0.0, 4.0), (5.0, 0.0), (0.0, 9.15)])
def test_gupta_needs_a_match_off_the_axes(camera, noise_px, field_m):
    """Scaling across the halfway line keeps it, its points, their polars and the vanishing line; so along it."""
    seen = scenario_view("true_centre", camera, noise_px)
    point = Keypoint("on axis", np.array(field_m), camera.project(field_m), SIGMA)
    assert code("gupta", replace(seen, keypoints=(point,))) == "underdetermined"


def test_pnl_refuses_collinear_keypoints(camera):
    seen = scenario_view("true_centre", camera)
    far = tuple(
        Keypoint(f"{y}", np.array([0.0, y]), camera.project([0.0, y]), SIGMA) for y in (-30.0, -20.0, 5.0, 15.0)
    )
    assert code("pnl_like", replace(seen, keypoints=far)) == "collinear_keypoints"


def test_a_center_outside_the_ellipse(camera):
    seen = central_view(camera.homography, soccer()[0])
    outside = replace(seen.marks[0], point_px=np.array([-900.0, -900.0]))
    assert code("magera_case1", replace(seen, marks=(outside,))) == "center_outside"


def test_an_inner_edge_outside_the_outer_one_has_no_center(camera):
    seen = central_view(camera.homography, soccer()[0])
    swapped = tuple(replace(c, edge=edge) for c, edge in zip(seen.circles, ("inner", "outer"), strict=True))
    assert code("magera_case3", replace(seen, circles=swapped)) == "no_real_center"


def test_intrinsics_only_methods(camera, main_cameras):
    template, circle = soccer()
    method = load_intrinsics_solver("huang_concentric")
    view = scenario_view("unknown_centre", camera)
    rng = np.random.default_rng(0)
    assert method([view, view], template, circle, rng).code == "needs_three_views"
    assert method([view] * 3, template, circle, rng).code == "views_too_alike"
    assert method([NOTHING] * 3, template, circle, rng).code == "needs_two_edges"
    assert load_intrinsics_solver("chen_wu")([], template, circle, rng).code == "needs_a_view"


def test_unknown_names_are_one_clear_line():
    with pytest.raises(ConfigError, match="unknown; known: great_axis"):
        load_solver("grate_axis")
    with pytest.raises(ConfigError, match="intrinsics only"):
        load_solver("huang_concentric")
    with pytest.raises(ConfigError, match="chen_wu"):
        load_intrinsics_solver("gupta")


def test_a_line_that_misses_the_circle(camera):
    H = camera.homography
    template, _ = soccer()
    aside = replace(halfway_under(H, template), points_px=np.array([[0.0, -4000.0], [1900.0, -4100.0]]))
    seen = Observations(1920, 1080, (circle_under(H, "centre_circle", template),), (aside,))
    assert code("alvarez_caselles", seen) == "line_misses_circle"
    assert code("footyvision", seen) == "line_misses_circle"


def haphazard_view(rng):
    """Points, lines and matches that no field shows."""

    def points(count):
        angles = rng.uniform(0, 2 * np.pi, count)
        size = rng.uniform(0.01, 900, 2)
        ellipse = [960, 540] + size * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        kinds = (rng.uniform(0, 1900, (count, 2)), np.full((count, 2), 500.0), ellipse, ellipse * 1e6, ellipse * 1e-6)
        return kinds[rng.integers(len(kinds))]

    names = ["centre_circle", "centre_circle", "penalty_arc_left", "nowhere"]
    circles = tuple(
        CirclePoints(str(rng.choice(names)), str(rng.choice(["outer", "inner", "center"])), seen, np.ones(len(seen)))
        for seen in (points(int(rng.integers(0, 30))) for _ in range(3))
    )
    lines = tuple(
        LinePoints(str(rng.choice(["halfway_line", "side_line_top", "nowhere"])), seen, np.ones(len(seen)))
        for seen in (points(int(rng.integers(1, 5))) for _ in range(2))
    )
    marks = (MarkPoint("centre_mark", rng.uniform(0, 1900, 2), 1.0),) if rng.random() < 0.6 else ()
    keypoints = tuple(
        Keypoint(str(k), rng.choice([0.0, 5.0, 9.15, 20.0], 2), rng.uniform(0, 1900, 2), 1.0)
        for k in range(rng.integers(0, 6))
    )
    return Observations(1920, 1080, circles, lines, marks, keypoints)


def spoil(seen, rng):
    """The view with all its pixels made alike, very large, very small, or put on one axis."""
    change = [
        lambda p: p * 1e-300,
        lambda p: p * 1e150,
        lambda p: np.clip(p, -1.0, 1.0) * 1e306,
        np.zeros_like,
        np.round,
        lambda p: 0.0 * p + [960.0, 540.0],
        lambda p: p * [1.0, 0.0],
    ][rng.integers(7)]
    return replace(
        seen,
        circles=tuple(replace(c, points_px=change(c.points_px)) for c in seen.circles),
        lines=tuple(replace(line, points_px=change(line.points_px)) for line in seen.lines),
        marks=tuple(replace(m, point_px=change(m.point_px)) for m in seen.marks),
        keypoints=tuple(replace(k, point_px=change(k.point_px)) for k in seen.keypoints),
    )


def views(count):
    """Haphazard and spoilt views in turn."""
    for seed in range(count):
        rng = np.random.default_rng(seed)
        yield haphazard_view(rng)
        yield spoil(haphazard_view(rng), rng)


SLOW = {"circlecal", "circlecal_default", "tvcalib_like"}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("solver", solver_names())
def test_nothing_is_raised_or_warned_of_whatever_is_shown(solver):
    for seen in views(3 if solver in SLOW else 40):
        code(solver, seen)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("solver", ["chen_wu", "huang_concentric"])
def test_no_calibration_matrix_is_raised_or_warned_of(solver):
    method, shown = load_intrinsics_solver(solver), list(views(20))
    for triple in zip(shown, shown[1:], shown[2:], strict=False):
        found = method(triple, *soccer(), np.random.default_rng(0))
        assert (found.code == "ok") == (found.intrinsics is not None)


def test_a_cone_without_circular_sections_has_none():
    conic = np.diag([1.0, 1.0, -1.0])
    with np.errstate(all="ignore"):  # as within a solver
        found = circular_sections(conic, np.array([1.0, np.inf, 0.0, 2.0]), np.zeros(2), 1.0)
    assert np.isfinite(found.centers).all(axis=(1, 2)).tolist() == [True, False, False, True]

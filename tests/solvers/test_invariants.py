"""What must hold of each method whatever the view."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from circlecal.geometry.circular_sections import circular_sections
from circlecal.geometry.conics import circle_conic, normalise_conic, polar, sampson_distance, transform_conic
from circlecal.geometry.homography import homography_from_circle, turn_homography
from circlecal.geometry.projective import apply_homography, join, lift, meet
from circlecal.observations import Keypoint, Observations
from circlecal.solvers import load_intrinsics_solver, solve_by_name
from circlecal.solvers.huang_self_polar import degenerate_lines, vanishing_line
from circlecal.solvers.primitives import fit_normalised_conic

from .conftest import ORIGIN, SIGMA, central_view, circle_under, hockey, proportional, scenario_view, soccer

RNG = np.random.default_rng
PAIR = ("faceoff_left_top", "faceoff_left_bottom")


def solved(name, seen, field=soccer):
    result = solve_by_name(name, seen, *field(), RNG(0))
    assert result.H_image_field is not None, result
    return result.H_image_field


@pytest.mark.parametrize("solver", ["magera_case1", "magera_case3", "alvarez_caselles"])
def test_the_circle_maps_onto_the_fitted_ellipse(solver, main_cameras):
    template, circle = soccer()
    for k, camera in enumerate(main_cameras):
        seen = scenario_view("true_centre", camera, 0.2, seed=k)
        result = solve_by_name(solver, seen, template, circle, RNG(0))
        if result.H_image_field is None:
            continue
        outer = seen.circle("centre_circle", "outer")
        fitted = fit_normalised_conic(outer.points_px, outer.sigma_px, RNG(0))
        mapped = transform_conic(result.H_image_field, circle_conic(ORIGIN, template.radius(circle, "outer")))
        assert mapped == pytest.approx(normalise_conic(fitted), rel=1e-6)


def test_case_one_is_the_closed_form(main_cameras):
    """Any ellipse, centre and line define a consistent homography: the DLT on derived points adds nothing."""
    template, circle = soccer()
    seen = scenario_view("true_centre", main_cameras[0], 1.0)
    outer = seen.circle("centre_circle", "outer")
    conic = fit_normalised_conic(outer.points_px, outer.sigma_px, RNG(0))
    line = join(*lift(seen.line("halfway_line").points_px))
    H = homography_from_circle(
        conic, lift(seen.marks[0].point_px), line, ORIGIN, template.radius(circle, "outer"), [0.0, 1.0]
    )
    found = solved("magera_case1", seen)
    closer = min((H, turn_homography(H, ORIGIN)), key=lambda h: np.abs(h - found).max())
    grid = np.array([[5.0, 3.0], [-9.0, 0.0], [2.0, -6.0]])
    assert apply_homography(found, grid) == pytest.approx(apply_homography(closer, grid), abs=1e-7)


def test_alvarez_gives_harmonic_points_on_the_line(main_cameras):
    H = solved("alvarez_caselles", scenario_view("true_centre", main_cameras[0], 2.0))
    a, b, c = apply_homography(H, np.array([[0.0, 9.15], [0.0, -9.15], [0.0, 0.0]]))
    v = H @ [0.0, 1.0, 0.0]
    v = v[:2] / v[2]
    along = (a - b) / np.linalg.norm(a - b)
    ta, tb, tc, tv = (float(p @ along) for p in (a, b, c, v))
    assert (tc - ta) * (tv - tb) / ((tc - tb) * (tv - ta)) == pytest.approx(-1.0, abs=1e-6)


def test_alvarez_does_not_depend_on_which_point_of_the_line_is_known(main_cameras):
    camera = main_cameras[0]
    bare = central_view(camera.homography, soccer()[0], mark=False)
    found = []
    for y in (0.0, 4.0, -6.5, 20.0):
        point = Keypoint("known", np.array([0.0, y]), apply_homography(camera.homography, [0.0, y]), SIGMA)
        found.append(solved("alvarez_caselles", replace(bare, keypoints=(point,))))
    for other in found[1:]:
        assert other == pytest.approx(found[0], rel=1e-8, abs=1e-10)


def test_gupta_keeps_pole_and_polar(main_cameras):
    template, circle = soccer()
    camera = main_cameras[1]
    seen = scenario_view("keypoints", camera)
    H = solved("gupta", seen)
    C = circle_conic(ORIGIN, template.radius(circle, "outer"))
    E = transform_conic(H, C)
    for point in seen.keypoints:
        assert (
            proportional(H.T @ polar(E, lift(point.point_px)), polar(C, np.linalg.solve(H, lift(point.point_px))))
            < 1e-7
        )


def test_chum_matas_ends_at_the_maximum_of_the_likelihood():
    template, _ = hockey()
    rng = RNG(5)
    H = np.array([[30.0, 6.0, 1500.0], [-2.0, 14.0, 560.0], [0.002, -0.012, 1.0]])
    seen = Observations(
        1920, 1080, tuple(circle_under(H, name, template, count=60, noise_px=0.5, rng=rng) for name in PAIR)
    )
    found = solved("chum_matas", seen, hockey)

    def residuals(h):
        estimate = np.append(h, 1.0).reshape(3, 3)
        return np.concatenate(
            [
                sampson_distance(
                    transform_conic(estimate, circle_conic(template.circle_by_name[c.circle].center, 4.5)), c.points_px
                )
                for c in seen.circles
            ]
        )

    best = least_squares(residuals, H.ravel()[:8], x_scale=np.abs(H.ravel()[:8]), xtol=1e-14, ftol=1e-14)
    ml = np.append(best.x, 1.0).reshape(3, 3)
    grid = np.array([[-30.0, -10.0], [-20.0, 10.0], [-25.0, 0.0], [-15.0, 0.0]])
    truth, ours, theirs = (apply_homography(h, grid) for h in (H, found, ml))
    assert np.linalg.norm(ours - theirs, axis=1).mean() < 0.1 * np.linalg.norm(theirs - truth, axis=1).mean()


def test_circular_sections_agree_at_the_true_focal_length(faceoff_cameras):
    template, _ = hockey()
    for camera in faceoff_cameras:
        conics = [
            transform_conic(camera.homography, circle_conic(template.circle_by_name[name].center, 4.5)) for name in PAIR
        ]
        focals = camera.focal_px[0] * np.array([1.0, 1.2])
        first, second = (circular_sections(c, focals, camera.principal_point_px, 4.5) for c in conics)
        gaps = np.array(
            [
                min(
                    np.linalg.norm(np.cross(first.normals[k, i], second.normals[k, j]))
                    + abs(first.distances[k, i] / second.distances[k, j] - 1.0)
                    for i in range(2)
                    for j in range(2)
                )
                for k in range(2)
            ]
        )
        assert gaps[0] < 1e-9 < 1e-4 < gaps[1]
        assert np.abs(first.distances[0] + camera.position_m[2]).min() < 1e-7  # the camera's height


def test_focal_length_does_not_depend_on_a_turn_of_the_picture(faceoff_cameras):
    template, circle = hockey()
    seen = scenario_view("hockey_pair", faceoff_cameras[0], 0.3)
    c, s = np.cos(0.7), np.sin(0.7)
    center = faceoff_cameras[0].principal_point_px
    turned = replace(
        seen,
        circles=tuple(
            replace(p, points_px=(p.points_px - center) @ np.array([[c, s], [-s, c]]) + center) for p in seen.circles
        ),
    )
    focal = load_intrinsics_solver("chen_wu")
    first, second = (focal([view], template, circle, RNG(0)).intrinsics[0, 0] for view in (seen, turned))
    assert first == pytest.approx(second, rel=1e-6)


def test_self_polar_triangle_of_separate_circles(faceoff_cameras):
    """One vertex is the vanishing point across the line of centres, the other two lie on the line of centres."""
    template, _ = hockey()
    H = faceoff_cameras[0].homography
    centers = [np.asarray(template.circle_by_name[name].center) for name in PAIR]
    first, second = (transform_conic(H, circle_conic(center, 4.5)) for center in centers)
    line = vanishing_line(first, second)
    assert proportional(line, np.linalg.inv(H).T @ [0.0, 0.0, 1.0]) < 1e-9
    line_of_centers = join(H @ lift(centers[0]), H @ lift(centers[1]))
    _, vertices = np.linalg.eig(np.linalg.solve(second, first))
    on_line = np.abs(line_of_centers @ vertices) / np.linalg.norm(line_of_centers)
    across = H @ [1.0, 0.0, 0.0]  # the pair's centres differ in y
    assert np.sort(on_line / np.abs(vertices[2]).clip(1e-12))[1] < 1e-5
    assert min(proportional(across, vertices[:, k].real) for k in range(3)) < 1e-8


def test_lines_of_a_degenerate_conic():
    a, b = np.array([1.0, 2.0, 3.0]), np.array([-2.0, 1.0, 0.5])
    found = degenerate_lines(np.outer(a, b) + np.outer(b, a))
    assert len(found) == 2
    assert min(proportional(found[0], a), proportional(found[0], b)) < 1e-12
    assert proportional(meet(*found), meet(a, b)) < 1e-12
    assert degenerate_lines(np.diag([1.0, 1.0, 0.0])) == []


def test_order_of_the_circles_does_not_matter(faceoff_cameras):
    seen = scenario_view("hockey_pair", faceoff_cameras[2], 0.3)
    turned = replace(seen, circles=seen.circles[::-1])
    for name in ("chum_matas", "chen_wu", "huang_self_polar"):
        assert solved(name, seen, hockey) == pytest.approx(solved(name, turned, hockey), rel=1e-5, abs=1e-7)

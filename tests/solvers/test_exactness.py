"""Row 1: solvers that claim to be exact are so on noise-free input that meets their assumptions."""

from __future__ import annotations

import numpy as np
import pytest

from circlecal.solvers import INTRINSICS, SOLVERS, load_intrinsics_solver, solve_by_name

from .conftest import error_px, hockey, scenario_view, soccer, stated

CLOSED = [
    ("magera_case1", "true_centre"),
    ("magera_case2", "known_point"),
    ("magera_case2", "keypoints"),
    ("magera_case3", "unknown_centre"),
    ("magera_case3", "dense"),
    ("alvarez_caselles", "true_centre"),
    ("gupta", "known_point"),
    ("gupta", "keypoints"),
    ("huang_self_polar", "hockey_pair"),
    ("huang_self_polar", "circle_and_arc"),
]
ITERATIVE = [
    ("chum_matas", "hockey_pair"),
    ("chum_matas", "circle_and_arc"),
    ("chen_wu", "hockey_pair"),
    ("chen_wu", "unknown_centre"),
    ("pnl_like", "keypoints"),
    ("circlecal", "true_centre"),
    ("circlecal", "unknown_centre"),
]


@pytest.mark.parametrize(("solver", "scenario"), CLOSED)
def test_closed_forms(solver, scenario, main_cameras, faceoff_cameras):
    assert worst(solver, scenario, main_cameras, faceoff_cameras) < 1e-8


@pytest.mark.parametrize(("solver", "scenario"), ITERATIVE)
def test_iterative_methods(solver, scenario, main_cameras, faceoff_cameras):
    assert worst(solver, scenario, main_cameras, faceoff_cameras) < 1e-6


def worst(solver, scenario, main_cameras, faceoff_cameras):
    from circlecal.evaluation.bench.solver_scenarios import solver_scenarios

    chosen = solver_scenarios()[scenario]
    if scenario == "circle_and_arc":
        cameras = [chosen.camera(np.random.default_rng([7, index])) for index in range(3)]
    else:
        cameras = faceoff_cameras if scenario == "hockey_pair" else main_cameras
    errors = []
    for k, camera in enumerate(cameras):
        seen = scenario_view(scenario, camera, seed=k)
        result = solve_by_name(solver, seen, chosen.template, chosen.circle, np.random.default_rng(k))
        errors.append(error_px(result, camera, chosen.template))
    return max(errors)


def test_every_solver_is_held_to_something():
    from .test_approximations import APPROXIMATE

    held = {name for name, _ in CLOSED + ITERATIVE} | set(APPROXIMATE) | {"circlecal_default"}
    assert held == set(SOLVERS)


def test_three_views_of_concentric_circles_give_the_calibration_matrix(main_cameras):
    template, circle = soccer()
    views, K = views_of_one_zoom(main_cameras[:3])
    found = load_intrinsics_solver("huang_concentric")(views, template, circle, np.random.default_rng(0))
    assert found.intrinsics == pytest.approx(K, rel=1e-5, abs=0.05)


def test_focal_length_of_two_circles(faceoff_cameras):
    template, circle = hockey()
    for camera in faceoff_cameras:
        view = scenario_view("hockey_pair", camera)
        found = load_intrinsics_solver("chen_wu")([view], template, circle, np.random.default_rng(0))
        assert found.intrinsics[0, 0] == pytest.approx(camera.focal_px[0], rel=1e-10)
    assert set(INTRINSICS) == {"chen_wu", "huang_concentric"}


def views_of_one_zoom(cameras):
    from dataclasses import replace

    focal = cameras[0].focal_px
    same = [replace(camera, focal_px=focal) for camera in cameras]
    views = [scenario_view("unknown_centre", camera) for camera in same]
    return [stated(view, 1e-4) for view in views], same[0].K

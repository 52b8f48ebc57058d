"""Starts without a circle: homographies of points and lines, and cameras aimed at them."""

import numpy as np
import pytest

from circlecal.camera.residuals import FixedPoints
from circlecal.camera.starts_landmarks import (
    Landmarks,
    aim_cameras,
    collect_landmarks,
    homography_starts,
    usual_positions,
)
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, camera_of
from circlecal.geometry.projective import fit_line
from circlecal.geometry.surface import Surface
from circlecal.observations import LinePoints, Observations
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("flat"))
BOX = aim_camera(np.array([3.0, 62.0, -17.0]), np.array([-40.0, -4.0, 0.0]), 1900.0, 0.01, 1920, 1080)
LINES = ("big_rect_left_main", "big_rect_left_top", "side_line_left", "small_rect_left_main", "side_line_top")
POINTS = np.array([[-41.5, 0.0], [-36.0, -20.16], [-52.5, -20.16], [-47.0, -9.16], [-36.0, 20.16], [-47.0, 9.16]])
GRID = np.stack(np.meshgrid(np.arange(-50.0, -25.0, 5.0), np.arange(-20.0, 15.0, 5.0)), axis=-1).reshape(-1, 2)


def landmarks(points=POINTS, lines=LINES, camera=BOX):
    ends = np.array([SOCCER.line_ends(SOCCER.line_by_name[name]) for name in lines]).reshape(-1, 2, 2)
    pixels = camera.project(ends.reshape(-1, 2)).reshape(-1, 2, 2)
    return Landmarks(
        points,
        camera.project(points),
        np.array([SOCCER.line_coordinates(SOCCER.line_by_name[name]) for name in lines]).reshape(-1, 3),
        np.array([fit_line(piece) for piece in pixels]).reshape(-1, 3),
        ends.mean(axis=1),
        pixels,
    )


def error_px(theta, camera=BOX):
    return float(np.linalg.norm(camera_of(theta, MODEL).project(GRID) - camera.project(GRID), axis=1).max())


@pytest.mark.parametrize(
    ("points", "lines"),
    [(POINTS[:4], ()), (POINTS, ()), (POINTS[:0], LINES), (POINTS[[0, 3, 5]], LINES[:1]), (POINTS[:1], LINES[2:]),
     (POINTS, LINES)],
    ids=["4 points", "6 points", "5 lines", "3 and 1", "1 and 3", "all"],
)  # fmt: skip
def test_homographies_of_any_four_are_exact(points, lines):
    starts = homography_starts(landmarks(points, lines), np.array([-40.0, 0.0]), MODEL)
    assert len(starts)
    assert error_px(starts[0]) < 0.05


def test_the_majority_is_found_among_wrong_ones():
    seen = landmarks()
    wrong = seen.points_px.copy()
    wrong[[0, 3]] += [[300.0, -120.0], [-90.0, 200.0]]
    lines = seen.lines_px.copy()
    lines[1] = fit_line(np.array([[0.0, 900.0], [1900.0, 200.0]]))
    ends = seen.ends_px.copy()
    ends[1] = [[0.0, 900.0], [1900.0, 200.0]]
    mixed = Landmarks(seen.points_m, wrong, seen.lines_m, lines, seen.middles_m, ends)
    assert error_px(homography_starts(mixed, np.array([-40.0, 0.0]), MODEL)[0]) < 0.05


def test_too_few_or_mirrored_landmarks_give_none():
    assert len(homography_starts(landmarks(POINTS[:3], ()), np.zeros(2), MODEL)) == 0
    seen = landmarks(POINTS, ())
    mirrored = seen.points_px * [-1.0, 1.0] + [1919.0, 0.0]
    flipped = Landmarks(seen.points_m, mirrored, seen.lines_m, seen.lines_px, seen.middles_m, seen.ends_px)
    assert len(homography_starts(flipped, np.array([-40.0, 0.0]), MODEL)) == 0


def test_a_level_camera_at_a_known_position_is_aimed_almost_exactly():
    level = aim_camera(BOX.position_m, np.array([-40.0, -4.0, 0.0]), 1900.0, 0.0, 1920, 1080)
    positions = np.stack([level.position_m, [0.0, 300.0, -17.0]])
    starts = aim_cameras(landmarks(POINTS[:2], LINES[:2], level), positions, MODEL)
    assert error_px(starts[0], level) < 60.0
    assert len(aim_cameras(landmarks(POINTS[:1], LINES[:1]), positions, MODEL)) == 0


def test_usual_positions_stand_on_the_side_and_above():
    found = usual_positions(np.array([-40.0, 3.0]), "left_goal")
    assert (found[:, 0] <= -40.0 + 1e-6).all()
    assert (found[:, 2] < 0).all()


def test_the_middle_is_where_the_picture_looks():
    assert np.linalg.norm(landmarks().middle_m(MODEL) - [-43.0, -5.0]) < 12
    assert np.allclose(landmarks(POINTS[:0], ()).middle_m(MODEL), 0.0)
    one = landmarks(POINTS[:0], ("side_line_left",)).middle_m(MODEL)
    assert np.allclose(one, [-52.44, 0.0])


def test_lines_without_name_or_length_and_very_many_points_are_no_burden():
    pixels = np.array([[100.0, 200.0], [700.0, 300.0]])
    lines = (
        LinePoints(None, pixels, np.ones(2)),
        LinePoints("side_line_top", pixels[[0, 0]], np.ones(2)),
        LinePoints("side_line_left", pixels, np.ones(2)),
        LinePoints("not painted", pixels, np.ones(2)),
    )
    many = np.random.default_rng(0).uniform(-20, 20, (5000, 2))
    points = FixedPoints(many, BOX.project(many), np.ones(5000), ("p",) * 5000)
    found = collect_landmarks(Observations(1920, 1080, lines=lines), SOCCER, points, BOX)
    assert len(found.lines_m) == 1
    assert 4 <= len(found.points_m) <= 24
    assert len(homography_starts(found, np.zeros(2), MODEL))

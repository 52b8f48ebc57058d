"""Metres on the ground, and the WorldCup metrics, by hand."""

import numpy as np
import pytest

from circlecal.evaluation.homography_metrics import (
    iou_part,
    iou_whole,
    projection_error,
    reprojection_error,
    score_homography,
    template_homography,
)
from circlecal.evaluation.metres import errors_of_annotated_points, field_positions, ground_errors
from circlecal.evaluation.soccernet_metric import MetricCamera, PlaneHomography, field_polylines
from evaluation.scenes import SIZE, look_at_circle

YARDS = np.diag([115 / 1280, 74 / 720, 1.0])
"""The whole picture is the whole template."""


def shifted(dx, dy=0.0):
    return np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]]) @ YARDS


def test_positions_come_back_through_the_lens():
    camera = MetricCamera.from_camera(look_at_circle(kappa=0.04))
    points = field_polylines()["Circle central"]
    pixels, _ = camera.project(points)
    assert field_positions(camera, pixels, np.zeros((len(points), 2))) == pytest.approx(points[:, :2], abs=1e-3)
    above = field_positions(camera, np.array([[480.0, -5000.0]]), np.zeros((1, 2)))
    assert np.isnan(above).all()


def test_ground_error_of_a_shifted_camera_is_the_shift():
    camera = look_at_circle()
    moved = look_at_circle(x=3.5)
    errors = ground_errors(MetricCamera.from_camera(camera), MetricCamera.from_camera(moved), *SIZE)
    assert len(errors) > 100
    assert errors == pytest.approx(0.5, abs=1e-4)
    turned = ground_errors(MetricCamera.from_camera(camera), MetricCamera.from_camera(camera.turn_field()), *SIZE)
    assert turned == pytest.approx(0.0, abs=1e-4)


def test_annotated_points_in_metres():
    camera = MetricCamera.from_camera(look_at_circle())
    radius = 9.15 + 0.1
    ring = np.array([[radius, 0, 0], [0, radius, 0], [-radius, 0, 0]])
    annotated = {"Circle central": camera.project(ring)[0], "Middle line": camera.project(np.array([[0.2, 3, 0]]))[0]}
    assert errors_of_annotated_points(annotated, camera) == pytest.approx([0.1, 0.1, 0.1, 0.2], abs=1e-3)
    assert len(errors_of_annotated_points({}, camera)) == 0


def test_areas():
    assert iou_part(YARDS, YARDS) == 1.0
    assert iou_whole(YARDS, YARDS) == pytest.approx(1.0)
    # half the picture's width to the right: half of each is common
    assert iou_whole(YARDS, shifted(57.5)) == pytest.approx(1 / 3)
    assert iou_part(YARDS, shifted(57.5)) == pytest.approx(0.5, abs=0.02)  # the template ends on the right
    assert iou_whole(YARDS, shifted(0.0, 500.0)) == 0.0
    assert iou_whole(YARDS, np.zeros((3, 3))) == 0.0


def test_errors_of_a_shift():
    rng = np.random.default_rng(0)
    assert projection_error(YARDS, shifted(1.15), rng) == pytest.approx(1.0)
    assert projection_error(YARDS, shifted(0.0, 0.74), rng) == pytest.approx(0.6)
    assert reprojection_error(YARDS, shifted(1.15)) == pytest.approx(1.15 * 1280 / 115 / 720)
    assert np.isnan(projection_error(YARDS, shifted(500), rng))
    assert np.isnan(reprojection_error(YARDS, shifted(500)))
    scores = score_homography(YARDS, YARDS, rng)
    assert (scores.projection, scores.reprojection) == (0, 0)


def test_template_of_cameras_and_homographies():
    camera = look_at_circle(size=(1280, 720))
    H = template_homography(MetricCamera.from_camera(camera), None)
    center = H @ np.r_[camera.project([0.0, 0.0]), 1.0]
    assert center[:2] / center[2] == pytest.approx([57.5, 37.0], abs=1e-3)
    direct = template_homography(PlaneHomography(camera.homography), camera.homography)
    assert direct / direct[2, 2] == pytest.approx(H / H[2, 2], rel=1e-5, abs=1e-5)
    assert template_homography(MetricCamera.from_camera(look_at_circle(pan=180.0)), None) is None

"""Short straight markings, told from limbs and boards by how the field runs before the camera."""

import cv2
import numpy as np
import pytest

from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.conics import circle_conic, transform_conic
from circlecal.geometry.surface import Surface
from circlecal.results import MarkingMask, Segment
from circlecal.stages.mask import MaskConfig, find_short_markings
from circlecal.stages.short_lines import measure_short_lines

from .conftest import CIRCLE, SOCCER, view
from .test_verdict import camera_fit

TRUE = view(position=(0.0, 65.0, -18.0), target=(-18.0, -8.0, 0.0), focal=1500.0)
CLOSER = view(position=(0.0, 55.0, -15.0), target=(-18.0, -8.0, 0.0), focal=1270.0)
TOUCHLINE = ((-40.0, -33.94), (10.0, -33.94))
CORNER = (((-36.0, -20.1), (-36.0, -13.0)), ((-41.0, -20.1), (-36.0, -20.1)))
LIMB = ((-20.0, -20.0), (-17.0, -17.5))
PIECE = ((-30.0, -33.94), (-25.0, -33.94))
BOARD = ((-30.0, -43.0), (-25.0, -43.0))


def fit_of(camera):
    theta = theta_of(camera, ProjectionModel(camera.width, camera.height, Surface("flat", CIRCLE.radius_m)))
    return camera_fit(camera, theta=theta, covariance=np.zeros((len(theta), len(theta))), parameters=PARAMETERS)


def find(*drawn, camera=TRUE, region=True, known=(), width_px=3):
    image = np.full((TRUE.height, TRUE.width, 3), (60, 120, 70), np.uint8)
    for ends in drawn:
        pixels = np.round(16 * TRUE.project(np.array(ends))).astype(np.int32)[:, None]
        cv2.polylines(image, [pixels], False, (220, 230, 225), width_px, cv2.LINE_AA, 4)
    noise = np.random.default_rng(3).normal(0.0, 2.0, image.shape)
    image = np.clip(cv2.GaussianBlur(image, (0, 0), 0.8) + noise, 0, 255).astype(np.uint8)
    picture = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    mask = MarkingMask(
        np.zeros(picture.shape, np.uint8),
        "detector",
        transform_conic(circle_conic(CIRCLE.center, CIRCLE.radius_m), TRUE.homography),
        lines=tuple(Segment(*TRUE.project(np.array(ends))) for ends in known),
        field_region=np.ones((90, 160), np.bool_) if region else None,
    )
    runs = find_short_markings(picture, mask, np.zeros((0, 2, 2)), MaskConfig())
    return measure_short_lines(image, picture, runs, fit_of(camera), SOCCER, 1.0, 1.2, (6.0, 2.0))


@pytest.mark.parametrize("camera", [TRUE, CLOSER], ids=["true", "closer"])
def test_a_corner_of_the_penalty_area_is_measured(camera):
    """Also before a camera that is too near by a sixth, as an open field lets it be."""
    found = find(TOUCHLINE, LIMB, *CORNER, camera=camera, known=(TOUCHLINE,))
    assert len(found) == 2
    for ends in CORNER:
        (start, end), span = TRUE.project(np.array(ends)), np.diff(TRUE.project(np.array(ends)), axis=0)[0]
        normal = np.array([-span[1], span[0]]) / np.hypot(*span)
        best = min(found, key=lambda line: np.abs((line.points_px - start) @ normal).max())
        assert np.abs((best.points_px - start) @ normal).max() < 1.0
        assert np.ptp(best.points_px @ span) > 0.6 * (end - start) @ span
        assert best.name is None


def test_limbs_boards_and_known_markings_are_none():
    assert find(LIMB, known=(TOUCHLINE,)) == ()
    assert find(BOARD, known=(TOUCHLINE,)) == ()
    assert find(TOUCHLINE, known=(TOUCHLINE,)) == ()
    assert len(find(PIECE)) == 1


def test_a_run_that_is_far_broader_than_paint_is_none():
    assert len(find(PIECE, width_px=3)) == 1
    assert find(PIECE, width_px=5) == ()


def test_nothing_is_looked_for_where_no_surface_was_found():
    assert find(*CORNER, region=False) == ()

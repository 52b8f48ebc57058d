"""The linear system on points and tangents."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.errors import EstimationError
from circlecal.geometry.homography import transfer_errors, turn_homography
from circlecal.geometry.projective import lift
from circlecal.observations import Keypoint, LinePoints, Observations
from circlecal.results import PointCorrespondence
from circlecal.stages.correspondences import correspondences_from_line
from circlecal.stages.homography import HomographyConfig, choose_turn, estimate_homography

from .conftest import CIRCLE, SOCCER, line_cue, true_conic, view

CAMERA = view()
EXACT = correspondences_from_line(
    true_conic(CAMERA), lift(CAMERA.project(np.zeros(2))), line_cue(CAMERA).line, np.zeros(2), CIRCLE.radius_m,
    np.array([0.0, 1.0]),
)  # fmt: skip
FIELD = np.random.default_rng(1).uniform(-12, 12, (40, 2))


def shaken(rng, sigma=0.5):
    points = tuple(replace(p, image_px=p.image_px + rng.normal(0, sigma, 2)) for p in EXACT.points)
    return replace(EXACT, points=points)


@pytest.mark.parametrize("use_tangents", [True, False])
def test_exact_and_both_directions(use_tangents):
    found = estimate_homography(EXACT, np.zeros(2), HomographyConfig(use_tangents=use_tangents))
    assert transfer_errors(found.H_image_field, FIELD, CAMERA.project(FIELD)).max() < 1e-8
    assert transfer_errors(found.H_field_image, CAMERA.project(FIELD), FIELD).max() < 1e-10
    assert transfer_errors(found.H_image_field_turned, -FIELD, CAMERA.project(FIELD)).max() < 1e-8
    assert found.residuals_px.max() < 1e-8
    assert found.null_ratio < 1e-9
    assert found.residuals_px.shape == (8,)


def test_residuals_and_null_ratio_grow_with_noise():
    rng = np.random.default_rng(2)
    found = estimate_homography(shaken(rng), np.zeros(2), HomographyConfig(use_tangents=False))
    # 16 coordinates, 8 unknowns: rms of the length is sigma sqrt(2 (16 - 8) / 16) = sigma
    assert 0.2 < np.sqrt(np.mean(found.residuals_px**2)) < 0.9
    assert found.null_ratio > 1e-5


def test_tangents_help():
    """With noisy points, exact tangents make the answer better."""
    errors = {True: [], False: []}
    for seed in range(12):
        given = shaken(np.random.default_rng(seed), 1.0)
        for use in errors:
            H = estimate_homography(given, np.zeros(2), HomographyConfig(use_tangents=use)).H_image_field
            errors[use].append(transfer_errors(H, FIELD, CAMERA.project(FIELD)).mean())
    assert np.mean(errors[True]) < 0.9 * np.mean(errors[False])


def test_refusals():
    ill = HomographyConfig(maximum_condition=1.5)
    with pytest.raises(EstimationError) as refused:
        estimate_homography(EXACT, np.zeros(2), ill)
    assert refused.value.code == "ill_conditioned"
    assert "1.5" in refused.value.reason
    on_a_line = tuple(
        PointCorrespondence(str(k), np.array([float(k), 0.0]), np.array([10.0 * k, 5.0])) for k in range(8)
    )
    with pytest.raises(EstimationError) as refused:
        estimate_homography(replace(EXACT, points=on_a_line, tangents=()), np.zeros(2), HomographyConfig())
    assert refused.value.code == "degenerate"


def test_a_published_method_is_turned_to_the_side_of_the_camera_or_to_what_was_seen():
    turned = turn_homography(CAMERA.homography, np.zeros(2))
    line = LinePoints("halfway_line", CAMERA.project(np.array([[0.0, -9.0], [0.0, 9.0]])), np.ones(2))
    alike = Observations(CAMERA.width, CAMERA.height, lines=(line,))

    def error_px(H, seen, side):
        chosen = choose_turn(H, seen, SOCCER, np.zeros(2), side)
        return transfer_errors(chosen, FIELD, CAMERA.project(FIELD)).max()

    for H in (CAMERA.homography, turned):
        assert error_px(H, alike, "main") < 1e-6
        assert error_px(H, alike, "opposite") > 50.0
        place = np.array([0.0, -9.15])
        told = replace(alike, keypoints=(Keypoint("far crossing", place, CAMERA.project(place) + 0.5, 1.0),))
        assert error_px(H, told, "opposite") < 1e-6
        touchline = LinePoints("side_line_top", CAMERA.project(np.array([[-5.0, -34.0], [5.0, -34.0]])), np.ones(2))
        assert error_px(H, replace(alike, lines=(line, touchline)), "opposite") < 1e-6

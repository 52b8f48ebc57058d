"""The linear system on points and tangents."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.errors import EstimationError
from circlecal.geometry.homography import transfer_errors, turn_homography
from circlecal.geometry.projective import apply_homography, lift
from circlecal.observations import Keypoint, LinePoints, Observations
from circlecal.results import Cues, MarkCue, PointCorrespondence
from circlecal.stages.correspondences import (
    CorrespondencesConfig,
    choose_turn,
    correspondences_from_line,
    derive_correspondences,
)
from circlecal.stages.homography import HomographyConfig, estimate_homography

from .conftest import CIRCLE, SOCCER, fits_of, line_cue, true_conic, view

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


def with_far_line(rng, side="main", line="side_line_top"):
    """A mark a pixel off, from which points and tangents are derived, and a named line beside them."""
    points = CAMERA.project(np.linspace(*SOCCER.line_ends(SOCCER.line_by_name[line]), 9)[3:6])
    mark = MarkCue("centre_mark", CAMERA.project(np.zeros(2)) + rng.normal(0, 1.0, 2), 1.0, 9.0)
    seen = Observations(
        CAMERA.width, CAMERA.height, lines=(LinePoints(line, points + rng.normal(0, 0.3, points.shape), np.ones(3)),)
    )
    cues = Cues(line_cue(CAMERA), mark)
    return derive_correspondences(
        fits_of(CAMERA, ("center",)), cues, SOCCER, CIRCLE, seen, CorrespondencesConfig(camera_side=side)
    )


def test_tangents_change_nothing_alone_and_weigh_the_circle_against_what_was_seen():
    """Points and tangents of one conic, centre and direction agree whatever the noise; a named line does not."""
    given = with_far_line(np.random.default_rng(4))
    for found, least_px, most_px in ((replace(given, seen_lines=()), 0.0, 1e-8), (given, 1e-3, 5.0)):
        with_them, without = (
            estimate_homography(found, np.zeros(2), HomographyConfig(use_tangents=use)) for use in (True, False)
        )
        moved = transfer_errors(with_them.H_image_field, FIELD, apply_homography(without.H_image_field, FIELD)).max()
        assert least_px <= moved <= most_px
        assert (with_them.residuals_px.max() > 1e-6) == (without.residuals_px.max() > 1e-6) == bool(found.seen_lines)
        assert with_them.lines == without.lines + 8


def test_a_named_line_makes_the_field_about_it_better():
    """Without it the homography rests on the circle alone, and what it leaves open grows away from it."""
    far = np.array([[x, y] for x in (-15.0, 0.0, 15.0) for y in (-34.0, -25.0)])
    errors = {True: [], False: []}
    for seed in range(12):
        given = with_far_line(np.random.default_rng(seed))
        for used in errors:
            found = given if used else replace(given, seen_lines=())
            H = estimate_homography(found, np.zeros(2), HomographyConfig()).H_image_field
            errors[used].append(transfer_errors(H, far, CAMERA.project(far)).mean())
    assert all(np.array(errors[True]) < np.array(errors[False]))


def test_what_was_seen_overrules_the_side_of_the_camera():
    found = with_far_line(np.random.default_rng(5), side="opposite")
    H = estimate_homography(found, np.zeros(2), HomographyConfig()).H_image_field
    assert transfer_errors(H, FIELD, CAMERA.project(FIELD)).max() < 10.0


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

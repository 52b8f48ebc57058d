"""Cases 1, 2 and 3: points and tangents from a circle, exact without noise."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from circlecal.errors import EstimationError
from circlecal.field import load_field
from circlecal.geometry.conics import polar, pole
from circlecal.geometry.ellipses import conic_from_ellipse
from circlecal.geometry.homography import SIDES, homography_from_circle, transfer_errors, turn_homography
from circlecal.geometry.projective import apply_homography, dehomogenise, join, lift, meet, normalise_line
from circlecal.observations import Keypoint, Observations
from circlecal.results import Cues, EllipseFits, MarkCue
from circlecal.stages import correspondences
from circlecal.stages.correspondences import (
    USUAL_DISTANCE_LOG_SD,
    USUAL_DISTANCE_RADII,
    USUAL_ROLL_RAD,
    CorrespondencesConfig,
    correspondences_from_line,
    correspondences_from_point,
    derive_correspondences,
    pinhole_center,
)
from circlecal.stages.homography import HomographyConfig, estimate_homography

from .conftest import CIRCLE, SOCCER, fit_of, fits_of, line_cue, true_conic, view

HOCKEY = load_field("ice-hockey")
ORIGIN, UP = np.zeros(2), np.array([0.0, 1.0])
AUTO = CorrespondencesConfig()
CAMERA = view()
FIELD = np.random.default_rng(3).uniform(-12, 12, (60, 2))


def mark_cue(camera):
    return MarkCue("centre_mark", camera.project(ORIGIN), 0.1, 50.0)


def cues_of(camera, mark=True, line=True):
    return Cues(line_cue(camera) if line else None, mark_cue(camera) if mark else None)


def derived(camera, config=AUTO, edges=("outer", "inner"), cues=None, keypoints=(), circle=CIRCLE, template=SOCCER):
    return derive_correspondences(
        fits_of(camera, edges, circle, template),
        cues_of(camera) if cues is None else cues,
        template,
        circle,
        Observations(camera.width, camera.height, keypoints=keypoints),
        config,
    )


def homography_of(found, circle=CIRCLE):
    return estimate_homography(found, np.asarray(circle.center), HomographyConfig())


def departure(H, camera, field=FIELD):
    return float(transfer_errors(H, field, camera.project(field)).max())


def keypoint(camera, field_m):
    return Keypoint("somewhere", np.asarray(field_m), camera.project(np.asarray(field_m)), 0.1)


CAMERAS = {
    "before the halfway line": view(),
    "far aside": view(position=(-22.0, 55.0, -12.0), focal=2600.0),
    "rolled": view(position=(8.0, 50.0, -25.0), roll=-0.12, focal=2300.0),
    "low": view(position=(6.0, 80.0, -8.0), focal=4500.0),
    "circle half outside": view(target=(11.0, 0.0, 0.0), focal=3400.0),
}
BOTH_WAYS = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


@BOTH_WAYS
def test_case_1_is_exact(camera):
    found = derived(camera)
    assert (found.case, found.center_source) == (1, "centre_mark")
    assert departure(homography_of(found).H_image_field, camera) < 1e-8


@BOTH_WAYS
def test_case_2_is_exact_whatever_the_side(camera):
    """The point tells the two solutions apart, the prior on the side is not asked."""
    for side in SIDES:
        config = CorrespondencesConfig(case=2, camera_side=side)
        for point in ((3.0, -5.0), (-9.0, 1.0), (0.5, 8.0), (-20.0, -30.0)):
            found = derived(camera, config, keypoints=(keypoint(camera, point),))
            assert found.case == 2
            assert departure(homography_of(found).H_image_field, camera) < 1e-8


@BOTH_WAYS
def test_case_3_is_exact(camera):
    found = derived(camera, CorrespondencesConfig(case=3))
    assert (found.case, found.center_source) == (3, "two_edges")
    assert departure(homography_of(found).H_image_field, camera) < 1e-8


@BOTH_WAYS
def test_case_1_with_the_centre_from_the_pinhole_camera_is_exact(camera):
    found = derived(camera, edges=("center",), cues=cues_of(camera, mark=False))
    assert (found.case, found.center_source) == (1, "pinhole")
    assert departure(homography_of(found).H_image_field, camera) < 1e-6


def test_case_3_goes_on_from_a_point_where_no_line_is_seen():
    cues = Cues(None, None)
    found = derived(CAMERA, cues=cues, keypoints=(keypoint(CAMERA, (9.0, 4.0)),))
    assert (found.case, found.center_source) == (3, "two_edges")
    assert departure(homography_of(found).H_image_field, CAMERA) < 1e-8


@pytest.mark.parametrize("line", ["side_line_top", "big_rect_right_main", "small_rect_left_top"])
def test_case_1_from_a_line_beside_the_centre(line):
    drawn = SOCCER.line_by_name[line]
    start, end = SOCCER.line_ends(drawn)
    image_line = line_cue(CAMERA, line).line
    found = correspondences_from_line(
        true_conic(CAMERA), lift(CAMERA.project(ORIGIN)), image_line, ORIGIN, CIRCLE.radius_m, end - start
    )
    assert departure(homography_of(found).H_image_field, CAMERA) < 1e-8


@pytest.mark.parametrize("name", [c.name for c in HOCKEY.circles])
def test_every_circle_of_a_rink(name):
    """The red line passes beside the face-off circles, and their centres lie away from the field's origin."""
    circle = HOCKEY.circle_by_name[name]
    camera = view(position=(circle.center[0] + 5.0, 45.0, -12.0), target=(*circle.center, 0.0), focal=2800.0)
    field = FIELD[:20] * 0.5 + circle.center
    center = camera.homography @ lift(circle.center)
    found = correspondences_from_line(
        true_conic(camera, "outer", circle, HOCKEY), center, line_cue(camera, "centre_line", HOCKEY).line,
        np.asarray(circle.center), circle.radius_m, UP,
    )  # fmt: skip
    H = homography_of(found, circle)
    assert departure(H.H_image_field, camera, field) < 1e-8
    turned = transfer_errors(H.H_image_field_turned, 2 * np.asarray(circle.center) - field, camera.project(field))
    assert turned.max() < 1e-8
    by_edges = derived(
        camera, CorrespondencesConfig(case=3), cues=Cues(line_cue(camera, "centre_line", HOCKEY), None),
        circle=circle, template=HOCKEY,
    )  # fmt: skip
    assert departure(homography_of(by_edges, circle).H_image_field, camera, field) < 1e-8


@pytest.mark.parametrize("side", sorted(SIDES))
def test_every_side_of_the_field(side):
    toward = np.array(SIDES[side])
    camera = view(position=(*(55.0 * toward + 4.0 * toward[::-1]), -15.0), target=(0.0, 0.5, 0.0))
    fit = homography_of(derived(camera, CorrespondencesConfig(camera_side=side)))
    assert departure(fit.H_image_field, camera) < 1e-8
    assert np.linalg.det(fit.H_image_field) > 0
    # the wrong side gives the other solution, and the truth is kept beside it
    opposite = next(s for s, d in SIDES.items() if np.allclose(d, -toward))
    wrong = homography_of(derived(camera, CorrespondencesConfig(camera_side=opposite)))
    assert departure(wrong.H_image_field, camera) > 50.0
    assert departure(wrong.H_image_field_turned, camera) < 1e-8
    assert departure(turn_homography(wrong.H_image_field, ORIGIN), camera) < 1e-8


@BOTH_WAYS
def test_closed_form_equals_the_linear_system(camera):
    E, c, line = true_conic(camera), lift(camera.project(ORIGIN)), line_cue(camera).line
    found = correspondences_from_line(E, c, line, ORIGIN, CIRCLE.radius_m, UP)
    closed = homography_from_circle(E, c, line, ORIGIN, CIRCLE.radius_m, UP)
    linear = homography_of(found).H_image_field
    candidates = (closed, turn_homography(closed, ORIGIN))
    assert min(transfer_errors(H, FIELD, apply_homography(linear, FIELD)).max() for H in candidates) < 1e-8


SCALE = st.floats(1e-6, 1e6).flatmap(lambda s: st.sampled_from([s, -s]))


@given(SCALE, SCALE, SCALE)
def test_scales_of_conic_centre_and_line_do_not_matter(by_conic, by_center, by_line):
    E, c, line = true_conic(CAMERA), lift(CAMERA.project(ORIGIN)), line_cue(CAMERA).line
    plain = correspondences_from_line(E, c, line, ORIGIN, CIRCLE.radius_m, UP)
    scaled = correspondences_from_line(by_conic * E, by_center * c, by_line * line, ORIGIN, CIRCLE.radius_m, UP)
    assert [p.label for p in scaled.points] == [p.label for p in plain.points]
    for one, other in zip(scaled.points, plain.points, strict=True):
        np.testing.assert_allclose(one.image_px, other.image_px, atol=1e-8)
    point = np.array([3.0, -5.0])
    first, second = (
        correspondences_from_point(a * E, b * c, CAMERA.project(point), point, ORIGIN, CIRCLE.radius_m)
        for a, b in ((1.0, 1.0), (by_conic, by_center))
    )
    for one, other in zip(first.points, second.points, strict=True):
        np.testing.assert_allclose(one.image_px, other.image_px, atol=1e-8)


@BOTH_WAYS
def test_points_and_tangents_are_where_their_labels_say(camera):
    found = derived(camera)
    radius = SOCCER.radius(CIRCLE, "outer")
    s = np.sqrt(0.5)
    outward = {
        "right": (1, 0), "left": (-1, 0), "top": (0, -1), "bottom": (0, 1),
        "top_right": (s, -s), "top_left": (-s, -s), "bottom_right": (s, s), "bottom_left": (-s, s),
    }  # fmt: skip
    assert {p.label for p in found.points} == {t.label for t in found.tangents} == set(outward)
    for point, tangent in zip(found.points, found.tangents, strict=True):
        assert point.label == tangent.label
        expected = radius * np.array(outward[point.label])
        np.testing.assert_allclose(point.field_m, expected, atol=1e-12)
        np.testing.assert_allclose(point.image_px, camera.project(expected), atol=1e-8)
        # the field's tangent touches the circle there, the image's touches the conic there
        assert tangent.field_line @ lift(point.field_m) == pytest.approx(0, abs=1e-12)
        np.testing.assert_allclose(tangent.field_line, [*outward[point.label], -radius], atol=1e-12)
        assert tangent.image_line @ lift(point.image_px) == pytest.approx(0, abs=1e-7)
        contact = dehomogenise(pole(found.conic, tangent.image_line))
        np.testing.assert_allclose(contact, point.image_px, atol=1e-6)
        assert np.hypot(*tangent.image_line[:2]) == pytest.approx(1.0)
    horizon = normalise_line(np.linalg.inv(camera.homography).T @ [0.0, 0.0, 1.0])
    assert np.abs(np.cross(horizon, found.vanishing_line)).max() < 1e-8 * np.abs(horizon).max()


def test_tangents_meet_in_the_pole_and_not_in_the_polar():
    """A point is the pole of a line, through the inverse of the conic."""
    point = np.array([4.0, -6.0])
    found = correspondences_from_point(
        true_conic(CAMERA), lift(CAMERA.project(ORIGIN)), CAMERA.project(point), point, ORIGIN, CIRCLE.radius_m
    )
    line = join(found.imaged_center, lift(CAMERA.project(point)))
    vanishing = meet(found.tangents[0].image_line, found.tangents[1].image_line)
    vanishing = vanishing / np.linalg.norm(vanishing)
    right, wrong = (v / np.linalg.norm(v) for v in (pole(found.conic, line), polar(found.conic, line)))
    assert np.linalg.norm(np.cross(vanishing, right)) < 1e-8
    assert np.linalg.norm(np.cross(vanishing, wrong)) > 1e-3


def test_radius_is_that_of_the_edge_that_carries_the_fit():
    for edge in ("outer", "center", "inner"):
        found = derived(CAMERA, edges=(edge,))
        assert found.radius_m == SOCCER.radius(CIRCLE, edge)
        assert departure(homography_of(found).H_image_field, CAMERA) < 1e-8


def with_inner_stretched(camera, share):
    """Fits whose inner edge is measured too long by a share, which splits the double eigenvalue."""
    fits = fits_of(camera)
    ellipse = fits.inner.ellipse
    longer, shorter = ellipse.semi_axes
    inner = fit_of(conic_from_ellipse(replace(ellipse, semi_axes=(longer * (1 + share), shorter))), "inner")
    return EllipseFits(fits.outer, inner, None)


def refusal_of(fits, config=CorrespondencesConfig(case=3), cues=None):
    with pytest.raises(EstimationError) as refused:
        derive_correspondences(
            fits, cues or cues_of(CAMERA, mark=False), SOCCER, CIRCLE, Observations(1280, 720), config
        )
    assert refused.value.stage == "correspondences"
    return refused.value


@pytest.mark.parametrize(("share", "code"), [(1e-5, None), (1e-3, None), (0.01, "eigenvalue_gap_within_noise")])
def test_case_3_is_refused_where_the_eigenvalue_gap_is_within_noise(share, code):
    fits = with_inner_stretched(CAMERA, share)
    if code is None:
        config = CorrespondencesConfig(case=3)
        found = derive_correspondences(fits, cues_of(CAMERA), SOCCER, CIRCLE, Observations(1280, 720), config)
        assert found.case == 3
    else:
        refused = refusal_of(fits)
        assert refused.code == code
        assert "eigenvalue" in refused.reason
    strict = CorrespondencesConfig(case=3, maximum_pair_split=1e-6)
    assert refusal_of(fits, strict).code == "eigenvalue_gap_within_noise"


def test_case_3_is_refused_without_two_edges_or_without_a_centre():
    assert refusal_of(fits_of(CAMERA, ("center",))).code == "no_center"
    fits = fits_of(CAMERA)
    swapped = EllipseFits(fit_of(fits.inner.conic, "outer"), fit_of(fits.outer.conic, "inner"), None)
    assert refusal_of(swapped).code == "no_center"


def test_what_is_missing_is_named():
    nothing = refusal_of(fits_of(CAMERA), AUTO, Cues(None, mark_cue(CAMERA)))
    assert nothing.code == "no_line_or_point"
    assert "no halfway line and no known point" in nothing.reason
    assert refusal_of(fits_of(CAMERA), CorrespondencesConfig(case=2)).code == "no_point"
    point = Keypoint("beside", np.array([0.0, -9.15]), CAMERA.project(np.array([0.0, -9.15])), 0.1)
    with pytest.raises(EstimationError) as refused:
        derived(CAMERA, CorrespondencesConfig(case=1), cues=cues_of(CAMERA, line=False), keypoints=(point,))
    assert refused.value.code == "no_line"


def test_a_centre_outside_the_ellipse_is_refused():
    away = MarkCue("centre_mark", np.array([5.0, 5.0]), 0.1, 50.0)
    assert refusal_of(fits_of(CAMERA), AUTO, Cues(line_cue(CAMERA), away)).code == "center_outside"


@BOTH_WAYS
def test_pinhole_center_needs_neither_mark_nor_second_edge(camera):
    center = pinhole_center(true_conic(camera), line_cue(camera).line, (camera.width, camera.height))
    np.testing.assert_allclose(dehomogenise(center), camera.project(ORIGIN), atol=1e-6)


@pytest.mark.parametrize(("distances", "is_usual"), [(1.0, True), (3.9, True), (4.1, False)])
def test_a_centre_that_only_an_unusual_camera_allows_is_none(distances, is_usual, monkeypatch):
    """Chi-square 16: four standard deviations of roll, or of the logarithm of the distance."""
    away_m = CIRCLE.radius_m * USUAL_DISTANCE_RADII * np.exp(-distances * USUAL_DISTANCE_LOG_SD)
    place = np.array([0.0, np.cos(0.6), -np.sin(0.6)]) * away_m
    focal_px = 3000.0 * away_m / 64.0
    camera = view(position=tuple(place), target=(0.0, 0.0, 0.0), focal=focal_px, roll=0.0)
    # where the camera stands in the plane of the halfway line that tells nothing of the centre
    true = lift(camera.project(ORIGIN))
    monkeypatch.setattr(correspondences, "pinhole_centers", lambda *given: [true])
    center = pinhole_center(true_conic(camera, "center"), line_cue(camera).line, (camera.width, camera.height))
    assert (center is not None) == is_usual


@pytest.mark.parametrize(("rolls", "is_usual"), [(0.5, True), (3.9, True), (4.1, False)])
def test_a_centre_that_only_a_rolled_camera_allows_is_none(rolls, is_usual, monkeypatch):
    away_m = CIRCLE.radius_m * USUAL_DISTANCE_RADII
    camera = view(position=(0.0, away_m * np.cos(0.3), -away_m * np.sin(0.3)), roll=rolls * USUAL_ROLL_RAD)
    true = lift(camera.project(ORIGIN))
    monkeypatch.setattr(correspondences, "pinhole_centers", lambda *given: [true])
    center = pinhole_center(true_conic(camera, "center"), line_cue(camera).line, (camera.width, camera.height))
    assert (center is not None) == is_usual

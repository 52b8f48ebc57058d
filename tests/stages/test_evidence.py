"""What the whole picture says of a camera: paint that it does not explain, near and far, and what is no field."""

from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.observations import MarkingKey
from circlecal.results import Agreement, Evidence, MarkingMask, Segment, Surroundings, Verdict
from circlecal.stages import evidence as module
from circlecal.stages.evidence import _misfit, measure_evidence
from circlecal.stages.verdict_on_picture import weigh_evidence

from .conftest import CIRCLE, SOCCER, view
from .test_verdict import camera_fit

CAMERA = view(position=(3.0, 60.0, -18.0), target=(0.0, 2.0, 0.0), focal=1600.0)
CARRIERS = frozenset({CIRCLE.name, "halfway_line"})
OBLIQUE, ALONG = ((-12.0, -14.0), (-2.0, 14.0)), ((-14.0, 14.0), (14.0, 14.0))


def fit_of(camera):
    theta = theta_of(camera, ProjectionModel(camera.width, camera.height, Surface("flat", CIRCLE.radius_m)))
    covariance = np.diag(np.where(np.arange(len(PARAMETERS)) < 4, 1e-8, 0.0))
    return camera_fit(camera, theta=theta, covariance=covariance, parameters=PARAMETERS, named_lines=("side_line_top",))


def paint(further=(), grows=0.0):
    """Grass with the markings, and further lines; their paint may be wider with a power of the distance."""
    surface = np.random.default_rng(0).normal(90, 3, (CAMERA.height, CAMERA.width))
    picture = np.zeros_like(surface)
    lines = [np.linspace(*map(np.asarray, ends), 200) for ends in further]
    for points in (*SOCCER.polylines().values(), *lines):
        across = np.stack([-np.gradient(points[:, 1]), np.gradient(points[:, 0])], axis=-1)
        across *= 0.06 / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        across *= (np.maximum(CAMERA.depth(points), 5.0) / 60.0)[:, None] ** grows
        near, far = points - across, points + across
        strips = np.stack([near[:-1], near[1:], far[1:], far[:-1]], axis=1)
        seen = (CAMERA.depth(strips.reshape(-1, 2)).reshape(-1, 4) > 5.0).all(axis=1)
        for strip in np.round(16 * CAMERA.project(strips[seen])).astype(np.int32):
            cv2.fillConvexPoly(picture, strip, (110.0,), cv2.LINE_AA, 4)
    return (surface + cv2.GaussianBlur(picture, (0, 0), 0.8)).clip(0, 255).astype(np.uint8)


def mask_of(further=(), region=None):
    ends = [CAMERA.project(np.array(line)) for line in further]
    drawn = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
    return MarkingMask(drawn, "detector", lines=tuple(Segment(*pair) for pair in ends), field_region=region)


FAR_CONTRAST = 0.45
"""Contrast of a far line, over that of a sharp picture."""
NO_PAINT = Evidence(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
NO_GROUND = Surroundings(0.0, 0.0, 0.0, 0.0, 0.0)


NOTHING_MORE = Agreement((), np.zeros(0), np.zeros(0))


def weigh(evidence, camera, ground=NO_GROUND, template=SOCCER, agreement=NOTHING_MORE):
    return weigh_evidence(Verdict("calibrated", None, None, None), camera, evidence, ground, template, agreement)


@pytest.fixture(scope="module")
def plain():
    return paint()


def test_a_right_camera_finds_its_paint_and_nothing_against_it(plain):
    halfway = SOCCER.line_ends(SOCCER.line_by_name["halfway_line"])
    camera = fit_of(CAMERA)
    found = measure_evidence(plain, mask_of((halfway,)), camera, SOCCER, CARRIERS)
    assert found.oblique_widths == found.alone_widths == found.bare_widths == 0.0
    assert found.painted_share > 0.9 and found.reversal < -5.0
    assert weigh(found, camera).status == "calibrated"


def test_paint_across_the_field_that_is_no_marking_speaks_against_a_camera():
    further = (OBLIQUE,)
    camera = fit_of(CAMERA)
    found = measure_evidence(paint(further), mask_of(further), camera, SOCCER, CARRIERS)
    length = np.linalg.norm(np.subtract(*CAMERA.project(np.array(OBLIQUE)))) / CAMERA.width
    assert found.oblique_widths == pytest.approx(length, rel=0.15)
    assert weigh(replace(found, oblique_widths=0.25), camera).code == "paint_unexplained"


def test_one_line_along_the_field_is_told_from_the_field_of_another_sport():
    other = ((-14.0, 18.0), (14.0, 18.0))
    camera = fit_of(CAMERA)
    one = measure_evidence(paint((ALONG,)), mask_of((ALONG,)), camera, SOCCER, CARRIERS)
    two = measure_evidence(paint((ALONG, other)), mask_of((ALONG, other)), camera, SOCCER, CARRIERS)
    assert one.alone_widths > 0.3 and two.alone_widths == 0.0
    assert one.oblique_widths == two.oblique_widths == 0.0
    assert one.parallel_widths == pytest.approx(one.alone_widths, rel=0.1)
    assert two.parallel_widths > 1.8 * one.parallel_widths
    assert weigh(one, camera).status == "calibrated"
    assert weigh(one, replace(camera, named_lines=())).code == "paint_unexplained"


def test_a_far_line_is_as_much_fainter_as_blur_makes_thin_paint():
    """As of a smaller pitch's penalty area."""
    far = ((-14.0, -26.0), (14.0, -26.0))
    bare, whole, camera = paint(), paint((far,)), fit_of(CAMERA)
    picture = cv2.addWeighted(bare, 1.0 - FAR_CONTRAST, whole, FAR_CONTRAST, 0.0)
    found = measure_evidence(picture, mask_of((far,)), camera, SOCCER, CARRIERS)
    assert found.alone_widths == 0.0 and found.parallel_widths > 0.3


def test_a_line_along_the_field_that_is_measured_in_pieces_is_one_line():
    (left, y), (right, _) = ALONG
    middle = (left + right) / 2.0
    camera, pieces = fit_of(CAMERA), (((left, y), (middle - 0.5, y)), ((middle + 0.5, y), (right, y)))
    whole = measure_evidence(paint((ALONG,)), mask_of((ALONG,)), camera, SOCCER, CARRIERS)
    found = measure_evidence(paint((ALONG,)), mask_of(pieces), camera, SOCCER, CARRIERS)
    assert found.alone_widths == pytest.approx(whole.alone_widths, rel=0.1)


def test_an_unexplained_line_in_another_paint_speaks_against_no_camera():
    halfway, asked = SOCCER.line_ends(SOCCER.line_by_name["halfway_line"]), []

    def find_other_paints(segments):
        asked.extend(segments)
        return np.ones(len(segments), np.bool_)

    mask = mask_of((halfway, OBLIQUE))
    found = measure_evidence(paint((OBLIQUE,)), mask, fit_of(CAMERA), SOCCER, CARRIERS, find_other_paints)
    assert found.oblique_widths == 0.0
    assert asked == [mask.lines[1]]


def test_what_would_refuse_nothing_alone_refuses_together():
    """As where a banner hides most of a circle, and the camera puts the rest of it into the stands."""
    camera = fit_of(CAMERA)
    worn, rough = Evidence(0.05, 0.0, 0.6, 0.073, 0.0, -1.7), Surroundings(0.118, 0.0, 0.0, 0.0, 0.0)
    assert weigh(worn, camera).status == "calibrated"
    assert weigh(NO_PAINT, camera, rough).status == "calibrated"
    verdict = weigh(worn, camera, rough)
    assert verdict.code == "picture_contradicts" and "each a little less than would refuse it alone" in verdict.reason


def test_a_segment_that_is_no_paint_says_nothing(plain):
    found = measure_evidence(plain, mask_of((OBLIQUE, ALONG)), fit_of(CAMERA), SOCCER, CARRIERS)
    assert found.oblique_widths == found.alone_widths == 0.0


def test_paint_that_grows_with_the_distance_is_a_picture_turned_upside_down():
    camera = fit_of(CAMERA)
    found = measure_evidence(paint(grows=2.0), mask_of(), camera, SOCCER, CARRIERS)
    assert found.reversal > 3.0
    assert weigh(found, replace(camera, named_lines=())).code == "picture_contradicts"


@pytest.mark.parametrize(("left", "exchanged", "told"), [(10.1, 6.5, 3.6), (28.5, 23.3, 0.0), (20.0, 24.0, -4.0)])
def test_widths_that_neither_camera_explains_tell_nothing(plain, left, exchanged, told, monkeypatch):
    """An old coat beside the paint widens it here and not there."""
    misfits = iter([left, *(exchanged + 1.0,) * 3, exchanged])
    monkeypatch.setattr(module, "_misfit", lambda *given: next(misfits))
    found = measure_evidence(plain, mask_of(), fit_of(CAMERA), SOCCER, CARRIERS)
    assert found.reversal == pytest.approx(told)


def test_a_pan_widens_what_it_sweeps_across(plain):
    blurred = cv2.blur(plain, (15, 1))
    camera = fit_of(CAMERA)
    found = measure_evidence(blurred, mask_of(), camera, SOCCER, CARRIERS)
    assert found.reversal < 1.0
    assert weigh(found, replace(camera, named_lines=())).status == "calibrated"


def test_a_circle_that_is_hardly_painted_speaks_against_a_camera():
    bare = np.random.default_rng(2).normal(90, 3, (CAMERA.height, CAMERA.width)).astype(np.uint8)
    camera = fit_of(CAMERA)
    found = measure_evidence(bare, mask_of(), camera, SOCCER, CARRIERS)
    assert found.painted_share < 0.2
    assert weigh(found, camera).code == "markings_missing"
    assert weigh(NO_PAINT, camera).status == "calibrated"


def test_a_halfway_line_that_breaks_off_in_full_view_speaks_against_a_camera(plain):
    camera = fit_of(CAMERA)
    first, last = CAMERA.project(np.array([(0.0, 8.0), (0.0, 33.5)]))
    box = np.s_[int(first[1]) : int(last[1]), int(first[0]) - 120 : int(first[0]) + 120]
    rng = np.random.default_rng(3)
    bare, hidden = plain.copy(), plain.copy()
    bare[box] = rng.normal(90, 3, bare[box].shape)
    hidden[box] = rng.integers(20, 230, hidden[box].shape)
    broken, covered = (measure_evidence(p, mask_of(), camera, SOCCER, CARRIERS) for p in (bare, hidden))
    assert broken.bare_widths == pytest.approx((CAMERA.height - first[1]) / CAMERA.width, rel=0.2)
    assert covered.bare_widths < 0.05
    # no other gate stops it
    assert broken.painted_share > 0.6
    assert weigh(broken, camera).code == "markings_missing"
    assert weigh(covered, camera).status == "calibrated"


def test_a_halfway_line_may_break_off_where_the_circle_is_worn_off_for_as_long(plain):
    camera, rng = fit_of(CAMERA), np.random.default_rng(3)
    first, last = CAMERA.project(np.array([(0.0, 23.0), (0.0, 33.5)]))
    left, right = (CAMERA.project(CIRCLE.radius_m * np.array([(np.cos(a), np.sin(a))]))[0] for a in (1.8, 3.1))
    worn = plain.copy()
    for box in (
        np.s_[int(first[1]) : int(last[1]), int(first[0]) - 120 : int(first[0]) + 120],
        np.s_[int(right[1]) : int(left[1]), int(right[0]) - 20 : int(left[0])],
    ):
        worn[box] = rng.normal(90, 3, worn[box].shape)
    found = measure_evidence(worn, mask_of(), camera, SOCCER, CARRIERS)
    assert found.worn_widths > found.bare_widths > 0.08
    assert weigh(found, camera).status == "calibrated"


@pytest.mark.parametrize(("beside_m", "is_coat"), [(0.4, True), (1.2, False)])
def test_an_old_coat_of_the_circle_is_no_paint_that_nothing_explains(beside_m, is_coat):
    camera, angle = replace(fit_of(CAMERA), named_lines=()), np.linspace(2.2, 4.0, 10)
    ring = (CIRCLE.radius_m + beside_m) * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    chords = tuple(pairwise(ring))
    found = measure_evidence(paint(chords), mask_of(chords), camera, SOCCER, CARRIERS)
    assert (found.oblique_widths < 0.02) == is_coat


def test_a_picture_turned_upside_down_is_told_where_its_camera_sees_little_perspective():
    # a camera that was fitted to a circle seen from afar understates how near the near side is
    distant = view(position=(3.0, 220.0, -70.0), target=(0.0, 2.0, 0.0), focal=6400.0)
    camera = replace(fit_of(CAMERA), camera=distant)
    found = measure_evidence(paint(grows=2.0), mask_of(), camera, SOCCER, CARRIERS)
    assert found.reversal > 3.0


def test_a_floor_has_other_sports_arcs_and_walls_of_its_colour():
    """Where two of its lines carry the camera; a pitch's carry none of that."""
    hall = load_field("futsal")
    lines = {MarkingKey(name): 0.3 for name in ("halfway_line", "side_line_top", "side_line_left")}
    carried, alone = (replace(fit_of(CAMERA), residuals_px=seen) for seen in (lines, {}))
    for evidence, ground in (
        (replace(NO_PAINT, oblique_widths=0.6), NO_GROUND),
        (NO_PAINT, replace(NO_GROUND, above_share=0.4)),
        (NO_PAINT, replace(NO_GROUND, beyond_share=0.4)),
    ):
        assert weigh(evidence, carried, ground, hall).status == "calibrated"
        assert weigh(evidence, alone, ground, hall).status == "refused"
        assert weigh(evidence, carried, ground).status == "refused"


@pytest.mark.parametrize(
    ("share", "status"),
    [((0.9, 0.6), "calibrated"), ((0.9, 0.1, 0.1), "refused"), ((0.9, 0.4), "refused")],
)
def test_markings_that_are_found_on_a_floor_carry_its_camera_too(share, status):
    hall, walls = load_field("futsal"), replace(NO_GROUND, above_share=0.4)
    found = Agreement(tuple("abc"[: len(share)]), np.full(len(share), 80.0), np.array(share))
    alone = replace(fit_of(CAMERA), residuals_px={})
    assert weigh(NO_PAINT, alone, walls, hall, found).status == status
    assert weigh(NO_PAINT, alone, walls, SOCCER, found).status == "refused"


def test_a_low_camera_sees_walls_above_its_horizon_on_grass_too():
    lines = {MarkingKey(name): 0.3 for name in ("halfway_line", "side_line_top", "centre_mark")}
    walls = replace(NO_GROUND, above_share=0.4)
    low, high = (
        replace(fit_of(view(position=(3.0, 42.0, height), target=(0.0, 0.0, 0.0), focal=950.0)), residuals_px=lines)
        for height in (-0.8, -16.0)
    )
    assert weigh(NO_PAINT, low, walls).status == "calibrated"
    assert weigh(NO_PAINT, high, walls).status == "refused"
    assert weigh(NO_PAINT, replace(low, residuals_px={}), walls).status == "refused"


def test_a_halfway_line_may_break_off_where_its_paint_comes_and_goes(plain):
    camera, rng = fit_of(CAMERA), np.random.default_rng(3)
    whole, patchy = plain.copy(), plain.copy()
    for picture, stretches in (
        (whole, [(14.0, 33.5)]),
        (patchy, [(-7.0, -5.0), (-2.0, -0.5), (2.0, 4.0), (5.5, 7.0), (14.0, 33.5)]),
    ):
        for stretch in stretches:
            first, last = CAMERA.project(np.array([(0.0, y) for y in stretch]))
            box = np.s_[int(first[1]) : int(last[1]), int(first[0]) - 60 : int(first[0]) + 60]
            picture[box] = rng.normal(90, 3, picture[box].shape)
    broken, worn = (measure_evidence(p, mask_of(), camera, SOCCER, CARRIERS) for p in (whole, patchy))
    assert broken.bare_widths > 0.1
    assert worn.bare_widths == 0.0


def test_a_line_and_the_mark_carry_a_camera_whose_circle_is_worn():
    worn, camera = replace(NO_PAINT, painted_share=0.5), fit_of(CAMERA)
    seen = ("halfway_line", "side_line_top"), ("halfway_line", "side_line_top", "centre_mark")
    found = [replace(camera, residuals_px={MarkingKey(name): 0.1 for name in names}) for names in seen]
    assert [weigh(worn, answer).status for answer in found] == ["refused", "calibrated"]


def test_further_lines_carry_a_camera_whose_circle_is_worn():
    worn = replace(NO_PAINT, painted_share=0.45)
    camera = fit_of(CAMERA)
    assert weigh(worn, camera).code == "markings_missing"
    keys = [MarkingKey(name) for name in ("side_line_top", "side_line_bottom", "big_rect_left_main")]
    carried = replace(camera, residuals_px=camera.residuals_px | dict.fromkeys(keys, 0.1))
    assert weigh(worn, carried).status == "calibrated"


def test_a_line_may_end_early_where_the_mark_and_lines_confirm_the_camera():
    bare, camera = replace(NO_PAINT, bare_widths=0.13), fit_of(CAMERA)
    assert weigh(bare, camera).code == "markings_missing"
    keys = [MarkingKey(name) for name in ("side_line_top", "big_rect_left_main", "centre_mark")]
    confirmed = replace(camera, residuals_px=camera.residuals_px | dict.fromkeys(keys, 0.1))
    assert weigh(bare, confirmed).status == "calibrated"


@pytest.mark.parametrize(("share", "code"), [(0.9, None), (0.2, "markings_missing")])
def test_a_line_may_end_early_where_lines_confirm_the_camera_and_a_further_marking_is_found(share, code):
    bare = replace(NO_PAINT, bare_widths=0.13)
    keys = [MarkingKey(name) for name in ("halfway_line", "side_line_top", "big_rect_left_main")]
    confirmed = replace(fit_of(CAMERA), residuals_px=dict.fromkeys(keys, 0.1))
    seen = Agreement(("big_rect_left_top",), np.array([120.0]), np.array([share]))
    assert weigh(bare, confirmed, agreement=seen).code == code


def test_a_piece_of_which_a_player_hides_all_but_a_fifth_does_not_outweigh_the_others():
    """Relative to what was measured its error would be thirty times as large as that of any other piece."""
    away = np.linspace(40.0, 75.0, 32)
    width = (500.0 / away) ** 2
    measured, blur = 0.7 * width + 2.0, np.ones((32, 1))
    reversed_width = width * (away / away.mean()) ** 8

    def reversal():
        return _misfit(width, blur, measured) - _misfit(reversed_width, blur, measured)

    assert reversal() < -10.0
    measured[0] = measured[0] / 30.0
    assert reversal() < -10.0


@pytest.mark.parametrize(
    ("field", "zoom", "scale", "code"),
    [
        ("soccer", 1.0, 9.7, None),
        ("soccer", 1.0, 11.8, "residual_too_large"),
        ("soccer", 4.0, 15.1, None),
        ("robocup", 1.0, 14.3, None),
    ],
)
def test_many_times_the_noise_of_the_picture_is_another_marking(field, zoom, scale, code):
    """All that circle and lines leave is taken for noise before a camera is believed; so much of it only wide paint
    has, which is ragged, and paint that is seen large, whose error is some of the field.
    """
    camera = replace(fit_of(replace(CAMERA, focal_px=zoom * CAMERA.focal_px)), noise_scale=scale)
    assert weigh(NO_PAINT, camera, template=load_field(field)).code == code

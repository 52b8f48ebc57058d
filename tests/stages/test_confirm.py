"""Markings that must be in view: painted, left out, hidden, and too uncertain to be looked for; and circles whose
paint is so faint that single profiles do not show it.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import PARAMETERS, ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.line_naming.marking_places import place_markings
from circlecal.paint.matched_filter import CLEAR, SECTORS
from circlecal.paint.profiles import to_gray
from circlecal.results import Agreement, Attempt, Check, Cues, Evidence, MarkCue
from circlecal.stages.confirm import (
    LEAST_EDGED,
    are_others_painted,
    count_edged_sectors,
    is_circle_painted,
    look_for_markings,
    measure_circle_sectors,
)
from circlecal.stages.verdict_on_picture import LEAST_FOUND, confirm, is_confirmed, needs_confirmation
from tests.folded import projected_without_fold

from .conftest import CIRCLE, SOCCER, paint_field, view
from .test_verdict import camera_fit, verdict

RINK = load_field("ice-hockey")
CENTRE = RINK.circle_by_name["centre_circle"]
CAMERA = view(position=(3.0, 42.0, -16.0), target=(0.0, 0.0, 0.0), focal=950.0)
KNOWN = frozenset({"centre_line"})
PITCH = load_field("robocup")
LOW = view(position=(-2.2, 0.3, -0.6), target=(1.0, 0.2, 0.0), focal=700.0)
PENALTY_AREAS = tuple(line.name for line in PITCH.lines if "rect" in line.name)


def fit_of(camera, sd=1e-4):
    theta = theta_of(camera, ProjectionModel(camera.width, camera.height, Surface("flat", CENTRE.radius_m)))
    covariance = np.diag(np.where(np.arange(len(PARAMETERS)) < 4, sd**2, 0.0))
    return camera_fit(camera, theta=theta, covariance=covariance, parameters=PARAMETERS)


def painted(template=RINK, without=(), camera=CAMERA):
    picture = np.random.default_rng(0).normal(90, 3, (camera.height, camera.width))
    for name, points in template.polylines().items():
        if name in without:
            continue
        points = points[camera.depth(points) > 1.0]
        pixels = np.round(16 * camera.project(points)).astype(np.int32)
        cv2.polylines(picture, [pixels[:, None]], False, (200.0,), 2, cv2.LINE_8, 4)
    return cv2.GaussianBlur(picture, (0, 0), 0.8).clip(0, 255).astype(np.uint8)


def believed(verdict, camera, cues):
    attempt = Attempt(cues=cues, camera=camera, verdict=verdict)
    return is_confirmed(attempt, RINK, CENTRE, 12.0 * CAMERA.width / 1920.0)


def test_painted_markings_are_found_whatever_their_shape():
    found = look_for_markings(painted(), fit_of(CAMERA), RINK, CENTRE, KNOWN, None)
    assert {"faceoff_left_top", "faceoff_right_bottom", "blue_line_left"} <= set(found.names)
    assert not {"centre_circle", "centre_line"} & set(found.names)
    assert found.share.min() > 0.8
    assert found.found_share > 0.9
    assert found.expected_px > CAMERA.width


def test_markings_that_are_not_there_are_missed():
    circles = tuple(circle.name for circle in RINK.circles)
    found = look_for_markings(painted(without=circles), fit_of(CAMERA), RINK, CENTRE, KNOWN, None)
    for name, share in zip(found.names, found.share, strict=True):
        assert share < LEAST_FOUND if name in circles else share > 0.8
    wrong = replace(CAMERA, angles_rad=CAMERA.angles_rad + np.array([0.06, 0.03, 0.0]))
    assert look_for_markings(painted(), fit_of(wrong), RINK, CENTRE, KNOWN, None).found_share < LEAST_FOUND


def test_only_what_is_known_well_and_lies_on_the_seen_surface_is_expected():
    assert look_for_markings(painted(), fit_of(CAMERA, 0.1), RINK, CENTRE, KNOWN, None).names == ()
    right = np.zeros((36, 64), np.bool_)
    right[:, 32:] = True
    found = look_for_markings(painted(), fit_of(CAMERA), RINK, CENTRE, KNOWN, right)
    assert set(found.names) and not [name for name in found.names if "left" in name]
    assert look_for_markings(painted(), fit_of(CAMERA), RINK, CENTRE, KNOWN, ~right & right) == Agreement(
        (), pytest.approx(np.zeros(0)), pytest.approx(np.zeros(0))
    )


def test_the_verdict_refuses_where_nothing_else_of_the_field_is_found():
    camera, accepted = camera_fit(), verdict(camera_fit())
    bare = Cues(None, None)
    width = camera.camera.width
    missing = Agreement(("a",), np.array([0.3 * width]), np.array([0.02]))
    refused = confirm(accepted, camera, bare, missing)
    assert (refused.status, refused.code, refused.stage) == ("refused", "markings_missing", "verdict")
    assert refused.reason is not None and "should be in view" in refused.reason
    found = confirm(accepted, camera, bare, replace(missing, share=np.array([0.5])))
    assert found.status == "calibrated" and found.checks[-1].name == "found_share"
    assert believed(found, camera, bare)
    assert not believed(accepted, camera, bare)
    assert not believed(accepted, None, bare)


def test_the_more_confirms_a_circle_the_more_must_be_missing():
    camera, accepted = camera_fit(), verdict(camera_fit())
    marked = Cues(None, MarkCue("centre_mark", np.zeros(2), 0.5, 30.0))
    missing = Agreement(("a",), np.array([0.3 * camera.camera.width]), np.array([0.0]), certain=False)
    assert confirm(accepted, camera, marked, missing) is accepted
    named = camera_fit(named_lines=("blue_line_left", "blue_line_right"))
    assert believed(accepted, named, Cues(None, None))
    # lines may be named of a field of another size, the mark of none
    assert confirm(accepted, named, Cues(None, None), missing).code == "markings_missing"
    assert confirm(accepted, named, marked, missing) is accepted
    # of places that are known well all must be bare
    assert confirm(accepted, named, marked, replace(missing, certain=True)).code == "markings_missing"
    found = replace(missing, share=np.array([0.02]), certain=True)
    assert confirm(accepted, named, marked, found).status == "calibrated"
    assert confirm(accepted, camera, marked, found).status == "calibrated"
    much = replace(found, length_px=2.0 * found.length_px)
    assert confirm(accepted, camera, marked, much).code == "markings_missing"
    assert confirm(accepted, camera, Cues(None, None), Agreement((), np.zeros(0), np.zeros(0))) is accepted


def test_paint_that_no_marking_explains_asks_for_markings_whatever_confirms_the_circle():
    camera = camera_fit(named_lines=("side_line_top",))
    accepted = verdict(camera)
    marked = Cues(None, MarkCue("centre_mark", np.zeros(2), 0.5, 30.0))
    few = Agreement(("a",), np.array([0.5 * camera.camera.width]), np.array([0.09]))
    lines = Evidence(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, parallel_widths=0.11)
    assert confirm(accepted, camera, marked, few, lines).code == "markings_missing"
    assert confirm(accepted, camera, marked, few, replace(lines, parallel_widths=0.05)).status == "calibrated"
    # places that are not well known may lie beside their markings
    open_few = replace(few, certain=False)
    assert confirm(accepted, camera, marked, open_few, lines).status == "calibrated"
    # lines of another sport beside markings that are found say nothing
    found = replace(few, share=np.array([0.7]))
    assert confirm(accepted, camera, marked, found, replace(lines, parallel_widths=3.0)).status == "calibrated"


def test_where_the_places_are_not_well_known_markings_are_looked_for_around_them():
    loose = look_for_markings(painted(), fit_of(CAMERA, 0.007), RINK, CENTRE, KNOWN, None)
    assert not loose.certain and loose.found_share > 0.7


def test_a_circle_with_hardly_any_of_its_other_markings_is_another_one():
    camera, accepted = camera_fit(), verdict(camera_fit())
    for share in (0.0, 0.05, 0.14, 0.24):
        missing = Agreement(("a",), np.array([0.3 * camera.camera.width]), np.array([share]))
        refused = confirm(accepted, camera, Cues(None, None), missing)
        assert (refused.status, refused.code) == ("refused", "markings_missing")
    few = Agreement(("a",), np.array([0.3 * camera.camera.width]), np.array([0.27]))
    doubted = confirm(accepted, camera, Cues(None, None), few)
    assert doubted.status == "calibrated" and needs_confirmation(doubted) and not needs_confirmation(accepted)


def test_where_places_are_guesses_a_confirmed_circle_needs_little_and_another_one_much():
    camera, accepted = camera_fit(), verdict(camera_fit())
    marked = Cues(None, MarkCue("centre_mark", np.zeros(2), 0.5, 30.0))
    thin = Agreement(("a",), np.array([0.6 * camera.camera.width]), np.array([0.04]), certain=False)
    assert confirm(accepted, camera, marked, thin).status == "calibrated"
    assert confirm(accepted, camera, Cues(None, None), thin).code == "markings_missing"
    nothing = replace(thin, share=np.zeros(1))
    assert confirm(accepted, camera, marked, nothing).code == "markings_missing"
    known = replace(thin, certain=True)
    assert confirm(accepted, camera, marked, known).code == "markings_missing"
    assert confirm(accepted, camera_fit(named_lines=("side_line_top",)), marked, known).status == "calibrated"


def test_a_marking_behind_a_barrel_lens_is_not_expected_where_the_lens_model_folds_it_to():
    template = load_field("robocup")
    circle = template.circle_by_name["centre_circle"]
    camera = replace(view((-3.3, 0.9, -1.5), (0.0, 0.0, 0.0), 435.0, (800, 448)), kappa=np.array([-0.08, 0.0]))
    theta = theta_of(camera, ProjectionModel(800, 448, Surface("flat", circle.radius_m)))
    fit = camera_fit(camera, theta=theta, covariance=np.eye(len(PARAMETERS)) * 1e-10, parameters=PARAMETERS)
    ends = template.line_ends(template.line_by_name["big_rect_left_top"])
    beside = projected_without_fold(camera, np.linspace(*ends, 200))
    assert ((beside > 0) & (beside < (800, 448))).all(axis=1).any()  # with the lens, but not in the picture
    found = look_for_markings(np.full((448, 800), 90, np.uint8), fit, template, circle, frozenset(), None)
    assert "big_rect_right_top" in found.names
    assert not [name for name in found.names if "left" in name]


MAIN_CAMERA = view()


def picture_of_circle(contrast=0.0, noise=6.0, first=0.0, last=360.0, camera=MAIN_CAMERA):
    angle = np.radians(np.linspace(first, last, 400))
    points = camera.project(SOCCER.radius(CIRCLE, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    drawn = np.full((camera.height, camera.width), 90.0)
    cv2.polylines(
        drawn, [np.round(16 * points).astype(np.int32)[:, None]], False, (90.0 + contrast,), 3, cv2.LINE_AA, 4
    )
    drawn += np.random.default_rng(1).normal(0, noise, drawn.shape)
    return drawn.clip(0, 255).astype(np.uint8)


def test_faint_paint_shows_in_every_sector():
    sectors = measure_circle_sectors(picture_of_circle(contrast=10.0), fit_of(MAIN_CAMERA), SOCCER, CIRCLE)
    assert len(sectors) == SECTORS
    assert (sectors > CLEAR).mean() > 0.8
    assert is_circle_painted(picture_of_circle(contrast=10.0), fit_of(MAIN_CAMERA), SOCCER, CIRCLE)


def test_bare_grass_an_arc_and_a_wrong_camera_are_not_is_circle_painted():
    assert (measure_circle_sectors(picture_of_circle(), fit_of(MAIN_CAMERA), SOCCER, CIRCLE) > CLEAR).mean() < 0.2
    assert not is_circle_painted(picture_of_circle(), fit_of(MAIN_CAMERA), SOCCER, CIRCLE)
    assert not is_circle_painted(picture_of_circle(30.0, 2.0, 40.0, 160.0), fit_of(MAIN_CAMERA), SOCCER, CIRCLE)
    other = view(position=(4.0, 50.0, -16.0))
    assert not is_circle_painted(picture_of_circle(30.0, 2.0), fit_of(other), SOCCER, CIRCLE)


def test_a_circle_that_is_mostly_out_of_view_says_nothing():
    near = view(target=(9.0, 0.0, 0.0), focal=6000.0)
    assert (
        len(measure_circle_sectors(picture_of_circle(30.0, 2.0, camera=near), fit_of(near), SOCCER, CIRCLE))
        < SECTORS // 2
    )
    assert not is_circle_painted(picture_of_circle(30.0, 2.0, camera=near), fit_of(near), SOCCER, CIRCLE)
    away = view(target=(0.0, 400.0, 0.0))
    assert len(measure_circle_sectors(picture_of_circle(camera=near), fit_of(away), SOCCER, CIRCLE)) == 0
    assert not is_circle_painted(picture_of_circle(camera=near), fit_of(away), SOCCER, CIRCLE)


@pytest.mark.parametrize(("without", "is_confirmed_so"), [((), True), (PENALTY_AREAS, False)])
def test_thin_markings_where_the_camera_puts_them_confirm_a_circle(without, is_confirmed_so):
    """A robot's camera shows the far penalty area a third as wide as the circle before it."""
    wanted = PITCH, PITCH.circle_by_name["centre_circle"], frozenset({"halfway_line"}), None
    fit = fit_of(LOW)
    assert look_for_markings(painted(PITCH, without, LOW), fit, *wanted).expected_px < 0.1 * LOW.width
    assert are_others_painted(painted(PITCH, without, LOW), fit, *wanted) is is_confirmed_so
    several = PITCH.model_copy(update={"circles": (*PITCH.circles, *RINK.circles)})
    assert not are_others_painted(painted(PITCH, without, LOW), fit, several, *wanted[1:])


def test_both_edges_of_wide_paint_show_a_circle_that_is_cut_by_the_picture():
    """Of a robots' circle from near the picture holds too little ground for faint paint to stand out."""
    field = load_field("robocup")
    circle = field.circle_by_name["centre_circle"]
    camera = view(position=(0.1, 1.3, -0.9), target=(0.2, 0.1, 0.0), focal=1100.0)
    picture = to_gray(paint_field(camera, field))
    assert count_edged_sectors(picture, fit_of(camera), field, circle) >= LEAST_EDGED
    assert is_circle_painted(picture, fit_of(camera), field, circle)
    for other in (np.roll(picture, 30, axis=0), picture[:, ::-1].copy(), np.full_like(picture, 90)):
        assert count_edged_sectors(other, fit_of(camera), field, circle) < LEAST_EDGED


def test_where_circle_and_line_are_worn_as_much_of_the_others_may_be():
    camera, accepted = camera_fit(), verdict(camera_fit())
    missing = Agreement(("a",), np.array([0.3 * camera.camera.width]), np.array([0.13]))
    for painted_share, status in ((0.64, "calibrated"), (0.95, "refused")):
        worn = Check.of("painted_share_of_carriers", painted_share, 0.55)
        told = replace(accepted, checks=(*accepted.checks, worn))
        assert confirm(told, camera, Cues(None, None), missing).status == status


@pytest.mark.parametrize(("length_sd_m", "is_expected"), [(0.5, True), (8.66, False)])
def test_the_side_of_a_penalty_area_is_not_expected_where_an_open_length_may_end_it(length_sd_m, is_expected):
    """Its place across is known as well as the camera is, how far it reaches is not."""
    camera = view(position=(-20.0, 62.0, -20.0), target=(-38.0, -12.0, 0.0), focal=1500.0)
    fit = fit_of(camera)
    covariance = fit.covariance.copy()
    covariance[PARAMETERS.index("length"), PARAMETERS.index("length")] = length_sd_m**2
    lines = [k for k, name in enumerate(SOCCER.outlines[0]) if name in ("big_rect_left_top", "side_line_top")]
    places = place_markings(replace(fit, covariance=covariance), SOCCER, lines)
    side = places.element == [places.names[k] for k in range(2)].index("big_rect_left_top")
    assert side.any()
    assert places.is_sure[side].any() == is_expected
    # the middle of a touchline is there whatever the length
    assert places.is_sure[~side].any()


@pytest.mark.parametrize("breadth_m", [-10.0, 0.0, 12.0])
def test_the_halfway_line_reaches_from_touchline_to_touchline_of_a_field_of_another_width(breadth_m):
    fit = fit_of(view(position=(-8.0, 95.0, -30.0), target=(0.0, 0.0, 0.0), focal=700.0))
    theta = fit.theta.copy()
    theta[PARAMETERS.index("breadth")] = breadth_m
    fit = replace(fit, theta=theta)
    wanted = [k for k, name in enumerate(SOCCER.outlines[0]) if name == "halfway_line"]
    places = place_markings(fit, SOCCER, wanted)
    reach_m = np.abs(fit.view.to_field(places.base)[:, 1]).max()
    assert reach_m == pytest.approx(0.5 * (SOCCER.width_m + breadth_m), abs=0.5)
    assert places.is_sure.all()


def test_how_far_the_halfway_line_reaches_is_not_known_on_a_field_of_any_width():
    fit = fit_of(view(position=(-8.0, 95.0, -30.0), target=(0.0, 0.0, 0.0), focal=700.0))
    covariance = fit.covariance.copy()
    covariance[PARAMETERS.index("breadth"), PARAMETERS.index("breadth")] = 5.0**2
    wanted = [k for k, name in enumerate(SOCCER.outlines[0]) if name == "halfway_line"]
    places = place_markings(replace(fit, covariance=covariance), SOCCER, wanted)
    y_m = np.abs(fit.view.to_field(places.base[places.is_sure])[:, 1])
    assert y_m.max() == pytest.approx(0.5 * SOCCER.width_m - 5.0, abs=0.5)

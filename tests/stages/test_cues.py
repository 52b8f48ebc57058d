"""Halfway line, centre mark and further lines."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.projective import line_distance
from circlecal.observations import Keypoint, LinePoints, MarkPoint, Observations
from circlecal.paint.centre_mark import _bare_sides
from circlecal.paint.lines import measure_lines
from circlecal.paint.other_paints import are_painted_otherwise, leave_out_other_paints, leave_out_yellow_lines
from circlecal.paint.profiles import to_gray
from circlecal.paint.rectified_line import RectifiedLine
from circlecal.results import Cues, EllipseFits, LineCue, Segment
from circlecal.stages.cues import CuesConfig, _line_cue, _split_pieces, cues_from_observations, find_cues

from .conftest import CIRCLE, SOCCER, fit_of, line_cue, paint, view

CONFIG = CuesConfig()
SEARCHED = CONFIG.search_px, CONFIG.spacing_px
CAMERA = view(position=(5.0, 48.0, -18.0), focal=2300.0, size=(1280, 720), roll=0.02)
TRUE_LINE = line_cue(CAMERA).line


def rough_line(camera=CAMERA, offset_px=(3.0, -2.0)):
    """The halfway line across the circle, with each end moved sideways."""
    far, near = camera.project(np.array([[0.0, -10.0], [0.0, 10.0]]))
    return Segment(far + np.array([offset_px[0], 0.0]), near + np.array([offset_px[1], 0.0]))


def cues_in(painted, config=CONFIG, halfway="rough", image=None, lines=()):
    halfway = rough_line(painted.camera) if halfway == "rough" else halfway
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    marking = painted.marking(halfway=halfway, lines=lines)
    return find_cues(to_gray(painted.image if image is None else image), marking, fits, 1.5, SOCCER, config)


@pytest.fixture(scope="module")
def painted():
    return paint(CAMERA, noise=1.5)


@pytest.fixture(scope="module")
def cues(painted):
    return cues_in(painted)


def test_halfway_line_is_sub_pixel(cues):
    ends = CAMERA.project(np.array([[0.0, -9.15], [0.0, 9.15]]))
    assert np.abs(line_distance(cues.halfway.line, ends)).max() < 0.08
    assert cues.halfway.name == "halfway_line"
    assert np.hypot(*cues.halfway.line[:2]) == pytest.approx(1.0)
    distance = line_distance(TRUE_LINE, cues.halfway.points_px)
    assert len(distance) > 80
    assert abs(distance.mean()) < 0.05
    assert distance.std() < 3 * cues.halfway.sigma_px.mean()
    assert cues.halfway.rms_px < 0.3
    assert cues.halfway.segment.support > 0.8


@pytest.mark.parametrize("seed", range(3))
def test_centre_mark_is_found_where_it_is_painted(seed):
    cue = cues_in(paint(CAMERA, noise=1.5, seed=seed)).mark
    assert cue is not None
    assert np.linalg.norm(cue.point_px - CAMERA.project(np.zeros(2))) < 1.0
    assert cue.snr > CONFIG.mark_snr
    assert 0.2 < cue.sigma_px < 3.0


@pytest.mark.parametrize("seed", range(5))
def test_no_centre_mark_is_found_where_none_is(seed):
    cues = cues_in(paint(CAMERA, mark=False, noise=1.5, seed=seed))
    assert cues.halfway is not None
    assert cues.mark is None


def test_a_player_over_the_mark_hides_it(painted):
    image = painted.image.copy()
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    image[y - 50 : y + 20, x - 12 : x + 12] = (60, 40, 150)
    found = cues_in(painted, image=image)
    assert found.mark is None or np.linalg.norm(found.mark.point_px - (x, y)) < 3.0


@pytest.mark.parametrize("side", [-1, 1])
def test_a_player_beside_the_mark_does_not_hide_it(painted, side):
    image = painted.image.copy()
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    left = x + 15 if side > 0 else x - 35
    image[y - 50 : y + 12, left : left + 20] = 215
    mark = cues_in(painted, image=image).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - CAMERA.project(np.zeros(2))) < 1.0


@pytest.mark.parametrize("level", [0, 215])
@pytest.mark.parametrize("near_px", [8, 9])
@pytest.mark.parametrize("side", [-1, 1])
def test_a_player_may_touch_the_mark(painted, side, near_px, level):
    image = painted.image.copy()
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    left, right = sorted((x + side * near_px, x + side * 30))
    image[y - 40 : y + 20, left:right] = level
    mark = cues_in(painted, image=image).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - CAMERA.project(np.zeros(2))) < 1.0


def test_the_mark_is_seen_on_a_line_that_is_worn_around_it(painted):
    """Most of the line's paint is gone around the mark, whose own stands out beside it."""
    image, bare = painted.image.astype(float), paint(CAMERA, noise=1.5, line=False).image
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    places = np.stack(np.meshgrid(np.arange(x - 30, x + 30), np.arange(y - 14, y + 14)), axis=-1)
    is_worn = np.abs(line_distance(TRUE_LINE, places)) < 4.0
    part = slice(y - 14, y + 14), slice(x - 30, x + 30)
    image[part][is_worn] = 0.25 * image[part][is_worn] + 0.75 * bare[part][is_worn]
    mark = cues_in(painted, image=image.round().astype(np.uint8)).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - (x, y)) < 1.0


def test_a_player_on_the_line_elsewhere_is_no_noise_beside_the_mark(painted):
    image = painted.image.copy()
    x, y = np.round(CAMERA.project(np.array([0.0, -2.2]))).astype(int)
    image[y - 34 : y - 6, x - 12 : x + 12] = (60, 40, 150)
    image[y - 6 : y + 8, x - 10 : x + 10] = 225
    mark = cues_in(painted, image=image).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - CAMERA.project(np.zeros(2))) < 1.0


def test_points_of_the_line_beyond_its_segment_lie_on_the_surface(painted):
    """Of a short arc the chord is a guess, along which the line would be followed into the stands."""
    far, near = CAMERA.project(np.array([[0.0, -6.0], [0.0, 6.0]]))
    surface = np.ones((90, 160), np.bool_)
    surface[: int(far[1] / 8.0)] = False
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    marking = painted.marking(halfway=Segment(far, near))
    picture, free = to_gray(painted.image), CuesConfig(centre_mark=False)
    whole = find_cues(picture, marking, fits, 1.5, SOCCER, free).halfway
    on_surface = find_cues(picture, replace(marking, field_region=surface), fits, 1.5, SOCCER, free).halfway
    margin_px = 8.0 * (0.02 * 160 + 1)
    assert whole.points_px[:, 1].min() < far[1] - margin_px
    assert on_surface.points_px[:, 1].min() > far[1] - margin_px


def test_the_mark_may_lie_near_the_border_of_the_picture():
    camera = view(position=(5.0, 48.0, -18.0), target=(-7.1, 0.0, 0.0), focal=4500.0, size=(1280, 720))
    place = camera.project(np.zeros(2))
    assert 14 < 1279 - place[0] < 40
    mark = cues_in(paint(camera, noise=1.5)).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - place) < 1.0


def test_the_mark_of_a_circle_of_few_pixels_is_found():
    """Across a half chord of 33 px there are few places by which the usual scatter is known."""
    camera = view(position=(5.0, 90.0, -6.0), focal=3700.0, size=(1280, 720))
    far, near = camera.project(np.array([[0.0, -9.15], [0.0, 9.15]]))
    assert np.linalg.norm(far - near) < 2 * 34
    mark = cues_in(paint(camera, noise=1.5)).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - camera.project(np.zeros(2))) < 1.0


@pytest.mark.parametrize("side", [-1, 1])
def test_a_spot_on_one_side_of_the_line_is_no_mark(side):
    """A boot or a ball beside the line: a mark lies on both sides of it."""
    bare = paint(CAMERA, mark=False, noise=1.5)
    image = bare.image.copy()
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    left = x + 3 if side > 0 else x - 8
    image[y - 3 : y + 4, left : left + 6] = 215
    assert cues_in(bare, image=image).mark is None


SLANTED = view(position=(22.0, 45.0, -12.0), focal=3500.0, size=(1280, 720))


@pytest.mark.parametrize("camera", [SLANTED, view(position=(-16.0, 60.0, -10.0), focal=4500.0, size=(1280, 720))])
def test_centre_mark_on_a_slanted_line_is_not_shifted(camera):
    """Seen from the side, the mark's two halves do not lie across the line but along the field's other axis."""
    painted = paint(camera, noise=1.5)
    cue = cues_in(painted).mark
    assert cue is not None
    assert np.linalg.norm(cue.point_px - camera.project(np.zeros(2))) < 0.4


def test_shorts_in_front_of_the_line_are_no_mark():
    """As bright as the paint and as wide as the mark, on both sides of the line, but taller."""
    bare = paint(CAMERA, mark=False, noise=1.5)
    image = bare.image.copy()
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    image[y - 16 : y + 16, x - 5 : x + 6] = (40, 40, 40)
    image[y - 4 : y + 5, x - 6 : x + 7] = 215
    assert cues_in(bare, image=image).mark is None


def test_nothing_is_invented_without_a_line():
    circle_only = paint(CAMERA, line=False, mark=False, noise=1.5)
    found = cues_in(circle_only)
    assert found.halfway is None
    assert found.mark is None
    assert cues_in(circle_only, halfway=None).halfway is None


def test_a_short_piece_of_a_line_is_not_the_halfway_line(painted):
    """A quarter of the chord may be a player's shadow or an advertisement."""
    image = paint(CAMERA, line=False, mark=False, noise=1.5).image
    far, near = CAMERA.project(np.array([[0.0, -9.0], [0.0, 9.0]]))
    top, bottom = round(far[1] + 0.4 * (near[1] - far[1])), round(far[1] + 0.62 * (near[1] - far[1]))
    image[top:bottom] = painted.image[top:bottom]
    assert cues_in(painted, image=image).halfway is None
    assert cues_in(painted, CuesConfig(minimum_support=0.1), image=image).halfway is not None


def test_a_line_that_misses_the_circle_is_not_the_halfway_line(painted):
    beside = Segment(np.array([20.0, 20.0]), np.array([60.0, 700.0]))
    assert cues_in(painted, halfway=beside).halfway is None


def test_what_is_switched_off_is_not_looked_for(painted):
    assert cues_in(painted, CuesConfig(halfway_line=False)).halfway is None
    without = cues_in(painted, CuesConfig(centre_mark=False))
    assert without.mark is None
    assert without.halfway is not None
    line = rough_line()
    assert len(cues_in(painted, halfway=None, lines=(line,)).lines) == 1
    assert cues_in(painted, CuesConfig(further_lines=False), halfway=None, lines=(line,)).lines == ()


def test_further_lines_have_no_name_and_false_ones_are_dropped(painted):
    bare = Segment(np.array([100.0, 30.0]), np.array([500.0, 60.0]))
    tiny = Segment(np.array([100.0, 30.0]), np.array([104.0, 31.0]))
    found = cues_in(painted, halfway=None, lines=(rough_line(), bare, tiny)).lines
    assert [line.name for line in found] == [None]
    assert np.abs(line_distance(found[0].line, CAMERA.project(np.array([[0.0, -8.0], [0.0, 8.0]])))).max() < 0.1


def test_given_observations_become_the_same_cues():
    points = CAMERA.project(np.stack([np.zeros(20), np.linspace(-9, 9, 20)], axis=-1))
    top = np.stack([np.linspace(10, 900, 5), np.full(5, 12.0)], axis=-1)
    seen = Observations(
        1280,
        720,
        lines=(
            LinePoints("side_line_top", top, np.ones(5)),
            LinePoints("halfway_line", points, np.full(20, 0.5)),
            LinePoints(None, top[:1], np.ones(1)),
        ),
        marks=(MarkPoint("penalty_mark_left", np.ones(2), 1.0), MarkPoint("centre_mark", np.array([3.0, 4.0]), 2.0)),
    )
    cues = cues_from_observations(seen, SOCCER, CIRCLE)
    assert np.abs(line_distance(cues.halfway.line, points)).max() < 1e-9
    assert [line.name for line in cues.lines] == ["side_line_top"]
    assert cues.mark.name == "centre_mark"
    np.testing.assert_allclose(cues.mark.point_px, [3.0, 4.0])
    np.testing.assert_allclose(sorted([cues.halfway.segment.start[1], cues.halfway.segment.end[1]]),
                               sorted([points[0, 1], points[-1, 1]]))  # fmt: skip


def test_a_keypoint_at_the_centre_is_the_mark_of_that_circle_only():
    rink = load_field("ice-hockey")
    circle = rink.circle_by_name["faceoff_left_top"]
    key = Keypoint("faceoff", np.asarray(circle.center), np.array([7.0, 8.0]), 1.0)
    mark = MarkPoint("centre_mark", np.ones(2), 1.0)
    cues = cues_from_observations(Observations(1280, 720, marks=(mark,), keypoints=(key,)), rink, circle)
    np.testing.assert_allclose(cues.mark.point_px, [7.0, 8.0])
    assert cues_from_observations(Observations(1280, 720, marks=(mark,)), rink, circle).mark is None


@pytest.mark.parametrize("away_px", [(3.0, -2.0), (-2.0, 3.0)])
def test_a_wide_marking_has_no_bias(away_px):
    """The paint is as wide as a plain profile: that would take paint for the surface beside it."""
    camera = view(position=(9.0, 46.0, -18.0), target=(0.0, 1.0, 0.0), focal=6000.0, size=(1280, 720))
    painted = paint(camera, mark=False, noise=1.0)
    halfway = cues_in(painted, halfway=rough_line(camera, away_px)).halfway
    truth = camera.project(np.stack([np.zeros(400), np.linspace(-12, 12, 400)], axis=-1))
    normal = line_cue(camera).line[:2]
    off = np.abs((halfway.points_px - truth.mean(axis=0)) @ normal)
    assert np.median(off) < 0.1
    assert np.quantile(off, 0.95) < 0.3
    (unnamed,) = measure_lines(to_gray(painted.image), [rough_line(camera, away_px)], 1.0, *SEARCHED)
    assert np.median(np.abs((unnamed.points_px - truth.mean(axis=0)) @ normal)) < 0.1


def test_the_halfway_line_ends_at_the_touchline_though_something_goes_on_behind_it():
    camera = view(position=(5.0, 48.0, -18.0), focal=1700.0, size=(1280, 720))
    painted = paint(camera, noise=1.0)
    end, before, side, other = camera.project(np.array([[0.0, -34.0], [0.0, -32.0], [-30.0, -34.0], [30.0, -34.0]]))
    ahead = (end - before) / np.linalg.norm(end - before)
    image = painted.image.copy()
    faint = np.zeros_like(image)
    for picture, first, last, level in ((image, side, other, 225), (faint, end, end + 60.0 * ahead + (1.5, 0.0), 12)):
        places = (tuple(np.rint(p).astype(int).tolist()) for p in (first, last))
        cv2.line(picture, *places, (level, level, level), 2)
    image = cv2.add(image, faint)
    halfway = cues_in(painted, image=image).halfway
    beyond = (halfway.points_px - end) @ ahead
    assert -8.0 < beyond.max() < 4.0
    assert any(end.crossed for end in halfway.ends)


@pytest.mark.parametrize("turned", [False, True])
def test_a_line_that_goes_on_where_the_halfway_line_is_hidden_is_its_piece(turned):
    camera = view(position=(5.0, 48.0, -18.0), focal=1700.0, size=(1280, 720))
    painted = paint(camera, noise=1.0)
    hidden, first, last, aside = camera.project(np.array([[0.0, 10.5], [0.0, 16.0], [0.0, 19.0], [4.0, 19.0]]))
    image = painted.image.copy()
    image[int(hidden[1]) : int(first[1])] = image[int(first[1]) - 1, 20]
    piece = Segment(first, aside if turned else last)
    if turned:
        places = (tuple(np.rint(p).astype(int).tolist()) for p in (first, aside))
        cv2.line(image, *places, (225, 225, 225), 3)
    cues = cues_in(painted, image=image, lines=(piece,))
    goes_on = cues.halfway.points_px[:, 1].max() > last[1] - 5.0
    assert (goes_on, len(cues.lines)) == ((False, 1) if turned else (True, 0))


@pytest.mark.parametrize(("slope", "goes_on"), [(40.0, True), (0.02, False)])
def test_a_piece_of_the_halfway_line_runs_in_its_direction(slope, goes_on):
    """The line of a goal area far away, drawn out, meets what is seen of the halfway line inside the circle."""
    halfway = Segment(np.array([1240.0, 660.0]), np.array([1241.0, 700.0]))
    start = np.array([1239.0, 620.0]) if goes_on else np.array([20.0, 655.0])
    other = Segment(start, start - np.array([1.0, slope]) * (1.0 if goes_on else 100.0))
    lines = [
        _line_cue(LinePoints(None, np.linspace(line.start, line.end, 20), np.full(20, 0.3)))
        for line in (halfway, other)
    ]
    pieces, others = _split_pieces(lines[0], [lines[1]], 2 / 3)
    assert (len(pieces), len(others)) == ((1, 0) if goes_on else (0, 1))


def test_the_halfway_line_is_not_followed_off_the_playing_surface():
    camera = view(position=(5.0, 48.0, -18.0), focal=1700.0, size=(1280, 720))
    painted = paint(camera, noise=1.0)
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    edge = camera.project(np.array([0.0, -20.0]))[1]
    surface = np.arange(135)[:, None] * np.ones(240) > edge * 135 / 720

    def highest(region):
        marking = replace(painted.marking(halfway=rough_line(camera)), field_region=region)
        return find_cues(to_gray(painted.image), marking, fits, 1.5, SOCCER, CONFIG).halfway.points_px[:, 1].min()

    assert highest(None) < edge - 40
    assert edge - 0.03 * 1280 < highest(surface) < edge


def test_halfway_line_outside_the_circle_only():
    """The circle's middle lies right of the picture; of the halfway line its near part is seen."""
    camera = view(position=(5.0, 48.0, -18.0), target=(-15.0, 9.0, 0.0), focal=2000.0, size=(1280, 720))
    painted = paint(camera, mark=False, noise=1.5)
    ends = camera.project(np.array([[0.0, 14.0], [0.0, 18.0]]))
    found = cues_in(painted, halfway=Segment(*ends)).halfway
    assert found is not None
    truth = camera.project(np.stack([np.zeros(50), np.linspace(12, 18, 50)], axis=-1))
    assert np.abs(line_distance(found.line, truth)).max() < 0.3


def test_the_halo_of_a_dark_line_is_no_light_line(painted):
    """Sharpening brightens the grass beside a dark line; a light line with a dark one at its side is a line."""
    image = painted.image.copy()
    for x, added in ((200, -60.0), (201, -60.0), (198, 12.0), (203, 12.0), (260, 70.0), (261, 70.0), (258, -60.0)):
        image[100:301, x] = np.clip(image[100:301, x] + added, 0, 255).astype(np.uint8)
    lines = []
    for x in (198, 260.5):
        points = np.stack([np.full(100, float(x)), np.linspace(101.0, 299.0, 100)], axis=-1)
        ends = Segment(points[0], points[-1])
        lines.append(LineCue(None, np.array([1.0, 0.0, -x]), points, np.full(100, 0.1), ends, 0.1, width_px=1.0))
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    kept = leave_out_other_paints(image, Cues(None, None, tuple(lines)), fits, 5.0)
    assert [float(line.points_px[0, 0]) for line in kept.lines] == [260.5]


def test_a_line_in_another_paint_is_left_out(painted):
    """Of two lines beside the circle one is white as the circle is, the other red; both were measured alike."""
    image = painted.image.copy()
    lines = []
    for x, colour in ((200, (210, 210, 210)), (260, (90, 90, 210))):
        cv2.line(image, (x, 100), (x, 300), colour, 3)
        points = np.stack([np.full(100, float(x)), np.linspace(101.0, 299.0, 100)], axis=-1)
        ends = Segment(points[0], points[-1])
        lines.append(LineCue(None, np.array([1.0, 0.0, -x]), points, np.full(100, 0.1), ends, 0.1, width_px=3.0))
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    kept = leave_out_other_paints(image, Cues(None, None, tuple(lines)), fits, 5.0)
    assert kept.lines == (lines[0],)
    assert leave_out_other_paints(image, Cues(None, None, tuple(lines)), EllipseFits(None, None, None), 5.0).lines


GRASS, WOOD = (0, 40, 5), (0, 20, 60)
"""What the ground is lighter than grey by, in blue, green and red."""


@pytest.mark.parametrize(
    ("ground", "added", "is_kept"),
    [
        (GRASS, (100, 100, 100), True),
        (GRASS, (34, 64, 71), False),  # yellow
        (GRASS, (38, 75, 64), True),  # smeared with grass
        (GRASS, (4, 8, 8), True),  # too faint
        (WOOD, (34, 64, 71), True),  # smeared with wood
    ],
)
def test_yellow_that_compression_has_made_nearly_white_is_left_out(painted, ground, added, is_kept):
    """Its colour is as near to the circle's as that of white lines may be."""
    image = np.clip(painted.image + np.array(ground), 0, 255).astype(np.uint8)
    cv2.line(image, (200, 100), (200, 300), [90 + below + more for below, more in zip(ground, added, strict=True)], 3)
    points = np.stack([np.full(100, 200.0), np.linspace(101.0, 299.0, 100)], axis=-1)
    ends = Segment(points[0], points[-1])
    line = LineCue(None, np.array([1.0, 0.0, -200.0]), points, np.full(100, 0.1), ends, 0.1, width_px=3.0)
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    assert bool(leave_out_other_paints(image, Cues(None, None, (line,)), fits, 5.0).lines) is is_kept


@pytest.mark.parametrize(
    ("added", "is_apart", "is_otherwise"),
    [
        ((34, 64, 71), True, True),
        ((16, 19, 20), False, False),  # white in haze
        ((15, 36, 30), False, True),  # less red than green
        ((150, 90, 90), False, False),  # white in a stripe
    ],
)
def test_yellow_lines_on_grass_are_set_apart_and_white_ones_beside_a_bluish_circle_are_not(
    painted, added, is_apart, is_otherwise
):
    """Mown stripes changed what the circle's paint adds to grass."""
    image = painted.image + np.array(GRASS) + (painted.image > 150) * np.array((50, -20, 0))
    image = np.clip(image, 0, 255).astype(np.uint8)
    cv2.line(image, (200, 100), (200, 300), [90 + below + more for below, more in zip(GRASS, added, strict=True)], 3)
    points = np.stack([np.full(100, 200.0), np.linspace(101.0, 299.0, 100)], axis=-1)
    ends = Segment(points[0], points[-1])
    line = LineCue(None, np.array([1.0, 0.0, -200.0]), points, np.full(100, 0.1), ends, 0.1, width_px=3.0)
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    told = leave_out_yellow_lines(image, Cues(None, None, (line,)), fits, 5.0)
    assert (told.lines, told.others) == (((), (line,)) if is_apart else ((line,), ()))
    assert are_painted_otherwise(image, (ends,), told, fits, 5.0).tolist() == [is_otherwise]


@pytest.mark.parametrize(
    ("beyond", "added", "is_kept"), [((14, -36, -36), (10, -3, 6), True), ((0, 0, 0), (3, 15, 24), False)]
)
def test_a_yellowish_edge_of_the_grass_is_no_yellow_line(painted, beyond, added, is_kept):
    """Beyond the far touchline a dark strip may begin, and the last of the grass adds to the mean of both."""
    image = painted.image + np.array(GRASS)
    image[:, :200] += np.array(beyond)
    image = np.clip(image, 0, 255).astype(np.uint8)
    cv2.line(image, (200, 100), (200, 300), (90 + np.array(GRASS) + added).tolist(), 3)
    points = np.stack([np.full(100, 200.0), np.linspace(101.0, 299.0, 100)], axis=-1)
    ends = Segment(points[0], points[-1])
    line = LineCue(None, np.array([1.0, 0.0, -200.0]), points, np.full(100, 0.1), ends, 0.1, width_px=3.0)
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    assert bool(leave_out_yellow_lines(image, Cues(None, None, (line,)), fits, 5.0).lines) is is_kept


def test_a_rough_line_that_was_measured_in_another_paint_is_told(painted):
    image = painted.image.copy()
    lines, segments = [], []
    for x, colour in ((200, (210, 210, 210)), (260, (90, 190, 210))):
        cv2.line(image, (x, 100), (x, 300), colour, 3)
        points = np.stack([np.full(100, float(x)), np.linspace(101.0, 299.0, 100)], axis=-1)
        ends = Segment(points[0], points[-1])
        lines.append(LineCue(None, np.array([1.0, 0.0, -x]), points, np.full(100, 0.1), ends, 0.1, width_px=3.0))
        segments.append(Segment(points[0] + np.array([1.0, 0.0]), points[-1] - np.array([1.0, 0.0])))
    crossing = Segment(np.array([230.0, 200.0]), np.array([290.0, 200.0]))
    fits = EllipseFits(None, None, fit_of(painted.conic(), "center"))
    cues = Cues(None, None, tuple(lines))
    found = are_painted_otherwise(image, (*segments, crossing), cues, fits, painted.marking().band_px)
    assert found.tolist() == [False, True, False]
    assert are_painted_otherwise(image, (), cues, fits, None).tolist() == []


def test_a_large_faint_mark_lies_on_the_ground_beside_it():
    """The ground around the disc is darker than usual by more than half of what the disc adds to it."""
    position, across = np.arange(0.0, 120.0, 0.5), np.arange(-30.0, 30.25, 0.5)
    along, aside = position[:, None] - 60.0, across[None]
    values = -6.0 * (np.abs(along) < 30.0) + 9.0 * ((along / 15.0) ** 2 + (aside / 12.0) ** 2 < 1.0)
    halves = np.tile([15.0, 12.0], (len(position), 1))
    line = position, across, np.zeros((len(position), 2)), 200.0, (15.0, 12.0), halves
    seen = RectifiedLine(values, 0.0 * across, np.ones((2, len(position)), np.bool_), *line)
    assert _bare_sides(seen, 120, 1.0, 6.0, 20.0) == (True, True)


def test_a_stripe_of_shade_across_the_mark_does_not_hide_it(painted):
    """It dims the lower edge of the disc and the ground beside it alike."""
    y = round(float(CAMERA.project(np.zeros(2))[1]))
    image = painted.image.copy()
    image[y + 1 : y + 7] = (0.6 * image[y + 1 : y + 7]).astype(np.uint8)
    mark = cues_in(painted, image=image).mark
    assert mark is not None
    assert np.linalg.norm(mark.point_px - CAMERA.project(np.zeros(2))) < 1.5


def test_a_faint_mark_is_believed_where_both_its_sides_are_seen(painted):
    """Legs in front of the upper half of its right side leave the left one alone."""
    touched = painted.image.copy()
    x, y = np.round(CAMERA.project(np.zeros(2))).astype(int)
    touched[y - 40 : y + 2, x + 6 : x + 30] = 0

    def is_found(image, share):
        """Whether the mark is found where its signal to noise ratio is this share of what is asked."""
        snr = cues_in(painted, image=image).mark.snr
        return cues_in(painted, CuesConfig(mark_snr=snr / share), image=image).mark is not None

    assert is_found(painted.image, 0.8)
    assert not is_found(painted.image, 0.6)
    assert not is_found(touched, 0.8)


def test_a_line_that_is_bare_inside_the_circle_is_measured_beside_it(painted):
    """Its paint there is worn off, and the detector has seen it on both sides of the circle."""
    far, near = CAMERA.project(np.array([[0.0, -16.0], [0.0, 16.0]]))
    worn = paint(CAMERA, line=False, mark=False, noise=1.5)
    image = painted.image.copy()
    inner = slice(*np.round(CAMERA.project(np.array([[0.0, -10.0], [0.0, 10.0]]))[:, 1]).astype(int))
    image[inner] = worn.image[inner]
    found = cues_in(painted, image=image, halfway=Segment(far, near)).halfway
    assert found is not None
    off = line_distance(TRUE_LINE, found.points_px)
    assert np.abs(off).mean() < 0.2
    rows = found.points_px[:, 1]
    assert (rows < inner.start).any() and (rows > inner.stop).any()
    assert np.count_nonzero((rows > inner.start + 5) & (rows < inner.stop - 5)) < 5
    assert cues_in(worn, halfway=Segment(far, near)).halfway is None


def test_a_clear_centre_mark_is_found_beyond_where_it_usually_lies(painted):
    """The ellipse of a part of the circle may be off by more than its arc says; what is faint is not believed there."""
    far = CONFIG.model_copy(update={"mark_offset": (0.3, 0.5)})
    cue = cues_in(painted, far).mark
    assert np.linalg.norm(cue.point_px - CAMERA.project(np.zeros(2))) < 1.0
    beyond = cues_in(painted, CONFIG.model_copy(update={"mark_offset": (0.5, 0.7)})).mark
    faint = cues_in(painted, far.model_copy(update={"mark_snr": cue.snr / 1.5})).mark
    assert (beyond, faint) == (None, None)


def test_no_centre_mark_is_found_far_out_where_none_is():
    for seed in range(5):
        bare = paint(CAMERA, mark=False, noise=1.5, seed=seed)
        assert cues_in(bare, CONFIG.model_copy(update={"mark_offset": (0.3, 0.5)})).mark is None

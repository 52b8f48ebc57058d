"""Looking at a drawn pitch: from a head nearby, and from nowhere."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.geometry.camera_parameters import rotations
from circlecal.rig.tripod import PLACE
from circlecal.tracking import search
from circlecal.tracking.entry import Entry
from circlecal.tracking.head_fit import count_crossing
from circlecal.tracking.looking import LEAST_CROSSING, LookedAt, Place
from circlecal.tracking.markings import place_markings, template_curves
from tests.tracking.scenes import HEAD, SIZE, draw, template, tripod

ARCS = "penalty_arc_left", "penalty_arc_right"


@pytest.fixture(scope="module")
def picture() -> LookedAt:
    return LookedAt.of(draw(HEAD, np.random.default_rng(1)), load_config().mask)


def pixels(head: np.ndarray) -> np.ndarray:
    """How far a head puts the picture from the true one, pixels: by zoom, pan and tilt."""
    return np.abs(head - HEAD) * np.array([640.0, 1500.0, 1500.0])


def test_a_head_nearby_is_led_to_the_paint(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    start = HEAD + np.array([0.002, 0.002, -0.0015])
    look = place.look(picture, start, np.diag(np.square([0.005, 0.002, 0.002])))
    assert look.is_confirmed
    assert pixels(look.fit.head).max() < 0.15
    assert look.measured.painted_share > 0.9


def test_a_head_follows_its_own_paint_and_no_line_that_it_does_not_show(picture: LookedAt) -> None:
    breadth, length = PLACE["breadth"], PLACE["length"]
    place = Place.of(tripod(), template())
    measured = place.look(picture, HEAD, np.eye(3) * 1e-6).measured
    names = template_curves(template()).names
    for name in ("side_line_top", "side_line_bottom"):
        measured = measured.leave_out(names.index(name))
    followed = place.follow_paint(HEAD, measured)
    # goal line and areas end elsewhere on a broader pitch, and lie where they lay
    assert np.abs(followed[1:, breadth]).max() < 1e-3 * np.abs(followed[1:, length]).max()


def test_a_head_that_is_followed_forgets_nothing_of_how_it_follows_the_tripod(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    look = place.look(picture, HEAD, np.diag(np.square([0.005, 0.002, 0.002])))
    found = look.fit.by_common
    for _ in range(5):
        look = place.look(picture, look.fit.head, np.diag(np.square([1e-4, 2e-5, 2e-5])), look.fit.by_common)
    for name in ("axis_x", "axis_y", "axis_z", "length", "head_roll"):
        change = look.fit.by_common[:, PLACE[name]] - found[:, PLACE[name]]
        assert np.abs(change).max() < 0.1 * np.abs(found[:, PLACE[name]]).max()


def test_an_arc_of_a_penalty_area_is_no_circle_that_carries_a_frame(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    spread = np.diag(np.square([0.005, 0.002, 0.002]))
    carried = []
    for pan in (-0.55, 0.0):
        head = np.array([np.log(2200.0), pan, HEAD[2]])
        shown = LookedAt.of(draw(head, np.random.default_rng(1)), load_config().mask)
        entry = Entry(0, 0.0, SIZE, 0, place)
        look = place.look(shown, head, spread)
        entry.take(look, look.fit.head)
        carried.append(entry.carriers)
        if pan < 0.0:
            assert any(look.measured.painted[place.drawn.names.index(arc)] > 8 for arc in ARCS)
    assert carried == [("lines",), ("circle", "lines")]


def test_a_wrong_head_is_not_confirmed(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    look = place.look(picture, HEAD + np.array([0.0, 0.05, 0.02]), np.diag(np.square([0.005, 0.002, 0.002])))
    assert not look.is_confirmed


def test_the_camera_is_found_from_nowhere(picture: LookedAt) -> None:
    look = Place.of(tripod(), template()).find(picture)
    assert look is not None
    assert pixels(look.fit.head).max() < 0.3


def test_a_picture_without_paint_is_not_found() -> None:
    noise = np.random.default_rng(2).normal(0.0, 4.0, (720, 1280, 3))
    bare = np.clip(np.array([60.0, 120.0, 60.0]) + noise, 0, 255).astype(np.uint8)
    looked = LookedAt.of(bare, load_config().mask)
    assert Place.of(tripod(), template()).find(looked) is None


def test_heads_that_differ_in_zoom_alone_are_all_kept() -> None:
    heads = HEAD + np.array([[0.0, 0.0, 0.0], [0.002, 0.0, 0.0], [0.06, 0.0, 0.0], [0.0, 0.02, 0.0]])
    np.testing.assert_array_equal(search._keep_apart(heads, 1280, 2.0), heads[[0, 2, 3]])


def test_markings_that_no_camera_shows_are_left_out_of_a_search(picture: LookedAt, monkeypatch) -> None:
    drawn, known = template_curves(template()), tripod()
    pieces, grid = search._pieces(drawn, known), search._grid(known, template())[::37]
    found = search._see(grid, pieces, known).score(picture.ridges, search.COARSE_PX)
    theta = known.model.thetas(HEAD[None], known.mean)
    few = search._nodes_in_view(pieces, rotations(theta).astype(np.float32), theta, known)
    assert len(few.on_marking) < 0.7 * len(pieces.on_marking)
    monkeypatch.setattr(search, "_nodes_in_view", lambda pieces, *_: pieces)
    every = search._see(grid, pieces, known).score(picture.ridges, search.COARSE_PX)
    np.testing.assert_allclose(found, every, atol=2e-3)


def test_a_camera_beyond_the_far_touchline_is_searched_where_it_looks_at_the_field() -> None:
    near, half = tripod(), np.array([0.0, np.pi, 0.0])
    mean = near.mean.copy()
    mean[[PLACE["axis_x"], PLACE["axis_y"]]] *= -1.0
    far = replace(near, mean=mean, head_low=near.head_low + half, head_high=near.head_high + half)
    np.testing.assert_allclose(search._grid(far, template()), search._grid(near, template()) + half, atol=1e-9)


def test_what_the_grid_puts_into_view_is_worked_out_once_for_all_pictures(picture: LookedAt, monkeypatch) -> None:
    place, counts = Place.of(tripod(), template()), []
    see = search._see
    monkeypatch.setattr(search, "_see", lambda heads, *others: counts.append(len(heads)) or see(heads, *others))
    first = place.propose(picture)
    of_grid = max(counts)
    np.testing.assert_array_equal(place.propose(picture), first)
    assert of_grid == len(place.views.heads) > 4 * search.FOLLOWED * len(search.NEIGHBOURS)
    assert counts.count(of_grid) == 1


def test_where_the_head_was_seen_is_proposed(picture: LookedAt) -> None:
    known = tripod()
    assert Place.of(known, template()).propose(picture)[-1] == pytest.approx((known.head_low + known.head_high) / 2)


def test_a_dark_run_off_is_not_taken_for_the_playing_surface() -> None:
    config = load_config().mask
    drawn = draw(HEAD, np.random.default_rng(1))
    grass = LookedAt.of(drawn, config).colour
    # the mown pitch has many greens, the run-off one colour
    rng = np.random.default_rng(2)
    green = rng.integers(-14, 15, (36, 64, 3)) * np.array([1, 0, 1])
    drawn = np.clip(drawn + np.kron(green, np.ones((20, 20, 1))), 0, 255).astype(np.uint8)
    drawn[400:] = (44, 30, 30)
    picture = LookedAt.of(drawn, config)
    assert picture.grass[:60].mean() < 0.1 * picture.grass[80:].mean()
    pitch = picture.take_surface(grass)
    assert pitch.grass[20:60].mean() > 10 * pitch.grass[80:].mean()
    assert pitch.take_surface(grass) is pitch


def test_worn_paint_in_the_shadow_is_found_by_searching() -> None:
    drawn = draw(HEAD, np.random.default_rng(1)).astype(np.float64)
    bare = np.array([60.0, 120.0, 60.0])
    # a twelfth of the contrast, on uneven grass, over the far half in the shadow of the stand
    faint = bare + (drawn - bare) / 12.0 * (np.abs(drawn - bare).max(axis=-1, keepdims=True) > 30)
    faint += 15.0 * cv2.GaussianBlur(np.random.default_rng(2).normal(0.0, 1.0, faint.shape), (0, 0), 1.5)[..., :1]
    faint[:300] *= 0.5
    picture = LookedAt.of(np.clip(faint, 0, 255).astype(np.uint8), load_config().mask)
    look = Place.of(tripod(), template()).find(picture)
    assert look is not None
    assert pixels(look.fit.head).max() < 1.0


def test_a_false_ridge_on_a_few_places_of_a_marking_is_not_that_marking(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    seen = place.look(picture, HEAD, np.diag(np.square([1e-3, 3e-4, 3e-4]))).measured
    hidden = int(np.argmax(seen.painted))
    at = seen.points_px[seen.marking == hidden]
    gray = picture.gray.copy()
    for x, y in at[len(at) // 5 :].astype(int):
        gray[y - 12 : y + 13, x - 12 : x + 13] = 100
    look = place.look(replace(picture, gray=gray), HEAD, np.diag(np.square([1e-3, 3e-4, 3e-4])))
    assert look.measured.painted[hidden] == 0
    assert hidden not in look.measured.marking


def test_paint_that_the_shutter_smears_is_not_expected(picture: LookedAt) -> None:
    place, spread = Place.of(tripod(), template()), np.diag(np.square([1e-3, 3e-4, 3e-4]))
    sharp, smeared = (place.look(picture, HEAD, spread, None, np.array([way, 0.0])).measured for way in (0.0, 60.0))
    upright = place.drawn.names.index("big_rect_left_main")
    level = place.drawn.names.index("big_rect_left_bottom")
    assert sharp.expected[upright] > 20
    assert smeared.expected[upright] == 0
    assert smeared.expected[level] == sharp.expected[level] > 20


def test_a_touchline_confirms_a_head_that_is_known_and_finds_none() -> None:
    head = np.array([8.7, -0.22, 1.435])
    known = replace(tripod(), head_low=head - np.array([0.1, 0.3, 0.03]), head_high=head + np.array([0.1, 0.8, 0.03]))
    place = Place.of(known, template())
    picture = LookedAt.of(draw(head, np.random.default_rng(1)), load_config().mask)
    look = place.look(picture, head, np.diag(np.square([1e-3, 3e-4, 3e-4])))
    shown = {name for name, count in zip(place.drawn.names, look.measured.painted, strict=True) if count > 6}
    assert shown == {"side_line_top"}
    assert look.is_confirmed
    assert not look.is_found
    assert place.find(picture) is None


def test_lines_in_two_directions_tell_the_pan_and_those_in_one_do_not() -> None:
    # from far beside a penalty area all its lines are seen within 17 degrees of the way of the picture under a pan
    common = tripod().mean.copy()
    common[:3] = [0.5, 81.0, -10.3]
    head, model, drawn = np.array([8.23, -0.52, 1.46]), tripod().model, template_curves(template())
    places = place_markings(drawn, model.thetas(head[None], common)[0], model.projection, 0.12)
    by_angle = places.by_theta @ model.derivatives(head[None], common)[0][0] / np.exp(head[0])
    from_middle = places.pixels - model.projection.center
    assert np.count_nonzero(np.abs(by_angle[:, 1]) > 0.3) < 9
    along = np.isin(places.marking, [drawn.names.index(name) for name in ("side_line_bottom", "side_line_top")])
    assert np.count_nonzero(along) > 80
    assert count_crossing(by_angle, places.normals, from_middle) > 2.0 * LEAST_CROSSING
    assert count_crossing(by_angle[along], places.normals[along], from_middle[along]) < 0.5 * LEAST_CROSSING


@pytest.mark.parametrize("hidden_share", [1.0, 0.7])
def test_a_broad_marking_that_is_not_seen_contradicts_a_head(hidden_share: float) -> None:
    # a line that crosses its own paint shows at a part of its places
    head, config = np.array([8.0, 0.0, 1.37]), load_config().mask
    picture = LookedAt.of(draw(head, np.random.default_rng(1)), config)
    place, spread = Place.of(tripod(), template()), np.diag(np.square([1e-3, 3e-4, 3e-4]))
    seen = place.look(picture, head, spread)
    assert seen.is_confirmed
    hidden = place.drawn.names.index("halfway_line")
    gray = picture.gray.copy()
    own = seen.measured.points_px[seen.measured.marking == hidden].astype(int)
    for x, y in own[: round(hidden_share * len(own))]:
        gray[max(y - 12, 0) : y + 13, x - 12 : x + 13] = 95
    look = place.look(replace(picture, gray=gray), head, spread)
    assert look.measured.painted_share > 0.5
    assert look.measured.missing == 1
    assert not look.is_confirmed


def test_a_line_near_the_border_lies_on_the_playing_surface() -> None:
    config = load_config().mask
    drawn = draw(HEAD, np.random.default_rng(1))
    drawn[:, :20] = (60, 120, 60)
    drawn[:, 20:34] = (230, 235, 230)
    assert (LookedAt.of(drawn, config).grass[40:100, 5] > 0).all()


def test_ridges_are_found_as_the_user_has_them(picture: LookedAt) -> None:
    detector = picture.mask.detector
    broad = detector.model_copy(update={"ridges": detector.ridges.model_copy(update={"sigma_px": 4.0})})
    other = LookedAt.of(draw(HEAD, np.random.default_rng(1)), picture.mask.model_copy(update={"detector": broad}))
    expected = search.map_ridges(other.gray, other.grass, broad.ridges)
    assert other.ridges.length_px == expected.length_px
    assert other.ridges.length_px != picture.ridges.length_px


def test_faint_paint_is_measured_and_not_asked_for(picture: LookedAt) -> None:
    place = Place.of(tripod(), template())
    look = place.look(picture, HEAD, place.proposal_covariance(HEAD))
    far = place.drawn.names.index("side_line_top")
    # 0.2 pixels broad under the camera, though drawn broader here
    assert np.count_nonzero(look.measured.marking == far) > 20
    assert look.measured.expected[far] == look.measured.painted[far] == 0
    assert look.is_confirmed

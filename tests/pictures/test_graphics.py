"""Level boxes of graphics over the picture, and the field that goes on behind them."""

import cv2
import numpy as np
import pytest

from circlecal.pictures.graphics import Band, cover_bands, fill_bands, find_bands, lie_clear
from circlecal.synthetic.sampling import SCENE_PROFILES, render_frame

TURF, BOX = (60, 130, 70), (120, 40, 30)


def field(tilt=0.0, seed=3):
    """Picture (360, 640) of turf with a stripe of paint, 6 px wide, that falls by ``tilt`` rows per column."""
    y, x = np.mgrid[:360, :640]
    image = np.array(TURF, np.float64) + np.random.default_rng(seed).normal(0.0, 2.0, (360, 640, 1))
    image[np.abs(y - 90 - tilt * x) < 3.0] = 215.0
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def with_box(image, top=200, bottom=240, left=0, right=639):
    """The picture under a box with a light upper edge and some letters."""
    image = image.copy()
    image[top : bottom + 1, left : right + 1] = BOX
    image[top : top + 3, left : right + 1] = 245
    image[top + 15 : top + 28, left + 30 : left + 120 : 3] = 245
    return image


@pytest.mark.parametrize(("left", "right"), [(0, 639), (150, 520)])
def test_a_box_is_found_where_it_is(left, right):
    (band,) = find_bands(with_box(field(0.05), left=left, right=right))
    assert abs(band.top - 200) <= 3
    assert abs(band.bottom - 240) <= 3
    assert max(abs(band.left - left), abs(band.right - right)) <= 24


@pytest.mark.parametrize("tilt", [0.0, 0.002, 0.05])
def test_paint_on_the_field_is_no_box(tilt):
    assert find_bands(field(tilt)) == ()


def test_a_level_strip_of_the_field_between_two_lines_is_no_box():
    image = field()
    image[150:156] = 215
    assert find_bands(image) == ()


def with_boards(strip):
    """The picture with boards down to row 59, and the ground before them down to row 77 in its own colour."""
    image = field()
    image[:60] = (150, 60, 40)
    image[60:78] = strip
    return image


def test_the_ground_between_the_touchline_and_the_boards_is_no_box():
    """It is the field in the shade; a box of any other colour there is one."""
    assert find_bands(with_boards(0.7 * np.array(TURF))) == ()
    (band,) = find_bands(with_boards((30, 60, 160)))
    assert abs(band.bottom - 77) <= 3


def test_the_field_between_level_boards_and_a_box_is_no_box():
    """Both of its edges run along rows, little field is seen elsewhere, and the box is as light as grass."""
    image = field()
    image[:100], image[250:] = (150, 60, 40), (90, 80, 80)
    image[200:225] = (60, 104, 124)
    (band,) = find_bands(image)
    assert (band.top, band.bottom) == (pytest.approx(200, abs=3), pytest.approx(224, abs=3))


def test_a_grey_box_under_a_crowd_is_a_box():
    """The crowd is grey on the average, and each of its places has another colour."""
    image = field()
    image[:100] = np.random.default_rng(4).integers(0, 180, (100, 640, 3))
    image[100:140] = 60
    image[100:103] = 245
    (band,) = find_bands(image)
    assert abs(band.bottom - 139) <= 3


@pytest.mark.parametrize(("noise", "count"), [(0.0, 2), (6.0, 1)])
def test_a_box_in_a_colour_of_the_field_beside_another_one_is_drawn_in_one_colour(noise, count):
    """What is between two boxes is field where it is grained as the field is."""
    rng, olive = np.random.default_rng(6), np.array((40, 110, 110), np.float64)
    image = field(0.05)
    image[250:, :160] = np.clip(olive + rng.normal(0.0, 6.0, (110, 160, 3)), 0, 255)
    image[160:200] = BOX
    image[200:240] = np.clip(olive + rng.normal(0.0, noise, (40, 640, 3)), 0, 255)
    assert len(find_bands(image)) == count


def test_a_box_in_the_fields_hue_close_below_another_one_is_a_box_with_its_stripe():
    """The rows between the two are counted to the stripe, and tell nothing of the ground."""
    image = field(0.05)
    image[160:200, 40:560] = BOX
    image[206:209], image[209:240] = 245, np.rint(0.45 * np.array(TURF))
    bands = find_bands(image)
    assert len(bands) == 2
    assert abs(bands[1].bottom - 239) <= 3


def test_two_boxes_in_two_shades_of_one_colour_are_boxes():
    """Grey ones, whose colour has no hue."""
    image = field(0.05)
    image[160:200], image[200:240] = 50, 90
    assert len(find_bands(image)) == 2


def test_a_green_box_in_the_middle_of_the_field_is_a_box():
    """With the field on both of its sides."""
    image = with_box(field(0.05))
    image[203:241][(image[203:241] == BOX).all(axis=-1)] = np.rint(1.6 * np.array(TURF)).astype(np.uint8)
    assert len(find_bands(image)) == 1


def test_a_box_right_below_another_one_is_found_too():
    """Between the two is one edge, and the lower one ends on a crowd, where nothing steps along a row."""
    image = with_box(field(0.05))
    image[241:281] = (30, 60, 160)
    image[281:] = np.random.default_rng(1).integers(0, 255, (79, 640, 1))
    first, second = find_bands(image)
    assert abs(first.bottom - 240) <= 3
    assert first.bottom < second.top <= 244
    assert abs(second.bottom - 280) <= 3


def test_an_edge_that_two_boxes_share_may_step_in_colour_before_it_steps_in_grey():
    """The lower box ends on a crowd, and is wider: rows 146 to 149 step in colour, 147 and 148 in grey."""
    rng = np.random.default_rng([9916, 97, SCENE_PROFILES.index("world_banners")])
    image = render_frame("world_banners", rng, 1280, 720).image
    upper, lower = find_bands(image)
    assert (upper.top, upper.right) == (pytest.approx(128, abs=3), pytest.approx(972, abs=12))
    assert (lower.top, lower.bottom) == (pytest.approx(150, abs=3), pytest.approx(201, abs=3))
    assert lower.right - lower.left > 1250


@pytest.mark.parametrize(("left", "right"), [(0, 639), (80, 500)])
def test_a_ticker_reaches_to_the_bottom_of_the_picture(left, right):
    (band,) = find_bands(with_box(field(0.05), top=310, bottom=359, left=left, right=right))
    assert abs(band.top - 310) <= 3 and band.bottom == 359
    assert max(abs(band.left - left), abs(band.right - right)) <= 24


def test_a_plain_run_off_at_the_bottom_of_the_picture_is_no_ticker():
    """It has no letters; or they are a mat's, and it goes on where the lens bends its edge."""
    run_off = field(0.05)
    run_off[310:] = BOX
    assert find_bands(run_off) == ()
    bent = with_box(field(0.05), top=310, bottom=359, left=100, right=540)
    for k in range(100):
        bent[312 + k // 20 :, [99 - k, 540 + k]] = BOX
    assert find_bands(bent) == ()


def test_the_field_between_two_boxes_is_none():
    """Where it is as plain as they are, and most of the rest is a crowd."""
    image = field()
    crowd = np.random.default_rng(1).integers(0, 255, (360, 640, 1)).repeat(3, axis=2)
    image[:120], image[310:] = crowd[:120], crowd[310:]
    image = with_box(image, top=120, bottom=150)
    image[241:270] = (200, 60, 220)
    assert [band.top > 145 and band.bottom < 245 for band in find_bands(image)] == [False, False]


def test_a_box_that_another_one_overlaps_is_found_below_it():
    image = field(0.05)
    image[220:270] = (200, 60, 220)
    image[190:240, 100:540] = BOX
    first, second = find_bands(image)
    assert max(abs(first.top - 190), abs(first.bottom - 239)) <= 3
    assert first.bottom < second.top <= 243
    assert abs(second.bottom - 269) <= 3
    assert second.left == 0
    assert second.right >= 632


def test_small_pictures_have_none():
    assert find_bands(np.zeros((20, 30, 3), np.uint8)) == ()


def test_the_place_of_a_box_is_filled_from_above_and_below():
    plain, boxed = field(0.05), with_box(field(0.05))
    bands = find_bands(boxed)
    filled = fill_bands(boxed, bands)
    covered = cover_bands(boxed.shape, bands)
    assert covered[200:241].all()
    assert not covered[:190].any()
    assert np.array_equal(filled[~covered], plain[~covered])
    assert np.abs(filled[covered].astype(int) - np.array(TURF)).max() < 12
    assert fill_bands(boxed, ()) is boxed


def test_a_box_at_the_border_takes_its_colour_from_the_other_side():
    boxed = with_box(field(0.05), top=320, bottom=359)
    filled = fill_bands(boxed, (Band(320, 359, 0, 639),))
    assert np.abs(filled[320:].astype(int) - np.array(TURF)).max() < 12


def test_a_striped_picture_has_no_boxes():
    image = field()
    image[::8] = 230
    image[4::8] = 20
    assert find_bands(image) == ()


def with_crowd(image, below=0, above=None):
    """The picture with a crowd in its rows from ``below`` to before ``above``."""
    image, rows = image.copy(), slice(below, above)
    crowd = np.random.default_rng(5).integers(10, 245, (60, 107, 3)).repeat(6, axis=0).repeat(6, axis=1)
    image[rows] = crowd[: len(image), : image.shape[1]][rows]
    return image


@pytest.mark.parametrize("below", [True, False])
def test_a_box_on_a_crowd_is_found_by_its_ground(below):
    crowd = with_crowd(field(0.05), 230) if below else with_crowd(field(0.05), 0, 210)
    (band,) = find_bands(with_box(crowd))
    assert (abs(band.top - 200), abs(band.bottom - 240)) <= (3, 3)


def test_the_field_between_two_boxes_is_seen():
    boxed = with_box(with_box(field(0.05), 120, 180), 230, 290)
    assert [
        (abs(band.top - top) <= 3, abs(band.bottom - bottom) <= 3)
        for band, (top, bottom) in zip(find_bands(boxed), ((120, 180), (230, 290)), strict=True)
    ] == [(True, True)] * 2


def test_a_narrow_stripe_of_another_colour_under_a_box_is_its_lower_part():
    image = with_box(field(0.05))
    image[241:253] = (125, 40, 60)
    upper, lower = find_bands(image)
    assert max(abs(upper.top - 200), abs(upper.bottom - 240), abs(lower.top - 241), abs(lower.bottom - 252)) <= 3


@pytest.mark.parametrize(("columns", "bottom"), [((0, 640), 246), ((200, 640), 240)])
def test_a_stripe_too_narrow_for_a_box_belongs_to_the_box_above_where_it_is_as_wide(columns, bottom):
    image = with_box(field(0.05))
    image[241:247, slice(*columns)] = (125, 40, 60)
    (band,) = find_bands(image)
    assert abs(band.bottom - bottom) <= 2


@pytest.mark.parametrize(("gain", "count"), [(1.7, 2), (1.1, 1)])
def test_a_box_of_the_fields_hue_that_is_lighter_than_the_field_anywhere_is_seen_behind_another(gain, count):
    image = with_box(field(0.05))
    image[241:250] = np.rint(gain * np.array(TURF))
    if count == 1:  # what is as light as the field may be is the field, which goes on elsewhere
        image[300:] = np.rint(0.8 * image[300:])
    assert len(find_bands(image)) == count


def test_a_box_that_is_as_light_as_grass_is_found():
    """An edge between red and green is none in a picture in grey."""
    image = field(0.05)
    image[200:241] = (40, 62, 200)
    gray = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    assert abs(float(gray[205:235].mean()) - float(gray[245:300].mean())) < 8.0
    (band,) = find_bands(image)
    assert (abs(band.top - 200), abs(band.bottom - 240)) <= (3, 3)


@pytest.mark.parametrize("shade", [0.55, 0.8])
def test_the_lit_field_between_a_shadow_and_a_box_is_no_box(shade):
    """It begins and ends along rows and is plain, but the field goes on below the box."""
    image = field()
    image[86:96] = TURF
    image[:150] = np.rint(shade * image[:150])
    image[330:] = (40, 70, 160)
    (band,) = find_bands(with_box(image, top=240, bottom=280))
    assert (abs(band.top - 240), abs(band.bottom - 280)) <= (3, 3)


def test_a_box_is_no_wider_than_its_colour():
    """One of its edges goes on as that of another thing."""
    image = with_box(field(0.05), left=120, right=400)
    image[240:, 401:] = (20, 40, 90)
    image[:240, 401:] = (90, 170, 100)
    (band,) = find_bands(image)
    assert abs(band.right - 400) <= 12


def test_points_on_and_right_beside_a_box_are_not_clear_of_it():
    covered = cover_bands((360, 640), (Band(100, 140, 200, 400),))
    points = np.array([[300.0, 120], [300, 97], [300, 143], [300, 90], [300, 150], [150, 120], [405, 120]])
    assert lie_clear(points, covered).tolist() == [False, False, False, True, True, True, True]
    assert lie_clear(points, None).all()


def test_a_stripe_along_a_box_belongs_to_it_where_the_field_above_was_taken_for_a_box_before():
    """Between two boxes lies a strip of field; the lower one's stripe begins in row 515. Compressed, its edge steps
    in all rows from 514 to 519.
    """
    rng = np.random.default_rng([9922, 196, SCENE_PROFILES.index("world_banners")])
    image = render_frame("world_banners", rng, 1280, 720).image
    encoded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 92])[1]
    upper, lower = find_bands(np.asarray(cv2.imdecode(encoded, cv2.IMREAD_COLOR), np.uint8))
    assert abs(upper.bottom - 347) <= 3
    assert (lower.top, lower.bottom) == (pytest.approx(514, abs=2), pytest.approx(546, abs=3))

"""What the ground in a picture says of a camera: where field is seen, and where none is."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.results import MarkingMask, Surroundings
from circlecal.stages.surroundings import measure_surroundings

from .conftest import SOCCER, view
from .test_evidence import CAMERA, NO_PAINT, fit_of, weigh

SIZE = CAMERA.height, CAMERA.width
LOW = view(position=(3.0, 60.0, -12.0), target=(0.0, -60.0, 0.0), focal=1600.0)
"""Its horizon lies in the picture."""


def picture(seed=0):
    return np.random.default_rng(seed).normal(90, 3, SIZE).astype(np.uint8)


def mask_of(region):
    return MarkingMask(np.zeros(SIZE, np.uint8), "detector", field_region=region)


def region_of(camera, beyond_m):
    """The surface that reaches so far beyond the field's border."""
    y, x = np.meshgrid(*(np.linspace(0.5, size - 0.5, count) for size, count in zip(SIZE, (72, 128), strict=True)),
                       indexing="ij")  # fmt: skip
    ground = fit_of(camera).view.to_field(np.stack([x, y], axis=-1).reshape(-1, 2)).reshape(72, 128, 2)
    with np.errstate(invalid="ignore"):
        return (np.abs(ground) < (52.5 + beyond_m, 34.0 + beyond_m)).all(axis=-1)


def weigh_ground(ground, camera):
    return weigh(NO_PAINT, camera, ground)


@pytest.mark.parametrize("camera", [CAMERA, LOW])
def test_nothing_speaks_against_a_right_camera(camera):
    fit = fit_of(camera)
    found = measure_surroundings(picture(), mask_of(region_of(camera, 6.0)), fit, SOCCER)
    assert found.above_share == found.beyond_share == found.rough_share == 0.0
    assert weigh_ground(found, fit).status == "calibrated"


def test_surface_above_the_horizon_speaks_against_a_camera():
    region = region_of(LOW, 6.0)
    region[:10] = True
    fit = fit_of(LOW)
    found = measure_surroundings(picture(), mask_of(region), fit, SOCCER)
    assert found.above_share > 0.1
    assert weigh_ground(found, fit).code == "picture_contradicts"


@pytest.mark.parametrize(("sky_bgr", "is_field"), [((42, 42, 42), False), ((40, 72, 50), True)])
def test_what_is_coloured_otherwise_than_the_field_is_none_of_it(sky_bgr, is_field):
    """In a dark picture all of it may be taken for one surface."""
    everywhere = np.ones((72, 128), np.bool_)
    image = np.random.default_rng(1).normal((36.0, 62.0, 45.0), 3.0, (*SIZE, 3))
    fit = fit_of(LOW)
    rows = np.stack([np.full(SIZE[0], 0.5 * SIZE[1]), np.arange(SIZE[0])], axis=-1)
    image[~np.isfinite(fit.view.to_field(rows)).all(axis=1)] += np.subtract(sky_bgr, (36.0, 62.0, 45.0))
    found = measure_surroundings(
        picture(), mask_of(everywhere), fit, SOCCER, image_bgr=image.clip(0, 255).astype(np.uint8)
    )
    assert (found.above_share > 0.05) == is_field
    assert measure_surroundings(picture(), mask_of(everywhere), fit, SOCCER).above_share > 0.05


@pytest.mark.parametrize(("sky", "is_field"), [(180.0, False), (91.0, True)])
def test_in_gray_pictures_what_is_as_bright_as_the_field_may_be_field(sky, is_field):
    """Without colours all of the picture is taken for one surface."""
    everywhere = np.ones((72, 128), np.bool_)
    gray = picture().astype(np.float64)
    fit = fit_of(LOW)
    rows = np.stack([np.full(SIZE[0], 0.5 * SIZE[1]), np.arange(SIZE[0])], axis=-1)
    gray[~np.isfinite(fit.view.to_field(rows)).all(axis=1)] += sky - 90.0
    image = np.repeat(gray[..., None], 3, axis=2).clip(0, 255).astype(np.uint8)
    found = measure_surroundings(image[..., 0], mask_of(everywhere), fit, SOCCER, image_bgr=image)
    assert (found.above_share > 0.05) == is_field


def test_surface_far_beyond_the_border_speaks_against_a_camera_without_further_lines():
    fit = fit_of(LOW)
    found = measure_surroundings(picture(), mask_of(region_of(LOW, 60.0)), fit, SOCCER)
    assert 0.05 < found.beyond_share < 0.25 and found.above_share == 0.0
    assert weigh_ground(found, fit).status == "calibrated"
    assert weigh_ground(found, replace(fit, named_lines=())).code == "picture_contradicts"


@pytest.mark.parametrize(("seats_sd", "status"), [(3, "refused"), (40, "calibrated")])
def test_seats_of_the_colour_of_the_field_are_no_surface_beyond_its_border(seats_sd, status):
    fit, region = fit_of(LOW), region_of(LOW, 6.0)
    field = cv2.resize(region.astype(np.uint8), SIZE[::-1], interpolation=cv2.INTER_NEAREST) > 0
    rng = np.random.default_rng(1)
    stand = rng.normal(90, seats_sd, SIZE).clip(0, 255)
    found = measure_surroundings(
        np.where(field, picture(), stand).astype(np.uint8), mask_of(np.ones_like(region)), fit, SOCCER
    )
    assert weigh_ground(found, fit).status == status


def test_a_stand_before_the_field_that_fills_half_of_the_picture_speaks_against_a_camera():
    region = region_of(CAMERA, 6.0)
    camera = view(position=(3.0, 60.0, -12.0), target=(0.0, 40.0, 0.0), focal=700.0)
    fit, seen = fit_of(camera), region_of(camera, 6.0)
    is_field = np.repeat(np.repeat(seen, SIZE[0] // 72 + 1, axis=0), SIZE[1] // 128 + 1, axis=1)[: SIZE[0], : SIZE[1]]
    crowd = np.where(is_field, picture(), np.random.default_rng(1).integers(20, 230, SIZE)).astype(np.uint8)
    stand = measure_surroundings(crowd, mask_of(seen), fit, SOCCER)
    assert stand.near_share > 0.4
    assert weigh_ground(stand, fit).code == "picture_contradicts"
    parapet = measure_surroundings(picture(), mask_of(seen), fit, SOCCER)
    assert parapet.near_share == 0.0
    assert measure_surroundings(picture(), mask_of(region), fit_of(CAMERA), SOCCER).near_share == 0.0


def test_a_ceiling_of_the_colour_of_the_floor_does_not_speak_against_a_camera():
    ceiling, joined = region_of(LOW, 6.0), region_of(LOW, 6.0)
    ceiling[:10], joined[:40] = True, True
    fit, hall = fit_of(LOW), SOCCER.model_copy(update={"ground": "floor"})
    assert measure_surroundings(picture(), mask_of(ceiling), fit, SOCCER).above_share > 0.1
    assert measure_surroundings(picture(), mask_of(ceiling), fit, hall).above_share == 0.0
    assert measure_surroundings(picture(), mask_of(joined), fit, hall).above_share > 0.1


def test_a_picture_that_is_put_together_has_a_seam():
    rng = np.random.default_rng(1)
    smooth = (90 + 60 * np.linspace(0, 1, SIZE[0])[:, None] + rng.normal(0, 3, SIZE)).astype(np.uint8)
    exchanged = np.roll(smooth, SIZE[0] // 2, axis=0)
    fit, nothing = fit_of(CAMERA), mask_of(None)
    assert measure_surroundings(smooth, nothing, fit, SOCCER).seam_share < 0.3
    found = measure_surroundings(exchanged, nothing, fit, SOCCER)
    assert found.seam_share > 0.8
    assert weigh_ground(found, fit).code == "picture_contradicts"


def test_halves_that_meet_along_a_plain_roof_have_a_seam():
    """The roof of a stand is as plain as a caption, but has one edge only."""
    joined = picture()
    joined[SIZE[0] // 2 :] = np.random.default_rng(4).integers(20, 200, (SIZE[0] - SIZE[0] // 2, SIZE[1]))
    joined[SIZE[0] // 2 : SIZE[0] // 2 + SIZE[0] // 6] = 30
    joined[: SIZE[0] // 2] = np.maximum(joined[: SIZE[0] // 2], 80)
    # the crowd fades into the roof
    rows = np.linspace(0.0, 1.0, SIZE[0] // 4)[:, None]
    start = SIZE[0] // 2 + SIZE[0] // 6
    joined[start : start + len(rows)] = (30 + rows * (joined[start : start + len(rows)] - 30.0)).astype(np.uint8)
    found = measure_surroundings(joined, mask_of(None), fit_of(CAMERA), SOCCER)
    assert found.seam_share > 0.8


def test_a_bar_and_a_caption_are_no_seam():
    bars, caption = picture(), picture()
    bars[:, : SIZE[1] // 4] = bars[:, -SIZE[1] // 4 :] = 0
    caption[-SIZE[0] // 6 :] = 200
    for seen in (bars, caption):
        assert measure_surroundings(seen, mask_of(None), fit_of(CAMERA), SOCCER).seam_share < 0.3


def test_the_lower_edge_of_a_level_railing_is_no_seam():
    """It is as plain as its noise, and its upper edge, farther from the eye, is not level."""
    rng = np.random.default_rng(6)
    seen = np.repeat(np.repeat(rng.integers(20, 230, (SIZE[0] // 4, SIZE[1] // 4)), 4, axis=0), 4, axis=1).astype(float)
    seen = cv2.GaussianBlur(seen, (0, 0), 1.5)
    middle = SIZE[0] // 2
    rows, columns = np.arange(SIZE[0])[:, None], np.arange(SIZE[1])
    # it turns away at the corner of the stand
    lower = middle + np.maximum(SIZE[1] // 3 - columns, 0) // 8
    railing = (rows >= middle - 30 - columns // 40) & (rows < lower)
    shown = np.where(railing, 15.0 + rng.normal(0.0, 2.0, SIZE), seen[: SIZE[0], : SIZE[1]]).clip(0, 255)
    assert measure_surroundings(shown.astype(np.uint8), mask_of(None), fit_of(CAMERA), SOCCER).seam_share < 0.3


@pytest.mark.parametrize(("top", "is_seam"), [(0.15, False), (0.0, True)])
def test_a_caption_that_begins_near_the_border_is_no_seam(top, is_seam):
    """Its other edge is; what reaches to the border has one edge only, as half of a picture has."""
    seen = picture()
    rows = slice(round(top * SIZE[0]), round(0.27 * SIZE[0]))
    seen[rows] = np.clip(np.random.default_rng(5).normal(190.0, 6.0, seen[rows].shape), 0.0, 255.0).astype(np.uint8)
    found = measure_surroundings(seen, mask_of(None), fit_of(CAMERA), SOCCER)
    assert (found.seam_share > 0.4) == is_seam


def test_without_a_surface_only_seams_are_looked_for():
    found = measure_surroundings(picture(), mask_of(None), fit_of(CAMERA), SOCCER)
    assert found == Surroundings(0.0, 0.0, 0.0, 0.0, found.seam_share)


def test_a_crowd_where_the_field_must_be_speaks_against_a_camera():
    region = np.ones((72, 128), np.bool_)
    region[:, 80:] = False
    plain = picture()
    crowd = plain.copy()
    crowd[:, 5 * CAMERA.width // 8 :] = np.random.default_rng(1).integers(
        20, 230, (CAMERA.height, CAMERA.width - 5 * CAMERA.width // 8)
    )
    camera = fit_of(CAMERA)
    shade = measure_surroundings(plain, mask_of(region), camera, SOCCER)
    found = measure_surroundings(crowd, mask_of(region), camera, SOCCER)
    assert shade.rough_share < 0.02
    assert found.rough_share > 0.2
    assert weigh(NO_PAINT, camera, found).code == "picture_contradicts"


def smooth_ground(seed=2):
    """Ground whose detail goes on from row to row."""
    return cv2.GaussianBlur(np.random.default_rng(seed).normal(0, 30, SIZE), (0, 0), 2.0) + 90


def test_the_edge_of_a_shadow_is_no_seam():
    shaded, joined = smooth_ground(), smooth_ground()
    shaded[SIZE[0] // 2 :] += 40
    joined[SIZE[0] // 2 :] = smooth_ground(3)[SIZE[0] // 2 :] + 40
    for ground, has_seam in ((shaded, False), (joined, True)):
        found = measure_surroundings(ground.clip(0, 255).astype(np.uint8), mask_of(None), fit_of(CAMERA), SOCCER)
        assert (found.seam_share > 0.4) == has_seam


def test_other_pictures_may_meet_along_graphics():
    joined = smooth_ground()
    joined[SIZE[0] // 2 :] = smooth_ground(3)[SIZE[0] // 2 :] + 40
    covered = np.zeros(SIZE, np.bool_)
    covered[SIZE[0] // 2 : SIZE[0] // 2 + 30] = True
    picture = joined.clip(0, 255).astype(np.uint8)
    assert measure_surroundings(picture, mask_of(None), fit_of(CAMERA), SOCCER, covered).seam_share < 0.3

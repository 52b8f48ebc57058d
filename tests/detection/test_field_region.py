import numpy as np
import pytest

from circlecal.detection.field_region import find_field_region
from circlecal.detection.options import FieldRegionConfig


def framed(surface: tuple[int, int, int], gain: float = 1.0) -> np.ndarray:
    """A field in the lower part of a picture of coloured noise, with a player standing on it."""
    random = np.random.default_rng(3)
    image = random.integers(0, 255, (360, 640, 3)).astype(float)
    image[120:] = np.array(surface) + random.normal(0, 4, (240, 640, 3))
    image[200:240, 300:312] = (200, 40, 40)
    return np.clip(image * gain, 0, 255).astype(np.uint8)


@pytest.mark.parametrize("surface", [(60, 130, 70), (50, 90, 120), (170, 140, 90), (235, 235, 235)])
def test_hull_is_the_surface_whatever_its_colour(surface: tuple[int, int, int]) -> None:
    hull = find_field_region(framed(surface), FieldRegionConfig()).hull_at(640, 360) > 0
    assert hull[135:].mean() > 0.98
    assert hull[:105].mean() < 0.02


def test_dark_picture_gives_the_same_hull() -> None:
    hull = find_field_region(framed((40, 90, 50), gain=0.3), FieldRegionConfig()).hull_at(640, 360) > 0
    assert hull[135:].mean() > 0.98
    assert hull[:105].mean() < 0.05


def test_players_do_not_make_holes() -> None:
    region = find_field_region(framed((60, 130, 70)), FieldRegionConfig())
    assert region.hull_at(640, 360)[210:230, 303:309].all()


def test_no_colour_no_field() -> None:
    assert find_field_region(np.zeros((90, 160, 3), np.uint8), FieldRegionConfig()).area_share == 0.0


def test_what_fills_more_of_the_picture_may_not_be_the_field() -> None:
    image = framed((60, 130, 70))
    image[220:] = (90, 90, 95)
    config = FieldRegionConfig()
    track = find_field_region(image, config)
    assert track.hull_at(640, 360)[260:].all()
    field = find_field_region(image, config, track).hull_at(640, 360) > 0
    assert field[135:200].mean() > 0.95
    assert field[240:].mean() < 0.05


def test_ice_is_the_light_part_of_what_has_its_colour() -> None:
    """Dark stands are as gray as ice, and fill more of the picture."""
    image = np.random.default_rng(3).normal((40, 38, 42), 12, (360, 640, 3)).clip(0, 255)
    image[200:320, 100:] = np.random.default_rng(4).normal(215, 4, (120, 540, 3))
    picture = image.astype(np.uint8)
    ice = find_field_region(picture, FieldRegionConfig(light=True)).hull_at(640, 360) > 0
    assert ice[205:315, 110:].mean() > 0.98
    assert ice[:190].mean() < 0.02
    assert find_field_region(picture, FieldRegionConfig()).hull_at(640, 360)[100:190].mean() > 100
    # a calm surface has no two parts
    calm = framed((235, 235, 235))
    assert find_field_region(calm, FieldRegionConfig(light=True)).hull_at(640, 360)[135:].mean() > 0.95 * 255

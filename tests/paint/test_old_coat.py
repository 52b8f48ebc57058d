"""Old coats of a circle beside its new paint."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.special import ndtr

from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.surface import Surface
from circlecal.paint import old_coat
from circlecal.paint.old_coat import find_old_coats, remove_old_coat, sample_coats

SOCCER = load_field("soccer")
CIRCLE = SOCCER.circle_by_name[SOCCER.default_circle]
RADIUS = SOCCER.radius(CIRCLE, "center")
CAMERA = Camera(
    width=1280,
    height=720,
    focal_px=np.array([2100.0, 2100.0]),
    principal_point_px=image_center(1280, 720),
    angles_rad=np.radians([0.0, 72.0, 0.0]),
    position_m=np.array([2.0, 52.0, -17.0]),
    kappa=np.zeros(2),
)
VIEW = FieldView(CAMERA, Surface("flat", CIRCLE.radius_m))
OLD = (-0.05, 0.1, -0.15)
"""Growth of the old circle, and its middle from the new one's, metres."""


@cache
def field_of_pixels():
    """Where on the field each pixel (H, W) looks, metres."""
    pixels = np.stack(np.meshgrid(np.arange(1280.0), np.arange(720.0)), axis=-1)
    return VIEW.to_field(pixels.reshape(-1, 2)).reshape(720, 1280, 2)


def draw_ring(growth=0.0, x=0.0, y=0.0, blur_px=0.8, width_m=SOCCER.marking_width_m):
    """Share (H, W) of each pixel that a ring of paint covers, blurred."""
    outside_m = np.linalg.norm(field_of_pixels() - (x, y), axis=-1) - RADIUS - growth
    metres = np.hypot(*np.gradient(outside_m))
    half = 0.5 * width_m
    edges = ((outside_m + side * half) / metres / blur_px for side in (1.0, -1.0))
    outer, inner = (ndtr(edge) for edge in edges)
    return np.nan_to_num(outer - inner)


def picture(strength, seed=0, width_m=SOCCER.marking_width_m):
    """Grass with the circle, and what is left of an old one, which may have been painted wider."""
    new = draw_ring(width_m=width_m)
    image = 90.0 + 90.0 * (new + strength * (1.0 - 0.8 * new) * draw_ring(*OLD))
    return (image + np.random.default_rng(seed).normal(0.0, 2.0, image.shape)).clip(0, 255).astype(np.uint8)


def look_for_coat(image, view=VIEW):
    return only_coat(sample_coats(image, view, CIRCLE, SOCCER))


def only_coat(profiles):
    coats = find_old_coats(profiles, SOCCER.marking_width_m)
    assert len(coats) <= 1
    return coats[0] if coats else None


@pytest.fixture(scope="module")
def coated():
    return picture(0.35)


@pytest.fixture(scope="module")
def turned_coated(coated):
    """What a camera sees that looks aside: of a picture of the same plane the rays alone decide."""
    pixels = np.stack(np.meshgrid(np.arange(1280.0), np.arange(720.0)), axis=-1).reshape(-1, 2)
    field = turn_camera(14.0).to_field(pixels)
    from_x, from_y = VIEW.project(field).reshape(720, 1280, 2).transpose(2, 0, 1).astype(np.float32)
    return cv2.remap(coated, from_x, from_y, cv2.INTER_LINEAR, borderValue=90)


def test_an_old_coat_is_told_from_the_new_paint(coated):
    coat = look_for_coat(coated)
    assert coat is not None
    assert coat.strength == pytest.approx(0.35, abs=0.12)
    assert coat.width_m == pytest.approx(0.12, abs=0.02)
    expected = OLD[0] + OLD[1] * np.cos(coat.angle) + OLD[2] * np.sin(coat.angle)
    assert np.abs(coat.beside_m - expected).max() < 0.04
    assert np.abs(coat.place_m * coat.scale).max() < 0.15


def test_an_old_coat_may_be_wider_than_the_new_paint():
    coat = look_for_coat(picture(0.4, width_m=0.08))
    assert coat is not None
    assert coat.width_m == pytest.approx(0.08, abs=0.01)
    assert coat.old_width_m == pytest.approx(0.12, abs=0.02)
    assert np.abs(coat.place_m).max() < 0.005


def test_the_new_paint_is_found_beside_a_camera_that_the_old_one_led_astray(coated):
    led_astray = replace(CAMERA, position_m=CAMERA.position_m + np.array([0.03, 0.0, 0.0]))
    coat = look_for_coat(coated, FieldView(led_astray, VIEW.surface))
    assert coat is not None
    assert np.abs(coat.place_m - 0.03 * np.cos(coat.angle)).max() < 0.01


@pytest.mark.parametrize("strength", [0.0, 0.95])
def test_without_a_fainter_one_there_is_none(strength):
    assert look_for_coat(picture(strength)) is None


def test_its_light_is_taken_out_of_the_picture(coated):
    coat = look_for_coat(coated)
    cleaned = remove_old_coat(coated, VIEW, CIRCLE, RADIUS, coat)
    bare = picture(0.0).astype(float)
    before, after = (np.abs(image - bare)[draw_ring(*OLD) > 0.5].mean() for image in (coated, cleaned))
    assert after < 0.35 * before
    far = np.ones(bare.shape, np.bool_)
    far[100:620] = False
    assert np.array_equal(cleaned[far], coated.astype(np.float32)[far])


def turn_camera(degrees):
    return FieldView(replace(CAMERA, angles_rad=CAMERA.angles_rad + np.radians([degrees, 0.0, 0.0])), VIEW.surface)


def test_half_of_the_circle_tells_an_old_coat(turned_coated):
    profiles = sample_coats(turned_coated, turn_camera(14.0), CIRCLE, SOCCER)
    assert len(profiles.angle) < 34
    coat = only_coat(profiles)
    assert coat is not None
    expected = OLD[0] + OLD[1] * np.cos(coat.angle) + OLD[2] * np.sin(coat.angle)
    assert np.abs(coat.beside_m - expected).max() < 0.06


def test_of_a_small_part_of_the_circle_nothing_is_told(coated):
    assert sample_coats(coated, turn_camera(23.0), CIRCLE, SOCCER) is None


def test_an_old_coat_beside_worn_paint_may_be_nearly_as_strong():
    coat = look_for_coat(picture(0.75))
    assert coat is not None
    assert coat.strength == pytest.approx(0.75, abs=0.12)


def test_the_fainter_one_of_two_coats_is_the_old_one(coated):
    """The camera was fitted to the old one, and the other is found beside it."""
    growth, x, y = OLD
    profiles = sample_coats(coated, VIEW, CIRCLE, SOCCER)
    away = growth + x * np.cos(profiles.angle) + y * np.sin(profiles.angle)
    astray = replace(profiles, offset_px=profiles.offset_px - (away * profiles.scale)[:, None])
    coat = only_coat(astray)
    assert coat is not None
    assert coat.strength < 0.6
    assert np.abs(coat.beside_m - away).max() < 0.04


@pytest.fixture(scope="module")
def between_alike():
    """Profiles across two coats that are alike, and how far apart these lie: the camera was led between them, where one
    band runs along one of them here and along the other there.
    """
    growth, x, y = OLD
    profiles = sample_coats(picture(1.0), VIEW, CIRCLE, SOCCER)
    away = growth + x * np.cos(profiles.angle) + y * np.sin(profiles.angle)
    return replace(profiles, offset_px=profiles.offset_px - (0.5 * away * profiles.scale)[:, None]), away


def test_each_of_two_coats_that_are_alike_may_be_the_old_one(between_alike):
    between, away = between_alike
    assert find_old_coats(between, SOCCER.marking_width_m) == ()
    coats = find_old_coats(between, SOCCER.marking_width_m, may_be_alike=True)
    assert len(coats) == 2
    assert 0.9 < coats[0].strength <= coats[1].strength < 1.2
    first, second = coats if np.dot(coats[0].beside_m, away) > 0.0 else coats[::-1]
    for coat, sign in ((first, 1.0), (second, -1.0)):
        assert np.abs(coat.beside_m - sign * away).max() < 0.04
        assert np.abs(coat.place_m + sign * 0.5 * away).max() < 0.03
        assert coat.growth_m == pytest.approx(sign * OLD[0], abs=0.03)


@pytest.mark.parametrize(("noise", "count"), [(15.0, 2), (30.0, 0)])
def test_coats_that_may_be_alike_must_stand_out_more_than_a_faint_one(between_alike, noise, count):
    profiles, _ = between_alike
    level = profiles.level + np.random.default_rng(1).normal(0.0, noise, profiles.level.shape)
    noisy = replace(profiles, level=level, noise=noise)
    assert len(find_old_coats(noisy, SOCCER.marking_width_m, may_be_alike=True)) == count


def test_a_coat_of_quite_another_radius_is_another_circle(coated):
    coat = look_for_coat(coated)
    assert coat.is_told()
    assert not replace(coat, growth_m=0.3).is_told()
    assert not replace(coat, gain=80.0).is_told()
    assert not replace(coat, strength=0.1).is_told()


@pytest.mark.parametrize(("strength", "is_followed"), [(0.08, False), (0.15, True)])
def test_a_coat_that_seems_too_faint_after_a_few_steps_is_followed_no_further(strength, is_followed, monkeypatch):
    """The first steps see every two sectors as one."""
    looked_at, fit = [], old_coat.minimise

    def count_samples(problem, state, rule):
        looked_at.append(problem.linearise(state.parameters[:1])[0].size)
        return fit(problem, state, rule)

    monkeypatch.setattr(old_coat, "minimise", count_samples)
    profiles = sample_coats(picture(strength), VIEW, CIRCLE, SOCCER)
    assert (len(find_old_coats(profiles, SOCCER.marking_width_m)) == 1) == is_followed
    assert looked_at[:2] == [profiles.level.size // 2] * 2
    assert (profiles.level.size in looked_at) == is_followed

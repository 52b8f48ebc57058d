"""Every profile keeps what it promises."""

import numpy as np
import pytest

from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.cameras import (
    aim_camera,
    halfway_length_px,
    inside_frame,
    other_markings,
    sample_camera,
    soccer,
    visible_circle_deg,
)
from circlecal.synthetic.views import CAMERA_PROFILES

SEEDS = range(12)


def cameras(profile, **options):
    return [sample_camera(profile, np.random.default_rng([7, seed]), **options) for seed in SEEDS]


def sees_only_the_circle(camera, surface=FLAT):
    pixels = camera.project(surface.lift(other_markings(soccer())))
    return not inside_frame(pixels, camera.width, camera.height).any()


@pytest.mark.parametrize(("profile", "offset"), [("main", 12.0), ("wide", 25.0)])
def test_main_and_wide(profile, offset):
    for camera in cameras(profile):
        x, y, z = camera.position_m
        assert 45.0 <= np.linalg.norm(camera.position_m) <= 90.0
        assert 8.0 <= -z <= 25.0
        assert abs(x) <= offset
        assert y > 0
        assert abs(np.degrees(camera.angles_rad[2])) <= 2.5
        assert visible_circle_deg(camera, soccer(), margin_px=7.9) == 360.0
        assert sees_only_the_circle(camera)
        assert halfway_length_px(camera, soccer()) > 400
        assert np.linalg.det(camera.homography) > 0


def test_partial():
    for camera in cameras("partial"):
        assert 0.4 * 360 - 3 <= visible_circle_deg(camera, soccer()) <= 0.8 * 360 + 3
        assert sees_only_the_circle(camera)


@pytest.mark.parametrize("arc_deg", [180.0, 120.0, 90.0, 60.0])
def test_arc(arc_deg):
    rim = 9.15 * np.stack([np.cos(t := np.radians(np.arange(720) / 2)), np.sin(t)], axis=-1)
    for camera in cameras("arc", arc_deg=arc_deg):
        assert abs(visible_circle_deg(camera, soccer()) - arc_deg) <= 12.0
        inside = inside_frame(camera.project(rim), camera.width, camera.height)
        assert np.sum(inside & ~np.roll(inside, 1)) == 1
        assert halfway_length_px(camera, soccer()) >= 50
        assert 5000 <= camera.focal_px[0] <= 16000


def test_hard():
    drawn = cameras("hard")
    distance = np.array([np.linalg.norm(camera.position_m) for camera in drawn])
    height = np.array([-camera.position_m[2] for camera in drawn])
    assert np.all(((height >= 6.0) & (height <= 10.0)) | ((distance >= 38.0) & (distance <= 45.0)))
    assert min(visible_circle_deg(camera, soccer()) for camera in drawn) >= 0.44 * 360
    assert max(abs(np.degrees(camera.angles_rad[2])) for camera in drawn) > 2.5


def test_broadcast():
    for camera in cameras("broadcast"):
        assert 1500 <= camera.focal_px[0] <= 4000
        assert visible_circle_deg(camera, soccer()) == 360.0


def test_lens_crown_and_size():
    surface = Surface(crown_m=0.08)
    camera = sample_camera("main", np.random.default_rng(1), 1280, 720, kappa=0.05, surface=surface)
    assert (camera.width, camera.height) == (1280, 720)
    assert camera.kappa.tolist() == [0.05, 0.0]
    assert visible_circle_deg(camera, soccer(), surface, margin_px=7.9) == 360.0
    assert sees_only_the_circle(camera, surface)


def test_offset_bound():
    offsets = [sample_camera("main", np.random.default_rng(s), offset_m=1.0).position_m[0] for s in SEEDS]
    assert np.abs(offsets).max() <= 1.0


@pytest.mark.parametrize("profile", CAMERA_PROFILES)
def test_the_same_seed_gives_the_same_camera(profile):
    options = {"arc_deg": 100.0} if profile == "arc" else {}
    first, second = (sample_camera(profile, np.random.default_rng(5), **options) for _ in range(2))
    assert first.position_m.tolist() == second.position_m.tolist()
    assert first.angles_rad.tolist() == second.angles_rad.tolist()
    assert first.focal_px.tolist() == second.focal_px.tolist()


def test_wrong_use():
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match="unknown camera profile 'blimp'"):
        sample_camera("blimp", rng)
    with pytest.raises(ValueError, match="arc_deg"):
        sample_camera("arc", rng)
    with pytest.raises(ValueError, match="arc_deg"):
        sample_camera("main", rng, arc_deg=90.0)


def test_aimed_camera_sees_its_target_in_the_middle():
    camera = aim_camera(np.array([5.0, 60.0, -15.0]), np.array([-20.0, 3.0, -1.0]), 3000.0, 0.02, 1280, 720)
    np.testing.assert_allclose(camera.project([-20.0, 3.0, -1.0]), (639.5, 359.5), atol=1e-9)
    far, near = camera.project([[-20.0, 0.0, 0.0], [-20.0, 10.0, 0.0]])
    assert far[1] < near[1]

"""Every profile: its paint lies where the truth of the delivered picture says, and it shows what it promises."""

import cv2
import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.synthetic.cameras import inside_frame
from circlecal.synthetic.negatives import NEGATIVE_KINDS, negative_scene
from circlecal.synthetic.paint import CIRCLE_CLASS
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import SCENE_PROFILES, profile_field, render_frame, sample_scene
from circlecal.synthetic.surface import Surface

POSITIVE = [p for p in SCENE_PROFILES if p != "negative"]
SIZE = (960, 540)
OFFSETS_PX = np.arange(-5.0, 5.01, 0.25)


def drawn(profile, seed=0):
    return render_frame(profile, np.random.default_rng([41, seed]), *SIZE)


def rim(truth, angles):
    """Pixels (N, 2) of the circle's centreline by the truth alone."""
    template = load_field(truth.field_name)
    circle = template.circle_by_name[template.default_circle]
    radius = template.radius(circle, "center", truth.marking_width_m)
    surface = Surface(truth.crown_m, truth.crown_shape, truth.crown_reference_m)
    ring = np.asarray(circle.center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return truth.camera.project(surface.lift(ring))


def cross_profile(rendering):
    """Mean colour contrast across the circle's paint where it is seen, at OFFSETS_PX along the normals, 0..1."""
    truth = rendering.truth
    angles = np.linspace(0, 2 * np.pi, 1440, endpoint=False)
    sites = rim(truth, angles)
    tangent = rim(truth, angles + 1e-4) - rim(truth, angles - 1e-4)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(tangent, axis=1)[:, None]
    near = np.round(sites).astype(int)
    inside = inside_frame(sites, truth.camera.width, truth.camera.height, 8.0)
    shown = np.zeros(len(sites), dtype=bool)
    shown[inside] = truth.classes[near[inside, 1], near[inside, 0]] == CIRCLE_CLASS
    grid = sites[shown, None] + OFFSETS_PX[:, None] * normal[shown, None]
    columns, rows = (np.ascontiguousarray(grid[..., k], dtype=np.float32) for k in (0, 1))
    colour = cv2.remap(rendering.image.astype(np.float32), columns, rows, cv2.INTER_LINEAR)
    ground = np.median(colour[:, np.abs(OFFSETS_PX) > 4.0], axis=1, keepdims=True)
    contrast = np.mean(colour - ground, axis=0)
    towards = contrast[np.abs(OFFSETS_PX) < 0.6].mean(axis=0)
    return contrast @ towards / np.linalg.norm(towards), int(shown.sum())


@pytest.mark.parametrize("profile", POSITIVE)
def test_paint_lies_on_the_projected_circle(profile):
    profiles, sites = zip(*(cross_profile(drawn(profile, seed)) for seed in range(2)), strict=True)
    for contrast, count in zip(profiles, sites, strict=True):
        assert count > 100
        peak = contrast.max()
        assert peak > 4.0
        high = np.where(contrast > 0.5 * peak, contrast, 0.0)
        assert abs(np.sum(high * OFFSETS_PX) / np.sum(high)) < 0.4


@pytest.mark.parametrize("profile", POSITIVE)
def test_truth_of_the_delivered_picture(profile):
    truth = drawn(profile).truth
    x0, y0, x1, y1 = truth.picture_box_px
    assert -1 <= x0 < x1 <= truth.camera.width
    assert -1 <= y0 < y1 <= truth.camera.height
    pixels = rim(truth, np.linspace(0, 2 * np.pi, 720, endpoint=False))
    with np.errstate(invalid="ignore"):
        inside = (pixels >= (x0, y0)).all(axis=1) & (pixels <= (x1, y1)).all(axis=1)
    assert abs(inside.mean() * 360 - truth.visible_circle_deg) < 6.0
    np.testing.assert_allclose(truth.camera.homography, truth.H_image_field)
    assert truth.field_name == profile_field(profile)


def test_archive_has_oblong_pixels_fields_and_blocks():
    scenes = [sample_scene("archive", np.random.default_rng([5, seed]), *SIZE) for seed in range(24)]
    sizes = {(s.camera.width, s.camera.height) for s in scenes}
    assert {(398, 224), (720, 576)} <= sizes
    aspects = {round(float(s.camera.focal_px[1] / s.camera.focal_px[0]), 3) for s in scenes}
    assert {1.0, 1.067, 1.422} <= aspects
    assert any(s.delivery.interlace_px for s in scenes)
    assert all(s.delivery.block_quality and s.delivery.chroma_step > 1 for s in scenes)
    combed = next(s for s in scenes if abs(s.delivery.interlace_px) > 3)
    image = render(combed, np.random.default_rng(0)).image.astype(np.float64).mean(axis=2)
    assert np.abs(image[1:-1] - (image[:-2] + image[2:]) / 2).mean() > 1.3 * np.abs(image[2:] - image[:-2]).mean() / 2


def test_letterbox_has_bars_in_a_frame_of_the_size_asked_for():
    for seed in range(4):
        rendering = drawn("letterbox", seed)
        assert rendering.image.shape == (SIZE[1], SIZE[0], 3)
        x0, y0, x1, y1 = rendering.truth.picture_box_px
        assert (x1 - x0 + 1) * (y1 - y0 + 1) < 0.97 * SIZE[0] * SIZE[1]
        middle = np.array([(x0 + x1) / 2, (y0 + y1) / 2])
        np.testing.assert_allclose(rendering.truth.camera.principal_point_px, middle)


def test_behind_the_goal_the_halfway_line_runs_across():
    for seed in range(3):
        camera = sample_scene("behind_goal", np.random.default_rng([6, seed]), *SIZE).camera
        across = camera.project([[0.0, 5.0, 0.0], [0.0, -5.0, 0.0]])
        along = np.abs(across[1] - across[0])
        assert along[0] > 3 * along[1]


def test_short_arcs_and_missing_halfway_lines():
    for seed in range(3):
        short = drawn("short_arc", seed).truth
        assert 55 <= short.visible_circle_deg <= 145
        assert short.halfway_px >= 95
        without = drawn("no_halfway", seed).truth
        assert without.halfway_px == 0
        assert without.visible_circle_deg >= 70


@pytest.mark.parametrize("kind", NEGATIVE_KINDS)
def test_negatives_show_no_circle_and_say_what_they_are(kind):
    template = load_field("soccer")
    rendering = render(negative_scene(np.random.default_rng(3), SIZE, template, kind), np.random.default_rng(0))
    assert rendering.truth.kind == kind
    assert rendering.truth.visible_circle_deg == 0.0
    assert rendering.truth.expect == "refuse"
    assert not np.any(rendering.truth.classes == CIRCLE_CLASS)
    assert rendering.image.std() > 4.0


def test_negatives_are_varied():
    kinds = [sample_scene("negative", np.random.default_rng([7, seed]), *SIZE).kind for seed in range(150)]
    assert set(kinds) == set(NEGATIVE_KINDS)

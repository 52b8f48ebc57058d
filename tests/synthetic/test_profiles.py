"""Every profile: its paint lies where the truth of the delivered picture says, and it shows what it promises."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from circlecal.field import Mark, load_field
from circlecal.geometry.surface import FLAT
from circlecal.synthetic.alterations import ALTERATIONS, alter
from circlecal.synthetic.cameras import aim_camera, inside_frame
from circlecal.synthetic.decals import Decal, draw_decals, plain
from circlecal.synthetic.delivery import cut_out
from circlecal.synthetic.floors import rink_paint, rugby_paint
from circlecal.synthetic.goals import draw_goals
from circlecal.synthetic.looks import sample_config
from circlecal.synthetic.negatives import NEGATIVE_KINDS, negative_scene
from circlecal.synthetic.paint import CIRCLE_CLASS
from circlecal.synthetic.rays import pixel_rays
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import SCENE_PROFILES, profile_field, render_frame, sample_scene
from circlecal.synthetic.scene import Graphics
from tests.folded import projected_without_fold

POSITIVE = [p for p in SCENE_PROFILES if p not in ("negative", "altered")]
WORLD = [p for p in SCENE_PROFILES if p.startswith("world_")]
SIZE, SMALL = (960, 540), (640, 360)
OFFSETS_PX = np.arange(-5.0, 5.01, 0.25)


def drawn(profile, seed=0, size=SIZE):
    return render_frame(profile, np.random.default_rng([41, seed]), *size)


def rim(truth, angles):
    """Pixels (N, 2) of the circle's centreline by the truth alone."""
    painted = truth.painted
    circle = painted.circle_by_name[painted.default_circle]
    radius = painted.radius(circle, "center", truth.marking_width_m)
    surface = truth.surface
    ring = np.asarray(circle.center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return truth.camera.project(surface.lift(ring))


def cross_profile(rendering, quarter):
    """Mean colour contrast across a quarter of the circle's paint where it is seen, at OFFSETS_PX along the normals,
    and at how many places that is. All round, paint that is shifted as a whole would lie in its place on average.
    """
    truth = rendering.truth
    angles = np.linspace(0, np.pi / 2, 360, endpoint=False) + quarter * np.pi / 2
    sites = rim(truth, angles)
    tangent = rim(truth, angles + 1e-4) - rim(truth, angles - 1e-4)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1) / np.linalg.norm(tangent, axis=1)[:, None]
    near = np.round(sites).astype(int)
    inside = inside_frame(sites, truth.camera.width, truth.camera.height, 8.0)
    shown = np.zeros(len(sites), dtype=bool)
    shown[inside] = truth.classes[near[inside, 1], near[inside, 0]] == CIRCLE_CLASS
    if not shown.any():
        return None, 0
    grid = sites[shown, None] + OFFSETS_PX[:, None] * normal[shown, None]
    columns, rows = (np.ascontiguousarray(grid[..., k], dtype=np.float32) for k in (0, 1))
    colour = cv2.remap(rendering.image.astype(np.float32), columns, rows, cv2.INTER_LINEAR)
    ground = np.median(colour[:, np.abs(OFFSETS_PX) > 4.0], axis=1, keepdims=True)
    contrast = np.mean(colour - ground, axis=0)
    towards = contrast[np.abs(OFFSETS_PX) < 0.6].mean(axis=0)
    return contrast @ towards / np.linalg.norm(towards), int(shown.sum())


@pytest.fixture(scope="module", params=POSITIVE)
def rendering(request):
    """A frame of a profile, for all tests of it."""
    return request.param, drawn(request.param, size=SMALL)


def test_paint_lies_on_the_projected_circle(rendering):
    profile, first = rendering
    off_px = []
    for found in (first, drawn(profile, seed=1, size=SMALL)):
        quarters = [cross_profile(found, quarter) for quarter in range(4)]
        assert sum(count for _, count in quarters) > 100
        for contrast in (contrast for contrast, count in quarters if count > 50):
            peak = contrast.max()
            assert peak > 4.0
            high = np.where(contrast > 0.5 * peak, contrast, 0.0)
            off_px.append(abs(np.sum(high * OFFSETS_PX) / np.sum(high)))
    # players and other markings stand in some quarters
    assert np.median(off_px) < 0.3


def test_a_part_of_a_picture_points_beside_its_middle():
    for seed in range(4):
        scene = sample_scene("cut", np.random.default_rng(seed), *SIZE)
        width, height = scene.camera.width, scene.camera.height
        assert (0.54 * SIZE[0] < width < 0.86 * SIZE[0]) and (0.54 * SIZE[1] < height < 0.86 * SIZE[1])
        # the middle of the whole picture lies as far from its first pixel as that is cut off
        first = (np.array(SIZE) - 1) / 2 - scene.camera.principal_point_px
        assert (first >= -1e-9).all() and (first + np.array([width, height]) <= np.array(SIZE) + 1e-9).all()


def test_a_cut_view_sees_every_point_where_the_whole_one_did():
    whole = sample_scene("broadcast", np.random.default_rng(3), *SIZE).camera
    part = cut_out(replace(whole, kappa=np.array([0.04, 0.01])), (120, 80), 600, 400)
    points = np.array([[0.0, 0.0, 0.0], [9.0, 3.0, 0.0], [-9.0, -3.0, 0.0], [20.0, -20.0, 0.0]])
    expected = replace(whole, kappa=np.array([0.04, 0.01])).project(points) - (120, 80)
    np.testing.assert_allclose(part.project(points), expected, atol=1e-9)


def test_truth_of_the_delivered_picture(rendering):
    profile, truth = rendering[0], rendering[1].truth
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


def test_a_circle_needs_a_line_through_its_middle_or_two_beside_it():
    truth = drawn("no_halfway", 0).truth
    least = 0.08 * SIZE[0]
    for others, expected in (((), "refuse"), ((900.0,), "refuse"), ((900.0, 0.9 * least), "refuse")):
        assert replace(truth, others_px=others).expect == expected
        assert replace(truth, others_px=others, halfway_px=1.1 * least).expect == "calibrate"
    assert replace(truth, others_px=(900.0, 1.1 * least)).expect == "calibrate"
    assert replace(truth, others_px=(900.0, 900.0), visible_circle_deg=40.0).expect == "refuse"
    assert truth.to_json()["others_px"] == sorted(truth.others_px, reverse=True)


@pytest.mark.parametrize("kind", NEGATIVE_KINDS)
def test_negatives_show_no_circle_and_say_what_they_are(kind):
    template = load_field("soccer")
    rendering = render(negative_scene(np.random.default_rng(3), SMALL, template, kind), np.random.default_rng(0))
    assert rendering.truth.kind == kind
    assert rendering.truth.visible_circle_deg == 0.0
    assert rendering.truth.expect == "refuse"
    assert not np.any(rendering.truth.classes == CIRCLE_CLASS)
    assert rendering.image.std() > 4.0


def test_negatives_are_varied():
    kinds = [sample_scene("negative", np.random.default_rng([7, seed]), *SIZE).kind for seed in range(150)]
    assert set(kinds) == set(NEGATIVE_KINDS)


def test_fields_of_the_world_are_of_any_size_flat_or_crowned():
    scenes = [sample_scene(p, np.random.default_rng([8, seed]), *SIZE) for p in WORLD for seed in range(8)]
    width, length = (np.array([getattr(s.template, name) for s in scenes]) for name in ("width_m", "length_m"))
    assert width.min() < 52 < 83 < width.max() <= 90
    assert length.min() < 95 < 115 < length.max() <= 120
    assert 0.2 < np.mean([s.surface.shape == "flat" for s in scenes]) < 0.8
    kappa = np.array([s.camera.kappa[0] for s in scenes])
    assert -0.03 <= kappa.min() < 0 < 0.05 < kappa.max() <= 0.08
    truth = render(scenes[0], np.random.default_rng(0)).truth
    assert truth.to_json()["field_sizes"]["width"] == scenes[0].template.width_m
    assert truth.template == scenes[0].template


def test_banners_cover_bands_of_the_picture():
    scene = sample_scene("world_banners", np.random.default_rng(9), *SIZE)
    assert scene.config.graphics.banners >= 1
    bare = replace(scene, config=scene.config.model_copy(update={"graphics": Graphics(), "scorebug": False}))
    with_banner, without = (render(s, np.random.default_rng(0)).image.astype(int) for s in (scene, bare))
    changed = np.abs(with_banner - without).max(axis=2) > 8
    assert changed.mean(axis=1).max() > 0.5


@pytest.mark.parametrize("kind", ALTERATIONS)
def test_altered_pictures_promise_nothing(kind):
    shown = drawn("easy")
    image, truth = alter(shown.image, shown.truth, kind, np.random.default_rng(0))
    assert image.shape == shown.image.shape
    assert not np.array_equal(image, shown.image)
    assert (truth.kind, truth.expect, truth.visible_circle_deg) == (kind, "refuse", 0.0)
    assert not truth.classes.any()
    if kind == "shuffled":
        assert image[: SIZE[1] // 2 * 2].sum() == shown.image[: SIZE[1] // 2 * 2].sum()


def test_lines_of_other_sports_are_no_markings_of_the_field():
    scene = sample_scene("colours", np.random.default_rng(1), *SIZE)
    template = load_field("soccer")
    bare, painted = (
        render(replace(scene, extras=extras), np.random.default_rng(0))
        for extras in ((), rugby_paint(template, np.random.default_rng(2)))
    )
    assert np.array_equal(bare.truth.classes, painted.truth.classes)
    changed = np.abs(bare.image.astype(int) - painted.image).max(axis=2) > 20
    assert 500 < changed.sum() < 0.2 * changed.size


def test_pictures_on_the_ground_lie_where_they_should():
    camera = sample_scene("ice", np.random.default_rng(4), *SIZE).camera
    rays = pixel_rays(camera, FLAT)
    ground = np.zeros((SIZE[1], SIZE[0], 3), dtype=np.float32)
    draw_decals(ground, rays, (Decal(plain(np.full(3, 200.0)), (1.0, -2.0), (4.0, 3.0), 1.0),))
    x, y = camera.back_project(np.stack(np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1])), -1).astype(float)).T
    with np.errstate(invalid="ignore"):
        deep, off = (((np.abs(x - 1.0) < 2.0 + s) & (np.abs(y + 2.0) < 1.5 + s)).T for s in (-0.2, 0.2))
    assert deep.sum() > 100
    assert ground[deep].min() > 150
    assert ground[~off].max() == 0


def test_goals_hide_markings_with_their_posts_only():
    scene = negative_scene(np.random.default_rng(2), SIZE, load_field("soccer"), "behind_net")
    camera = aim_camera(np.array([70.0, 1.0, -6.0]), np.array([52.0, 0.0, -1.0]), 900.0, 0.0, *SIZE)
    scene = replace(scene, camera=camera, players=())
    picture = np.zeros((SIZE[1], SIZE[0], 3), dtype=np.float32)
    hidden = np.zeros(picture.shape[:2], dtype=np.float32)
    draw_goals(picture, hidden, scene)
    crossbar = np.round(camera.project([52.44, 1.2, -2.44])).astype(int)
    assert hidden[crossbar[1], crossbar[0]] == 1.0
    assert picture[crossbar[1], crossbar[0]].min() > 200
    assert np.sum(picture[..., 0] > 20) > 2 * np.sum(hidden > 0.1)


def test_a_barrel_lens_does_not_fold_the_field_back():
    camera = replace(
        aim_camera(np.array([0.0, 60.0, -15.0]), np.zeros(3), 500.0, 0.0, *SIZE), kappa=np.array([-0.1, 0.0])
    )
    far_aside = np.array([[120.0, 20.0, 0.0], [0.0, 0.0, 0.0]])
    assert inside_frame(projected_without_fold(camera, far_aside), *SIZE).all()
    assert inside_frame(camera.project(far_aside), *SIZE).tolist() == [False, True]


def test_shade_darkens_ground_paint_and_players_but_casts_no_second_shadow():
    rng = np.random.default_rng(5)
    scene = sample_scene("broadcast", rng, *SIZE)
    dark = {"shade": 0.6, "shade_edge_m": 400.0, "exposure": 1.0, "shadow_strength": 0.5, "noise": 0.0}
    shaded, bare = (
        render(replace(scene, config=scene.config.model_copy(update={**dark, **more})), np.random.default_rng(0)).image
        for more in ({}, {"shadow_strength": 0.0})
    )
    assert np.array_equal(shaded, bare)
    lit = render(replace(scene, config=scene.config.model_copy(update={"shade": 0.0})), np.random.default_rng(0)).image
    rows = rim_rows(scene)
    assert 0.3 < shaded[rows].mean() / lit[rows].mean() < 0.5


def rim_rows(scene):
    """Rows of the picture about the centre mark."""
    row = int(scene.camera.project([0.0, 0.0])[1])
    return slice(row - 10, row + 10)


def test_both_fields_show_the_same_players_and_score():
    scene = next(
        s
        for s in (sample_scene("archive", np.random.default_rng([5, seed]), *SIZE) for seed in range(24))
        if s.delivery.interlace_px and s.config.scorebug and len(s.players) > 4
    )
    delivery = scene.delivery.model_copy(update={"interlace_px": 1e-6, "block_quality": None})
    config = scene.config.model_copy(update={"noise": 0.0})
    frame = render(replace(scene, delivery=delivery, config=config), np.random.default_rng(0)).image.astype(float)
    teeth = np.abs(frame[1:-1] - (frame[:-2] + frame[2:]) / 2).mean()
    calm = delivery.model_copy(update={"interlace_px": 0.0})
    still = render(replace(scene, delivery=calm, config=config), np.random.default_rng(0)).image.astype(float)
    assert teeth == pytest.approx(np.abs(still[1:-1] - (still[:-2] + still[2:]) / 2).mean(), rel=0.05)


def test_a_rinks_spots_are_painted_once():
    """They are the template's: rounder numbers would paint those of the neutral zone a second time, 15 cm off."""
    (paint,) = rink_paint(load_field("ice-hockey"), np.random.default_rng(0))
    assert not any(isinstance(element, Mark) for element in paint.elements)


def test_every_look_of_shade_can_be_rendered():
    """Slopes are drawn from a normal distribution, whose tails lie beyond what the renderer takes."""
    slopes = [sample_config("shade", np.random.default_rng(seed), 1280).shade_tilt for seed in range(1500)]
    assert max(np.abs(slopes)) == 2.0

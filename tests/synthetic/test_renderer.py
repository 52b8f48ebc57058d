"""Rendered markings lie where the projection says, and the truth agrees with the picture."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from circlecal.field import field_names, load_field
from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.cameras import aim_camera, inside_frame, sample_camera, soccer
from circlecal.synthetic.paint import CIRCLE_CLASS, CLASS_NAMES, HALFWAY_CLASS, paint_layers
from circlecal.synthetic.renderer import render
from circlecal.synthetic.sampling import SCENE_PROFILES, render_frame, sample_scene
from circlecal.synthetic.scene import RenderConfig, Scene
from tests.folded import projected_without_fold

SMALL = (960, 540)


def clean_scene(camera, surface, width_m=0.12, template=None):
    config = RenderConfig(marking_width_m=width_m, paint_opacity=1.0).clean()
    return Scene(camera, template or soccer(), surface, config)


def paint_share(image):
    """Share of paint (H, W) from the blue channel of a clean frame."""
    config = RenderConfig()
    return (image[..., 0].astype(np.float64) - config.turf_bgr[0]) / (config.paint_bgr[0] - config.turf_bgr[0])


def curve(camera, surface, edge, angles, width_m=0.12):
    """Pixels (N, 2) of one edge of the circle's paint at field angles (N,)."""
    circle = soccer().circle_by_name["centre_circle"]
    ring = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    return camera.project(surface.lift(soccer().radius(circle, edge, width_m) * ring))


def along_normals(dense, sites, tangent, normal):
    """Where a dense curve (K, 2) crosses the normals of sites (N, 2), pixels along the normal (N,)."""
    offset = dense[None] - sites[:, None]
    t, n = (np.einsum("nki,ni->nk", offset, direction) for direction in (tangent, normal))
    nearest = np.argmin(np.abs(t) + 1e3 * (np.abs(n) > 25.0), axis=1)[:, None] % (len(dense) - 1)
    t0, t1, n0, n1 = (np.take_along_axis(v, nearest + k, axis=1)[:, 0] for v in (t, n) for k in (0, 1))
    return n0 - t0 * (n1 - n0) / (t1 - t0)


def measured_edges(image, camera, surface, angles):
    """Errors (N, 2) of outer and inner edge along the normals, from flux and centroid across the paint."""
    sites = curve(camera, surface, "center", angles)
    tangent = curve(camera, surface, "center", angles + 1e-4) - curve(camera, surface, "center", angles - 1e-4)
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=-1)
    around = np.linspace(0, 2 * np.pi, 20001)
    dense = [curve(camera, surface, edge, around) for edge in ("outer", "inner")]
    true = np.stack([along_normals(points, sites, tangent, normal) for points in dense], axis=-1)
    reach = np.abs(true).max() + 3.0
    offsets = np.linspace(-reach, reach, 1501)
    grid = sites[:, None] + offsets[:, None] * normal[:, None]
    profile = map_coordinates(paint_share(image), [grid[..., 1], grid[..., 0]], order=3, mode="nearest")
    flux = profile.sum(axis=1) * (offsets[1] - offsets[0])
    center = (profile * offsets).sum(axis=1) / profile.sum(axis=1)
    half = np.sign(true[:, 0] - true[:, 1]) * flux / 2
    return np.stack([center + half, center - half], axis=-1) - true


@pytest.mark.parametrize("profile", ["main", "broadcast", "partial"])
@pytest.mark.parametrize(
    ("surface", "kappa"),
    [(FLAT, 0.0), (Surface(crown_m=0.08), 0.05), (Surface("roof", crown_m=0.05), -0.01)],
    ids=str,
)
def test_edges_of_the_circle(profile, surface, kappa):
    camera = sample_camera(profile, np.random.default_rng(21), kappa=kappa, surface=surface)
    image = render(clean_scene(camera, surface), np.random.default_rng(0)).image
    angles = np.radians(np.arange(0.0, 360.0, 1.5))
    away_from_halfway_line = np.abs(np.cos(angles)) > 0.2
    pixels = curve(camera, surface, "outer", angles)
    inside = (np.abs(pixels - (959.5, 539.5)) < (940, 520)).all(axis=1)
    errors = measured_edges(image, camera, surface, angles[inside & away_from_halfway_line])
    assert len(errors) > 60
    assert np.abs(errors).max() < 0.05
    assert np.abs(errors.mean(axis=0)).max() < 0.005
    assert errors.std() < 0.012


def test_halfway_line_and_center_mark():
    surface = Surface(crown_m=0.05)
    camera = sample_camera("main", np.random.default_rng(4), kappa=0.03, surface=surface)
    share = paint_share(render(clean_scene(camera, surface), np.random.default_rng(0)).image)
    y = np.linspace(1.0, 4.0, 40)
    sides = [camera.project(surface.lift(np.stack([np.full(40, x), y], axis=-1))) for x in (-0.06, 0.06)]
    rows = np.round((sides[0][:, 1] + sides[1][:, 1]) / 2)[1:-1]
    middle = np.interp(rows, *((sides[0] + sides[1]) / 2).T[::-1])
    columns = np.arange(camera.width)
    near = np.abs(columns - middle[:, None]) < 30
    profile = share[rows.astype(int)] * near
    centroid = (profile * columns).sum(axis=1) / profile.sum(axis=1)
    assert np.abs(centroid - middle).max() < 0.02
    mark = camera.project(surface.lift([0.0, 0.0]))
    beside = camera.project(surface.lift([[0.095, 0.0], [-0.095, 0.0], [0.2, 0.0]]))
    at = cv2.remap(share, *(beside.astype(np.float32).T), cv2.INTER_LINEAR).ravel()
    assert np.isfinite(mark).all()
    assert at[0] > 0.5
    assert at[1] > 0.5
    assert at[2] < 0.1


@pytest.mark.parametrize("profile", SCENE_PROFILES)
def test_frames_and_truth(profile):
    rng = np.random.default_rng([3, 1])
    rendering = render_frame(profile, rng, *SMALL)
    truth = rendering.truth
    assert rendering.image.shape == (truth.camera.height, truth.camera.width, 3)
    assert rendering.image.dtype == np.uint8
    assert truth.classes.shape == rendering.image.shape[:2]
    if profile not in ("archive", "cut"):
        assert rendering.image.shape == ((1080, 1920, 3) if profile == "uhd" else (540, 960, 3))
    circle_pixels = np.sum(truth.classes == CIRCLE_CLASS)
    record = truth.to_json()
    assert record["circle_pixels"] == circle_pixels
    if profile in ("negative", "altered"):
        assert circle_pixels == 0
        assert truth.visible_circle_deg == 0.0
        assert truth.expect == "refuse"
        return
    assert circle_pixels > 60
    assert truth.expect == "calibrate" or profile == "no_halfway"
    H = truth.H_image_field
    center = H @ np.r_[truth.template.circle_by_name[truth.template.default_circle].center, 1.0]
    np.testing.assert_allclose(truth.imaged_center_undistorted_px, center[:2] / center[2], atol=1e-9)
    np.testing.assert_allclose(truth.camera.distort(truth.imaged_center_undistorted_px), truth.imaged_center_px)
    assert {"easy": {"visible"}, "hidden_mark": {"hidden", "not_painted"}}.get(profile, {truth.center_mark}) >= {
        truth.center_mark
    }


@pytest.mark.parametrize("seed", range(6))
def test_hidden_marks_are_hidden_and_easy_ones_are_not(seed):
    for profile, states in (("hidden_mark", {"hidden", "not_painted"}), ("easy", {"visible"})):
        rng = np.random.default_rng([8, seed])
        assert render_frame(profile, rng, 640, 360).truth.center_mark in states


def test_mask_agrees_with_the_picture():
    camera = sample_camera("broadcast", np.random.default_rng(2))
    rendering = render(clean_scene(camera, FLAT), np.random.default_rng(0))
    classes, share = rendering.truth.classes, paint_share(rendering.image)
    for class_id in (CIRCLE_CLASS, HALFWAY_CLASS):
        assert share[classes == class_id].min() > 0.15
    on_field = camera.back_project(np.stack(np.meshgrid(np.arange(1920), np.arange(1080)), axis=-1).astype(float))
    radius = np.linalg.norm(on_field, axis=-1)
    near_circle = np.abs(radius - 9.09) < 0.04
    assert np.mean(classes[near_circle & (np.abs(on_field[..., 0]) > 0.5)] == CIRCLE_CLASS) > 0.98
    assert not np.any((classes == CIRCLE_CLASS) & (np.abs(radius - 9.09) > 0.5))


def test_players_are_not_in_the_mask():
    rng = np.random.default_rng([3, 5])
    scene = sample_scene("hard", rng, *SMALL)
    seen = render(scene, np.random.default_rng(0)).truth.classes
    bare = Scene(scene.camera, scene.template, scene.surface, scene.config.model_copy(update={"scorebug": False}))
    empty = render(bare, np.random.default_rng(0)).truth.classes
    assert np.all((seen == empty) | (seen == 0))
    assert np.sum(seen > 0) < np.sum(empty > 0)


def test_the_same_seed_gives_the_same_frame():
    first, second = (render_frame("hard", np.random.default_rng(6), 640, 360) for _ in range(2))
    assert np.array_equal(first.image, second.image)
    assert first.truth.to_json() == second.truth.to_json()


@pytest.mark.parametrize("name", [name for name in field_names() if load_field(name).circles])
def test_every_field_template_can_be_painted(name):
    template = load_field(name)
    camera = sample_camera("broadcast", np.random.default_rng(2), *SMALL, template=soccer())
    rendering = render(clean_scene(camera, FLAT, template.marking_width_m, template), np.random.default_rng(0))
    assert np.any(rendering.truth.classes > 0)


def test_class_names():
    assert CLASS_NAMES[CIRCLE_CLASS] == "Circle central"
    assert CLASS_NAMES[HALFWAY_CLASS] == "Middle line"
    assert len(CLASS_NAMES) == 29
    assert all(e.class_name in CLASS_NAMES for e in (*soccer().circles, *soccer().arcs, *soccer().lines))


def test_look_is_checked():
    with pytest.raises(ValueError, match="noise"):
        RenderConfig(noise=-1.0)
    with pytest.raises(ValueError, match="unknown scene profile"):
        sample_scene("moon", np.random.default_rng(0))


def test_a_mark_that_a_barrel_lens_folds_into_the_picture_lies_outside_it():
    template = load_field("robocup")
    camera = aim_camera(np.array([-0.1, 0.3, -0.11]), np.array([3.0, 0.3, -0.11]), 435.0, 0.0, 800, 448, kappa=-0.08)
    assert inside_frame(projected_without_fold(camera, [0.0, 0.0]), 800, 448)
    rendering = render(Scene(camera, template, FLAT, RenderConfig()), np.random.default_rng(0))
    assert rendering.truth.center_mark == "outside"


def test_wide_paint_of_a_small_circle_is_cut_off_nowhere():
    field = load_field("robocup")
    circle = field.circle_by_name["centre_circle"]
    camera = aim_camera(np.array([0.0, 1.2, -0.9]), np.array([0.0, 0.7, 0.0]), 1500.0, 0.0, 640, 360)
    layer = next(layer for layer in paint_layers(camera, field, FLAT, 0.05) if layer.name == circle.name)
    coverage = np.zeros((360, 640))
    coverage[layer.rows, layer.columns] = layer.coverage
    ground = camera.back_project(np.stack(np.meshgrid(np.arange(640.0), np.arange(360.0)), axis=-1), FLAT)
    off_m = np.abs(np.hypot(*np.moveaxis(ground, -1, 0)) - circle.radius_m)
    assert (coverage[off_m < 0.4 * 0.05] > 0.95).all()

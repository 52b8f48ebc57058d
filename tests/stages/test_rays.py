"""Inner edge, outer edge and centreline by casting rays."""

import cv2
import numpy as np
import pytest

from circlecal.errors import EstimationError
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, theta_of
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic, orthogonal_distance
from circlecal.geometry.surface import FLAT, Surface
from circlecal.paint.along_curve import RaysConfig, leave_out_single, measure_along_model
from circlecal.paint.bands import Bands
from circlecal.paint.predicted_width import predict_paint_widths
from circlecal.paint.profiles import to_gray
from circlecal.results import EdgePoints, MarkingMask
from circlecal.stages.edges import EdgesConfig, detect_edges
from circlecal.stages.rays import _along, _Centreline, _pair_edges, cast_rays, even_angles
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.paint import paint_layers

from .conftest import CIRCLE, SOCCER, WIDTH_M, Painted, developed, paint, paint_field, view

NEAR = view(position=(4.0, 40.0, -22.0), focal=2300.0)
RELATIVE = WIDTH_M / SOCCER.radius(CIRCLE, "center")


def cast(painted, image=None, config=RaysConfig(), marking=None, polarity=1.0):
    image = painted.image if image is None else image
    marking = painted.marking() if marking is None else marking
    picture = to_gray(~image if polarity < 0 else image)
    edges = detect_edges(picture, marking, EdgesConfig())
    return cast_rays(picture, edges, marking, RELATIVE, config, np.random.default_rng(1))


def distances(painted, points, edge):
    return orthogonal_distance(ellipse_from_conic(painted.conic(edge)), points)


@pytest.fixture(scope="module")
def painted() -> Painted:
    return paint(NEAR, noise=1.5)


@pytest.fixture(scope="module")
def found(painted):
    return cast(painted)


@pytest.mark.parametrize(("edge", "name"), [("outer", "outer"), ("inner", "inner"), ("center", "center_line")])
def test_points_lie_on_their_edge(painted, found, edge, name):
    points, sigma = getattr(found, f"{name}_px"), getattr(found, f"{name}_sigma_px")
    distance = distances(painted, points, edge)
    assert len(points) > 400
    assert sigma.shape == (len(points),)
    assert abs(np.median(distance)) < 0.08
    assert np.sqrt(np.mean(distance**2)) < 0.25
    assert np.abs(distance).max() < 1.5
    # bloom is part of the edges' error; all have a floor, for what paint and grass leave
    assert np.sqrt(np.mean(distance**2)) < 2.0 * np.sqrt(np.mean(sigma**2))


def test_outer_and_inner_points_are_those_of_the_same_rays(found):
    assert len(found.outer_px) == len(found.inner_px) <= found.rays
    gap = np.linalg.norm(found.outer_px - found.inner_px, axis=1)
    assert (gap > 1.0).all()
    assert (gap < 20.0).all()


def test_the_rough_centre_is_estimated_once_more(painted):
    ellipse = ellipse_from_conic(painted.conic())
    rough = type(ellipse)(
        ellipse.center + np.array([2.0, 1.5]), (ellipse.semi_axes[0] - 2, ellipse.semi_axes[1] + 1), 0.0
    )
    found = cast(painted, marking=painted.marking(conic=conic_from_ellipse(rough)))
    np.testing.assert_allclose(found.center_px, ellipse.center, atol=0.2)


def test_far_away_only_the_centreline_is_claimed():
    """The marking is narrower than the blur: two edges would be a fiction."""
    far = paint(view(position=(6.0, 85.0, -10.0), focal=2600.0), noise=1.0, blur=1.2)
    found = cast(far)
    assert len(found.center_line_px) > 300
    assert abs(np.median(distances(far, found.center_line_px, "center"))) < 0.05
    angles = ellipse_from_conic(far.conic()).parameter(found.outer_px)
    # near and far piece of the outline, where the band is thinnest
    assert not (np.abs(np.sin(angles)) > 0.7).any()


def with_player(painted, angle):
    """A player's legs on the circle, and where (x, y) they stand."""
    image = painted.image.copy()
    x, y = ellipse_from_conic(painted.conic()).points(angle)
    left, top = round(x) - 12, round(y) - 60
    cv2.rectangle(image, (left, top), (left + 24, top + 75), (250, 250, 250), -1)
    return image, (left, top, left + 24, top + 75)


@pytest.mark.parametrize("angle", [0.7, 1.6, 4.0, 3.2])
def test_a_player_on_the_circle_is_rejected(painted, found, angle):
    image, (left, top, right, bottom) = with_player(painted, angle)

    def behind_the_player(rays):
        points = np.concatenate([rays.outer_px, rays.inner_px, rays.center_line_px])
        inside = (points >= (left + 2, top + 2)) & (points <= (right - 2, bottom - 2))
        return int(inside.all(axis=1).sum())

    with_him = cast(painted, image)
    assert behind_the_player(found) >= 8
    assert behind_the_player(with_him) <= 2
    assert len(with_him.center_line_px) > len(found.center_line_px) - 60
    for name, edge in (("outer", "outer"), ("inner", "inner"), ("center_line", "center")):
        assert np.abs(distances(painted, getattr(with_him, f"{name}_px"), edge)).max() < 2.5


def test_paint_of_another_brightness_is_not_the_marking():
    """A white boot or a board on faint paint: as wide as the band, but much brighter than the band around it."""
    faint = paint(NEAR, noise=1.5, paint=125.0)
    bright = paint(NEAR, noise=1.5, paint=250.0)
    ellipse = ellipse_from_conic(faint.conic())
    x, y = np.round(ellipse.points(0.7)).astype(int)
    place = (slice(y - 15, y + 16), slice(x - 15, x + 16))
    image = faint.image.copy()
    image[place] = bright.image[place]
    for given, low, high in ((faint.image, 10, 40), (image, 0, 4)):
        points = cast(faint, given).center_line_px
        inside = (np.abs(points - (x, y)) < 13).all(axis=1).sum()
        assert low <= inside <= high


def test_one_edge_only_is_no_band(painted):
    """Where turf of another brightness begins at the marking's place, there is an edge but no band."""
    disc = ellipse_from_conic(painted.conic("outer"))
    image = np.full_like(painted.image, 90)
    outline = np.round(disc.points(np.linspace(0, 2 * np.pi, 720)) * 16).astype(np.int32)
    cv2.fillPoly(image, [outline], (210, 210, 210), cv2.LINE_AA, 4)
    with pytest.raises(EstimationError) as refused:
        cast(painted, image)
    assert (refused.value.stage, refused.value.code) == ("rays", "no_band")


def test_centre_outside_the_frame():
    camera = view(position=(4.0, 40.0, -22.0), target=(0.0, 15.5, 0.0), focal=2300.0)
    assert camera.project(np.zeros(2))[1] < 0
    painted = paint(camera, mark=False, noise=1.5)
    found = cast(painted)
    assert found.center_px[1] < 0
    assert len(found.center_line_px) > 150
    assert np.sqrt(np.mean(distances(painted, found.center_line_px, "center") ** 2)) < 0.1
    assert ((found.center_line_px >= 0) & (found.center_line_px <= (1279, 719))).all()


def test_a_rough_ellipse_outside_the_frame_is_no_band(painted):
    ellipse = ellipse_from_conic(painted.conic())
    away = type(ellipse)(ellipse.center + np.array([3000.0, 0.0]), ellipse.semi_axes, 0.0)
    edges = detect_edges(to_gray(painted.image), painted.marking(), EdgesConfig())
    marking = painted.marking(conic=conic_from_ellipse(away))
    with pytest.raises(EstimationError) as refused:
        cast_rays(to_gray(painted.image), edges, marking, RELATIVE, RaysConfig(), np.random.default_rng(1))
    assert refused.value.code == "no_band"


def test_dark_markings(painted, found):
    dark = cast(painted, 255 - painted.image, polarity=-1.0)
    np.testing.assert_allclose(dark.center_line_px, found.center_line_px, atol=0.01)


def test_without_a_rough_ellipse_there_is_nothing_to_cast_at(painted):
    marking = MarkingMask(painted.marking().classes, "file")
    with pytest.raises(EstimationError) as refused:
        cast(painted, marking=marking)
    assert refused.value.code == "no_circle_found"


def test_no_band_on_bare_turf(painted):
    bare = np.random.default_rng(3).normal(90, 2, painted.image.shape).clip(0, 255).astype(np.uint8)
    edges = detect_edges(to_gray(painted.image), painted.marking(), EdgesConfig())
    with pytest.raises(EstimationError) as refused:
        cast_rays(to_gray(bare), edges, painted.marking(), RELATIVE, RaysConfig(), np.random.default_rng(1))
    assert refused.value.code == "no_band"


def test_even_angles_are_even_in_the_picture(painted):
    ellipse = ellipse_from_conic(painted.conic())
    points = ellipse.points(even_angles(ellipse, 3.0, 4096))
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    np.testing.assert_allclose(step, 3.0, rtol=0.02)
    assert len(even_angles(ellipse, 3.0, 100)) == 100


def test_a_camera_that_is_a_little_off_leads_along_the_whole_circle(painted):
    """Half the circle is enough for a camera; along its curve the other half is measured too."""
    from .test_verdict import camera_fit

    off = view(position=(4.1, 40.3, -22.2), focal=2312.0)
    model = ProjectionModel(NEAR.width, NEAR.height, Surface("flat", CIRCLE.radius_m))
    fit = camera_fit(off, theta=theta_of(off, model))
    points, sigma = measure_along_model(to_gray(painted.image), fit.view, CIRCLE, SOCCER, 1.5, RaysConfig())
    assert len(points) > 400
    assert sigma.shape == (len(points),)
    assert np.median(np.abs(distances(painted, points, "center"))) < 0.15


@pytest.mark.parametrize(("rows", "is_seen"), [(7, True), (2, False)])
def test_the_circle_is_measured_up_to_the_picture_border(painted, rows, is_seen):
    """As far as the picture shows ground beyond the paint; where it cuts the paint nothing is measured."""
    from .test_verdict import camera_fit

    curve = ellipse_from_conic(painted.conic("center")).points(np.linspace(0.0, 2 * np.pi, 721))
    lowest = float(curve[:, 1].max())
    picture = to_gray(painted.image)[: int(lowest) + rows + 1]
    points, _ = measure_along_model(picture, camera_fit(NEAR).view, CIRCLE, SOCCER, 1.5, RaysConfig())
    near = points[points[:, 1] > lowest - 1.0]
    assert (len(near) > 20) == is_seen
    assert np.abs(distances(painted, near, "center")).max(initial=0.0) < 0.25
    assert np.abs(distances(painted, points, "center").mean()) < 0.05


def test_an_arc_is_measured_between_its_ends():
    """A boot on the arc is left out; so is what lies beyond the line on which the arc ends."""
    from .test_verdict import camera_fit

    arc = SOCCER.circle_by_name["penalty_arc_left"]
    camera = view(position=(-30.0, 40.0, -22.0), target=(-33.0, 0.0, 0.0), focal=2600.0)
    layers = paint_layers(camera, SOCCER, FLAT, WIDTH_M)
    coverage = np.zeros((camera.height, camera.width))
    for layer in layers:
        coverage[layer.rows, layer.columns] = np.maximum(coverage[layer.rows, layer.columns], layer.coverage)
    image = developed(coverage, noise=1.5)
    angle = np.radians(np.linspace(arc.start_deg, arc.end_deg, 400))
    middle = np.asarray(arc.center) + SOCCER.radius(arc, "center") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    boot = camera.project(middle[200])
    cv2.circle(image, (round(float(boot[0]) + 5), round(float(boot[1]))), 4, (240, 240, 240), -1)
    model = ProjectionModel(camera.width, camera.height, Surface("flat", arc.radius_m))
    fit = camera_fit(camera, theta=theta_of(camera, model))
    points, _ = measure_along_model(to_gray(image), fit.view, arc, SOCCER, 1.5, RaysConfig())
    truth = camera.project(middle)
    distance = np.linalg.norm(points[:, None] - truth, axis=-1)
    assert len(points) > 100
    assert distance.min(axis=1).max() < 1.6
    nearest = distance.argmin(axis=1)
    assert nearest.min() >= 5
    assert nearest.max() <= 395


def test_paint_that_would_fill_the_picture_is_not_measured():
    """The outer edge lies under a camera whose barrel lens folds the middle of the paint into the picture."""
    from .test_verdict import camera_fit

    radius, focal, height, kappa = SOCCER.radius(CIRCLE, "outer"), 700.0, 0.174, -0.1
    place, ahead = np.array([-radius, 0.0, -height]), np.array([0.0, 0.0, -height])
    camera = aim_camera(place, ahead, focal, 0.0, 1280, 720, kappa)
    assert np.isnan(camera.project(np.array([-SOCCER.radius(CIRCLE, "center"), 0.0]))).all()
    fit = camera_fit(camera)
    points, sigma = measure_along_model(np.full((720, 1280), 90, np.uint8), fit.view, CIRCLE, SOCCER, 1.5, RaysConfig())
    assert (points.shape, sigma.shape) == ((0, 2), (0,))


def test_paint_that_is_wider_than_the_search_is_measured_in_its_middle():
    """A robots' circle: 5 cm of paint are up to 60 px wide, and the camera that leads there is off by half of that."""
    from .test_verdict import camera_fit

    field = load_field("robocup")
    circle = field.circle_by_name["centre_circle"]
    camera = view(position=(0.1, 1.6, -0.7), target=(0.0, 0.05, 0.0), focal=1000.0)
    image = paint_field(camera, field)
    off = view(position=(0.1, 1.63, -0.7), target=(0.0, 0.08, 0.0), focal=1000.0)
    assert predict_paint_widths(camera_fit(camera).view, circle, field).max() > 40.0
    rays = RaysConfig(search_px=15, refine_px=12)
    points, _ = measure_along_model(to_gray(image), camera_fit(off).view, circle, field, 1.5, rays)
    away = np.linalg.norm(camera_fit(camera).view.to_field(points), axis=1) - circle.radius_m
    assert len(points) > 900
    assert np.abs(away).max() < 0.1 * field.marking_width_m


def test_single_faint_bands_on_bare_ground_are_no_paint():
    """Half of a circle is painted; on the other half every fourth place shows something."""
    found = np.zeros(400, np.bool_)
    found[:200] = True
    found[60:100] = False  # a player
    found[200::4] = True
    contrast = np.where(np.arange(400) < 200, 30.0, 12.0)
    kept = leave_out_single(found, contrast, 16.0)
    assert not kept[216:].any()
    assert np.array_equal(kept[:200], found[:200])
    assert not leave_out_single(np.zeros(40, np.bool_), np.zeros(40), 16.0).any()


def test_a_short_piece_of_paint_behind_a_player_is_kept():
    found = np.zeros(400, np.bool_)
    found[:200] = True
    found[240:248] = True
    contrast = np.full(400, 30.0)
    assert leave_out_single(found, contrast, 16.0)[240:248].all()
    contrast[240:248] = 12.0
    assert not leave_out_single(found, contrast, 16.0)[240:248].any()


def test_evenly_worn_paint_is_kept():
    found = np.random.default_rng(0).random(400) < 0.3
    assert np.array_equal(leave_out_single(found, np.full(400, 20.0), 16.0), found)


def test_rough_grass_where_paint_is_worn_off_is_not_measured(painted):
    """The far half of the circle is gone; the grass there is as rough as grass is."""
    rng = np.random.default_rng(4)
    center = ellipse_from_conic(painted.conic("center")).center
    grass = cv2.GaussianBlur(rng.normal(0.0, 1.0, painted.image.shape[:2]), (0, 0), 1.2)
    image = painted.image.astype(np.float64)
    far = slice(0, int(center[1]))
    image[far] = np.median(image.reshape(-1, 3), axis=0) + 6.0 * (grass / grass.std())[far, :, None]
    found = cast(painted, np.rint(image).clip(0, 255).astype(np.uint8))
    on_grass = found.center_line_px[:, 1] < center[1] - 5.0
    assert np.count_nonzero(~on_grass) > 300
    assert np.count_nonzero(on_grass) < 0.06 * len(on_grass)


def centreline_of(angles, middle_px, width_px):
    """A centreline with bands of these middles and widths (N,) at these angles (N,)."""
    nothing = np.zeros(len(angles))
    whole = np.ones(len(angles), np.bool_)
    bands = Bands(
        middle_px, middle_px - 0.5 * width_px, middle_px + 0.5 * width_px, nothing, nothing, nothing, nothing, whole
    )
    return _Centreline(np.zeros((len(angles), 2)), bands, angles, 0)


def test_the_band_between_two_measured_ones_lies_between_them_by_its_distance_from_each():
    angles = np.radians([1.0, 3.0, 4.0, 8.0, 359.5])
    centreline = centreline_of(angles, np.array([1.0, 5.0, 5.0, 5.0, 4.0]), np.array([10.0, 2.0, 2.0, 2.0, 4.0]))
    width, middle, known = _along(centreline, np.radians([1.5, 2.9, 0.0, -0.25, 5.5, 370.0]))
    np.testing.assert_allclose(middle[:4], [2.0, 4.8, 3.0, 3.5])
    np.testing.assert_allclose(width[:4], [8.0, 2.4, 6.0, 5.0])
    np.testing.assert_array_equal(known, [True, True, True, True, False, False])


@pytest.mark.parametrize(("aside_px", "is_pair"), [(0.0, True), (1.6, True), (2.0, False), (-2.0, False)])
def test_a_pair_of_edges_beside_the_measured_band_is_not_its_own(aside_px, is_pair):
    """A band 3 px wide: the middle of its edges may lie 1.75 px off that of its flux."""
    circle, gap_px, count = Ellipse(np.array([500.0, 500.0]), (200.0, 200.0), 0.0), 3.0, 100
    config = RaysConfig()
    rays = int(2 * np.pi * 200.0)
    # in the middle of rays, beyond those on which the band is as narrow as the blur
    angles = 2 * np.pi * (np.arange(300, 300 + 3 * count, 3) + 0.5) / rays
    outward = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    radii = 200.0 + aside_px + np.array([-0.5, 0.5])[:, None, None] * gap_px
    points, normals = (circle.center + radii * outward).reshape(-1, 2), np.concatenate([outward, -outward])
    edges = EdgePoints(points, normals, np.ones(2 * count), np.ones(2 * count), 1.0, 0.7, (1.0, 2.0))
    along = np.linspace(0.0, 2 * np.pi, 720, endpoint=False)
    centreline = centreline_of(along, np.zeros(720), np.where(along < 1.0, 1.0, gap_px))
    outer, inner, told, rejected = _pair_edges(edges, circle, centreline, gap_px / 200.0, config, 1.0)
    assert told == rays
    assert sorted(inner) == list(range(count if is_pair else 0))
    np.testing.assert_array_equal(outer, inner + count)
    assert len(rejected) == (0 if is_pair else 2 * count)

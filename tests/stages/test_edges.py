"""Sub-pixel Canny points."""

import numpy as np
import pytest
from pydantic import ValidationError

from circlecal.errors import EstimationError
from circlecal.geometry.ellipses import ellipse_from_conic, orthogonal_distance
from circlecal.paint.profiles import to_gray
from circlecal.results import MarkingMask
from circlecal.stages.edges import EdgesConfig, detect_edges, search_region

from .conftest import developed, paint, step_px, view

CONFIG = EdgesConfig()
PAINTED = paint(view(position=(4.0, 40.0, -22.0), focal=2300.0), line=False, mark=False, noise=1.0)


def edges_of(image, marking, config, polarity=1.0):
    return detect_edges(to_gray(~image if polarity < 0 else image), marking, config)


def whole(image):
    return MarkingMask(np.full(image.shape[:2], 7, np.uint8), "file")


def slanted_step(shift, noise=0.0, seed=0, slope=0.3, size=(200, 120), **look):
    """Picture of a straight edge ``x cos + y sin = 100 + shift``, bright on its right side."""
    x, y = np.meshgrid(np.arange(size[0], dtype=float), np.arange(size[1], dtype=float))
    distance = (x + slope * y) / np.hypot(1, slope) - 100.0 - shift
    return developed(step_px(-distance, 0.0), 0.7, noise, seed, **look)


def distance_from_step(points, shift, slope=0.3):
    return (points @ [1.0, slope]) / np.hypot(1, slope) - 100.0 - shift


def test_a_picture_full_of_edges_has_no_limit():
    noise = np.random.default_rng(0).integers(0, 256, (480, 480), dtype=np.uint8)
    found = detect_edges(noise, whole(noise), EdgesConfig(thresholds=(1.0, 2.0)))
    assert len(found.points_px) > 2**15


@pytest.mark.parametrize("shift", [0.0, 0.2, 0.5, 0.7])
def test_points_of_a_step_lie_on_it(shift):
    image = slanted_step(shift)
    found = edges_of(image, whole(image), CONFIG)
    distance = distance_from_step(found.points_px, shift)
    assert len(distance) > 100
    assert abs(distance.mean()) < 0.02
    assert distance.std() < 0.06
    # from dark to bright
    assert (found.normals @ [1.0, 0.3] > 1.0).all()
    np.testing.assert_allclose(np.linalg.norm(found.normals, axis=1), 1.0)
    assert np.median(found.contrast) == pytest.approx(120.0, rel=0.25)


def test_sigma_is_the_scatter_in_a_noisy_picture():
    spread, stated = [], []
    for seed in range(4):
        image = slanted_step(0.3, noise=12.0, seed=seed)
        found = edges_of(image, whole(image), CONFIG)
        distance = distance_from_step(found.points_px, 0.3)
        near = np.abs(distance) < 3
        assert near.mean() > 0.9
        spread.append(distance[near].std())
        stated.append(np.median(found.sigma_px))
        assert found.noise == pytest.approx(12.0, rel=0.15)
    assert 1 / 1.6 < np.mean(spread) / np.mean(stated) < 1.6, (spread, stated)


def test_both_edges_of_the_circle():
    """The band is wide against the blur, so its two edges stay apart; blur moves each by a few hundredths."""
    found = edges_of(PAINTED.image, PAINTED.marking(), CONFIG)
    for edge in ("outer", "inner"):
        distance = orthogonal_distance(ellipse_from_conic(PAINTED.conic(edge)), found.points_px)
        near = np.abs(distance) < 0.5
        assert near.sum() > 800
        assert abs(np.median(distance[near])) < 0.12
    middle = ellipse_from_conic(PAINTED.conic())
    inward = -middle.normals(middle.parameter(found.points_px))
    side = orthogonal_distance(middle, found.points_px)
    toward_the_paint = np.sum(found.normals * inward, axis=1) * np.sign(side)
    assert np.mean(toward_the_paint > 0.9) > 0.97


def test_blur_and_noise_of_the_picture_are_told():
    for blur in (0.6, 1.5):
        image = paint(PAINTED.camera, line=False, mark=False, blur=blur, noise=2.0).image
        found = edges_of(image, PAINTED.marking(), CONFIG)
        assert found.noise == pytest.approx(2.0, rel=0.25)
        # the picture's own blur and that of the filter together
        assert found.blur_px == pytest.approx(np.hypot(blur, 1.06), rel=0.3)


def test_given_thresholds_are_used_and_automatic_ones_told():
    faint = paint(PAINTED.camera, line=False, mark=False, paint=104.0, noise=1.0)
    automatic = edges_of(faint.image, faint.marking(), CONFIG)
    assert len(automatic.points_px) > 1000
    low, high = automatic.thresholds
    assert 0 < low < high
    given = edges_of(faint.image, faint.marking(), EdgesConfig(thresholds=(low, high)))
    np.testing.assert_array_equal(given.points_px, automatic.points_px)
    with pytest.raises(EstimationError) as refused:
        edges_of(faint.image, faint.marking(), EdgesConfig(thresholds=(30.0, 60.0)))
    assert (refused.value.stage, refused.value.code) == ("edges", "no_edges")
    strong = edges_of(PAINTED.image, PAINTED.marking(), CONFIG)
    assert strong.thresholds[1] > 2 * high


def test_thresholds_must_be_in_order():
    with pytest.raises(ValidationError, match="low one must be below"):
        EdgesConfig(thresholds=(5.0, 2.0))


def test_nothing_is_found_outside_the_mask():
    half = PAINTED.marking(conic=None)
    half.classes[:, 640:] = 0
    found = edges_of(PAINTED.image, half, EdgesConfig(dilate_px=6))
    assert len(found.points_px) > 500
    assert found.points_px[:, 0].max() < 650
    with pytest.raises(EstimationError) as refused:
        edges_of(PAINTED.image, MarkingMask(np.zeros((720, 1280), np.uint8), "file"), CONFIG)
    assert refused.value.code == "no_edges"


def test_search_region_holds_class_and_rough_ellipse():
    classes = np.zeros((720, 1280), np.uint8)
    classes[100:110, 100:110] = 7
    classes[300:310, 100:110] = 18
    found = search_region(MarkingMask(classes, "file", PAINTED.conic()), classes.shape, 5.0)
    region = np.zeros(classes.shape, bool)
    region[found.window] = found.inside
    assert region[95:115, 103].all()
    assert not region[305, 105]
    ellipse = ellipse_from_conic(PAINTED.conic())
    x, y = np.round(ellipse.points(np.linspace(0, 6.28, 50))).astype(int).T
    assert region[y, x].all()
    assert not region[tuple(np.round(ellipse.center[::-1]).astype(int))]


def test_dark_markings():
    image = 255 - PAINTED.image
    found = edges_of(image, PAINTED.marking(), CONFIG, polarity=-1.0)
    light = edges_of(PAINTED.image, PAINTED.marking(), CONFIG)
    np.testing.assert_allclose(found.points_px, light.points_px, atol=1e-3)
    np.testing.assert_allclose(found.normals, light.normals, atol=1e-3)

from dataclasses import replace

import numpy as np

from circlecal.detection.ellipse_batch import EllipseBatch
from circlecal.detection.ellipse_search import (
    ROUND_RATIO,
    EllipseSearch,
    conics_from_tangents,
    draw_ellipses,
    find_pencil_parameter,
    measure_support,
    refit_ellipses,
    select_best,
)
from circlecal.detection.options import HypothesisConfig
from circlecal.detection.ridges import RidgePoints, RidgeRaster
from circlecal.geometry.conics import conic_from_coefficients, normalise_conic
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse

ELLIPSE = Ellipse(np.array([0.2, -0.1]), (0.7, 0.25), 0.4)
SHAPES = HypothesisConfig()
SEARCH = EllipseSearch(4000, 1500, 6, SHAPES.half_axis, SHAPES.axis_ratio, SHAPES.tilt_deg)
TRUE = Ellipse(np.array([300.0, 150.0]), (180.0, 60.0), 0.1)
REGION = np.full((300, 600), 255, np.uint8)


def triples(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Exact points and normals (2, 3, count) of the ellipse."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, (3, count))
    return np.moveaxis(ELLIPSE.points(angle), -1, 0), np.moveaxis(ELLIPSE.normals(angle), -1, 0)


def test_pencil_conic_is_exact() -> None:
    points, normals = triples(200)
    apart = np.abs(points[:, 0] - points[:, 1]).max(axis=0) > 0.1
    third = np.minimum(*(np.abs(points[:, 2] - points[:, k]).max(axis=0) for k in (0, 1))) > 0.1
    points, normals = points[..., apart & third], normals[..., apart & third]
    mu, agreement = find_pencil_parameter(points, normals)
    conics = normalise_conic(conic_from_coefficients(conics_from_tangents(points, normals, mu)))
    np.testing.assert_allclose(conics, np.broadcast_to(conic_from_ellipse(ELLIPSE), conics.shape), atol=1e-8)
    np.testing.assert_allclose(agreement, 1.0, atol=1e-9)


def test_third_tangent_shows_a_foreign_point() -> None:
    points, normals = triples(500, seed=1)
    turned = normals.copy()
    turned[:, 2] = np.stack([-normals[1, 2], normals[0, 2]])
    _, agreement = find_pencil_parameter(points, turned)
    assert np.median(agreement) < 1e-6


def drawn(ridges: RidgePoints, usable: np.ndarray | None = None) -> EllipseBatch:
    mask = np.ones(len(ridges), np.bool_) if usable is None else usable
    return draw_ellipses(ridges, mask, (960, 540), SEARCH, np.random.default_rng(2))


def cluttered() -> tuple[Ellipse, RidgePoints]:
    """An ellipse of 800 points among 1600 stray ones."""
    random = np.random.default_rng(4)
    ellipse = Ellipse(np.array([500.0, 260.0]), (220.0, 70.0), 0.05)
    angle = random.uniform(0, 2 * np.pi, 800)
    turn = random.uniform(0, np.pi, 1600)
    points = np.concatenate([ellipse.points(angle), random.uniform((0, 0), (960, 540), (1600, 2))])
    normals = np.concatenate([ellipse.normals(angle), np.stack([np.cos(turn), np.sin(turn)], axis=-1)])
    return ellipse, RidgePoints(points, normals, np.full(2400, 40))


def test_the_ellipse_is_among_the_hypotheses() -> None:
    ellipse, ridges = cluttered()
    batch = drawn(ridges)
    close = (np.abs(batch.centers - ellipse.center).max(axis=1) < 3) & (np.abs(batch.great_lengths - 220) < 4)
    assert np.count_nonzero(close) > 30


def test_a_short_arc_is_found_by_points_near_each_other() -> None:
    random = np.random.default_rng(5)
    ellipse = Ellipse(np.array([500.0, 260.0]), (220.0, 70.0), 0.0)
    angle, turn = random.uniform(-0.9, 0.3, 150), random.uniform(0, np.pi, 3000)
    points = np.concatenate([ellipse.points(angle), random.uniform((0, 0), (960, 540), (3000, 2))])
    normals = np.concatenate([ellipse.normals(angle), np.stack([np.cos(turn), np.sin(turn)], axis=-1)])
    ridges, config = RidgePoints(points, normals, np.full(3150, 40)), replace(SEARCH, draws=12000)
    usable = np.ones(3150, np.bool_)
    found = []
    for near in (True, False):
        batch = draw_ellipses(ridges, usable, (960, 540), config, np.random.default_rng(6), near=near)
        close = np.abs(batch.centers - ellipse.center).max(axis=1) < 3
        found.append(np.count_nonzero(close & (np.abs(batch.great_lengths - 220) < 4)))
    assert found[0] > 20
    assert found[1] < 10


def test_points_on_lines_are_not_drawn() -> None:
    ellipse, ridges = cluttered()
    usable = np.arange(2400) >= 800
    batch = drawn(ridges, usable)
    close = (np.abs(batch.centers - ellipse.center).max(axis=1) < 3) & (np.abs(batch.great_lengths - 220) < 4)
    assert np.count_nonzero(close) == 0


def test_implausible_shapes_are_left_out() -> None:
    _, ridges = cluttered()
    config = SEARCH
    batch = drawn(ridges)
    ratio = batch.small_lengths / batch.great_lengths
    assert len(batch) > 0
    assert ratio.min() >= config.axis_ratio[0]
    assert batch.great_lengths.min() >= config.half_axis[0] * 960
    steep = np.abs(batch.great[:, 1]) > np.sin(np.radians(config.tilt_deg)) * batch.great_lengths + 1e-9
    assert (ratio[steep] >= ROUND_RATIO).all()


def test_too_few_points_give_no_hypothesis() -> None:
    _, ridges = cluttered()
    assert len(drawn(ridges, np.zeros(2400, np.bool_))) == 0


def batch_of(*ellipses: Ellipse) -> EllipseBatch:
    frames = np.stack([ellipse.frame() for ellipse in ellipses])
    return EllipseBatch(frames[:, :2, 2], frames[:, :2, 0], frames[:, :2, 1])


def drawn_part(first: float, last: float, turned: bool = False) -> RidgePoints:
    angle = np.linspace(first, last, 1500)
    normals = TRUE.normals(angle)
    if turned:
        normals = np.stack([-normals[:, 1], normals[:, 0]], axis=-1)
    return RidgePoints(TRUE.points(angle), normals, np.full(1500, 99))


def test_support_is_the_drawn_share() -> None:
    support = measure_support(batch_of(TRUE), RidgeRaster(drawn_part(0, np.pi), REGION))
    assert abs(support.whole[0] - 0.5) < 0.03


def test_what_lies_outside_the_field_counts_against_the_whole_only() -> None:
    region = REGION.copy()
    lower = TRUE.points(np.linspace(0, np.pi, 200))
    region[: int(lower[:, 1].min())] = 0
    support = measure_support(batch_of(TRUE), RidgeRaster(drawn_part(0, np.pi), region))
    assert abs(support.whole[0] - 0.5) < 0.05
    assert support.field[0] > 0.8


def test_points_of_another_direction_do_not_count() -> None:
    support = measure_support(batch_of(TRUE), RidgeRaster(drawn_part(0, 2 * np.pi, turned=True), REGION))
    assert support.whole[0] == 0.0


def test_refit_pulls_an_ellipse_onto_the_points() -> None:
    rough = Ellipse(TRUE.center + np.array([2.0, -2.0]), (183.0, 58.0), 0.11)
    raster = RidgeRaster(drawn_part(0, 2 * np.pi), REGION)
    fitted = refit_ellipses(batch_of(rough), raster, (5.0, 3.0, 1.5, 1.0))
    np.testing.assert_allclose(fitted.centers[0], TRUE.center, atol=0.1)
    np.testing.assert_allclose(fitted.great_lengths[0], 180.0, atol=0.15)
    np.testing.assert_allclose(fitted.small_lengths[0], 60.0, atol=0.1)


def test_best_distinct_drops_repetitions_and_puts_the_best_first() -> None:
    other = Ellipse(np.array([250.0, 180.0]), (120.0, 50.0), 0.0)
    nearly = Ellipse(TRUE.center + 0.3, (180.5, 60.2), 0.1)
    best = select_best(batch_of(other, nearly, TRUE), RidgeRaster(drawn_part(0, 2 * np.pi), REGION), 5)
    assert len(best) == 2
    np.testing.assert_allclose(best.great_lengths[0], 180.0, atol=1.0)

import numpy as np

from circlecal.detection.hypotheses import (
    EllipseBatch,
    conics_from_tangents,
    draw_ellipses,
    ellipses_from_coefficients,
    pencil_parameter,
)
from circlecal.detection.options import HypothesisConfig
from circlecal.detection.ridges import RidgePoints
from circlecal.geometry.conics import coefficients_from_conic, conic_from_coefficients, normalise_conic
from circlecal.geometry.ellipses import Ellipse, conic_from_ellipse, ellipse_from_conic

ELLIPSE = Ellipse(np.array([0.2, -0.1]), (0.7, 0.25), 0.4)


def triples(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Exact points and normals (2, 3, count) of the ellipse."""
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi, (3, count))
    return np.moveaxis(ELLIPSE.points(angle), -1, 0), np.moveaxis(ELLIPSE.normals(angle), -1, 0)


def test_pencil_conic_is_exact() -> None:
    points, normals = triples(200)
    apart = np.abs(points[:, 0] - points[:, 1]).max(axis=0) > 0.1
    third = np.minimum(*(np.abs(points[:, 2] - points[:, k]).max(axis=0) for k in (0, 1))) > 0.1
    points, normals = points[..., apart & third], normals[..., apart & third]
    mu, agreement = pencil_parameter(points, normals)
    conics = normalise_conic(conic_from_coefficients(conics_from_tangents(points, normals, mu)))
    np.testing.assert_allclose(conics, np.broadcast_to(conic_from_ellipse(ELLIPSE), conics.shape), atol=1e-8)
    np.testing.assert_allclose(agreement, 1.0, atol=1e-9)


def test_third_tangent_shows_a_foreign_point() -> None:
    points, normals = triples(500, seed=1)
    turned = normals.copy()
    turned[:, 2] = np.stack([-normals[1, 2], normals[0, 2]])
    _, agreement = pencil_parameter(points, turned)
    assert np.median(agreement) < 1e-6


def test_ellipses_of_conics_match_the_geometry_and_skip_hyperbolas() -> None:
    hyperbola = np.diag([1.0, -2.0, -1.0])
    coefficients = np.stack([coefficients_from_conic(c) for c in (-3 * conic_from_ellipse(ELLIPSE), hyperbola)])
    batch, real = ellipses_from_coefficients(coefficients)
    assert real.tolist() == [True, False]
    np.testing.assert_allclose(batch.centers[0], ELLIPSE.center, atol=1e-12)
    np.testing.assert_allclose([batch.great_lengths[0], batch.small_lengths[0]], ELLIPSE.semi_axes, atol=1e-12)
    direction = np.arctan2(batch.great[0, 1], batch.great[0, 0]) % np.pi
    np.testing.assert_allclose(direction, ELLIPSE.angle_rad, atol=1e-12)


def drawn(ridges: RidgePoints, usable: np.ndarray | None = None) -> EllipseBatch:
    mask = np.ones(len(ridges), np.bool_) if usable is None else usable
    return draw_ellipses(ridges, mask, (960, 540), HypothesisConfig(draws=4000), np.random.default_rng(2))


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
    ridges, config = RidgePoints(points, normals, np.full(3150, 40)), HypothesisConfig(draws=12000)
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
    config = HypothesisConfig()
    batch = drawn(ridges)
    ratio = batch.small_lengths / batch.great_lengths
    assert len(batch) > 0
    assert ratio.min() >= config.axis_ratio[0]
    assert batch.great_lengths.min() >= config.half_axis[0] * 960
    steep = np.abs(batch.great[:, 1]) > np.sin(np.radians(config.tilt_deg)) * batch.great_lengths + 1e-9
    assert (ratio[steep] >= config.round_ratio).all()


def test_too_few_points_give_no_hypothesis() -> None:
    _, ridges = cluttered()
    assert len(drawn(ridges, np.zeros(2400, np.bool_))) == 0


def test_conic_round_trip_of_the_batch() -> None:
    coefficients = coefficients_from_conic(conic_from_ellipse(ELLIPSE))[None]
    batch, _ = ellipses_from_coefficients(coefficients)
    frame = np.eye(3)
    frame[:2, 0], frame[:2, 1], frame[:2, 2] = batch.great[0], batch.small[0], batch.centers[0]
    inverse = np.linalg.inv(frame)
    again = ellipse_from_conic(inverse.T @ np.diag([1.0, 1.0, -1.0]) @ inverse)
    assert again is not None
    np.testing.assert_allclose(again.semi_axes, ELLIPSE.semi_axes, atol=1e-12)

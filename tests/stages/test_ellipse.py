"""Robust ellipses of the marking's edges."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.errors import EstimationError
from circlecal.geometry.conics import normalise_conic, sampson_distance
from circlecal.geometry.ellipses import Ellipse, ellipse_from_conic, orthogonal_distance
from circlecal.geometry.ransac import ransac_conic
from circlecal.observations import CirclePoints, Observations
from circlecal.results import RayPoints
from circlecal.stages import ellipse
from circlecal.stages.ellipse import EllipseConfig, fit_edge, fit_ellipses, fit_observations

ELLIPSE = Ellipse(np.array([900.0, 500.0]), (520.0, 160.0), 0.04)
CONFIG = EllipseConfig()
NOTHING = np.zeros((0, 2))


def arc(count, first_deg=0.0, last_deg=360.0, sigma=0.3, seed=0, ellipse=ELLIPSE):
    rng = np.random.default_rng(seed)
    angle = np.radians(rng.uniform(first_deg, last_deg, count))
    return ellipse.points(angle) + rng.normal(0, sigma, count)[:, None] * ellipse.normals(angle)


def rays_of(outer=NOTHING, inner=NOTHING, center=NOTHING):
    def sigma(points):
        return np.full(len(points), 0.3)

    return RayPoints(ELLIPSE.center, outer, sigma(outer), inner, sigma(inner), center, sigma(center), 720, 0, NOTHING)


def rng():
    return np.random.default_rng(5)


def fitted(points, sigma=0.3, config=CONFIG):
    return fit_edge("outer", points, np.full(len(points), sigma), 1.0, config, rng())


def with_players(points, share=0.4, seed=1):
    """The first points are replaced by upright clusters on the circle and a band beside it."""
    draw = np.random.default_rng(seed)
    points = points.copy()
    bad = int(share * len(points))
    legs = bad // 2
    points[:legs] = points[draw.integers(bad, len(points), 4)][np.arange(legs) % 4] + draw.uniform(
        (-8, -60), (8, 5), (legs, 2)
    )
    points[legs:bad] += draw.normal(0, 25, (bad - legs, 2))
    return points, bad


def test_inliers_are_those_of_the_returned_conic():
    points, bad = with_players(arc(400))
    found = fitted(points)
    distance = np.abs(orthogonal_distance(found.ellipse, points))
    np.testing.assert_array_equal(found.inliers, distance < CONFIG.threshold_px + 3 * 0.3)
    assert found.inliers[bad:].mean() > 0.98
    assert np.abs(orthogonal_distance(found.ellipse, ELLIPSE.points(np.linspace(0, 6.28, 90)))).max() < 0.3
    assert found.rms_px == pytest.approx(np.sqrt(np.mean(distance[found.inliers] ** 2)), rel=1e-6)
    np.testing.assert_allclose(normalise_conic(found.conic), found.conic)
    np.testing.assert_allclose(ellipse_from_conic(found.conic).center, found.ellipse.center)


def test_inliers_follow_the_refinement():
    """With noise about the threshold some points change sides when the conic moves: the last conic decides."""
    few = CONFIG.model_copy(update={"hypotheses": 20})
    for seed in range(6):
        points = arc(300, -40, 200, sigma=3.0, seed=seed)
        found = fitted(points, 0.3, few)
        distance = np.abs(orthogonal_distance(found.ellipse, points))
        limit = CONFIG.threshold_px + 3 * 0.3
        wrong = found.inliers != (distance < limit)
        # the last refinement moves the conic by hundredths of a pixel
        assert (np.abs(distance[wrong] - limit) < 0.02).all()


def test_what_the_refined_conic_comes_near_to_refines_it_again(monkeypatch):
    """Each round takes the points that lie near the conic of the one before, until they stay."""
    points, used, refine = arc(200, sigma=0.1), [], ellipse.refine_conic
    strays = ELLIPSE.points(np.radians(np.linspace(0.0, 20.0, 20))) + np.array([3.5, 0.0])
    points = np.concatenate([points, strays])

    def follow(given, conic, sigma):
        used.append(len(given))
        return refine(given, conic, sigma)

    def begin(given, *others, **options):
        rough = ransac_conic(given, *others, **options)
        return replace(rough, inliers=np.arange(len(given)) < 60)

    monkeypatch.setattr(ellipse, "refine_conic", follow)
    monkeypatch.setattr(ellipse, "ransac_conic", begin)
    found = fitted(points, 0.1)
    assert used[0] == 60
    assert len(used) > 1
    assert used[1] > 190
    again, _ = refine(points[found.inliers], found.conic, np.full(int(found.inliers.sum()), 0.1))
    np.testing.assert_allclose(again, found.conic, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("method", ["direct", "algebraic", "taubin"])
def test_every_method_ends_in_the_same_geometric_fit(method):
    points = arc(300, sigma=0.5)
    found = fitted(points, 0.5, CONFIG.model_copy(update={"method": method}))
    assert found.method == method
    reference = fitted(points, 0.5)
    np.testing.assert_allclose(found.conic, reference.conic, rtol=1e-4, atol=1e-7)


def test_covariance_predicts_the_scatter_of_the_conic():
    """Deviation of the conic across the true ellipse: predicted against drawn, at several places."""
    places = ELLIPSE.points(np.radians([0.0, 60.0, 90.0, 200.0, 300.0]))
    drawn, predicted = [], []
    for seed in range(40):
        points = arc(120, -60, 220, sigma=0.5, seed=seed)
        found = fitted(points, 0.5, CONFIG.model_copy(update={"hypotheses": 100}))
        drawn.append(sampson_distance(found.conic, places))
        x, y = places.T
        design = np.stack([x * x, x * y, y * y, x, y, np.ones_like(x)], axis=-1)
        size = 2 * np.hypot(*(found.conic[:2] @ [x, y, np.ones_like(x)]))
        predicted.append(np.einsum("ni,ij,nj->n", design, found.covariance, design) / size**2)
    ratio = np.std(drawn, axis=0) / np.sqrt(np.mean(predicted, axis=0))
    assert ((ratio > 0.7) & (ratio < 1.4)).all(), ratio


@pytest.mark.parametrize("arc_deg", [80.0, 150.0, 250.0, 360.0])
def test_arc_coverage(arc_deg):
    found = fitted(arc(500, -30.0, -30.0 + arc_deg, sigma=0.1), 0.1)
    assert abs(found.arc_deg - arc_deg) <= 15.0


def test_a_gap_is_not_counted():
    points = np.concatenate([arc(200, 0, 90, 0.1), arc(200, 180, 270, 0.1, seed=2)])
    assert abs(fitted(points, 0.1).arc_deg - 180.0) <= 15.0


def test_too_few_points_are_no_edge():
    assert fitted(arc(CONFIG.minimum_points - 1)) is None
    assert fitted(arc(CONFIG.minimum_points + 6)) is not None
    scattered = np.random.default_rng(1).uniform(0, 1000, (60, 2))
    found = fitted(scattered)
    assert found is None or found.inliers.sum() < 40


def test_all_edges_and_the_primary_one():
    outer = Ellipse(ELLIPSE.center, (524.0, 161.5), 0.04)
    inner = Ellipse(ELLIPSE.center, (516.0, 158.5), 0.04)
    rays = rays_of(arc(200, 0, 300, ellipse=outer), arc(200, 0, 300, ellipse=inner), arc(400))
    found = fit_ellipses(rays, 1920, CONFIG, rng())
    assert [f.edge for f in found.all()] == ["outer", "inner", "center"]
    assert found.primary is found.center
    assert found.inner.ellipse.semi_axes[0] < found.center.ellipse.semi_axes[0] < found.outer.ellipse.semi_axes[0]
    only = fit_ellipses(rays_of(outer=arc(200)), 1920, CONFIG, rng())
    assert only.inner is None
    assert only.primary.edge == "outer"


def refusal(rays, config=CONFIG, width=1920):
    with pytest.raises(EstimationError) as refused:
        fit_ellipses(rays, width, config, rng())
    assert refused.value.stage == "ellipse"
    return refused.value


def test_short_arcs_are_refused_with_their_length():
    refused = refusal(rays_of(center=arc(300, 0, 45, 0.05)))
    assert refused.code == "arc_too_short"
    assert "60" in refused.reason
    lenient = CONFIG.model_copy(update={"minimum_arc_deg": 30.0})
    assert fit_ellipses(rays_of(center=arc(300, 0, 45, 0.05)), 1920, lenient, rng()).primary.arc_deg <= 60


def test_lines_beside_a_short_arc_leave_its_length_to_the_camera():
    short = rays_of(center=arc(300, 0, 45, 0.05))
    found = fit_ellipses(short, 1920, CONFIG, rng(), has_lines=True)
    assert found.primary.arc_deg < CONFIG.minimum_arc_deg == found.least_arc_deg
    assert fit_ellipses(rays_of(center=arc(300)), 1920, CONFIG, rng(), has_lines=True).least_arc_deg == 0.0


def test_large_residuals_are_refused():
    wide = CONFIG.model_copy(update={"threshold_px": 20.0})
    refused = refusal(rays_of(center=arc(400, sigma=4.0)), wide)
    assert refused.code == "residual_too_large"
    assert "2.00 are allowed" in refused.reason


def test_thresholds_follow_the_width_of_the_picture():
    """The same picture at half the size must not be judged more leniently."""
    half = Ellipse(ELLIPSE.center / 2, (260.0, 80.0), 0.04)
    wide = CONFIG.model_copy(update={"threshold_px": 20.0})
    assert "1.00 are allowed" in refusal(rays_of(center=arc(400, sigma=2.0, ellipse=half)), wide, 960).reason


def test_no_points_or_a_straight_line_are_no_ellipse():
    assert refusal(rays_of()).code == "no_ellipse"
    straight = np.stack([np.linspace(0, 900, 200), np.linspace(0, 90, 200)], axis=-1)
    assert refusal(rays_of(center=straight)).code in {"no_ellipse", "arc_too_short"}


def test_a_hyperbola_is_no_ellipse():
    """The branch of a hyperbola: an ellipse through it explains too little, or leaves it."""
    t = np.linspace(-1.5, 1.5, 300)
    branch = np.stack([960 + 300 * np.sinh(t), 300 + 80 * np.cosh(t)], axis=-1)
    assert refusal(rays_of(center=branch)).code in {"no_ellipse", "arc_too_short", "residual_too_large"}


def test_same_generator_same_answer():
    points, _ = with_players(arc(400))
    np.testing.assert_array_equal(fitted(points).conic, fitted(points).conic)


def test_a_handful_of_given_points_is_enough():
    points = ELLIPSE.points(np.linspace(0.2, 5.0, 8))
    seen = CirclePoints("centre_circle", "outer", points, np.ones(8))
    other = CirclePoints("elsewhere", "inner", points + 300, np.ones(8))
    found = fit_observations(Observations(1920, 1080, (other, seen)), "centre_circle", 1920, CONFIG, rng())
    assert found.inner is None
    np.testing.assert_allclose(found.outer.ellipse.center, ELLIPSE.center, atol=1e-6)
    with pytest.raises(EstimationError) as refused:
        few = CirclePoints("centre_circle", "outer", points[:5], np.ones(5))
        fit_observations(Observations(1920, 1080, (few,)), "centre_circle", 1920, CONFIG, rng())
    assert refused.value.code == "no_ellipse"
    assert "centre_circle" in refused.value.reason


def test_points_of_one_edge_in_several_pieces_give_one_ellipse():
    points = ELLIPSE.points(np.linspace(0.2, 5.0, 8))
    pieces = tuple(
        CirclePoints("centre_circle", "outer", part, np.ones(len(part))) for part in np.split(points, [3, 7])
    )
    found = fit_observations(Observations(1920, 1080, pieces), "centre_circle", 1920, CONFIG, rng())
    assert len(found.outer.points_px) == 8
    np.testing.assert_allclose(found.outer.ellipse.center, ELLIPSE.center, atol=1e-6)

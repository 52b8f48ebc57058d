"""Observations without a picture: on the curve, evenly spread, with the noise that they state."""

import numpy as np
import pytest

from circlecal.geometry.conics import circle_conic, sampson_distance, transform_conic
from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.cameras import inside_frame, sample_camera, soccer
from circlecal.synthetic.markings import MIN_SIGMA_PX, add_outliers, circle_points, line_points, mark_point

FULL = sample_camera("main", np.random.default_rng(1))
PART = sample_camera("partial", np.random.default_rng(2))


@pytest.mark.parametrize(("edge", "radius"), [("outer", 9.15), ("center", 9.10), ("inner", 9.05)])
@pytest.mark.parametrize("camera", [FULL, PART], ids=["full", "part"])
def test_points_lie_on_the_edge(camera, edge, radius):
    seen = circle_points(camera, soccer(), edge, 90, 0.0, np.random.default_rng(0), marking_width_m=0.1)
    conic = transform_conic(camera.homography, circle_conic((0.0, 0.0), radius))
    assert len(seen.points_px) == 90
    assert np.abs(sampson_distance(conic, seen.points_px)).max() < 1e-8
    assert inside_frame(seen.points_px, camera.width, camera.height, -0.5).all()
    assert seen.sigma_px.tolist() == [MIN_SIGMA_PX] * 90
    assert (seen.circle, seen.edge) == ("centre_circle", edge)


def test_lens_and_crown():
    surface = Surface(crown_m=0.06)
    camera = sample_camera("main", np.random.default_rng(3), kappa=0.04, surface=surface)
    seen = circle_points(camera, soccer(), "outer", 50, 0.0, np.random.default_rng(0), surface=surface)
    field = camera.back_project(seen.points_px, surface)
    np.testing.assert_allclose(np.linalg.norm(field, axis=1), 9.15, atol=1e-9)


def test_spacing():
    in_image = circle_points(FULL, soccer(), "outer", 200, 0.0, np.random.default_rng(0)).points_px
    steps = np.linalg.norm(np.diff(in_image, axis=0), axis=1)
    assert np.ptp(steps) < 0.02 * steps.mean()
    seen = circle_points(FULL, soccer(), "outer", 8, 0.0, np.random.default_rng(0), "field")
    on_field = FULL.back_project(seen.points_px, FLAT)
    angles = np.unwrap(np.arctan2(on_field[:, 1], on_field[:, 0]))
    np.testing.assert_allclose(np.diff(angles), np.pi / 4, atol=1e-9)


def test_a_common_phase_gives_both_edges_the_same_angles():
    rng = np.random.default_rng(0)
    edges = [circle_points(FULL, soccer(), e, 8, 0.0, rng, "field", phase=0.3).points_px for e in ("outer", "inner")]
    outer, inner = (FULL.back_project(pixels, FLAT) for pixels in edges)
    cross = outer[:, 0] * inner[:, 1] - outer[:, 1] * inner[:, 0]
    assert np.abs(cross).max() < 1e-7


def test_noise():
    clean = circle_points(FULL, soccer(), "outer", 4000, 0.0, np.random.default_rng(0), phase=0.5).points_px
    noisy = circle_points(FULL, soccer(), "outer", 4000, 0.7, np.random.default_rng(0), phase=0.5)
    assert np.std(noisy.points_px - clean) == pytest.approx(0.7, rel=0.03)
    assert set(noisy.sigma_px) == {0.7}


def test_line():
    seen = line_points(FULL, soccer(), "halfway_line", 2, 0.0, np.random.default_rng(0))
    assert seen.line == "halfway_line"
    np.testing.assert_allclose(FULL.back_project(seen.points_px, FLAT)[:, 0], 0.0, atol=1e-9)
    assert seen.points_px[0, 1] < 5
    assert seen.points_px[1, 1] > FULL.height - 6
    assert len(line_points(FULL, soccer(), "side_line_left", 10, 1.0, np.random.default_rng(0)).points_px) == 0


def test_mark():
    seen = mark_point(FULL, soccer(), "centre_mark", 0.0, np.random.default_rng(0))
    assert seen is not None
    np.testing.assert_allclose(seen.point_px, FULL.project([0.0, 0.0]))
    assert mark_point(FULL, soccer(), "penalty_mark_left", 1.0, np.random.default_rng(0)) is None


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_outliers(share):
    points = circle_points(FULL, soccer(), "outer", 400, 0.0, np.random.default_rng(0))
    mixed, inliers = add_outliers(points, share, np.random.default_rng(1))
    conic = transform_conic(FULL.homography, circle_conic((0.0, 0.0), 9.15))
    distance = np.abs(sampson_distance(conic, mixed.points_px))
    assert inliers.sum() == 400 - round(share * 400)
    assert distance[inliers].max() < 1e-8
    assert share == 0.0 or 5.0 < np.median(distance[~inliers]) < 50.0


def test_outlier_share_is_checked():
    points = circle_points(FULL, soccer(), "outer", 10, 0.0, np.random.default_rng(0))
    with pytest.raises(ValueError, match="share"):
        add_outliers(points, 1.0, np.random.default_rng(0))

"""The table of robust fits and its peers."""

import numpy as np

from circlecal.evaluation.bench.ransac import OUTLIER_SHARES, robustness, sample_contaminated_ellipse, speed
from circlecal.geometry.ellipses import orthogonal_distance


def test_contaminated_points():
    ellipse, points, inliers = sample_contaminated_ellipse(400, 0.5, 0.5, np.random.default_rng(1))
    assert inliers.sum() == 200
    distance = np.abs(orthogonal_distance(ellipse, points))
    assert distance[inliers].max() < 4 * 0.5
    assert np.median(distance[~inliers]) > 5.0


def test_robustness_at_every_share():
    rows = robustness(4, 0)
    assert [(row.outliers, row.sigma_px) for row in rows] == list(OUTLIER_SHARES)
    assert all(row.draws == 4 for row in rows)
    assert all(0.75 <= row.good <= 1.0 for row in rows[:3])


def test_speed_names_the_peers():
    ours, whole, loop, slow = speed(0, runs=1)
    assert ours.ratio == 1.0
    assert "cv2" in loop.name
    assert "skimage" in slow.name
    assert all(row.ms > 0 for row in (ours, whole, loop, slow))
    assert all(row.ratio == row.ms / ours.ms for row in (whole, loop, slow))

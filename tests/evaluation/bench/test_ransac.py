"""The table of robust fits and its peers."""

from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from circlecal.cli.app import app
from circlecal.evaluation.bench import ransac
from circlecal.evaluation.bench.ransac import OUTLIER_SHARES, robustness, sample_contaminated_ellipse, speed
from circlecal.geometry.ellipses import orthogonal_distance


def test_contaminated_points():
    ellipse, points, inliers = sample_contaminated_ellipse(400, 0.5, 0.5, np.random.default_rng(1))
    assert inliers.sum() == 200
    distance = np.abs(orthogonal_distance(ellipse, points))
    assert distance[inliers].max() < 4 * 0.5
    assert np.median(distance[~inliers]) > 5.0


@pytest.fixture(scope="module")
def command():
    """What ``circlecal bench ransac`` finds, in one run of each fit, and prints."""
    found = []

    def keep(table, *given):
        found.append(table(*given))
        return found[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ransac, "robustness", partial(keep, robustness))
        patch.setattr(ransac, "speed", lambda seed: keep(speed, seed, 1))
        ended = CliRunner().invoke(app, ["bench", "ransac", "--draws", "4"])
    assert ended.exit_code == 0, ended.output
    return *found, ended.stdout


def test_the_command_prints_both_tables(command):
    rows, times, told = command
    assert all(f"{row.good:.1%}" in told for row in rows)
    assert all(f"{row.ms:.1f}" in told for row in times)


def test_robustness_at_every_share(command):
    rows = command[0]
    assert [(row.outliers, row.sigma_px) for row in rows] == list(OUTLIER_SHARES)
    assert all(row.draws == 4 for row in rows)
    assert all(0.75 <= row.good <= 1.0 for row in rows[:3])


def test_speed_names_the_peers(command):
    ours, whole, loop, slow = command[1]
    assert ours.ratio == 1.0
    assert "cv2" in loop.name
    assert "skimage" in slow.name
    assert all(row.ms > 0 for row in (ours, whole, loop, slow))
    assert all(row.ratio == row.ms / ours.ms for row in (whole, loop, slow))

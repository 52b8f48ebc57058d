"""Points of a straight marking that lie on something else are told from its paint."""

import numpy as np
import pytest

from circlecal.geometry.projective import fit_line, line_distance
from circlecal.paint.strays import keep_on_course, lie_on_course
from circlecal.results import LineCue, Segment

UNIT = 1.0


def line_points(rng, count=200, bend_px=0.0, slope=0.6):
    """Points every 2 px along a line that bends by so much in its middle, 0.1 px off, and its line."""
    along = 2.0 * np.arange(count)
    t = np.linspace(-1.0, 1.0, count)
    off = bend_px * (1.0 - t * t) + rng.normal(0.0, 0.1, count)
    direction = np.array([1.0, slope]) / np.hypot(1.0, slope)
    points = 100.0 + along[:, None] * direction + off[:, None] * np.array([-direction[1], direction[0]])
    return points, fit_line(points)


@pytest.mark.parametrize("bend_px", [0.0, 3.0])
def test_points_on_a_board_behind_the_end_and_on_a_player_are_left_out(bend_px):
    rng = np.random.default_rng(3)
    points, line = line_points(rng, bend_px=bend_px)
    is_stray = np.zeros(len(points), np.bool_)
    is_stray[-8:] = True
    is_stray[60:66] = True
    points[-8:] += rng.choice([-1.0, 1.0], 8)[:, None] * rng.uniform(1.5, 3.0, (8, 1)) * line[:2]
    points[-4] -= line_distance(line, points[-4]) * line[:2]  # by chance on the line
    points[60:66] += 2.5 * line[:2]
    kept = lie_on_course(points, line, UNIT)
    assert not kept[is_stray].any()
    # beside strays a few points are given up
    assert kept[~is_stray].mean() > 0.95


@pytest.mark.parametrize("kink_px", [0.0, 1.0])
def test_paint_on_a_crowned_field_is_kept_whole(kink_px):
    points, line = line_points(np.random.default_rng(4))
    points += (kink_px * (0.5 - np.abs(np.linspace(-1.0, 1.0, len(points)))))[:, None] * line[:2]
    assert lie_on_course(points, fit_line(points), UNIT).all()


def test_the_order_of_points_does_not_matter():
    rng = np.random.default_rng(5)
    points, line = line_points(rng)
    points[:7] += 3.0 * line[:2]
    order = rng.permutation(len(points))
    assert np.array_equal(lie_on_course(points[order], line, UNIT), lie_on_course(points, line, UNIT)[order])


def test_few_points_are_kept():
    points, line = line_points(np.random.default_rng(6), count=12)
    points[-3:] += 5.0 * line[:2]
    assert lie_on_course(points, line, UNIT).all()


def test_a_marking_of_which_hardly_anything_would_be_left_is_kept():
    """Every second point lies astray, so no point has enough neighbours on the course."""
    rng = np.random.default_rng(0)
    points, line = line_points(rng, count=40)
    points += np.where(np.arange(40) % 2 == 0, rng.uniform(-9.0, 9.0, 40), 0.0)[:, None] * line[:2]
    assert lie_on_course(points, line, UNIT).all()


def test_a_marking_loses_its_strays_and_nothing_else():
    points, line = line_points(np.random.default_rng(7))
    points[-6:] += 4.0 * line[:2]
    cue = LineCue(
        "side_line_top", line, points, np.arange(len(points), dtype=float), Segment(points[0], points[-1]), 0.1
    )
    left = keep_on_course(cue, UNIT)
    assert left.name == "side_line_top"
    assert np.array_equal(left.points_px, points[left.sigma_px.astype(int)])
    assert 188 <= len(left.points_px) <= 194

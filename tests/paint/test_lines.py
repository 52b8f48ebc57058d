"""Straight markings measured across their paint."""

import numpy as np
import pytest
from scipy.special import expit

from circlecal.paint.lines import ONE_ROUND, measure_lines
from circlecal.results import Segment

SEARCHED = 6.0, 2.0
TURF, PAINT, NOISE = 90.0, 200.0, 1.5
LINES = np.array([[0.1, 0.995, -180.0], [0.8, 0.6, -560.0]])
LINES /= np.hypot(LINES[:, 0], LINES[:, 1])[:, None]
"""A flat one and a steep one; they cross in the picture."""


def painted(half_width_px=1.5, blur_px=1.0):
    """Picture (480, 800) of both markings."""
    y, x = np.mgrid[:480, :800]
    distance = np.abs(LINES @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)]))
    cover = 1.0 / (1.0 + np.exp((distance.min(axis=0) - half_width_px) * 1.7 / blur_px))
    light = TURF + (PAINT - TURF) * cover + np.random.default_rng(4).normal(0.0, NOISE, x.size)
    return np.clip(np.rint(light), 0, 255).astype(np.uint8).reshape(x.shape)


def on_line(line, x, off_px=(0.0, 0.0)):
    """The line between two columns, with each end moved off it."""
    ends = np.array([[c, -(line[0] * c + line[2]) / line[1]] for c in x])
    return Segment(*(ends + np.array(off_px)[:, None] * line[:2]))


ROUGH = (on_line(LINES[0], (60.0, 700.0), (1.5, -1.0)), on_line(LINES[1], (300.0, 640.0), (-1.0, 1.5)))
BARE = Segment(np.array([30.0, 300.0]), np.array([300.0, 330.0]))


def test_lines_and_points_are_sub_pixel():
    for cue, line in zip(measure_lines(painted(), ROUGH, NOISE, *SEARCHED), LINES, strict=True):
        off = cue.points_px @ line[:2] + line[2]
        assert np.abs(off).mean() < 0.1
        assert abs(off.mean()) < 0.03
        assert len(off) > 0.8 * np.hypot(*(cue.segment.end - cue.segment.start)) / SEARCHED[1]
        assert cue.width_px == pytest.approx(3.0, abs=0.5)


def test_markings_measured_together_are_those_measured_alone():
    picture = painted()
    together = measure_lines(picture, [*ROUGH, BARE], NOISE, *SEARCHED)
    assert together[2] is None
    for segment, line in zip(ROUGH, together[:2], strict=True):
        (alone,) = measure_lines(picture, [segment], NOISE, *SEARCHED)
        np.testing.assert_allclose(line.points_px, alone.points_px)
        np.testing.assert_allclose(line.line, alone.line, rtol=1e-6)


def test_paint_at_the_rim_of_a_lighter_strip_is_measured_for_itself():
    """Far touchlines run along mown strips: the middle of band and strip together is 0.9 to 1.8 px off."""
    y, x = np.mgrid[:480, :800]
    down = LINES[0] @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)])
    light = TURF + 22.0 * (np.abs(down + 2.6) < 3.5) + 18.0 * np.exp(-0.5 * (down / 0.9) ** 2)
    light += np.random.default_rng(5).normal(0.0, NOISE, x.size)
    picture = np.clip(np.rint(light), 0, 255).astype(np.uint8).reshape(x.shape)
    (cue,) = measure_lines(picture, ROUGH[:1], NOISE, *SEARCHED)
    off = cue.points_px @ LINES[0, :2] + LINES[0, 2]
    assert abs(np.median(off)) < 0.35
    assert cue.width_px < 4.0


def test_nothing_to_measure():
    assert measure_lines(painted(), [], NOISE, *SEARCHED) == []
    point = Segment(np.array([50.0, 50.0]), np.array([53.0, 50.0]))
    assert measure_lines(painted(), [point], NOISE, *SEARCHED, ONE_ROUND) == [None]


def test_a_marking_beyond_the_search_is_not_found():
    away = on_line(LINES[0], (60.0, 250.0), (20.0, 20.0))
    assert measure_lines(painted(), [away], NOISE, *SEARCHED) == [None]


@pytest.mark.parametrize(("middle_px", "is_found"), [(9.0, True), (3.0, False)])
def test_a_marking_along_the_border_is_measured_where_both_of_its_edges_show(middle_px, is_found):
    """Its profiles leave the picture; of one that touches the border one edge is unknown."""
    line = np.array([1.0, 0.01, -middle_px - 2.4])
    line /= np.hypot(*line[:2])
    y, x = np.mgrid[:480, :800]
    distance = np.abs(line @ np.stack([x.ravel(), y.ravel(), np.ones(x.size)]))
    cover = expit((4.0 - distance) * 1.7)
    light = TURF + (PAINT - TURF) * cover + np.random.default_rng(5).normal(0.0, NOISE, x.size)
    picture = np.clip(np.rint(light), 0, 255).astype(np.uint8).reshape(x.shape)
    ends = np.array([[-(line[1] * row + line[2]) / line[0], row] for row in (20.0, 460.0)])
    (cue,) = measure_lines(picture, [Segment(*ends)], NOISE, *SEARCHED)
    assert (cue is not None) is is_found
    if cue is not None:
        off = cue.points_px @ line[:2] + line[2]
        assert np.abs(off).mean() < 0.1 and len(off) > 150
        assert cue.width_px == pytest.approx(8.0, abs=0.5)

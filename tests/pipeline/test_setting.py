"""What a scene shows where no graphics lie over it."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.pictures.graphics import Band, cover_bands
from circlecal.pipeline import field_of
from circlecal.pipeline.setting import Scene, Setting, prepare_scene
from circlecal.results import LineCue, RayPoints, Segment

SHAPE = (360, 640)


def scene(*bands):
    gray = np.zeros(SHAPE, np.uint8)
    covered = cover_bands(SHAPE, bands) if bands else None
    return Scene(np.zeros((*SHAPE, 3), np.uint8), gray, None, None, None, covered=covered)


def line(last_row):
    rows = np.arange(20.0, last_row, 4.0)
    points = np.stack([np.full(len(rows), 300.0), rows], axis=-1)
    return LineCue("halfway_line", np.array([1.0, 0.0, -300.0]), points, rows, Segment(points[0], points[-1]), 0.1)


def test_a_line_is_left_where_no_graphics_cover_it():
    whole = line(340.0)
    clear = scene(Band(100, 140, 0, 639)).clear_line(whole)
    rows = clear.points_px[:, 1]
    assert not ((rows > 95) & (rows < 145)).any()
    assert np.array_equal(clear.sigma_px, rows)
    assert clear.ends == whole.ends and len(rows) > 50
    assert scene().clear_line(whole) is whole


@pytest.mark.parametrize("asked", [True, False])
def test_graphics_are_looked_for_where_that_is_asked(asked):
    config = load_config(None, [f"mask.leave_out_graphics={str(asked).lower()}"])
    image = np.random.default_rng(3).normal(0.0, 2.0, (*SHAPE, 1)) + np.array([60.0, 130.0, 70.0])
    image = np.rint(image).astype(np.uint8)
    image[200:241] = 120, 40, 30
    image[200:203] = 245
    setting = Setting(config, *field_of(config), image.shape[1], image.shape[0], np.random.default_rng(1))
    shown = prepare_scene(setting, image, None, None)
    assert (shown.covered is not None) == asked
    assert np.array_equal(shown.image, image) != asked


def test_a_line_that_runs_along_graphics_is_their_edge():
    along = replace(line(340.0), points_px=np.stack([np.arange(100.0, 180.0), np.full(80, 144.0)], axis=-1))
    shown = scene(Band(100, 140, 0, 639))
    assert shown.clear_line(along) is None
    (kept,) = shown.clear_lines((along, line(340.0)))
    assert kept.points_px[0, 0] == 300.0


def test_both_edges_of_the_circle_are_left_out_together_where_one_lies_beside_graphics():
    outer = np.array([[300.0, 60.0], [300.0, 92.0], [300.0, 200.0]])
    inner = outer + np.array([0.0, 5.0])
    rays = RayPoints(np.zeros(2), outer, np.arange(3.0), inner, np.arange(3.0), outer, np.arange(3.0), 3, 0, outer[:0])
    shown = scene(Band(100, 140, 0, 639)).clear_rays(rays)
    assert np.array_equal(shown.outer_sigma_px, [0.0, 2.0]) and np.array_equal(shown.inner_sigma_px, [0.0, 2.0])
    assert np.array_equal(shown.center_line_sigma_px, [0.0, 1.0, 2.0])
    assert scene().clear_rays(rays) is rays

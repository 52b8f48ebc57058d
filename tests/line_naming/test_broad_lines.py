"""Lines far broader than paint are no markings."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from circlecal.camera.problem import State
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, theta_of
from circlecal.geometry.surface import Surface
from circlecal.line_naming.broad_lines import hide_broad_lines
from circlecal.observations import LinePoints, Observations
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
CAMERA = aim_camera(np.array([-1.0, 62.0, -15.0]), np.array([1.0, 0.0, 0.0]), 1500.0, 0.0, 1920, 1080)
MODEL = ProjectionModel.of(CAMERA, Surface())
BLUR_PX = 1.0
"""A blur of which 2.355 px are a part of the width at half height."""


def touchline(y_m, widths, **changes):
    """A nameless line along the field, so many times as wide as blurred paint there."""
    x = np.linspace(-15.0, 15.0, 80)
    half = 0.5 * SOCCER.marking_width_m
    rims = [CAMERA.project(np.stack([x, np.full(80, y_m + side)], axis=-1)) for side in (-half, 0.0, half)]
    paint_px = float(np.median(np.abs(rims[2][:, 1] - rims[0][:, 1])))
    seen = LinePoints(None, rims[1], np.full(80, 0.4), (), widths * float(np.hypot(paint_px, 2.355 * BLUR_PX)), BLUR_PX)
    return replace(seen, **changes)


def hide(*lines):
    observations = Observations(1920, 1080, (), lines)
    theta = theta_of(CAMERA, MODEL)[None]
    state = State(theta, *(np.zeros((1, 0)) for _ in range(5)), np.zeros(1), np.zeros((1, 0)), np.zeros((1, 0, 0)))
    problem = cast("Any", SimpleNamespace(model=MODEL))
    hidden = hide_broad_lines(observations, problem, state, SOCCER)
    return [len(line.points_px) for line in hidden.lines]


@pytest.mark.parametrize("y_m", [-34.0, 34.0])
def test_what_is_three_times_as_broad_as_paint_there_loses_its_points_and_keeps_its_number(y_m):
    assert hide(touchline(y_m, 4.0), touchline(y_m, 2.0), touchline(y_m, 0.5)) == [0, 80, 80]


def test_lines_whose_name_or_width_says_no_more_stay():
    named, unmeasured = touchline(34.0, 9.0, line="side_line_bottom"), touchline(34.0, 9.0, width_px=0.0)
    few = touchline(34.0, 9.0, points_px=np.array([[900.0, 800.0]]), sigma_px=np.ones(1))
    assert hide(named, unmeasured, few) == [80, 80, 1]
    assert hide() == []

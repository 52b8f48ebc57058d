"""Which lines are which beside a circle that nothing else turns."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import Config
from circlecal.errors import EstimationError
from circlecal.field import load_field
from circlecal.observations import CirclePoints, LinePoints, Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera, inside_frame

SOCCER = load_field("soccer")
CIRCLE = SOCCER.circle_by_name["centre_circle"]
CAMERA = aim_camera(np.array([-10.0, 62.0, -18.0]), np.array([-31.0, -8.0, 0.0]), 2400.0, 0.01, 1920, 1080)
CONFIG = Config().camera.model_copy(update={"k1_mean": 0.0, "crown_m": 0.0})
SIGMA_PX = 0.2


def seen(name, camera=CAMERA, step_px=4.0):
    """Noisy points on what the frame shows of a template's marking."""
    points = camera.project(SOCCER.polylines(0.02)[name])
    points = points[inside_frame(points, camera.width, camera.height)]
    assert len(points) > 20, name
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])
    kept = np.searchsorted(along, np.arange(0.0, along[-1], step_px))
    rng = np.random.default_rng(len(name))
    return points[kept] + rng.normal(0.0, SIGMA_PX, (len(kept), 2))


def shortened(observed):
    """The same with no more of the lines than the penalty area is wide."""

    def cut_line(line):
        near = (np.abs(CAMERA.back_project(line.points_px)) < (19.0, np.inf)).all(axis=1)
        return replace(line, points_px=line.points_px[near], sigma_px=line.sigma_px[near])

    return replace(observed, lines=(cut_line(observed.lines[0]), *observed.lines[1:]))


def observations(lines, curves=(), camera=CAMERA):
    """The circle, and lines and curves without a name."""
    on_circle = seen(CIRCLE.name, camera)

    def nameless(points):
        return LinePoints(None, points, np.full(len(points), SIGMA_PX))

    return Observations(
        camera.width,
        camera.height,
        (CirclePoints(CIRCLE.name, "center", on_circle, np.full(len(on_circle), SIGMA_PX)),),
        tuple(nameless(seen(name, camera)) for name in lines),
        curves=tuple(seen(name, camera) for name in curves),
    )


def error_px(fit, camera=CAMERA):
    grid = np.stack(np.meshgrid(np.arange(-30.0, 0.1), np.arange(-20.0, 10.1)), axis=-1).reshape(-1, 2)
    there = camera.project(grid)
    grid, there = (a[inside_frame(there, camera.width, camera.height)] for a in (grid, there))
    return float(np.linalg.norm(fit.camera.project(grid) - there, axis=-1).mean())


@pytest.fixture(scope="module")
def box_view():
    lines = ["big_rect_left_main", "side_line_top", "big_rect_left_top"]
    return lines, estimate_camera(observations(lines), SOCCER, CIRCLE, CONFIG)


def test_the_view_shows_half_of_the_circle_and_no_halfway_line():
    shown = inside_frame(CAMERA.project(SOCCER.polylines(0.25)["centre_circle"]), 1920, 1080)
    assert 0.2 < shown.mean() < 0.55
    assert not inside_frame(CAMERA.project(SOCCER.polylines(0.25)["halfway_line"]), 1920, 1080).any()


def test_three_lines_turn_the_circle(box_view):
    lines, fit = box_view
    assert fit.names_by_line == dict(enumerate(lines))
    assert fit.named_lines == tuple(sorted(lines))
    assert error_px(fit) < 5.0


def test_names_do_not_depend_on_the_order_of_the_lines(box_view):
    lines, _ = box_view
    again = estimate_camera(observations(lines[::-1]), SOCCER, CIRCLE, CONFIG)
    assert again.names_by_line == dict(enumerate(lines[::-1]))


def test_an_earlier_camera_is_the_only_start(box_view):
    lines, fit = box_view
    again = estimate_camera(observations(lines), SOCCER, CIRCLE, CONFIG, earlier=fit)
    assert again.names_by_line == fit.names_by_line
    assert error_px(again) == pytest.approx(error_px(fit), abs=0.3)


def test_the_other_side_gives_the_turned_field(box_view):
    lines, _ = box_view
    fit = estimate_camera(observations(lines), SOCCER, CIRCLE, CONFIG, "opposite")
    assert set(fit.named_lines) == {"big_rect_right_main", "side_line_bottom", "big_rect_right_bottom"}
    assert fit.camera.position_m[1] < 0
    assert error_px(replace(fit, camera=fit.camera.turn_field())) < 5.0


@pytest.mark.parametrize("lines", [[], ["side_line_top"], ["big_rect_left_main"]])
def test_one_line_may_be_several_markings(lines):
    with pytest.raises(EstimationError) as refused:
        estimate_camera(observations(lines), SOCCER, CIRCLE, CONFIG)
    assert refused.value.code == "rotation_free"


TURNED = ["side_line_top", "big_rect_left_main"]
"""Nearly as far from the centre as each other, at a right angle: where both are short, the field may be turned."""


def test_two_lines_may_be_each_other():
    with pytest.raises(EstimationError, match="nothing shows how the circle is turned"):
        estimate_camera(shortened(observations(TURNED)), SOCCER, CIRCLE, CONFIG)


def test_a_penalty_arc_tells_the_touchline_from_the_penalty_area():
    fit = estimate_camera(shortened(observations(TURNED, ["penalty_arc_left"])), SOCCER, CIRCLE, CONFIG)
    assert fit.names_by_line == dict(enumerate(TURNED))
    assert error_px(fit) < 5.0


def test_a_penalty_arc_and_the_line_on_which_it_ends_are_enough():
    fit = estimate_camera(observations(["big_rect_left_main"], ["penalty_arc_left"]), SOCCER, CIRCLE, CONFIG)
    assert fit.named_lines == ("big_rect_left_main",)
    assert error_px(fit) < 10.0


def test_an_arc_that_is_recognised_weighs_against_a_line_that_is_nothing():
    """Of the two straight lines the longer one is a board's."""
    observed = observations(["big_rect_left_main"], ["penalty_arc_left"])
    points = np.array([900.0, 900.0]) + np.linspace(0.0, 800.0, 100)[:, None] * np.array([0.94, 0.34])
    board = LinePoints(None, points, np.full(100, SIGMA_PX))
    fit = estimate_camera(replace(observed, lines=(*observed.lines, board)), SOCCER, CIRCLE, CONFIG)
    assert fit.named_lines == ("big_rect_left_main",)
    assert error_px(fit) < 10.0


def test_a_curve_that_is_no_arc_of_the_field_changes_nothing():
    stray = np.stack([np.linspace(200.0, 700.0, 60), 900.0 - 0.002 * np.linspace(-250.0, 250.0, 60) ** 2], axis=-1)
    with pytest.raises(EstimationError, match="nothing shows how the circle is turned"):
        estimate_camera(replace(shortened(observations(TURNED)), curves=(stray,)), SOCCER, CIRCLE, CONFIG)


def test_without_naming_the_rotation_stays_free(box_view):
    lines, _ = box_view
    with pytest.raises(EstimationError, match="nothing shows how the circle is turned"):
        estimate_camera(observations(lines), SOCCER, CIRCLE, CONFIG.model_copy(update={"name_lines": False}))


def test_a_long_touchline_is_enough_where_no_other_marking_is_missing():
    camera = aim_camera(np.array([0.0, 62.0, -18.0]), np.array([-15.5, -8.0, 0.0]), 5400.0, 0.01, 1920, 1080)
    observed = observations(["side_line_top"], camera=camera)
    fit = estimate_camera(observed, SOCCER, CIRCLE, CONFIG)
    assert fit.named_lines == ("side_line_top",)
    assert error_px(fit, camera) < fit.max_sigma_px
    line = observed.lines[0]
    short = replace(line, points_px=line.points_px[:150], sigma_px=line.sigma_px[:150])
    with pytest.raises(EstimationError, match="turned"):
        estimate_camera(replace(observed, lines=(short,)), SOCCER, CIRCLE, CONFIG)

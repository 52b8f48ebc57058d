"""Where the halfway line ends the touchlines run: used where it can be believed, and no board's edge beside it."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.camera.problem import evaluate
from circlecal.camera.residuals import ground_feet, join_curves
from circlecal.estimation.task import Task
from circlecal.evaluation.bench.scenarios import KNOWN
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import theta_of
from circlecal.line_naming import line_ends
from circlecal.line_naming.line_ends import (
    agree_with_ends,
    find_passed_lines,
    lies_short_of_end,
    passes_end,
    passes_point,
)
from circlecal.observations import LineEnd, LinePoints, MarkingKey, Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points

SOCCER = load_field("soccer")
CIRCLE = SOCCER.circle_by_name["centre_circle"]
CAMERA = aim_camera(np.array([-1.0, 62.0, -15.0]), np.array([1.0, -10.0, 0.0]), 2000.0, 0.0, 1920, 1080)
FAR_END = np.array([0.0, -34.0 + SOCCER.marking_width_m])


def seen(ends=(), further=(), seed=0):
    """Circle and halfway line with its ends, and nameless lines."""
    rng = np.random.default_rng(seed)
    circle = circle_points(CAMERA, SOCCER, "center", 200, 0.4, rng)
    halfway = replace(line_points(CAMERA, SOCCER, "halfway_line", 60, 0.4, rng), ends=tuple(ends))
    return Observations(1920, 1080, (circle,), (halfway, *further))


def far_end(offset_px=0.0, crossed=True):
    return LineEnd(CAMERA.project(FAR_END) - np.array([0.0, offset_px]), crossed)


def nameless(y_m):
    points = CAMERA.project(np.stack([np.linspace(-20, 20, 80), np.full(80, y_m)], axis=-1))
    return LinePoints(None, points, np.full(80, 0.4))


def fitted(observations):
    return estimate_camera(observations, SOCCER, CIRCLE, KNOWN.model_copy(update={"name_lines": True}))


def error_at(fit, point):
    return float(np.linalg.norm(fit.camera.project(np.array(point)) - CAMERA.project(np.array(point))))


def test_an_end_tells_how_far_the_touchline_is():
    without, given = fitted(seen()), fitted(seen([far_end()]))
    assert given.max_sigma_px < 0.6 * without.max_sigma_px
    assert MarkingKey("side_line_top") in given.residuals_px
    assert error_at(given, [15.0, -30.0]) < 3.0 * given.max_sigma_px


def test_an_end_far_from_any_marking_is_not_used():
    """The edge of a banner or of a player, halfway between circle and touchline."""
    middle = LineEnd(CAMERA.project(np.array([0.0, -20.0])), False)
    given, without = fitted(seen([middle])), fitted(seen())
    assert MarkingKey("side_line_top") not in given.residuals_px
    np.testing.assert_allclose(given.theta, without.theta)


@pytest.mark.parametrize("offset_px", [-20.0, 20.0])
def test_an_end_beside_its_place_is_used_only_where_something_crosses(offset_px):
    """Worn paint ends early, and a board's edge runs on behind it; feet hide the end, where it is expected too."""
    crossed, bare = (fitted(seen([far_end(offset_px, crossed)])) for crossed in (True, False))
    assert MarkingKey("side_line_top") in crossed.residuals_px
    assert MarkingKey("side_line_top") not in bare.residuals_px
    assert error_at(bare, [15.0, -30.0]) < bare.max_sigma_px
    assert MarkingKey("side_line_top") not in fitted(seen([far_end(crossed=False)])).residuals_px


@pytest.mark.parametrize("beyond_m", [1.5, 3.0])
def test_an_edge_beyond_the_end_is_no_touchline(beyond_m):
    board = nameless(-34.0 - beyond_m)
    fit = fitted(seen([far_end()], [board]))
    assert MarkingKey("side_line_top") not in fit.named_lines
    assert error_at(fit, [15.0, -30.0]) < 3.0 * fit.max_sigma_px


def test_the_line_through_the_end_is_the_touchline():
    fit = fitted(seen([far_end()], [nameless(-34.0 + 0.5 * SOCCER.marking_width_m), nameless(-36.0)]))
    assert fit.named_lines == ("side_line_top",)
    assert error_at(fit, [15.0, -30.0]) < 3.0 * fit.max_sigma_px


def test_lines_that_pass():
    segment = np.array([[100.0, 200.0], [900.0, 200.0]])
    assert passes_point(segment, np.array([500.0, 202.0]), 1.0)
    assert not passes_point(segment, np.array([500.0, 206.0]), 1.0)
    # drawn on, a lens bends it
    assert passes_point(segment, np.array([1500.0, 206.0]), 1.0)


def test_an_end_lies_anywhere_within_the_marking_that_it_meets():
    """Near the camera a marking is wide in the picture, and the end is known no better than that."""
    segment = np.stack([np.linspace(100.0, 900.0, 81), np.full(81, 200.0)], axis=-1)
    far, near = (LinePoints("side_line_top", np.array([[500.0, 205.0]]), np.array([s])) for s in (2.0, 4.0))
    assert not passes_end(segment, far, 1.0)
    assert passes_end(segment, near, 1.0)


def test_a_long_line_passes_an_end_where_the_lens_bends_it():
    """By 3 px in the middle of the picture."""
    x = np.linspace(0.0, 1280.0, 641)
    touchline = np.stack([x, 650.0 + 3.0 * (1.0 - ((x - 640.0) / 640.0) ** 2)], axis=-1)
    middle, beside = (LinePoints("side_line_bottom", np.array([[640.0, y]]), np.array([1.3])) for y in (653.0, 650.0))
    assert passes_end(touchline, middle, 1.0)
    assert not passes_end(touchline, beside, 1.0)
    # a line that ends before goes on as its own ends say
    short = touchline[touchline[:, 0] < 500.0]
    assert passes_end(short, LinePoints("side_line_bottom", np.array([[640.0, 654.4]]), np.array([1.3])), 1.0)


def test_a_line_through_an_end_says_where_that_marking_runs():
    observations = seen([], [nameless(-34.0 + 0.5 * SOCCER.marking_width_m), nameless(-30.0)])
    met = (LinePoints("side_line_top", CAMERA.project(FAR_END)[None], np.array([2.0])),)
    assert agree_with_ends({1: "side_line_top"}, met, observations)
    assert not agree_with_ends({2: "side_line_top"}, met, observations)
    assert not agree_with_ends({1: "side_line_bottom"}, met, observations)
    assert not agree_with_ends({}, met, observations)


def test_a_line_that_the_halfway_line_runs_beyond_is_no_touchline():
    """Another sport's, along the field: the halfway line ends at its own touchline, which players hide."""
    inner, outer = nameless(-26.0), nameless(-34.0 + 0.5 * SOCCER.marking_width_m)
    length = np.ptp(inner.points_px[:, 0])
    beside = replace(inner, points_px=inner.points_px + np.array([5.0 * length, 0.0]))
    halfway = line_points(CAMERA, SOCCER, "halfway_line", 1200, 0.4, np.random.default_rng(1))
    observations = replace(seen([], [inner, outer, beside]), lines=(halfway, inner, outer, beside))
    sides = {(0, "side_line_top"), (0, "side_line_bottom")}
    assert find_passed_lines(observations, [1, 2, 3], SOCCER) == sides
    # drawn on by one of its lengths it meets the halfway line as well
    nearer = replace(inner, points_px=inner.points_px + np.array([1.5 * length, 0.0]))
    assert find_passed_lines(replace(observations, lines=(halfway, nearer)), [1], SOCCER) == sides
    assert "side_line_top" not in fitted(replace(observations, lines=(halfway, inner))).named_lines
    # lettering on the floor hides the crossing
    away = np.abs(halfway.points_px[:, 1] - np.interp(halfway.points_px[:, 0], *inner.points_px.T))
    clear = replace(halfway, points_px=halfway.points_px[away > 12.0], sigma_px=halfway.sigma_px[away > 12.0])
    assert find_passed_lines(replace(observations, lines=(clear, inner)), [1], SOCCER) == sides
    # where its paint was seen to end, what goes on behind it is something else
    ending = replace(halfway, ends=(LineEnd(CAMERA.project(np.array([0.0, -26.0])), False),))
    assert not find_passed_lines(replace(observations, lines=(ending, inner)), [1], SOCCER)


@pytest.mark.parametrize(("away_m", "is_believed"), [(4.0, True), (25.0, False)])
def test_a_line_passes_an_end_only_where_it_is_seen_near_it(away_m, is_believed):
    """A streak of a floor that is drawn on by three of its lengths passes through an end by chance."""
    points = CAMERA.project(np.stack([np.linspace(away_m, away_m + 8.0, 40), np.full(40, -34.0)], axis=-1))
    streak = LinePoints(None, points, np.full(40, 0.4))
    given = Observations(
        1920, 1080, (), (line_points(CAMERA, SOCCER, "halfway_line", 60, 0.4, np.random.default_rng(0)), streak)
    )
    assert line_ends._is_crossed(far_end(crossed=False), given.lines[0], given, 1.0) is is_believed


def test_a_long_line_crosses_an_end_where_the_lens_bends_it():
    """By 9 px in the middle of the picture."""
    end_px = np.array([640.0, 209.0])
    across = np.linspace(0.0, 1280.0, 641)
    halfway = LinePoints(
        "halfway_line", np.stack([np.full(60, 640.0), np.linspace(215.0, 600.0, 60)], axis=-1), np.full(60, 0.4)
    )
    for bend_px, is_believed in ((9.0, True), (-9.0, False)):
        bent = 200.0 + bend_px * (1.0 - ((across - 640.0) / 640.0) ** 2)
        touchline = LinePoints(None, np.stack([across, bent], axis=-1), np.full(641, 0.4))
        given = Observations(1920, 1080, (), (halfway, touchline))
        assert line_ends._is_crossed(LineEnd(end_px, False), halfway, given, 1.0) is is_believed


@pytest.mark.parametrize(("y_m", "is_short"), [(-34.0, False), (-31.0, True), (-36.0, False), (31.0, False)])
def test_a_line_before_the_end_of_the_halfway_line_is_no_border(y_m, is_short):
    """A streak of light before the far touchline; what lies behind the end, or on the other side, is none either."""
    middle = CAMERA.project(np.zeros(2))
    assert lies_short_of_end(nameless(y_m).points_px, (far_end(),), middle, 1.0) is is_short
    assert not lies_short_of_end(nameless(y_m).points_px, (), middle, 1.0)


def test_a_missed_end_is_reached_by_a_camera_that_stands_farther():
    """From a third of the distance the fit stays where a lens and perspective together explain the circle."""
    near = CAMERA.position_m / 3.0
    closer = replace(CAMERA, position_m=near, focal_px=CAMERA.focal_px / 3.0)
    task = Task(
        seen([far_end()]), SOCCER, CIRCLE, KNOWN.model_copy(update={"k1_sd": 0.05, "k1_mean": 0.0}), "bottom", None
    )
    problem = task.problem()
    end = line_ends._curve_of_point(
        SOCCER.line_by_name["side_line_top"], far_end().point_px, np.full(1, line_ends.SIGMA_PX), SOCCER
    )
    problem = replace(problem, curves=join_curves(end, problem.curves))
    theta = theta_of(closer, problem.model)[None]
    stuck = evaluate(problem, theta, ground_feet(problem.curves, theta, problem.model))
    assert abs(stuck.values[0, 0]) > line_ends.MISSED_SIGMAS
    reached = line_ends._reach_ends(problem, stuck, 1, np.inf)
    assert abs(reached.values[0, 0]) < 2.0
    assert np.linalg.norm(reached.theta[0, 4:7] - CAMERA.position_m) < 0.1 * np.linalg.norm(CAMERA.position_m)
    assert line_ends._reach_ends(problem, reached, 1, np.inf) is reached

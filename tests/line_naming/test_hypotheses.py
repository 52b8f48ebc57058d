"""Names of lines on floors, where markings may be painted some centimetres beside their places."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.camera.multistart import find_optima
from circlecal.camera.options import CameraConfig
from circlecal.config import load_config
from circlecal.estimation.beginnings import begin, choose_sight
from circlecal.estimation.task import Task
from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX
from circlecal.line_naming import hypotheses
from circlecal.line_naming.association import Association
from circlecal.line_naming.hypotheses import Trial, select_trial
from circlecal.observations import Observations
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera
from circlecal.synthetic.markings import circle_points, line_points

FUTSAL = load_field("futsal")
CAMERA = aim_camera(np.array([4.0, 14.0, -6.0]), np.array([1.0, -2.0, 0.0]), 1500.0, 0.01, 1920, 1080)


def look_with_circle_off(offset_m):
    """Circle, halfway line and a nameless touchline, with the circle painted so far along the field."""
    rng = np.random.default_rng(0)
    painted = FUTSAL.move_markings(lambda name: (offset_m, 0.0) if name == "centre_circle" else (0.0, 0.0))
    halfway, touchline = (
        line_points(CAMERA, painted, name, 60, 0.3, rng) for name in ("halfway_line", "side_line_top")
    )
    circle = circle_points(CAMERA, painted, "center", 200, 0.05, rng)
    return Observations(1920, 1080, (circle,), (halfway, replace(touchline, line=None)))


@pytest.mark.parametrize(("placement_sd_m", "names"), [(0.0, {}), (0.015, {1: "side_line_top"})])
def test_a_touchline_gets_its_name_although_the_circle_is_painted_beside_its_place(placement_sd_m, names):
    template = FUTSAL.model_copy(update={"placement_sd_m": placement_sd_m})
    circle, config = template.circle_by_name["centre_circle"], load_config("futsal").camera
    fit = estimate_camera(look_with_circle_off(0.04), template, circle, config)
    assert fit.names_by_line == names


def test_the_longest_lines_are_tried_alone_under_every_name_that_they_can_have(monkeypatch):
    monkeypatch.setattr(hypotheses, "RIVALS", 2)
    monkeypatch.setattr(hypotheses, "try_names", lambda scene, associations, starts: associations)
    scene = SimpleNamespace(lengths_px=np.array([5.0, 9.0, 7.0]), elsewhere=frozenset({(1, "side_line_left")}))
    given = [Association({0: "side_line_left", 1: "side_line_top"}, 14.0, 1.0)]
    alone = hypotheses._try_alone(scene, given, np.zeros((1, 17)))
    assert [tried.names for tried in alone] == [{1: "side_line_top"}, {2: "side_line_left"}, {2: "side_line_top"}]


def test_rivals_are_compared_by_what_painters_errors_leave_of_their_strain(monkeypatch):
    """A streak of light beside the far touchline of a rendered hall, which was taken for it, 35 px off."""
    costs = {(): 63.0, (0,): 78.1, (1,): 69.2}
    monkeypatch.setattr(hypotheses, "_cost_with_errors", lambda scene, tried, theta: costs[tuple(tried.names)])
    model = SimpleNamespace(width=1280)
    scene = SimpleNamespace(lengths_px=np.array([369.0, 314.0]), unit=2 / 3, problem=SimpleNamespace(model=model))

    def trial(k, explained_px, score):
        named = Association({k: "side_line_top"}, explained_px, 0.0)
        return Trial(named, np.arange(2) == k, explained_px, score, np.zeros(17), np.eye(17))

    streak, touchline = trial(1, 314.0, 250.0), trial(0, 369.0, -104.0)
    assert select_trial([streak, touchline], 1280) is streak
    weighed = hypotheses._weigh_rivals(scene, [streak, touchline], streak)
    assert [round(tried.score) for tried in weighed] == [252, 218]
    assert select_trial(weighed, 1280) is None
    # one that explains too little is no rival, and nothing is weighed
    short = trial(0, 60.0, -104.0)
    assert hypotheses._weigh_rivals(scene, [streak, short], streak) == [streak, short]


def test_a_name_strains_known_markings_by_no_more_than_the_circle_is_off():
    """Painted four centimetres off, each of circle and line is some two standard deviations beside its place."""
    seen = look_with_circle_off(0.04)
    circle, config = FUTSAL.circle_by_name["centre_circle"], load_config("futsal").camera
    task = Task(seen, FUTSAL, circle, config, "main", None)
    sight = choose_sight(task)
    task, problem, starts = begin(task, sight)
    state = find_optima(problem, starts, config, task.side).best()
    scene = hypotheses.make_naming_scene([1], problem, state, seen, FUTSAL, task.coarse_noise)
    named = Association({0: "side_line_top"}, 1.0, 0.0)
    alone, with_line = (
        hypotheses._cost_with_errors(scene, tried, state.theta[0]) for tried in (Association({}, 0.0, 0.0), named)
    )
    assert 0.0 < with_line - alone < 15.0


@pytest.mark.parametrize(("told", "apart_m", "taken"), [(True, 28.0, False), (True, 1.0, True), (False, 28.0, True)])
def test_names_that_tell_different_sizes_of_the_field_are_rivals(told, apart_m, taken):
    """A red line named as goal line, or the front of the penalty area: two lines, of which each may have its name."""

    def trial(k, name, length_m, score):
        theta, normal = np.zeros(17), np.eye(17)
        theta[INDEX["length"]] = length_m
        normal[INDEX["length"], INDEX["length"]] = 100.0 if told else 1.0 / 8.66**2
        return Trial(Association({k: name}, 300.0, 0.0), np.arange(2) == k, 300.0, score, theta, normal)

    red, front = trial(0, "side_line_right", -13.5, 290.0), trial(1, "big_rect_right_main", -13.5 + apart_m, 280.0)
    best = select_trial([red, front], 1280, np.array([8.66, 13.0]))
    assert best is (red if taken else None)


def test_lines_lie_on_the_extents_of_their_markings_after_the_fit():
    """A line of 30 m is no front of a goal area, 18.3 m long, whatever its direction."""
    soccer = load_field("soccer")
    names = ("small_rect_left_main", "big_rect_left_main")
    associations = [Association({1: name}, 300.0, 0.0) for name in names]
    feet = np.tile(np.concatenate([[7.0, 7.0], np.linspace(4.0, 34.0, 6)]), (2, 1))
    assumed = SimpleNamespace(of_line=np.tile([False, True], (2, 6, 1)))
    scene = SimpleNamespace(template=soccer)
    found = hypotheses._lie_on_extents(scene, associations, SimpleNamespace(feet=feet), assumed)
    assert found[:, 1].tolist() == [False, True]


def test_hypotheses_are_fitted_to_the_points_of_their_own_lines():
    """Fitted side by side, one line against two, they come to the cameras of fits alone: the points of the longer one
    that fill up the shorter one count for nothing.
    """
    rng, soccer = np.random.default_rng(0), load_field("soccer")
    camera = aim_camera(np.array([5.0, 60.0, -15.0]), np.array([18.0, -5.0, 0.0]), 1500.0, 0.01, 1920, 1080)
    names = ("side_line_top", "big_rect_right_main")
    halfway, *lines = (
        line_points(camera, soccer, name, count, 0.3, rng)
        for name, count in zip(("halfway_line", *names), (60, 60, 30), strict=True)
    )
    circle = circle_points(camera, soccer, "center", 200, 0.3, rng)
    nameless = (replace(line, line=None) for line in lines)
    seen = Observations(1920, 1080, (circle,), (halfway, *nameless))
    task = Task(seen, soccer, soccer.circles[0], CameraConfig(), "main", None)
    sight = choose_sight(task)
    task, problem, starts = begin(task, sight)
    state = find_optima(problem, starts, task.config, task.side).best()
    scene = hypotheses.make_naming_scene([1, 2], problem, state, seen, soccer, task.coarse_noise)
    tried = [Association({1: names[1]}, 1.0, 0.0), Association({0: names[0], 1: names[1]}, 1.0, 0.0)]
    together = hypotheses.try_names(scene, tried, np.repeat(state.theta, 2, axis=0))
    for trial, association in zip(together, tried, strict=True):
        (alone,) = hypotheses.try_names(scene, [association], state.theta)
        assert alone.passed.tolist() == trial.passed.tolist()
        assert [trial.score, *trial.theta] == pytest.approx([alone.score, *alone.theta], rel=1e-6, abs=1e-9)
    assert together[1].passed.all() and together[0].passed.tolist() == [False, True]


@pytest.mark.parametrize(("scores", "grown"), [((900, 890, 880, 870, 860), 4), ((900, 500, 400, 300, 200), 2)])
def test_all_hypotheses_near_the_best_one_are_grown(scores, grown):
    """Of four that name one line each in another way the last led to all six lines of a rendered penalty area."""
    asked = []
    trials = [
        Trial(Association({0: f"{k}"}, 300.0, 0.0), np.arange(2) == 0, 300.0, score, np.full(17, k), np.eye(17))
        for k, score in enumerate(scores)
    ]

    def hypotheses_of(thetas, normals, count, left):
        assert left.tolist() == [[False, True]] * len(thetas)
        asked.extend(int(theta[0]) for theta in thetas)
        return [[] for _ in thetas]

    problem = SimpleNamespace(model=SimpleNamespace(width=1280))
    scene = SimpleNamespace(problem=problem, segments=np.zeros((2, 2, 2)), hypotheses=hypotheses_of)
    assert hypotheses.match_further_lines(scene, trials, 2) == trials
    assert asked == list(range(grown))


def test_lines_are_left_where_a_fit_passes_through_all_that_it_names():
    trial = Trial(Association({0: "a", 2: "b"}, 300.0, 0.0), np.arange(3) != 1, 300.0, 0.0, np.zeros(17), np.eye(17))
    assert trial.left.tolist() == [False, True, False]
    assert replace(trial, passed=np.arange(3) == 0).left is None

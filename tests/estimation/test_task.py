"""Lines keep the numbers by which they get their names."""

import numpy as np

from circlecal.camera.options import CameraConfig
from circlecal.estimation.task import Task
from circlecal.field import load_field
from circlecal.observations import LineEnd, LinePoints, MarkingKey, Observations

SOCCER = load_field("soccer")
POINTS = np.stack([np.arange(9.0), np.zeros(9)], axis=-1)


def task_of(*names: str | None) -> Task:
    end = LineEnd(POINTS[0], crossed=True)
    lines = tuple(LinePoints(name, POINTS, np.ones(9), (end,)) for name in names)
    return Task(Observations(640, 480, (), lines), SOCCER, SOCCER.circles[0], CameraConfig(), "main", None)


def seen_of(task: Task) -> list[tuple[str | None, int, int]]:
    """Name, number of points and number of ends of each line."""
    return [(line.line, len(line.points_px), len(line.ends)) for line in task.observations.lines]


def test_a_line_that_is_left_out_keeps_its_number_and_loses_the_name_that_it_was_given():
    named = task_of("halfway_line", "side_line_left", None, None).with_names({2: "side_line_top", 3: "goal_line"})
    left = named.without({MarkingKey("side_line_left"), MarkingKey("side_line_top")})
    assert seen_of(left) == [("halfway_line", 9, 1), (None, 0, 0), (None, 0, 0), ("goal_line", 9, 1)]
    assert left.names == {3: "goal_line"}


def test_a_marking_that_is_nothing_is_found_by_the_number_of_its_line():
    given = task_of("halfway_line", "side_line_left", None, None)
    left = given.without({MarkingKey("side_line_left")}).without_marking("side_line_top", {2: "side_line_top"}, False)
    assert seen_of(left) == [("halfway_line", 9, 1), (None, 0, 0), (None, 0, 0), (None, 9, 1)]
    assert seen_of(given.without_marking("side_line_left", {}, True)) == [
        ("halfway_line", 9, 0), (None, 0, 0), (None, 9, 0), (None, 9, 0),
    ]  # fmt: skip


def test_names_are_given_to_lines_that_have_none_and_show_something():
    given = task_of("halfway_line", "side_line_left", None).without({MarkingKey("side_line_left")})
    named = given.with_names({0: "goal_line", 1: "side_line_left", 2: "side_line_top"})
    assert [line.line for line in named.observations.lines] == ["halfway_line", None, "side_line_top"]
    assert named.names == {2: "side_line_top"}

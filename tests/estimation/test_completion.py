"""What can be named beside the circle and its line."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

import circlecal
from circlecal.estimation import completion as module
from circlecal.line_naming.hypotheses import Naming
from circlecal.observations import LineEnd, LinePoints, Observations

HEAD, TRUE = (LineEnd(np.array([640.0, y]), crossed=True) for y in (80.0, 640.0))
ONE, THREE = {1: "side_line_bottom"}, {1: "side_line_bottom", 2: "big_rect_left_main", 3: "side_line_left"}


FOUR = THREE | {4: "small_rect_left_main"}


def recognise(monkeypatch, ends, name, strain=0.0):
    """What is named of four nameless lines beside a halfway line with these ends by a function of their rows."""
    points = np.stack([np.full(60, 640.0), np.linspace(100.0, 640.0, 60)], axis=-1)
    lines = [LinePoints("halfway_line", points, np.ones(60), ends)]
    lines += [LinePoints(None, points, np.ones(60))] * 4
    observations = Observations(1280, 720, (), tuple(lines))

    def add_line_ends(problem, state, observations, template):
        ends = observations.lines[0].ends
        fitted = SimpleNamespace(cost=np.array([24.0 + strain * (len(ends) > 1)]))
        points = (LinePoints("side_line", end.point_px[None], np.ones(1)) for end in ends)
        return problem, fitted, tuple(points)

    def name_lines(problem, state, observations, template, noise, ends=()):
        return Naming(name([float(end.points_px[0, 1]) for end in ends]), np.array([float(len(ends))]))

    monkeypatch.setattr(module, "add_line_ends", add_line_ends)
    monkeypatch.setattr(module, "name_lines", name_lines)
    monkeypatch.setattr(module, "curves_from_observations", lambda seen, *_: seen.lines)
    monkeypatch.setattr(module, "join_curves", lambda stated, further: further)
    monkeypatch.setattr(module, "replace", lambda given, **new: _replace(given, new))
    config = SimpleNamespace(name_lines=True)
    task = SimpleNamespace(observations=observations, template=None, config=config, coarse_noise=None, noise=None)
    fit = SimpleNamespace(problem=SimpleNamespace(), state=SimpleNamespace(cost=np.array([24.0])))
    found = module.recognise(cast("Any", task), cast("Any", None), cast("Any", fit))
    assert found is not None
    kept = [line for line in cast("Any", found.problem).curves if len(line.points_px) == 1]
    return found.names, [float(end.points_px[0, 1]) for end in kept]


@pytest.mark.parametrize(
    ("strain", "alone", "names"), [(18.0, THREE, THREE), (2.0, THREE, ONE), (18.0, {1: "side_line_top"}, ONE)]
)
def test_an_end_that_strains_the_other_is_none_where_more_is_named_without_it(strain, alone, names, monkeypatch):
    """A player's head before a board was taken for the halfway line's end."""
    found = recognise(monkeypatch, (HEAD, TRUE), lambda rows: alone if rows == [640.0] else ONE, strain)
    assert found == (names, [640.0] if names == THREE else [80.0, 640.0])


@pytest.mark.parametrize(("without", "overrules"), [(FOUR, True), (THREE, False)])
def test_a_whole_structure_of_lines_overrules_an_end_with_which_one_line_has_a_name(without, overrules, monkeypatch):
    """All six lines around a rendered penalty area had names without the end of the halfway line, one with it."""
    found = recognise(monkeypatch, (HEAD,), lambda rows: ONE if rows else without)
    assert found == ((FOUR, []) if overrules else (ONE, [80.0]))


CIRCLE = [
    [1267.7, 610.4], [1191.4, 705.4], [946.5, 783.2], [595.1, 810.3], [267.8, 775.5], [75.0, 687.9],
    [73.3, 594.8], [226.9, 511.3], [467.2, 462.5], [737.2, 446.1], [992.4, 464.7], [1186.9, 523.2],
]  # fmt: skip
HALFWAY_LINE = [[811.2, 173.3], [746.3, 345.0], [676.8, 601.5], [553.1, 1075.9]]
TOUCHLINE = [[9.3, 164.3], [645.4, 174.0], [1268.1, 178.5], [1911.2, 175.0]]


def test_a_wrong_click_is_no_pitch_that_falls_by_more_than_a_metre():
    """One point of the halfway line lies 25 px off: a parabola with a roof's crown at the circle took the camera 25 m
    away, named nothing and called it a sigma of 50 px.
    """
    lines = {"halfway_line": HALFWAY_LINE, "side_line_top": TOUCHLINE}
    found = circlecal.calibrate_points(size=(1920, 1080), circle=CIRCLE, lines=lines, sigma_px=1.5, convention="paint")
    assert found.code == "residual_too_large"


def _replace(given, new):
    kept = {name: getattr(given, name) for name in getattr(given, "__slots__", ())}
    return SimpleNamespace(**kept | new) if isinstance(given, SimpleNamespace) else type(given)(**kept | new)

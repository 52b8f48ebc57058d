"""What can be named beside the circle and its line."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from circlecal.estimation import completion as module
from circlecal.line_naming.hypotheses import Naming
from circlecal.observations import LineEnd, LinePoints, Observations

HEAD, TRUE = (LineEnd(np.array([640.0, y]), crossed=True) for y in (80.0, 640.0))
ONE, THREE = {1: "side_line_bottom"}, {1: "side_line_bottom", 2: "big_rect_left_main", 3: "side_line_left"}


@pytest.mark.parametrize(
    ("strain", "alone", "names"), [(18.0, THREE, THREE), (2.0, THREE, ONE), (18.0, {1: "side_line_top"}, ONE)]
)
def test_an_end_that_strains_the_other_is_none_where_more_is_named_without_it(strain, alone, names, monkeypatch):
    """A player's head before a board was taken for the halfway line's end."""
    points = np.stack([np.full(60, 640.0), np.linspace(100.0, 640.0, 60)], axis=-1)
    lines = [LinePoints("halfway_line", points, np.ones(60), (HEAD, TRUE))]
    lines += [LinePoints(None, points, np.ones(60))] * 3
    observations = Observations(1280, 720, (), tuple(lines))

    def add_line_ends(problem, state, observations, template):
        ends = observations.lines[0].ends
        fitted = SimpleNamespace(cost=np.array([24.0 + strain * (len(ends) > 1)]))
        points = (LinePoints("side_line", end.point_px[None], np.ones(1)) for end in ends)
        return problem, fitted, tuple(points)

    def name_lines(problem, state, observations, template, noise, ends=()):
        places = [float(end.points_px[0, 1]) for end in ends]
        return Naming(alone if places == [640.0] else ONE, np.array([float(len(ends))]))

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
    assert found.names == names
    ends = [line for line in cast("Any", found.problem).curves if len(line.points_px) == 1]
    assert [float(end.points_px[0, 1]) for end in ends] == ([640.0] if names == THREE else [80.0, 640.0])


def _replace(given, new):
    kept = {name: getattr(given, name) for name in getattr(given, "__slots__", ())}
    return SimpleNamespace(**kept | new) if isinstance(given, SimpleNamespace) else type(given)(**kept | new)

"""Ends of the halfway line inside the picture."""

import json

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.formats.exchange import read_observations
from circlecal.formats.line_ends import with_halfway_ends
from circlecal.observations import LinePoints, Observations


def seen(*points):
    line = LinePoints("halfway_line", np.array(points, dtype=float), np.full(len(points), 1.5))
    return Observations(1920, 1080, lines=(line,))


def test_an_end_inside_is_a_corner_of_the_touchline():
    found = with_halfway_ends(seen([900, 1079], [910, 300], [905, 700]), load_field("soccer"))
    (end,) = found.keypoints
    assert end.field_m == pytest.approx([0, -34])
    assert end.point_px == pytest.approx([910, 300])
    assert end.sigma_px == pytest.approx(3.0)


def test_both_ends_or_none():
    both = with_halfway_ends(seen([900, 900], [910, 300]), load_field("soccer"))
    assert [k.field_m[1] for k in both.keypoints] == [-34, 34]
    assert not with_halfway_ends(seen([900, 1075], [910, 3]), load_field("soccer")).keypoints
    assert not with_halfway_ends(Observations(1920, 1080), load_field("soccer")).keypoints


def test_only_where_asked_for(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"Middle line": [{"x": 0.5, "y": 0.3}, {"x": 0.5, "y": 0.9999}]}))
    for name, count in (("annotations", 1), (None, 0)):
        config = load_config(name, [])
        (frame,) = read_observations(path, load_field("soccer"), config.sources, (1920, 1080))
        assert len(frame.observations.keypoints) == count

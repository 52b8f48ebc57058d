"""Names of lines on floors, where markings may be painted some centimetres beside their places."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.line_naming import hypotheses
from circlecal.line_naming.association import Association
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

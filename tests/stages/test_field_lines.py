"""Straight markings without a circle: which of the lines with a name are paint."""

from types import SimpleNamespace

import cv2
import numpy as np

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import ProjectionModel, theta_of
from circlecal.line_naming.two_directions import FieldHypothesis
from circlecal.observations import CirclePoints, LinePoints, MarkingKey, Observations
from circlecal.results import MarkingMask, Segment
from circlecal.stages import field_lines
from circlecal.stages.field_lines import observe_field_lines, without_worst_marking
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1280, 720)
CAMERA = aim_camera(np.array([-2.0, 62.0, -16.0]), np.array([-42.0, -1.0, 0.0]), 2500.0, 0.01, 1280, 720)
WIDTHS_PX = {"side_line_left": 3, "big_rect_left_main": 3, "big_rect_left_top": 3, "side_line_top": 11}


def test_a_line_far_wider_than_its_paint_would_be_is_left_out(monkeypatch):
    """A board's lettering lies along the far touchline."""
    picture = np.full((720, 1280), 90, np.uint8)
    segments = []
    for name, width in WIDTHS_PX.items():
        line = SOCCER.line_by_name[name]
        points = CAMERA.project(np.linspace(line.start, line.end, 200))
        seen = points[((points > 40) & (points < (1240, 680))).all(axis=1)]
        ends = [tuple(np.rint(end).astype(int).tolist()) for end in seen[[0, -1]]]
        cv2.line(picture, *ends, 200, width, cv2.LINE_AA)
        segments.append(Segment(seen[0], seen[-1]))
    naming = FieldHypothesis(dict(enumerate(WIDTHS_PX)), theta_of(CAMERA, MODEL), 1.0)
    monkeypatch.setattr(field_lines, "propose_cameras", lambda *_: [naming])
    mask = MarkingMask(picture, "detector", lines=tuple(segments))
    ((found, theta),) = observe_field_lines(picture, mask, 1.0, SOCCER, 8.0, 2.0, "near")
    assert theta is naming.theta
    assert [line.line for line in found.lines] == ["side_line_left", "big_rect_left_main", "big_rect_left_top"]


def test_what_a_camera_explains_worst_loses_its_name_or_is_left_out():
    points, sigma = np.zeros((4, 2)), np.ones(4)
    lines = tuple(LinePoints(name, points, sigma) for name in ("side_line_left", "big_rect_left_top", None))
    given = Observations(1280, 720, (CirclePoints("penalty_arc_left", "center", points, sigma),), lines)
    arc, side = MarkingKey("penalty_arc_left", "center"), MarkingKey("side_line_left")

    def leave_out(residuals_px):
        return without_worst_marking(given, SimpleNamespace(residuals_px=residuals_px))

    without_line = leave_out({arc: 1.0, side: 3.0})
    assert [line.line for line in without_line.lines] == [None, "big_rect_left_top", None]
    assert without_line.circles == given.circles
    without_arc = leave_out({arc: 3.0, side: 1.0})
    assert without_arc.lines == given.lines
    assert without_arc.circles == ()

"""The camera from lines, arcs and points where the circle is not seen."""

from dataclasses import replace

import numpy as np
import pytest

from circlecal.observations import CirclePoints, Keypoint, MarkingKey
from circlecal.stages.camera import estimate_camera
from circlecal.synthetic.cameras import aim_camera

from .camera_views import CIRCLE, EXACT, SOCCER, departure, refusal, seen

BOX = aim_camera(np.array([3.0, 62.0, -17.0]), np.array([-40.0, -4.0, 0.0]), 1900.0, 0.01, 1920, 1080)
BOX_LINES = ("big_rect_left_main", "big_rect_left_top", "side_line_left", "small_rect_left_main")


def corners(camera, *places, sigma=0.3):
    return tuple(Keypoint(f"corner {k}", np.array(p), camera.project(np.array(p)), sigma) for k, p in enumerate(places))


def box_departure(fit, camera):
    return departure(fit, camera, 10.0, (-42.0, -4.0))


@pytest.mark.parametrize(
    ("lines", "places"),
    [
        (BOX_LINES, ()),
        (BOX_LINES[:2], ((-36.0, 20.16), (-47.0, 9.16))),
        ((), ((-36.0, -20.16), (-36.0, 20.16), (-47.0, 9.16), (-52.5, -9.16))),
    ],
    ids=["lines", "lines and points", "points"],
)
def test_lines_and_points_without_the_circle_are_exact(lines, places):
    given = replace(seen(BOX, line=None, circles=(), lines=lines), keypoints=corners(BOX, *places))
    fit = estimate_camera(given, SOCCER, CIRCLE, EXACT)
    assert box_departure(fit, BOX) < 1e-6
    # judged about the penalty area, not about the circle
    assert np.linalg.norm(fit.reference_m - [-44.0, -10.0]) < 15
    assert 0 < fit.max_sigma_px < 20


def test_a_camera_behind_the_goal_needs_no_side():
    camera = aim_camera(np.array([-75.0, -6.0, -14.0]), np.array([-44.0, 0.0, 0.0]), 1600.0, 0.01, 1920, 1080)
    given = seen(camera, line=None, circles=(), lines=BOX_LINES)
    assert box_departure(estimate_camera(given, SOCCER, CIRCLE, EXACT), camera) < 1e-6


def test_penalty_arc_and_one_line_with_a_known_position():
    arc = SOCCER.circle_by_name["penalty_arc_left"]
    angle = np.radians(np.linspace(arc.start_deg, arc.end_deg, 60))
    field = np.asarray(arc.center) + SOCCER.radius(arc, "outer") * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    given = seen(BOX, line=None, circles=(), lines=("big_rect_left_main",))
    part = CirclePoints("penalty_arc_left", "outer", BOX.project(field), np.full(60, 0.3))
    config = EXACT.model_copy(update={"position_m": tuple(BOX.position_m)})
    fit = estimate_camera(replace(given, circles=(part,)), SOCCER, CIRCLE, config)
    assert box_departure(fit, BOX) < 1e-3


def test_wrong_points_and_lines_are_named_and_left_out():
    places = ((-36.0, 20.16), (-47.0, 9.16), (-36.0, -20.16), (-41.5, 0.0))
    lines = (*BOX_LINES, "side_line_top", "small_rect_left_top")
    good = replace(seen(BOX, line=None, circles=(), lines=lines), keypoints=corners(BOX, *places))
    bad = replace(good.keypoints[1], point_px=good.keypoints[1].point_px + np.array([40.0, -25.0]))
    top = next(line for line in good.lines if line.line == "big_rect_left_top")
    given = replace(
        good,
        keypoints=(good.keypoints[0], bad, *good.keypoints[2:]),
        lines=tuple(
            replace(top, points_px=top.points_px + np.array([0.0, 60.0])) if s is top else s for s in good.lines
        ),
    )
    fit = estimate_camera(given, SOCCER, CIRCLE, EXACT)
    wrong = {MarkingKey("corner 1"), MarkingKey("big_rect_left_top")}
    assert set(fit.rejected) == wrong
    assert not wrong & set(fit.residuals_px)
    assert box_departure(fit, BOX) < 1e-6


@pytest.mark.parametrize(
    ("lines", "places", "config"),
    [((), (), EXACT), (BOX_LINES[:3], (), EXACT), ((), ((-36.0, 20.16),), EXACT.model_copy(
        update={"position_m": (0.0, 60.0, -15.0)}))],
    ids=["nothing", "three lines", "one point"],
)  # fmt: skip
def test_too_little_beside_no_circle_is_refused(lines, places, config):
    given = replace(seen(BOX, line=None, circles=(), lines=lines), keypoints=corners(BOX, *places))
    refused = refusal(given, config)
    assert refused.code == "no_circle"
    others = len(lines) + len(places)
    assert f"and {others} other marking{'' if others == 1 else 's'} were seen" in refused.reason

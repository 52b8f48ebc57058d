"""Errors put into keypoints come out of the audit."""

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.evaluation.audit import OPPOSED, audit_frames, distances_by_pair, opposite_pair_distances, pair_rows
from circlecal.field import load_field
from circlecal.formats.pnlcalib import keypoint_table, tangency_points
from circlecal.formats.shapes import AnnotatedFrame, Shape
from evaluation.scenes import look_at_circle

CIRCLE = (32, 35, 48, 49, 50, 51, 52, 53, 54)


def detected(camera, moved=None):
    """Exact keypoints of the circle and the far end of the halfway line, some of them moved."""
    table = {n: p for n, p in keypoint_table(load_field("soccer")).items() if n in (*CIRCLE, 2)}
    table |= tangency_points(9.15)
    shapes = []
    for number, position in table.items():
        pixel = camera.project(position) + np.array((moved or {}).get(number, (0.0, 0.0)))
        shapes.append(Shape(f"kp_{number}", "points", pixel[None], (0.9,)))
    return AnnotatedFrame("a", camera.width, camera.height, tuple(shapes))


@pytest.fixture(scope="module")
def config():
    return load_config("annotations", [])


def test_table_pairs_are_opposed():
    table = keypoint_table(load_field("soccer")) | tangency_points(9.15)
    for first, second in OPPOSED:
        (x0, y0), (x1, y1) = table[first], table[second]
        assert x0 * y1 - x1 * y0 == pytest.approx(0.0, abs=1e-9)


def test_exact_keypoints(config):
    frame = detected(look_at_circle())
    (found,) = audit_frames([frame], "kp", config)
    assert len(found.distances_px) == len(OPPOSED)
    assert max(found.distances_px.values()) < 1e-9


def test_injected_errors_in_pixels(config):
    # both keypoints of a level line up by 3 px, the centre to the right by 5 px
    frame = detected(look_at_circle(x=0.0, pan=0.0), {50: (0, 3), 52: (0, 3), 51: (5, 0)})
    (found,) = audit_frames([frame], "kp", config)
    assert found.distances_px[50, 52] == pytest.approx(3.0)
    assert found.distances_px[32, 35] == pytest.approx(5.0)
    assert opposite_pair_distances({32: np.zeros(2), 35: np.zeros(2)}, np.ones(2)) == {}


def test_our_center_does_not_follow_a_wrong_keypoint(config):
    # one point of each of two pairs 12 px off, and keypoint 51 as well: the other lines still meet in our centre
    frame = detected(look_at_circle(size=(1920, 1080), focal=3400.0, kappa=0.03), {51: (14, 14), 48: (0, 12)})
    by_kp, ours = (audit_frames([frame], center, config)[0] for center in ("kp", "ours"))
    assert ours.reason is None
    assert by_kp.distances_px[50, 52] > 10
    assert ours.distances_px[50, 52] < 1.5
    assert ours.distances_px[49, 53] < 1.5
    assert ours.distances_px[48, 54] > 3.5


def test_frames_without_an_answer(config):
    camera = look_at_circle()
    bare = AnnotatedFrame("b", 960, 540, (Shape("kp_32", "points", np.array([[1.0, 2.0]]), (0.9,)),))
    assert "opposed" in audit_frames([bare], "kp", config)[0].reason
    frame = detected(camera)
    headless = AnnotatedFrame("c", 960, 540, tuple(s for s in frame.shapes if s.label != "kp_51"))
    assert "51" in audit_frames([headless], "kp", config)[0].reason


def test_figures(config):
    frames = audit_frames([detected(look_at_circle(x=0.0, pan=0.0), {51: (dx, 0)}) for dx in (1, 2, 6)], "kp", config)
    rows = {row.pair: row for row in pair_rows(distances_by_pair(frames))}
    assert rows["32-35"].median_px == pytest.approx(2)
    assert rows["32-35"].mean_px == pytest.approx(3)
    assert rows["32-35"].largest_px == pytest.approx(6)
    assert rows["all"].count == 3 * len(OPPOSED)
    assert pair_rows({}) == []

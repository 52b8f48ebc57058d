"""Two people's annotations of a frame, compared."""

import json

import numpy as np
import pytest

from circlecal.evaluation.agreement import measure_apart
from circlecal.field import load_field
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.workbench.store import AnnotationStore

NAMES = ("centre_circle", "halfway_line", "side_line_top")


@pytest.fixture(scope="module")
def markings(frame_camera):
    """What is clicked without an error: points by name."""
    drawn = load_field("soccer").polylines(0.5)
    points = {name: frame_camera.project(drawn[name]) for name in NAMES}
    size = frame_camera.width, frame_camera.height
    inside = {name: p[((p > 5) & (p < np.array(size) - 5)).all(axis=1)] for name, p in points.items()}
    assert all(len(p) > 10 for p in inside.values())
    return size, inside


def save(folder, frame_id, markings, *, off=0.0, names=None, author="", flag=None):
    """An annotation whose straight lines lie ``off`` pixels lower."""
    (width, height), points = markings
    made = []
    for name, places in points.items():
        kind = "curve" if name == "centre_circle" else "line"
        moved = places + ((0.0, off) if name == "side_line_top" else (0.0, 0.0))
        named = (names or {}).get(name, name)
        if named is not None:
            made.append(AnnotatedMarking(name=named, kind=kind, points_px=moved.tolist(), sigma_px=[0.5] * len(moved)))
    told = Annotation(id=frame_id, width=width, height=height, markings=made, author=author, flag=flag)
    AnnotationStore(folder).save(told, 0)


def test_lines_names_and_cameras_are_compared_and_the_worst_frame_is_first(run_circlecal, markings, tmp_path):
    first, second = tmp_path / "ada", tmp_path / "bob"
    per_pixel = 1920 / markings[0][0]
    for name in ("alike", "moved", "named", "flagged"):
        save(first, name, markings, author="Ada")
    save(second, "alike", markings, author="Bob")
    save(second, "moved", markings, off=2.0, author="Bob")
    save(second, "named", markings, names={"side_line_top": "big_rect_left_top", "halfway_line": None}, author="Bob")
    save(second, "flagged", markings, flag="no_field", author="Bob")
    save(second, "alone", markings)
    outcome = run_circlecal("evaluate", first, second, "--json")
    told = json.loads(outcome.out)
    frames = {frame["id"]: frame for frame in told["frames"]}
    assert frames["alike"]["authors"] == ["Ada", "Bob"]
    assert max(frames["alike"]["lines_px"].values()) < 0.3 and frames["alike"]["camera_largest_px"] == 0.0
    assert frames["moved"]["lines_px"]["side_line_top"] == pytest.approx(2.0 * per_pixel, rel=0.05)
    assert 0.3 < frames["moved"]["camera_px"] < frames["moved"]["camera_largest_px"] < 100
    assert frames["named"]["renamed"] == [["side_line_top", "big_rect_left_top"]]
    assert (frames["named"]["only_first"], frames["named"]["only_second"]) == (["halfway_line"], [])
    assert frames["flagged"]["flags"] == [None, "no_field"] and frames["flagged"]["camera_px"] is None
    assert [frame["id"] for frame in told["frames"]][-1] == "alike"
    rows = {row["name"]: row for row in told["lines"]}
    assert rows["side_line_top"]["frames"] == 3 and rows["halfway_line"]["only_first"] == 1
    assert (told["only_first"], told["only_second"]) == ([], ["alone"])
    table = run_circlecal("evaluate", first, second)
    assert table.code == 0
    for text in ("Agreement in 4 frames", "side line top / big rect left top", "Ada", "not flagged / no field"):
        assert text in " ".join(table.out.split())
    assert "alone" in table.err


def test_folders_without_a_common_frame_are_told(run_circlecal, markings, tmp_path):
    save(tmp_path / "a", "x", markings)
    save(tmp_path / "b", "y", markings)
    outcome = run_circlecal("evaluate", tmp_path / "a", tmp_path / "b")
    assert outcome.code == 2 and "hold annotations of no frame together" in outcome.err


def test_parts_of_a_line_that_do_not_overlap_say_nothing():
    left, right = (np.array([[x, 0.1 * x] for x in span], float) for span in (range(5), range(10, 15)))
    assert measure_apart("line", left, right) is None
    assert measure_apart("line", left, left + np.array([0.0, 1.0])) == pytest.approx(1.0, abs=0.02)
    assert measure_apart("point", left[:1], left[:1] + np.array([3.0, 4.0])) == 5.0
    assert measure_apart("curve", left[:3], left[:3]) is None

"""Every rule of the official metric, by cases worked out by hand."""

import numpy as np
import pytest

from circlecal.evaluation.soccernet_metric import (
    CLASSES,
    Comparison,
    FrameComparison,
    MetricCamera,
    PlaneHomography,
    compare_frame,
    field_polylines,
    image_polylines,
    opposite_class,
    polyline_distances,
)
from evaluation.scenes import SIZE, annotation_of, look_at_circle


def overhead(focal=100.0, height=100.0, center=(50.0, 50.0), **distortion):
    """Straight down: x of the field to the right, y down, one pixel per metre with the defaults."""
    parts = {"radial": np.zeros(6), "tangential": np.zeros(2), "thin_prism": np.zeros(4)} | distortion
    return MetricCamera(np.full(2, focal), np.array(center), np.eye(3), np.array([0.0, 0.0, -height]), **parts)


def test_sampling_steps():
    drawn = field_polylines()
    assert len(drawn) == 26
    circle = drawn["Circle central"]
    assert len(circle) == 287
    assert circle[0] == pytest.approx([9.15, 0, 0])
    assert circle[1, 1] > 0  # towards y
    assert np.linalg.norm(circle[0] - circle[-1]) == pytest.approx(0.29, abs=0.005)
    line = drawn["Middle line"]
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    assert len(line) == 1 + int(68 / 0.9 - 1) + 1
    assert steps[:-1] == pytest.approx(0.9)
    assert steps[-1] == pytest.approx(68 - 74 * 0.9)
    assert drawn["Circle left"][-1] == pytest.approx([-36, np.sqrt(9.15**2 - 5.5**2), 0])
    assert drawn["Circle right"][0] == pytest.approx([36, np.sqrt(9.15**2 - 5.5**2), 0])


def test_labels_of_the_turned_field():
    turned = {name: opposite_class(name) for name in CLASSES}
    assert {turned[turned[name]] for name in CLASSES} == set(CLASSES)
    assert turned["Side line top"] == "Side line bottom"
    assert turned["Big rect. left top"] == "Big rect. right bottom"
    assert turned["Goal left post left"] == "Goal right post left"
    assert turned["Goal left crossbar"] == "Goal right crossbar"
    assert turned["Line unknown"] == "Line unknown"
    drawn = field_polylines()
    for name, points in drawn.items():  # the table is the geometry's
        other = drawn[turned[name]] * [-1, -1, 1]
        assert np.sort(points[[0, -1], 1]) == pytest.approx(np.sort(other[[0, -1], 1]), abs=0.3)


def test_border_crossings():
    # 100 x 100 pixels of one metre: the halfway line leaves above and below at rows 16 and 84: inside, so no crossing
    whole = image_polylines(overhead(), 100, 100)["Middle line"]
    assert whole[[0, -1], 1] == pytest.approx([16, 84])
    # moved up by 40 m: it starts 24 rows above the picture and enters at row 0
    cut = image_polylines(overhead(center=(50.0, 10.0)), 100, 100)["Middle line"]
    assert cut[0] == pytest.approx([50, 0], abs=1e-9)
    assert cut[1, 1] == pytest.approx(0.3, abs=1e-4)
    # moved down by 30: it leaves at H - 1, not at H
    left = image_polylines(overhead(center=(50.0, 80.0)), 100, 100)["Middle line"]
    assert left[-1] == pytest.approx([50, 99], abs=1e-9)


def test_a_line_that_leaves_and_comes_back_is_joined():
    # the circle reaches 9.15 px beyond the left border: out at one place, in at another, joined along the border
    circle = image_polylines(overhead(center=(0.0, 50.0)), 100, 100)["Circle central"]
    jumps = np.linalg.norm(np.diff(circle, axis=0), axis=1)
    at = int(jumps.argmax())
    assert circle[at] == pytest.approx([0, 59.15], abs=0.1)
    assert circle[at + 1] == pytest.approx([0, 40.85], abs=0.1)


def test_elements_out_of_view_are_absent():
    drawn = image_polylines(overhead(focal=1000.0), 100, 100)
    assert drawn.keys() == {"Middle line"}
    assert not image_polylines(overhead(focal=1000.0, center=(-150.0, 50.0)), 100, 100)


def test_points_behind_are_skipped_and_keep_the_state():
    camera = MetricCamera.from_camera(look_at_circle(x=0.0, y=20.0, z=-5.0, focal=300.0, pan=0.0))
    pixels, front = camera.project(field_polylines()["Middle line"])
    assert 0 < front.sum() < len(front)
    assert np.isfinite(pixels).all()
    drawn = image_polylines(camera, *SIZE)["Middle line"]
    assert (drawn >= 0).all()
    assert (drawn[:, 1] <= SIZE[1] - 1).all()
    assert drawn[:, 1].max() == pytest.approx(SIZE[1] - 1, abs=1e-6)  # leaves below before it passes the camera


def test_distances():
    polyline = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 0.0], [10.0, 10.0]])  # with an empty segment
    points = np.array([[5.0, 3.0], [-3.0, 4.0], [13.0, 5.0], [10.0, 0.0]])
    assert polyline_distances(points, polyline) == pytest.approx([3, 5, 3, 0])
    assert polyline_distances(points[:1], polyline[:1]) == pytest.approx([np.hypot(5, 3)])


def test_strict_threshold_and_all_points_of_an_element():
    found = Comparison({"Middle line": np.array([1.0, 5.0])}, {}, ())
    assert found.jaccard(5.0) == 0.0  # 5 px is not less than 5 px
    assert found.jaccard(5.0 + 1e-9) == 1.0


def test_jaccard_counts_missed_invented_and_unknown():
    camera = overhead(focal=1000.0)  # shows the halfway line alone
    middle = np.array([[50.0, 20.0], [50.0, 80.0]])
    assert compare_frame({"Middle line": middle}, camera, 100, 100).direct.jaccard(5) == 1.0
    unknown = compare_frame({"Middle line": middle, "Line unknown": middle}, camera, 100, 100)
    assert unknown.direct.jaccard(5) == 0.5
    assert unknown.direct.missed == {"Line unknown": 2}
    invented = compare_frame({"Side line top": middle}, camera, 100, 100).direct
    assert invented.jaccard(5) == 0.0
    assert invented.invented == ("Middle line",)
    empty = compare_frame({"Middle line": np.zeros((0, 2))}, overhead(center=(-9e3, 0.0)), 100, 100).direct
    assert empty.jaccard(5) == 0.0
    assert unknown.direct.class_points(5) == {"Middle line": (2, 0, 0), "Line unknown": (0, 0, 2)}
    assert invented.class_points(5) == {"Side line top": (0, 0, 2), "Middle line": (0, 2, 0)}


def test_turned_labels_are_taken_unless_the_direct_ones_are_strictly_better():
    good, bad = Comparison({"a": np.zeros(1)}, {}, ()), Comparison({}, {"a": 1}, ())
    assert FrameComparison(good, bad).official(5) is good
    assert FrameComparison(bad, good).official(5) is good
    same = Comparison({"b": np.zeros(1)}, {}, ())
    assert FrameComparison(good, same).official(5) is same


def test_a_camera_on_the_other_side_scores_as_well():
    camera = look_at_circle(x=10.0, pan=8.0)
    annotated = {k: np.array([(p["x"], p["y"]) for p in v]) * (959, 539) for k, v in annotation_of(camera).items()}
    score = compare_frame(annotated, MetricCamera.from_camera(camera.turn_field()), *SIZE)
    assert score.direct.jaccard(5) < 0.5
    assert score.official(5).jaccard(5) == 1.0


def test_opencv_distortion():
    import cv2

    radial = np.array([0.1, -0.05, 0.02, 0.03, -0.01, 0.004])
    tangential, prism = np.array([0.01, -0.02]), np.array([0.003, -0.002, 0.004, 0.001])
    camera = overhead(radial=radial, tangential=tangential, thin_prism=prism)
    points = np.random.default_rng(1).uniform(-60, 60, (50, 3)) * [1, 1, 0]
    order = np.concatenate([radial[:2], tangential, radial[2:], prism])
    matrix = np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]])
    expected = cv2.projectPoints(points, np.zeros(3), np.array([0.0, 0.0, 100.0]), matrix, order)[0][:, 0]
    assert camera.project(points)[0] == pytest.approx(expected, abs=1e-4)


def test_our_lens_is_that_of_the_metric():
    camera = look_at_circle(kappa=0.03)
    points = field_polylines()["Circle central"]
    assert MetricCamera.from_camera(camera).project(points)[0] == pytest.approx(camera.project(points), abs=1e-4)


def test_a_homography_draws_the_ground_only():
    camera = look_at_circle(x=30.0, pan=20.0, focal=1000.0)
    by_camera = image_polylines(MetricCamera.from_camera(camera), *SIZE)
    for sign in (1.0, -1.0):
        drawn = image_polylines(PlaneHomography(sign * camera.homography), *SIZE)
        assert drawn.keys() == {name for name in by_camera if not name.startswith("Goal")}
        assert drawn["Big rect. right main"] == pytest.approx(by_camera["Big rect. right main"], abs=1e-3)

"""Labels as circles, lines, marks and keypoints of the field; ends of the halfway line inside the picture."""

import json

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.errors import InputError
from circlecal.field import load_field
from circlecal.formats.annotation import Annotation, markings_of
from circlecal.formats.cameras import derive_shapes
from circlecal.formats.meaning import SourcesConfig, add_halfway_ends, observe, read_observations
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.observations import CirclePoints, LineEnd, LinePoints, MarkPoint, Observations


def shape(label, *points, kind="points", confidence=None):
    return Shape(label, kind, np.array(points, dtype=float).reshape(-1, 2), confidence)


def read(*shapes, template=None, source="labelme", width=1920):
    frame = AnnotatedFrame("a", width, 1080, shapes)
    return observe(frame, template or load_field("soccer"), SourcesConfig(), source, "file.json")


def test_soccernet_classes(seen, soccer):
    found = observe(seen, soccer, SourcesConfig(), "soccernet", "f")
    (circle,), (line,), (mark,) = found.observations.circles, found.observations.lines, found.observations.marks
    assert (circle.circle, circle.edge, line.line, mark.mark) == (
        "centre_circle",
        "center",
        "halfway_line",
        "centre_mark",
    )
    assert set(circle.sigma_px) == {0.75}
    assert (found.id, found.image, found.warnings) == ("view", "view.jpg", ())


@pytest.mark.parametrize(
    "label", ["Circle central", "circle CENTRAL ", "centre_circle", "Center circle", "centre  circle"]
)
def test_spellings(label):
    assert read(shape(label, (1, 2), (3, 4))).observations.circles[0].circle == "centre_circle"


@pytest.mark.parametrize(("label", "arc"), [("Circle left", "penalty_arc_left"), ("Circle right", "penalty_arc_right")])
def test_arcs(label, arc):
    assert read(shape(label, (1, 2), (3, 4), kind="line")).observations.circles[0].circle == arc


def test_points_of_one_marking_are_put_together():
    found = read(shape("Middle line", (1, 2)), shape("halfway_line", (3, 4))).observations
    assert found.lines[0].points_px.tolist() == [[1, 2], [3, 4]]


def test_lines_of_one_point_and_unknown_labels_are_warned_of():
    found = read(shape("Middle line", (1, 2)), shape("Side line top", (1, 2), (1, 2)), shape("Player", (5, 5)))
    assert not found.observations.lines
    assert [w.split(": ")[1] for w in found.warnings] == ["Player", "Middle line", "Side line top"]
    assert all(w.startswith("file.json: ") for w in found.warnings)


@pytest.mark.parametrize("label", ["kp_2", "KP_2", "kp 2", " Kp_2 "])
def test_spellings_of_keypoints(label):
    found = read(shape(label, (7, 8)))
    assert [k.field_m.tolist() for k in found.observations.keypoints] == [pytest.approx([0.0, -34.0], abs=0.1)]
    assert not found.warnings


def test_a_far_point_is_left_out_and_the_others_stay():
    """One click that went astray must not take the marking with it."""
    found = read(shape("Circle central", (1, 2), (1e5, -1e5), (3, 4), (5, 6)))
    assert found.observations.circles[0].points_px.tolist() == [[1, 2], [3, 4], [5, 6]]
    place = "point 2 of 4 at (100000, -100000) lies more than 20 pictures away"
    assert found.warnings == (f"file.json: Circle central: {place}; left out",)
    several = read(shape("Circle central", (1e5, 2), (1, 1e5), (3, 4), (5, 6)))
    assert several.warnings[0].endswith(
        "point 1 of 4 at (100000, 2) and 1 more lie more than 20 pictures away; left out"
    )
    line = shape("Middle line", (1, 2), (1e5, 3), (4, 500), kind="line", confidence=(0.9, 0.4, 0.81))
    assert read(line).observations.lines[0].sigma_px == pytest.approx([1.5 / np.sqrt(0.9), 1.5 / 0.9])


def test_of_a_far_ellipse_nothing_stays():
    found = read(shape("Circle central", (900, 500), (1e5, 500), (900, 700), kind="ellipse"))
    assert not found.observations.circles
    assert found.warnings == ("file.json: Circle central: reaches more than 20 pictures away; left out",)


def test_goals_and_unknown_classes_are_left_out_in_silence():
    labels = ("Goal left post left", "Goal left post left ", "Goal right crossbar", "Line unknown", "Goal unknown")
    found = read(*(shape(label, (1, 2), (3, 4), kind="line") for label in labels))
    assert not found.warnings
    assert not found.observations.lines


def test_points_by_direction():
    found = read(
        shape("centre_circle top_left", (1, 2)), shape("Centre Circle bottom", (3, 4)), template=load_field("soccer")
    )
    places = {k.name: k.field_m for k in found.observations.keypoints}
    radius = 9.15 - 0.06
    assert places["centre_circle top_left"] == pytest.approx(-radius * np.array([1, 1]) / np.sqrt(2))
    assert places["Centre Circle bottom"] == pytest.approx([0, radius])
    assert len(found.observations.circles[0].points_px) == 2


@pytest.mark.parametrize("label", ["centre", "center", "centre_mark", "Centre mark", "centre_circle centre", "kp_51"])
def test_the_centre(label):
    found = read(shape(label, (7, 8))).observations
    assert [(m.mark, m.point_px.tolist()) for m in found.marks] == [("centre_mark", [7.0, 8.0])]


@pytest.mark.parametrize("kind", ["line", "points"])
@pytest.mark.parametrize("label", ["centre_mark", "centre_circle top", "halfway_line x side_line_top", "kp_2"])
def test_an_outline_of_a_point_is_not_taken_for_its_first_corner(label, kind):
    found = read(shape(label, (7, 8), (9, 8), (8, 11), kind=kind))
    assert found.warnings == (f"file.json: {label}: has 3 points, but names one of the field; left out",)
    seen = found.observations
    assert not (seen.marks or seen.keypoints or seen.circles)


def test_of_an_ellipse_about_a_mark_the_centre_counts():
    (mark,) = read(shape("centre_mark", (7, 8), (9, 8), (7, 9), kind="ellipse")).observations.marks
    assert mark.point_px.tolist() == [7.0, 8.0]


def test_classes_of_soccernet_in_the_names_of_points(soccer):
    found = read(shape("Middle line x Side line top", (7, 8)), shape("Circle central top", (1, 2)), template=soccer)
    assert [k.field_m.round(6).tolist() for k in found.observations.keypoints] == [[0.0, -34.0], [0.0, -9.15]]
    assert not found.warnings


def test_meets_of_lines(soccer):
    found = read(
        shape("halfway_line x side_line_top", (7, 8)), shape("halfway_line x halfway_line", (1, 1)), template=soccer
    )
    assert found.observations.keypoints[0].field_m == pytest.approx([0.0, -34.0])
    assert len(found.warnings) == 1


def test_tangents_that_were_derived_are_no_observation(calibrated, soccer):
    found = observe(derive_shapes(calibrated), soccer, SourcesConfig(), "labelme", "f")
    assert not found.warnings
    assert not found.observations.lines
    assert len(found.observations.keypoints) == 8
    assert len(found.observations.marks) == 1


def test_an_ellipse_counts_as_five_numbers():
    ellipse = shape("Circle central", (900, 500), (1500, 500), (900, 700), kind="ellipse")
    (circle,) = read(ellipse).observations.circles
    assert len(circle.points_px) == 48
    assert np.sum(1.0 / circle.sigma_px**2) == pytest.approx(5 / 1.5**2)
    straight = read(shape("Middle line", (1, 1), (2, 1), (1, 2), kind="ellipse"))
    assert "straight" in straight.warnings[0]


def test_detected_lines_below_the_least_confidence_are_left_out():
    found = read(
        shape("Middle line", (1, 2), (3, 400), kind="line", confidence=(0.9, 0.1)),
        shape("Side line top", (1, 2), (300, 4), kind="line", confidence=(0.25 + 0.24, 1.0)),
        source="pnlcalib",
    ).observations
    assert [line.line for line in found.lines] == ["side_line_top"]
    assert found.lines[0].sigma_px == pytest.approx([2.5 / 0.7, 2.5])


def test_a_picture_of_another_size(seen):
    large = seen.resize(1920, 1080)
    assert large.shapes[2].points_px == pytest.approx((seen.shapes[2].points_px + 0.5) * 2 - 0.5)
    assert seen.resize(960, 540) is seen
    assert seen.resize(427, 240).width == 427  # 240.2 rows would be exact


def test_a_measured_annotation_of_a_picture_of_another_size_stays_what_it_is(soccer):
    pixels, sigma = np.array([[100.0, 50.0], [300.0, 90.0], [200.0, 20.0]]), np.array([0.2, 0.3, 0.4])
    measured = Observations(
        960,
        540,
        (CirclePoints("centre_circle", "outer", pixels, sigma),),
        (LinePoints("halfway_line", pixels, sigma, (LineEnd(pixels[0], True),)),),
        (MarkPoint("centre_mark", pixels[1], 0.5),),
    )
    annotation = Annotation(id="a", width=960, height=540, markings=markings_of(measured, "measured"))
    small = observe(annotation.frame().resize(480, 270), soccer, SourcesConfig(), "workbench", "f").observations
    half = (pixels + 0.5) / 2 - 0.5
    (circle,), (line,), (mark,) = small.circles, small.lines, small.marks
    assert (small.width, small.height, circle.edge, mark.sigma_px) == (480, 270, "outer", 0.25)
    for found in (circle, line):
        order = np.argsort(found.points_px[:, 0])
        np.testing.assert_allclose(found.points_px[order], half[[0, 2, 1]], atol=1e-3)
        np.testing.assert_allclose(found.sigma_px[order], sigma[[0, 2, 1]] / 2, atol=1e-4)
    np.testing.assert_allclose(line.ends[0].point_px, half[0], atol=1e-3)
    np.testing.assert_allclose(mark.point_px, half[1], atol=1e-3)


@pytest.mark.parametrize("size", [(1440, 1080), (1920, 1200), (540, 540)])
def test_a_picture_of_another_aspect_is_refused(seen, size):
    with pytest.raises(InputError, match="has another aspect"):
        seen.resize(*size)


def test_other_fields_have_other_names():
    found = read(shape("Circle central", (1, 2), (3, 4)), template=load_field("basketball"))
    assert len(found.warnings) + len(found.observations.circles) == 1


def halfway(*points):
    line = LinePoints("halfway_line", np.array(points, dtype=float), np.full(len(points), 1.5))
    return Observations(1920, 1080, lines=(line,))


def test_an_end_inside_is_a_corner_of_the_touchline():
    found = add_halfway_ends(halfway([900, 1079], [910, 300], [905, 700]), load_field("soccer"))
    (end,) = found.keypoints
    assert end.field_m == pytest.approx([0, -34])
    assert end.point_px == pytest.approx([910, 300])
    assert end.sigma_px == pytest.approx(3.0)


def test_both_ends_or_none():
    both = add_halfway_ends(halfway([900, 900], [910, 300]), load_field("soccer"))
    assert [k.field_m[1] for k in both.keypoints] == [-34, 34]
    assert not add_halfway_ends(halfway([900, 1075], [910, 3]), load_field("soccer")).keypoints
    assert not add_halfway_ends(Observations(1920, 1080), load_field("soccer")).keypoints


def test_only_where_asked_for(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps({"Middle line": [{"x": 0.5, "y": 0.3}, {"x": 0.5, "y": 0.9999}]}))
    for name, count in (("annotations", 1), (None, 0)):
        config = load_config(name, [])
        (frame,) = read_observations(path, load_field("soccer"), config.sources, (1920, 1080))
        assert len(frame.observations.keypoints) == count

"""The marking mask: given, or made from the picture."""

import cv2
import numpy as np
import pytest

from circlecal.errors import EstimationError
from circlecal.geometry.ellipses import ellipse_from_conic, orthogonal_distance
from circlecal.geometry.projective import line_distance
from circlecal.refusals import Confidence
from circlecal.results import MarkingMask, SeenArc, Segment
from circlecal.stages.mask import MaskConfig, find_marking, replace_circle_by_arc

from .conftest import line_cue, paint, view

CAMERA = view(position=(5.0, 50.0, -16.0), focal=2600.0)
PAINTED = paint(CAMERA, noise=1.5)
CIRCLE = paint(CAMERA, line=False, mark=False).coverage > 0.3
LINE = paint(CAMERA, circle=False, mark=False).coverage > 0.3
THICK = np.ones((7, 7), np.uint8)


def thick(region):
    return cv2.dilate(region.astype(np.uint8), THICK) > 0


def found_in(classes, config=MaskConfig(), image=PAINTED.image):
    given = None if classes is None else classes.astype(np.uint8)
    return find_marking(image, given, config, np.random.default_rng(2))


def check_circle(marking):
    ellipse = ellipse_from_conic(marking.conic)
    truth = ellipse_from_conic(PAINTED.conic()).points(np.linspace(0, 2 * np.pi, 100))
    assert np.abs(orthogonal_distance(ellipse, truth)).max() < 2.5


def check_halfway(marking):
    ends = np.stack([marking.halfway.start, marking.halfway.end])
    assert np.abs(line_distance(line_cue(CAMERA).line, ends)).max() < 2.5
    # along the whole chord at least
    chord = CAMERA.project(np.array([[0.0, -9.0], [0.0, 9.0]]))
    assert np.linalg.norm(ends[1] - ends[0]) > 0.7 * np.linalg.norm(chord[1] - chord[0])


def test_class_ids():
    classes = np.where(thick(CIRCLE), 7, 0)
    classes[thick(LINE) & ~thick(CIRCLE)] = 18
    marking, refusal = found_in(classes)
    assert refusal is None
    assert marking.source == "file"
    np.testing.assert_array_equal(marking.classes, classes)
    check_circle(marking)
    check_halfway(marking)
    assert marking.lines == ()


def test_the_halfway_line_inside_the_class_of_the_circle():
    """A binary mask of both: a robust ellipse and a robust line sort them out."""
    marking, refusal = found_in(7 * (thick(CIRCLE) | thick(LINE)))
    assert refusal is None
    check_circle(marking)
    check_halfway(marking)


def test_beside_a_circle_alone_the_picture_is_asked_for_its_line():
    marking, refusal = found_in(7 * thick(CIRCLE))
    assert refusal is None and marking.source == "file"
    check_circle(marking)
    check_halfway(marking)
    bare = paint(CAMERA, line=False, mark=False, noise=1.5).image
    marking, refusal = found_in(7 * thick(CIRCLE), image=bare)
    assert refusal is None and marking.halfway is None
    # a circle elsewhere in the picture is none of the mask's
    moved = np.roll(PAINTED.image, 150, axis=1)
    marking, refusal = found_in(7 * thick(CIRCLE), image=moved)
    assert refusal is None and marking.halfway is None
    check_circle(marking)


def test_the_circle_among_all_markings_of_a_binary_mask():
    """Two straight lines make a thin ellipse on which more points lie than on the circle."""
    lines = np.zeros(CIRCLE.shape, np.uint8)
    for start, end in (
        ((0, 90), (1279, 60)),
        ((0, 112), (1279, 86)),
        ((900, 300), (1279, 420)),
        ((0, 640), (1279, 700)),
    ):
        cv2.line(lines, start, end, 1, 7)
    marking, refusal = found_in(7 * (thick(CIRCLE) | thick(LINE) | (lines > 0)))
    assert refusal is None
    check_circle(marking)
    check_halfway(marking)


def test_lines_of_a_mask_without_a_circle_are_looked_for_in_the_picture():
    classes = np.where(thick(LINE), 18, 0)
    marking, refusal = found_in(classes)
    assert refusal.code == "no_circle_found"
    # the picture's circle is not marked, and is none
    assert marking.conic is None and len(marking.lines) > 0 and marking.source == "detector"


def test_other_classes_are_further_lines():
    classes = 7 * thick(CIRCLE).astype(np.uint8)
    cv2.line(classes, (30, 40), (1200, 90), 12, 5)
    cv2.ellipse(classes, (200, 600), (150, 60), 0, 0, 200, 8, 5)
    marking, refusal = found_in(classes)
    assert refusal is None
    (line,) = marking.lines
    np.testing.assert_allclose(sorted([line.start[0], line.end[0]]), [30, 1200], atol=6)
    truth = np.array([[30.0, 40.0], [1200.0, 90.0]])
    expected = np.cross([*truth[0], 1.0], [*truth[1], 1.0])
    assert np.abs(line_distance(expected, np.stack([line.start, line.end]))).max() < 1.0


def test_half_of_the_circle_is_enough():
    classes = 7 * thick(CIRCLE)
    classes[:, 600:] = 0
    marking, refusal = found_in(classes)
    assert refusal is None
    ellipse = ellipse_from_conic(marking.conic)
    truth = ellipse_from_conic(PAINTED.conic()).points(np.linspace(0, 2 * np.pi, 200))
    seen = truth[truth[:, 0] < 600]
    assert np.abs(orthogonal_distance(ellipse, seen)).max() < 2.5


@pytest.mark.parametrize("content", ["nothing", "only a line", "everything", "noise"])
def test_masks_without_a_circle_are_refused(content):
    classes = {
        "nothing": np.zeros(CIRCLE.shape),
        "only a line": 7 * thick(LINE),
        "everything": np.full(CIRCLE.shape, 7),
        "noise": 7 * (np.random.default_rng(3).random(CIRCLE.shape) < 0.002),
    }[content]
    marking, refusal = found_in(classes)
    assert isinstance(refusal, EstimationError)
    assert (refusal.stage, refusal.code) == ("mask", "no_circle_found")
    assert ("all black" if content == "nothing" else "class (id 7)") in refusal.reason
    assert marking.conic is None
    assert marking.classes.shape == CIRCLE.shape


def test_a_wrong_class_is_no_circle():
    _, refusal = found_in(np.where(thick(CIRCLE), 9, 0))
    assert refusal.code == "no_circle_found"


def test_a_mask_that_must_be_given_is_missed():
    marking, refusal = found_in(None, MaskConfig(source="file"))
    assert refusal.code == "no_mask"
    assert not marking.classes.any()


def test_without_a_mask_the_detector_makes_one():
    image = PAINTED.image.copy()
    # the detector wants turf: colour it
    image[..., 0] = (image[..., 0] * 0.7).astype(np.uint8)
    image[..., 2] = (image[..., 2] * 0.7).astype(np.uint8)
    marking, refusal = found_in(None, image=image)
    assert refusal is None
    assert marking.source == "detector"
    check_circle(marking)
    check_halfway(marking)
    assert (marking.classes == 7).sum() > 500
    by_force, _ = found_in(np.zeros(CIRCLE.shape), MaskConfig(source="detector"), image)
    np.testing.assert_array_equal(by_force.classes, marking.classes)


def test_bare_turf_is_refused_by_the_detector():
    turf = np.random.default_rng(4).normal((50, 120, 60), 3, (360, 640, 3)).clip(0, 255).astype(np.uint8)
    marking, refusal = found_in(None, image=turf)
    assert refusal is not None
    assert refusal.stage == "mask"
    assert " " in refusal.reason
    assert marking.conic is None


def test_an_arc_in_place_of_the_circle():
    classes = np.zeros((720, 1280), np.uint8)
    classes[100, 100], classes[200, 200], classes[300, 300] = 7, 18, 17
    line = Segment(np.zeros(2), np.ones(2))
    arcs = tuple(SeenArc(k * np.eye(3), np.array([[400.0 + 50 * k, 500.0], [900.0, 719.0]]), True) for k in range(2))
    marking = MarkingMask(classes, "detector", np.eye(3), line, (line,), arcs=arcs)
    changed = replace_circle_by_arc(marking, arcs[1])
    assert changed.arcs == arcs[:1]
    assert changed.conic is arcs[1].conic
    assert changed.halfway is None
    assert changed.lines == marking.lines
    assert changed.confidence is Confidence.TENTATIVE
    assert [changed.classes[k, k] for k in (100, 200, 300)] == [0, 0, 17]
    assert (changed.classes[500, 450], changed.classes[719, 900]) == (7, 7)
    assert marking.classes[100, 100] == 7

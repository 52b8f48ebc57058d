"""Which seen line is which line of the template: hypotheses by a linear update, then a decision by full fits."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, project, theta_of
from circlecal.geometry.surface import Surface
from circlecal.line_naming.association import (
    Association,
    _pairs,
    associate_lines,
    has_allowed_size,
)
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080, Surface("flat"))
CAMERA = aim_camera(np.array([-3.0, 62.0, -17.0]), np.array([-25.0, -4.0, 0.0]), 1500.0, 0.01, 1920, 1080)
KNOWN = ("halfway_line",)


def segment_of(name, camera=CAMERA):
    """Ends (2, 2) of what the frame shows of a template's line."""
    ends = SOCCER.line_ends(SOCCER.line_by_name[name])
    points = camera.project(np.linspace(ends[0], ends[1], 400))
    inside = (points >= 0).all(axis=1) & (points <= (1919, 1079)).all(axis=1)
    assert inside.any(), name
    return points[inside][[0, -1]]


def covariance_of(theta, angle_sd=1e-3, size_sd=0.02, place_sd=0.4):
    covariance = np.zeros((len(theta), len(theta)))
    covariance[np.arange(7), np.arange(7)] = np.r_[size_sd, [angle_sd] * 3, [place_sd] * 3] ** 2
    return covariance


def associate(segments, template, excluded, theta, covariance, model, sigma_px, asked=None):
    """The names under one camera."""
    own = None if asked is None else asked[None]
    return associate_lines(segments, template, excluded, (theta[None], covariance[None], model), sigma_px, asked=own)[0]


def test_association_compares_names():
    one = Association({0: "a", 1: "b"}, 500.0, 3.0)
    assert one.score == pytest.approx(500.0 - 36.0)
    assert one.contradicts(Association({0: "c"}, 100.0, 0.0))
    assert one.contradicts(Association({2: "a"}, 100.0, 0.0))
    assert not one.contradicts(Association({1: "b", 3: "d"}, 100.0, 0.0))
    assert not one.contradicts(one)
    # two pieces of one line, and one of them
    pieces = Association({0: "a", 1: "a"}, 900.0, 0.0)
    assert not pieces.contradicts(Association({1: "a"}, 500.0, 0.0))
    assert not Association({1: "a"}, 500.0, 0.0).contradicts(pieces)
    assert pieces.contradicts(Association({2: "a"}, 500.0, 0.0))


def test_best_hypothesis_names_every_line_of_a_broadcast_view():
    names = ["side_line_top", "big_rect_left_main", "big_rect_left_top", "small_rect_left_main"]
    segments = np.array([segment_of(name) for name in names])
    theta = theta_of(CAMERA, MODEL)
    shifted = theta + np.r_[0.01, 5e-4, -5e-4, 3e-4, 0.2, -0.3, 0.2, np.zeros(len(theta) - 7)]
    found = associate(segments, SOCCER, KNOWN, shifted, covariance_of(theta), MODEL, 1.5)
    assert found[0].names == dict(enumerate(names))
    assert found[0].length_px == pytest.approx(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).sum())
    assert [a.score for a in found] == sorted((a.score for a in found), reverse=True)


def test_a_penalty_area_may_lie_elsewhere_along_its_lines_where_the_length_is_unknown():
    longer = load_field("soccer", {"length": 120.0})
    ends = longer.line_ends(longer.line_by_name["big_rect_left_top"])
    camera = aim_camera(np.array([-3.0, 62.0, -17.0]), np.array([-35.0, -15.0, 0.0]), 1500.0, 0.01, 1920, 1080)
    theta = theta_of(camera, MODEL)
    covariance = covariance_of(theta)
    segment = camera.project(ends)[None]
    assert associate(segment, SOCCER, KNOWN, theta, covariance, MODEL, 1.5) == []
    covariance[INDEX["length"], INDEX["length"]] = 8.0**2
    (best, *_) = associate(segment, SOCCER, KNOWN, theta, covariance, MODEL, 1.5)
    assert best.names == {0: "big_rect_left_top"}


def test_a_line_lies_on_its_marking_under_the_camera_that_it_implies_itself():
    """Under an uncertain camera the far end of a penalty area's front seems to lie far beyond its corner."""
    camera = aim_camera(np.array([-3.0, 62.0, -17.0]), np.array([-30.0, -6.0, 0.0]), 1500.0, 0.01, 1920, 1080)
    segment, theta = segment_of("big_rect_left_main", camera)[None], theta_of(camera, MODEL)
    covariance = covariance_of(theta, 0.02, 0.05, 4.0)
    off = theta + 0.6 * np.sqrt(np.diag(covariance)) * np.random.default_rng(135).normal(size=len(theta))
    drawn = [k for k, line in enumerate(SOCCER.lines) if line.name == "big_rect_left_main"]
    ends, shifts = (geometry[drawn] for geometry in SOCCER.drawn_lines)
    assert not _pairs(segment, ends, shifts, off[None], MODEL, np.zeros((1, 1))).on_marking.any()
    covariance[INDEX["length"], INDEX["length"]] = 8.0**2
    found = associate(segment, SOCCER, KNOWN, off, covariance, MODEL, 1.5)
    assert [a.names for a in found] == [{0: "big_rect_left_main"}]


def test_known_names_and_lines_elsewhere_are_not_given():
    theta = theta_of(CAMERA, MODEL)
    segment = segment_of("side_line_top")[None]
    others = associate(segment, SOCCER, (*KNOWN, "side_line_top"), theta, covariance_of(theta), MODEL, 1.5)
    assert all("side_line_top" not in a.names.values() for a in others)
    nowhere = np.array([[[400.0, 900.0], [1500.0, 960.0]]])
    exact = covariance_of(theta, 1e-5, 1e-5, 1e-3)
    assert associate(nowhere, SOCCER, KNOWN, theta, exact, MODEL, 1.5) == []


def test_nothing_is_named_where_no_line_that_is_asked_for_comes_near_a_marking():
    theta = theta_of(CAMERA, MODEL)
    exact = covariance_of(theta, 1e-5, 1e-5, 1e-3)
    segments = np.array([segment_of("side_line_top"), [[400.0, 900.0], [1500.0, 960.0]]])
    on_marking, elsewhere = (
        associate(segments, SOCCER, KNOWN, theta, exact, MODEL, 1.5, asked=np.arange(2) == k) for k in (0, 1)
    )
    assert [a.names for a in on_marking] == [{0: "side_line_top"}]
    assert elsewhere == []


def test_nothing_seen_or_nothing_left():
    theta = theta_of(CAMERA, MODEL)
    empty = np.zeros((0, 2, 2))
    assert associate(empty, SOCCER, KNOWN, theta, covariance_of(theta), MODEL, 1.5) == []
    everything = tuple(line.name for line in SOCCER.lines)
    segment = segment_of("side_line_top")[None]
    assert associate(segment, SOCCER, everything, theta, covariance_of(theta), MODEL, 1.5) == []


def test_two_pieces_of_one_line_get_one_name():
    start, end = segment_of("side_line_top")
    pieces = np.array([[start, start + 0.35 * (end - start)], [start + 0.6 * (end - start), end]])
    theta = theta_of(CAMERA, MODEL)
    found = associate(pieces, SOCCER, KNOWN, theta, covariance_of(theta), MODEL, 1.5)
    assert found[0].names == {0: "side_line_top", 1: "side_line_top"}


def test_no_line_is_named_where_a_lens_folds_back():
    """A goal line far aside of the picture seems to run through it beyond the fold of a barrel lens."""
    futsal, model = load_field("futsal"), ProjectionModel(1280, 720, Surface("flat"))
    camera = aim_camera(np.array([0.0, 14.0, -6.0]), np.array([2.0, 0.0, 0.0]), 700.0, 0.0, 1280, 720, -0.3)
    theta = theta_of(camera, model)
    line = futsal.line_by_name["side_line_left"]
    seen = project(theta[None], np.linspace(line.start, line.end, 400)[None], model)
    inside = ((seen.pixels[0] > 0) & (seen.pixels[0] < (1279, 719))).all(axis=1) & (seen.depth[0] > 0)
    assert inside.any() and not seen.visible[0, inside].any()
    segments = seen.pixels[0][inside][None, [0, -1]]
    assert not associate(segments, futsal, KNOWN, theta, covariance_of(theta), model, 1.5)


LONGER = load_field("soccer", {"length": 119.0})
LONGER_CAMERA = aim_camera(np.array([-3.0, 62.0, -17.0]), np.array([-40.0, -12.0, 0.0]), 1300.0, 0.01, 1920, 1080)


@pytest.mark.parametrize(("size_sd_m", "named"), [(0.3, False), (8.66, True)])
def test_the_front_of_a_penalty_area_is_named_far_from_its_usual_place_where_the_length_is_unknown(size_sd_m, named):
    """And is no goal line, which would make the field shorter than the rules allow."""
    ends = LONGER.line_ends(LONGER.line_by_name["big_rect_left_main"])
    theta = theta_of(LONGER_CAMERA, MODEL)
    covariance = covariance_of(theta, 1e-4, 1e-3, 0.02)
    covariance[INDEX["length"], INDEX["length"]] = size_sd_m**2
    segment = LONGER_CAMERA.project(ends)[None]
    found = associate(segment, SOCCER, KNOWN, theta, covariance, MODEL, 1.5)
    assert [a.names for a in found] == ([{0: "big_rect_left_main"}] if named else [])


def test_sizes_beyond_the_rules_are_not_allowed():
    theta = np.zeros((4, len(INDEX)))
    theta[:, INDEX["length"]] = [-17.0, -19.0, 17.0, 0.0]
    theta[:, INDEX["breadth"]] = [0.0, 0.0, 24.0, 26.0]
    assert has_allowed_size(theta, SOCCER).tolist() == [True, False, True, False]


def test_several_cameras_name_lines_as_each_does_alone():
    camera = aim_camera(np.array([-3.0, 62.0, -17.0]), np.array([-30.0, -6.0, 0.0]), 1500.0, 0.01, 1920, 1080)
    names = ("big_rect_left_main", "big_rect_left_top")
    segments, theta = np.array([segment_of(name, camera) for name in names]), theta_of(camera, MODEL)
    covariance = covariance_of(theta)
    off = theta + 0.3 * np.sqrt(np.diag(covariance)) * np.random.default_rng(5).normal(size=len(theta))
    asked = np.array([[True, True], [True, False], [False, False]])
    thetas, covariances = np.array([theta, off, theta]), np.array([covariance] * 3)
    cameras = thetas, covariances, MODEL
    together = associate_lines(segments, SOCCER, KNOWN, cameras, 1.5, 6, frozenset(), asked)
    alone = [
        associate(segments, SOCCER, KNOWN, *own, MODEL, 1.5, asked=lines)
        for *own, lines in zip(thetas, covariances, asked, strict=True)
    ]
    assert [[a.names for a in found] for found in together] == [[a.names for a in found] for found in alone]
    assert together[0] and together[1] and together[2] == []

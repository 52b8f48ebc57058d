"""Straight markings without a circle: which line is which, and where the camera stands."""

import numpy as np
import pytest

from circlecal.field import load_field
from circlecal.geometry.camera_parameters import PAN, PARAMETERS, POSITION, ProjectionModel, theta_of
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import lift
from circlecal.line_naming import two_directions
from circlecal.line_naming.two_directions import find_arc, propose_cameras
from circlecal.synthetic.cameras import aim_camera

SOCCER = load_field("soccer")
MODEL = ProjectionModel(1920, 1080)
LEFT = (
    "big_rect_left_main",
    "big_rect_left_top",
    "big_rect_left_bottom",
    "small_rect_left_main",
    "small_rect_left_top",
)
OUTSIDE = ("side_line_left", "side_line_top")


def see(camera, names, rng=None, noise_px=0.0, shortest_px=120.0):
    """Names and ends (S, 2, 2) of what a camera shows of some lines."""
    seen, ends = [], []
    for name in names:
        first, last = SOCCER.line_ends(SOCCER.line_by_name[name])
        points = camera.project(np.linspace(first, last, 400))
        with np.errstate(invalid="ignore"):
            inside = (points >= 0).all(axis=1) & (points <= (1919, 1079)).all(axis=1)
        if inside.any() and np.linalg.norm(np.ptp(points[inside], axis=0)) > shortest_px:
            seen.append(name)
            ends.append(points[inside][[0, -1]])
    noise = 0.0 if rng is None else rng.normal(0.0, noise_px, (len(ends), 2, 2))
    return seen, np.array(ends).reshape(-1, 2, 2) + noise


def penalty_area_camera(x=-2.0, y=62.0, z=-16.0, target=(-43.0, -2.0, 0.0), focal_px=4200.0):
    return aim_camera(np.array([x, y, z]), np.array(target), focal_px, 0.0, 1920, 1080)


def test_lines_of_a_penalty_area_get_their_names_and_the_camera_its_place():
    names, segments = see(penalty_area_camera(), LEFT + OUTSIDE)
    assert len(names) >= 5
    best = propose_cameras(segments, (), SOCCER, MODEL, "main", 3)[0]
    assert best.names == dict(enumerate(names))
    assert best.theta[POSITION] == pytest.approx([-2.0, 62.0, -16.0], abs=0.2)


def test_random_main_cameras_are_recognised_and_nothing_wrong_is_named():
    rng = np.random.default_rng(7)
    recognised = tried = 0
    for _ in range(40):
        target = (rng.uniform(-47.0, -38.0), rng.uniform(-8.0, 6.0), 0.0)
        place = rng.uniform((-6.0, 50.0, -22.0), (6.0, 95.0, -10.0))
        camera = penalty_area_camera(*place, target, rng.uniform(2200.0, 5000.0))
        names, segments = see(camera, LEFT + OUTSIDE, rng, 0.5)
        if len(names) < 6:
            continue
        tried += 1
        found = propose_cameras(segments, (), SOCCER, MODEL, "main", 3)
        recognised += bool(found) and all(names[k] == name for k, name in found[0].names.items())
    assert tried >= 20
    assert recognised >= 0.95 * tried


def test_a_board_and_a_crease_get_no_name():
    names, segments = see(penalty_area_camera(), LEFT + OUTSIDE)
    others = np.array([[[100.0, 900.0], [500.0, 1040.0]], [[900.0, 40.0], [1500.0, 10.0]]])
    best = propose_cameras(np.concatenate([others, segments]), (), SOCCER, MODEL, "main", 3)[0]
    assert best.names == {k + 2: name for k, name in enumerate(names)}


def see_arc(camera, name="penalty_arc_left"):
    """Points (N, 2) of what a camera shows of an arc."""
    arc = SOCCER.circle_by_name[name]
    angles = np.radians(np.linspace(arc.start_deg, arc.end_deg, 60))
    return camera.project(SOCCER.curve_points(arc, "center", angles))


def test_three_lines_and_an_arc_are_enough_and_without_the_arc_they_are_not():
    camera = penalty_area_camera()
    names, segments = see(camera, ("side_line_left", "big_rect_left_main", "big_rect_left_top"))
    assert len(names) == 3
    arc = see_arc(camera)
    best = propose_cameras(segments, (arc,), SOCCER, MODEL, "main", 3)[0]
    assert best.names == dict(enumerate(names))
    assert best.theta[POSITION] == pytest.approx([-2.0, 62.0, -16.0], abs=0.2)
    assert find_arc(arc, best.theta, SOCCER, MODEL) == "penalty_arc_left"
    # under the rough camera of a fast pan arcs lie so far off
    assert find_arc(arc + np.array([0.0, 16.0]), best.theta, SOCCER, MODEL) == "penalty_arc_left"
    assert find_arc(arc + np.array([0.0, 60.0]), best.theta, SOCCER, MODEL) is None
    assert propose_cameras(segments, (), SOCCER, MODEL, "main", 3) == []


def test_a_seen_arc_tells_the_penalty_area_from_the_goal_area():
    """Lines of both have one shape: what the names are, only their sizes say, and the arc."""
    camera = penalty_area_camera(focal_px=3000.0)
    names, segments = see(camera, ("side_line_left", "big_rect_left_main", "big_rect_left_top", "big_rect_left_bottom"))
    best = propose_cameras(segments, (see_arc(camera),), SOCCER, MODEL, "main", 3)[0]
    assert best.names == dict(enumerate(names))
    alone = propose_cameras(segments, (), SOCCER, MODEL, "main", 3)
    assert best.score > alone[0].score


def test_a_camera_on_the_other_side_is_told_by_the_side_that_is_asked_for():
    _, segments = see(penalty_area_camera(), LEFT + OUTSIDE)
    best = propose_cameras(segments, (), SOCCER, MODEL, "opposite", 3)[0]
    assert {name.replace("right", "left") for name in best.names.values()} >= {"big_rect_left_main"}
    assert all("left" not in name for name in best.names.values() if "rect" in name)
    assert best.theta[POSITION] == pytest.approx([2.0, -62.0, -16.0], abs=0.2)


@pytest.mark.parametrize(
    ("side", "place"),
    [
        ("main", (-2.0, 62.0, -16.0)),
        ("opposite", (-30.0, -55.0, -14.0)),
        ("left_goal", (-85.0, 14.0, -12.0)),
        ("right_goal", (85.0, -14.0, -12.0)),
    ],
)
def test_a_camera_on_each_side_of_the_field_gets_its_place(side, place):
    target = (np.copysign(43.0, place[0]), -2.0, 0.0)
    near = [name.replace("left", "right") if place[0] > 0 else name for name in LEFT + OUTSIDE]
    names, segments = see(penalty_area_camera(*place, target, 1500.0), near)
    assert len(names) >= 5
    best = propose_cameras(segments, (), SOCCER, MODEL, side, 3)[0]
    assert best.names == dict(enumerate(names))
    assert best.theta[POSITION] == pytest.approx(place, abs=0.2)


@pytest.mark.parametrize(("side", "across"), [("main", "opposite"), ("left_goal", "right_goal")])
def test_cameras_from_one_side_are_those_from_across_the_field_turned(side, across):
    _, segments = see(penalty_area_camera(), LEFT + OUTSIDE)
    ends = (segments - MODEL.center) / (MODEL.width / 2.0)
    lines = np.cross(lift(ends[:, 0]), lift(ends[:, 1]))
    lines /= np.hypot(lines[:, 0], lines[:, 1])[:, None]
    views = next(two_directions._all_views(lines, ends))
    one, other = (two_directions._positions(views, lines, SOCCER, MODEL, name) for name in (side, across))
    assert len(one) > 100
    assert (one[:, POSITION][:, :2] @ SIDES[side] >= 0).all()
    assert (other[:, POSITION][:, :2] @ SIDES[across] >= 0).all()
    np.testing.assert_allclose(one[:, POSITION], other[:, POSITION] * (-1.0, -1.0, 1.0))
    np.testing.assert_allclose(np.cos(one[:, PAN] - other[:, PAN]), -1.0)
    rest = np.setdiff1d(np.arange(len(PARAMETERS)), [PAN, *range(*POSITION.indices(len(PARAMETERS)))])
    np.testing.assert_allclose(one[:, rest], other[:, rest], atol=1e-9)


def test_markings_in_view_that_nobody_saw_count_against_a_camera():
    """What it explains, less a share of what it predicts in vain; what lies outside of the picture costs nothing."""
    camera = penalty_area_camera()
    theta = theta_of(camera, MODEL)[None]
    names, segments = see(camera, LEFT, shortest_px=0.0)
    index = {line.name: k for k, line in enumerate(SOCCER.lines)}
    marking = np.array([[index[name] for name in names]])
    length_m = np.linalg.norm(np.diff(SOCCER.drawn_lines[0], axis=1)[:, 0], axis=-1)
    along = np.stack([np.zeros(len(names)), length_m[marking[0]]], axis=-1)[None]
    everything, _ = see(camera, [line.name for line in SOCCER.lines], shortest_px=0.0)
    rest = [name for name in everything if name not in names]
    assert rest
    _, ends = see(camera, rest, shortest_px=0.0)
    missing_px = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1).sum()
    found = two_directions._missing_px(theta, two_directions._Matches(marking, along), SOCCER, MODEL)
    assert found == pytest.approx(missing_px, rel=0.1)
    lines = (np.array(segments), np.arange(len(names)), ())
    best = two_directions._rank(theta, *lines, SOCCER, MODEL, 1)[0]
    length_px = np.linalg.norm(segments[:, 1] - segments[:, 0], axis=-1).sum()
    expected = (length_px - two_directions.MISSING_WEIGHT * found[0]) / MODEL.width
    assert best.score == pytest.approx(expected, rel=1e-3)


def test_views_to_whose_vanishing_points_little_of_what_was_seen_runs_are_not_looked_at(monkeypatch):
    _, segments = see(penalty_area_camera(), LEFT + OUTSIDE)
    looked_at, told = [], []

    def share(views, ends):
        told.append(np.linspace(100.0, 0.0, len(views.focal)))
        return told[-1]

    monkeypatch.setattr(two_directions, "length_to_vanishing_points", share)
    monkeypatch.setattr(
        two_directions, "_positions", lambda views, *given: looked_at.append(len(views.focal)) or np.zeros((0, 0))
    )
    propose_cameras(segments, (), SOCCER, MODEL, "main", 3)
    assert looked_at == [np.count_nonzero(length >= 100.0 * two_directions.DIRECTED_SHARE) for length in told]
    assert all(0 < count < len(length) for count, length in zip(looked_at, told, strict=True))


@pytest.mark.parametrize("names", [(), LEFT[:3], ("side_line_left", "big_rect_left_main", "small_rect_left_main")])
def test_too_few_lines_or_one_direction_give_nothing(names):
    _, segments = see(penalty_area_camera(), names)
    assert propose_cameras(segments, (), SOCCER, MODEL, "main", 3) == []


def test_degenerate_segments_neither_raise_nor_warn():
    rng = np.random.default_rng(3)
    pencil = np.array([[[960.0, 540.0], [960.0 + 300 * np.cos(a), 540.0 + 300 * np.sin(a)]] for a in range(6)])
    parallel = np.array([[[100.0, y], [1800.0, y]] for y in (100.0, 300.0, 500.0, 700.0, 900.0)])
    same = np.repeat(parallel[:1], 6, axis=0)
    for segments in (pencil, parallel, same, rng.uniform(0, 1920, (12, 2, 2)), np.zeros((5, 2, 2))):
        propose_cameras(segments, (), SOCCER, MODEL, "main", 3)


def test_where_the_lens_bends_nearly_parallel_lines_the_level_camera_names_them(monkeypatch):
    names, segments = see(penalty_area_camera(-38.0, 59.0, -10.6, (-43.0, -6.0, 0.0), 5000.0), LEFT + OUTSIDE)
    off = segments - MODEL.center
    bent = MODEL.center + off * (1.0 - 0.02 * np.square(off / 960.0).sum(axis=-1, keepdims=True))
    # as if no two vanishing points were at right angles
    usual = two_directions.two_pair_views
    monkeypatch.setattr(two_directions, "two_pair_views", lambda lines: usual(lines[:0]))
    best = propose_cameras(bent, (), SOCCER, MODEL, "main", 3)[0]
    assert len(best.names) >= 5 and all(names[k] == name for k, name in best.names.items())
    assert best.theta[POSITION] == pytest.approx([-38.0, 59.0, -10.6], abs=12.0)
    assert not propose_cameras(bent[:3], (), SOCCER, MODEL, "main", 3)


def test_a_seen_part_of_the_centre_circle_is_explained_by_it():
    """Where a wide view shows it beside a penalty area: it is no penalty arc at the other end."""
    camera = penalty_area_camera(-1.0, 65.0, -17.0, (-24.0, -4.0, 0.0), 1700.0)
    names, segments = see(camera, LEFT + OUTSIDE, np.random.default_rng(3), 1.0)
    circle = SOCCER.circle_by_name["centre_circle"]
    arc = camera.project(SOCCER.curve_points(circle, "center", np.radians(np.linspace(120.0, 240.0, 60))))
    best = propose_cameras(segments, (arc,), SOCCER, MODEL, "main", 3)[0]
    assert all(names[k] == name for k, name in best.names.items())
    assert find_arc(arc, best.theta, SOCCER, MODEL) == "centre_circle"

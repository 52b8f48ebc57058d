"""Field templates: the ones of the package, sizes of the user, and what is wrong with a wrong file."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from circlecal.errors import ConfigError
from circlecal.field import (
    COMPASS,
    FieldTemplate,
    evaluate_size,
    field_folder,
    field_names,
    load_field,
    template_from_mapping,
    unit_circle,
)

NAMES = field_names()


def _mapping(name="soccer"):
    return yaml.safe_load((field_folder() / f"{name}.yaml").read_text(encoding="utf-8"))


def test_the_sports_are_there():
    assert {"soccer", "futsal", "ice-hockey", "basketball", "robocup"} <= set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_every_template_loads_and_is_consistent(name):
    template = load_field(name)
    assert template.name == name
    assert template.title
    elements = [*template.circles, *template.arcs, *template.lines, *template.marks]
    assert len({e.name for e in elements}) == len(elements)
    assert template.default_circle in template.circle_by_name or not template.circle_by_name
    assert len(template.line_by_name) == len(template.lines)
    assert len(template.mark_by_name) == len(template.marks)
    half = np.array([template.length_m, template.width_m]) / 2 + template.marking_width_m
    for polyline in template.polylines().values():
        assert polyline.shape[1] == 2
        assert len(polyline) >= 2
        assert (np.abs(polyline) <= half).all()
    for mark in template.marks:
        assert (np.abs(mark.position) <= half).all()


@pytest.mark.parametrize("name", [name for name in NAMES if load_field(name).halfway_line is not None])
def test_halfway_line_passes_through_the_middle_of_the_default_circle(name):
    template = load_field(name)
    line = template.line_coordinates(template.line_by_name[template.halfway_line])
    center = template.circle_by_name[template.default_circle].center
    assert line @ [*center, 1.0] == pytest.approx(0.0, abs=1e-12)
    assert np.hypot(line[0], line[1]) == pytest.approx(1.0)


@pytest.mark.parametrize("name", NAMES)
def test_templates_are_symmetric(name):
    template = load_field(name)
    points = np.vstack(list(template.polylines(step_m=0.05).values()))
    for mirror in ((-1.0, 1.0), (1.0, -1.0)):
        distance = np.abs((points * mirror)[::37, None] - points[None]).max(axis=-1).min(axis=1)
        assert distance.max() < 0.08


def test_radius_of_every_edge_follows_from_the_one_that_is_given():
    template = load_field("soccer")
    circle = template.circle_by_name["centre_circle"]
    assert template.radius(circle, "outer") == pytest.approx(9.15)
    assert template.radius(circle, "center") == pytest.approx(9.09)
    assert template.radius(circle, "inner") == pytest.approx(9.03)
    assert template.radius(circle, "inner", marking_width_m=0.1) == pytest.approx(9.05)
    inner = circle.model_copy(update={"edge": "inner"})
    assert template.radius(inner, "outer") == pytest.approx(9.27)


@pytest.mark.parametrize("side", ["left", "right"])
def test_arc_ends_lie_on_the_paint_of_the_penalty_area_line(side):
    template = load_field("soccer")
    line = template.line_ends(template.line_by_name[f"big_rect_{side}_main"])[0, 0]
    arc = template.polylines()[f"penalty_arc_{side}"]
    assert np.abs(arc[[0, -1], 0] - line).max() < template.marking_width_m / 2
    # the arc lies outside the penalty area, which the circle of its radius mostly does not
    assert (np.abs(arc[1:-1, 0]) <= np.abs(arc[[0, -1], 0]).max() + 1e-9).all()
    np.testing.assert_allclose(
        np.linalg.norm(arc - template.circle_by_name[f"penalty_arc_{side}"].center, axis=1), 9.15 - 0.06
    )


def test_paint_lies_inside_the_area_that_it_bounds():
    template = load_field("soccer")
    half = template.marking_width_m / 2
    for name, axis, sign in (("top", 1, 1), ("bottom", 1, -1), ("left", 0, 1), ("right", 0, -1)):
        line = template.line_by_name[f"side_line_{name}"]
        moved = template.line_ends(line) - np.array([line.start, line.end])
        np.testing.assert_allclose(moved[:, axis], sign * half)
        np.testing.assert_allclose(moved[:, 1 - axis], 0.0)
    for side, sign in (("left", -1), ("right", 1)):
        for box in ("big", "small"):
            line = template.line_by_name[f"{box}_rect_{side}_main"]
            assert template.line_ends(line)[0, 0] - line.start[0] == pytest.approx(sign * half)
    halfway = template.line_by_name["halfway_line"]
    np.testing.assert_allclose(template.line_ends(halfway), [halfway.start, halfway.end])
    boundary = load_field("basketball")
    outside = boundary.line_ends(boundary.line_by_name["side_line_right"])[0, 0]
    assert outside == pytest.approx(14.025)  # outside the court there


def test_sizes_of_the_user_move_what_depends_on_them():
    template = load_field("soccer", {"length": 100, "circle_radius": 9.0})
    assert template.length_m == 100
    assert template.mark_by_name["penalty_mark_left"].position[0] == pytest.approx(-39.0)
    assert template.circle_by_name["centre_circle"].radius_m == 9.0
    assert load_field("soccer").length_m == 105


def test_sizes_may_follow_from_earlier_ones():
    content = _mapping()
    content["sizes"]["width"] = "length * 2 / 3 - 2"
    assert template_from_mapping(content, "mine.yaml").width_m == pytest.approx(68.0)


@pytest.mark.parametrize(
    "size",
    [
        "unknown_size",
        "length ** 2",
        "length / 0",
        "__import__('os')",
        "length.real",
        "length, width",
        "'a'",
        "",
        "(",
        "1e400",
        "nan",
        True,
        None,
        [1],
        "9" * 400,
    ],
)
def test_a_wrong_expression_names_the_file_and_the_key(size):
    content = _mapping()
    content["circles"][0]["radius_m"] = size
    with pytest.raises(ConfigError, match=r"mine\.yaml: circles\.0\.radius_m: "):
        template_from_mapping(content, "mine.yaml")
    content = _mapping()
    content["sizes"]["marking"] = size
    with pytest.raises(ConfigError, match=r"mine\.yaml: sizes(\.marking)?: "):
        template_from_mapping(content, "mine.yaml")


def test_what_is_wrong_with_a_template_is_said():
    def broken(**changes):
        content = {**_mapping(), **changes}
        with pytest.raises(ConfigError) as caught:
            template_from_mapping(content, "mine.yaml")
        assert "\n" not in str(caught.value)
        return str(caught.value)

    assert broken(colour="red") == "mine.yaml: colour: is unknown"
    assert "twice" in broken(marks=[{"name": "halfway_line", "position": [0, 0], "diameter_m": 0.2}])
    assert "default_circle" in broken(default_circle="moon")
    assert "halfway_line" in broken(halfway_line="moon")
    assert "marking_width_m" in broken(marking_width_m=0)
    assert "circles" in broken(circles=7)
    for size in (0, -105, 1e9):
        assert "length_m: should be" in broken(length_m=size)
    spot, arc = _mapping()["marks"][0], _mapping()["arcs"][0]
    assert "marks.0.position.1: should be" in broken(marks=[{**spot, "position": [0, 1e9]}])
    assert "arcs.0.end_deg: should be" in broken(arcs=[{**arc, "end_deg": 1e9}])
    backwards = {**arc, "start_deg": 30, "end_deg": -30}
    assert "end_deg must be larger than start_deg" in broken(arcs=[backwards])
    halfway = next(line for line in _mapping()["lines"] if line["name"] == "halfway_line")
    assert "'halfway_line': start and end are one point" in broken(lines=[{**halfway, "end": halfway["start"]}])
    assert "paint tells a direction" in broken(lines=[{**halfway, "paint": [0, 2]}])
    beside = {**halfway, "start": [1, -34], "end": [1, 34]}
    assert "'halfway_line' runs 1 m beside the middle of 'centre_circle'" in broken(lines=[beside])
    assert "length_m is 18, but circle 'centre_circle' needs 18.3 m" in broken(length_m=18)
    assert "width_m is 12, but circle 'centre_circle' needs 18.3 m" in broken(width_m=12)
    assert "length_range_m [120.0, 90.0]: the smallest comes first" in broken(length_range_m=[120, 90])
    assert "sizes" in broken(sizes=[1, 2])
    for content in (None, [], "soccer", {}):
        with pytest.raises(ConfigError, match=r"mine\.yaml"):
            template_from_mapping(content, "mine.yaml")
    with pytest.raises(ConfigError, match=r"^field\.sizes\.length=0: length_m: should be greater than 0"):
        load_field("soccer", {"length": 0})
    with pytest.raises(ConfigError, match=r"field\.sizes\.lenght.*length"):
        load_field("soccer", {"lenght": 100})


def test_unknown_and_unreadable_templates(tmp_path: Path):
    with pytest.raises(ConfigError, match="soccer"):
        load_field("cricket")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_field(tmp_path / "missing.yaml")
    (tmp_path / "broken.yaml").write_text("a: [1,", encoding="utf-8")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_field(tmp_path / "broken.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(ConfigError, match="cannot be read"):
        load_field(tmp_path / "binary.yaml")
    mine = tmp_path / "mine.yml"
    mine.write_text((field_folder() / "futsal.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    assert load_field(mine) == load_field("futsal")


def test_templates_are_frozen():
    template = load_field("soccer")
    with pytest.raises(ValueError, match="frozen"):
        template.length_m = 3.0
    assert isinstance(template, FieldTemplate)


@given(st.floats(-100, 100), st.floats(0.1, 100))
def test_arithmetic_over_named_sizes(a, b):
    sizes = {"a": a, "b": b}
    assert evaluate_size("-a / 2 + 3 * (b - 1)", sizes) == pytest.approx(-a / 2 + 3 * (b - 1))
    assert evaluate_size("+a", sizes) == a
    assert evaluate_size(3, {}) == 3.0
    assert evaluate_size("3.5", {}) == 3.5


def test_templates_are_equal_by_what_they_say():
    """Arrays that were derived from one of them do not count."""
    soccer, other = load_field("soccer"), load_field("soccer", {"length": 100.0})
    again = soccer.model_copy()
    assert len(soccer.outlines[1]) and len(again.outlines[1])
    assert soccer == again != other
    assert soccer != "soccer"


def test_sizes_that_the_rules_allow():
    length, width = load_field("soccer").extents
    assert (length.size_m, width.size_m) == (105.0, 68.0)
    least, most = length.range_m
    assert length.beyond_rules(least - 2.0) == length.beyond_rules(most + 2.0) == pytest.approx(2.0)
    assert length.beyond_rules(105.0) < 0.0
    assert all(extent.beyond_rules(1000.0) == -np.inf for extent in load_field("ice-hockey-nhl").extents)


def test_a_full_circle_is_an_arc_all_round():
    template = load_field("soccer")
    full = [circle.span_deg for circle in template.round_ones]
    assert full == [(0.0, 360.0)] * len(template.circles) + [(arc.start_deg, arc.end_deg) for arc in template.arcs]
    drawn = template.polylines(1.0)["centre_circle"]
    assert drawn[0] == pytest.approx(drawn[-1])


def test_directions_have_their_names_as_the_main_camera_sees_them():
    # x to the right, y towards the camera
    assert list(COMPASS) == [
        *("right", "bottom_right", "bottom", "bottom_left", "left", "top_left", "top", "top_right"),
    ]
    assert COMPASS["top"] == pytest.approx([0.0, -1.0])
    assert COMPASS["bottom_left"] == pytest.approx(np.array([-1.0, 1.0]) / np.sqrt(2.0))
    angles = np.arctan2(*np.array(list(COMPASS.values())).T[::-1])
    assert np.array(list(COMPASS.values())) == pytest.approx(unit_circle(angles))


def test_where_two_lines_meet():
    template = load_field("soccer")
    assert template.meet_lines("halfway_line", "side_line_top") == pytest.approx([0.0, -34.0], abs=0.07)
    assert template.meet_lines("side_line_bottom", "side_line_top") is None
    assert template.meet_lines("halfway_line", "halfway_line") is None
    assert template.meet_lines("halfway_line", "nowhere") is None


def test_the_border_is_what_lies_on_it_all_along():
    """A line across the whole field only ends on it."""
    assert load_field("soccer").border == {f"side_line_{side}" for side in ("top", "bottom", "left", "right")}
    assert not {"blue_line_left", "goal_line_left"} & load_field("ice-hockey").border

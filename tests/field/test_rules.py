"""Every number of every field template against a table of the rules, in the rules' own units.

The figures are written down from the rules, not from the templates: lines by the places of their ends, circles by
centre and radius, all as distances from the middle of the field: one row stands for both halves and both sides.
"""

import re

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.errors import ConfigError
from circlecal.field import field_names, load_field
from circlecal.pipeline import field_of

M, FT, YD = 1.0, 0.3048, 0.9144
SIDE = re.compile(r"_(left|right|top|bottom)(?=_|$)")


def soccer(length, width, depth, wide, mark, radius, goal_area=None):
    """Rows of soccer's markings: field, penalty area (depth and width), penalty mark, circle, goal area."""
    x, y = length / 2, width / 2
    rows = {
        "field": (length, width),
        "centre_circle": (0, 0, radius),
        "halfway_line": (0, y, 0, y),
        "side_line": (x, y, x, y),
        "big_rect_main": (x - depth, wide / 2, x - depth, wide / 2),
        "big_rect": (x, wide / 2, x - depth, wide / 2),
        "centre_mark": (0, 0),
        "penalty_mark": (x - mark, 0),
    }
    if goal_area is not None:
        deep, broad = goal_area
        rows["small_rect_main"] = (x - deep, broad / 2, x - deep, broad / 2)
        rows["small_rect"] = (x, broad / 2, x - deep, broad / 2)
    return rows


def basketball(length, width, radius, free_throw, key, arc, basket, corner, straight, *, key_at_line=None, half=0.0):
    """Rows of a court: ``free_throw`` and ``basket`` from the end line, ``corner`` from the side line, ``straight`` the
    length of the straight part of the three-point line, ``half`` half a line's width.
    """
    x, y, far = length / 2, width / 2, key if key_at_line is None else key_at_line
    return {
        "field": (length, width),
        "centre_circle": (0, 0, radius),
        "halfway_line": (0, y, 0, y),
        "side_line": (x, y, x, y),
        "free_throw": (x - free_throw + half, 0, radius),
        "free_throw_circle": (x - free_throw + half, 0, radius),
        "free_throw_line": (x - free_throw, far / 2, x - free_throw, far / 2),
        "lane": (x, key / 2, x - free_throw, far / 2),
        "three_point": (x - basket, 0, arc),
        "corner": (x, y - corner, x - straight, y - corner),
    }


def small_size(length, width, depth, wide, penalty):
    """Rows of a Small Size field: field, defense area (depth and width), penalty mark from the opponent's goal."""
    x, y = length / 2, width / 2
    return {
        "field": (length, width),
        "centre_circle": (0, 0, 0.5),
        "halfway_line": (0, y, 0, y),
        "goal_to_goal_line": (x, 0, x, 0),
        "side_line": (x, y, x, y),
        "defense_area_main": (x - depth, wide / 2, x - depth, wide / 2),
        "defense_area": (x, wide / 2, x - depth, wide / 2),
        "penalty_mark": (penalty - x, 0),
    }


PENALTY_ARC = {"penalty_arc": (41.5, 0, 9.15)}
SOCCER = soccer(105, 68, 16.5, 40.32, 11, 9.15, (5.5, 18.32)) | PENALTY_ARC
INCH = 1 / 12
HANDBALL = (
    M,
    {
        "field": (40, 20),
        "centre_circle": (0, 0, 2),
        "halfway_line": (0, 10, 0, 10),
        "side_line": (20, 10, 20, 10),
        "goal_area": (20, 1.5, 6),
        "goal_area_main": (14, 1.5, 14, 1.5),
        "seven_metre": (13, 0.5, 13, 0.5),
    },
)

RULES = {
    "soccer": (M, SOCCER),
    "soccer-any": (M, soccer(103, 66, 16.5, 40.32, 11, 9.15, (5.5, 18.32)) | {"penalty_arc": (40.5, 0, 9.15)}),
    "soccer-9": (YD, soccer(80, 50, 13, 32, 9, 7)),
    "soccer-7": (YD, soccer(60, 40, 10, 18, 8, 6)),
    "beach-soccer": (M, {"field": (36, 27), "side_line": (18, 13.5, 18, 13.5)}),
    "futsal": (
        M,
        {
            "field": (40, 20),
            "centre_circle": (0, 0, 3),
            "halfway_line": (0, 10, 0, 10),
            "side_line": (20, 10, 20, 10),
            # 6 m about the outer faces of posts 8 cm wide, 3 m apart
            "area": (20, 1.58, 6),
            "area_main": (14, 1.58, 14, 1.58),
            "centre_mark": (0, 0),
            "penalty_mark": (14, 0),
            "second_mark": (10, 0),
        },
    ),
    "handball": HANDBALL,
    "handball-any": HANDBALL,
    "ice-hockey": (
        M,
        {
            "field": (60, 30),
            "centre_circle": (0, 0, 4.5),
            "faceoff": (20, 7, 4.5),
            "centre_line": (0, 15, 0, 15),
            "blue_line": (7.14, 15, 7.14, 15),
            "goal_line": (26, 15, 26, 15),
            "centre_mark": (0, 0),
            "end_spot": (20, 7),
            "neutral_spot": (5.49, 7),
        },
    ),
    "ice-hockey-nhl": (
        FT,
        {
            "field": (200, 85),
            "centre_circle": (0, 0, 15),
            "faceoff": (69, 22, 15),
            "centre_line": (0, 42.5, 0, 42.5),
            # 50 ft between lines that are 1 ft wide
            "blue_line": (25.5, 42.5, 25.5, 42.5),
            "goal_line": (89, 42.5, 89, 42.5),
            "centre_mark": (0, 0),
            "end_spot": (69, 22),
            "neutral_spot": (20, 22),
        },
    ),
    "basketball": (M, basketball(28, 15, 1.8, 5.8, 4.9, 6.75, 1.575, 0.9, 2.99, half=0.025)),
    "basketball-fiba-2009": (
        M,
        basketball(28, 15, 1.8, 5.8, 6, 6.25, 1.575, 1.25, 1.575, key_at_line=3.6, half=0.025),
    ),
    "basketball-nba": (FT, basketball(94, 50, 6, 19, 16, 23.75, 5.25, 3, 14.197, half=INCH)),
    "basketball-ncaa": (
        FT,
        basketball(94, 50, 6, 19, 12, 22 + 1.75 * INCH, 5.25, 40.125 * INCH, 9 + 10.375 * INCH, half=INCH),
    ),
    "basketball-nfhs": (FT, basketball(84, 50, 6, 19, 12, 19 + 9 * INCH, 5.25, 5.25, 5.25, half=INCH)),
    # the Standard Platform League's figure, to the middle of the lines
    "robocup": (M, soccer(9, 6, 1.65, 4, 1.3, 0.75, (0.6, 2.2))),
    "robocup-kid": (M, soccer(9, 6, 2, 5, 1.5, 0.75, (1, 3))),
    "robocup-adult": (M, soccer(14, 9, 3, 6, 2.1, 1.5, (1, 4))),
    "robocup-msl": (M, soccer(22, 14, 2.25, 6.9, 3.6, 2, (0.75, 3.9))),
    "robocup-ssl": (M, small_size(9, 6, 1, 2, 6)),
    "robocup-ssl-a": (M, small_size(12, 9, 1.8, 3.6, 8)),
    "field-hockey": (
        M,
        {
            "field": (91.4, 55),
            "halfway_line": (0, 27.5, 0, 27.5),
            "side_line": (45.7, 27.5, 45.7, 27.5),
            "circle": (45.7, 1.83, 14.63),
            "circle_main": (31.07, 1.83, 31.07, 1.83),
            "quarter_line": (22.8, 27.5, 22.8, 27.5),
            "penalty_mark": (45.7 - 0.075 - 6.4, 0),  # from the inner edge of the goal line
        },
    ),
    "australian-football": (
        M,
        {
            "field": (165, 135),
            "centre_circle": (0, 0, 5),
            "inner_circle": (0, 0, 1.5),
            "centre_line": (0, 5, 0, 5),
            "square": (25, 25, 25, 25),
            "fifty": (82.5, 0, 50),
            "goal_line": (82.5, 9.6, 82.5, 9.6),
            "kick_off": (73.5, 3.2, 73.5, 3.2),
            "goal_square": (82.5, 3.2, 73.5, 3.2),
        },
    ),
    "curling": (
        FT,
        {
            "field": (150, 16 + 5 * INCH),
            "twelve_foot": (57, 0, 6),
            "eight_foot": (57, 0, 4),
            "four_foot": (57, 0, 2),
            "button": (57, 0, 0.5),
            "centre_line": (69, 0, 69, 0),
            "tee_line": (57, 8 + 2.5 * INCH, 57, 8 + 2.5 * INCH),
            "back_line": (63, 8 + 2.5 * INCH, 63, 8 + 2.5 * INCH),
            "hog_line": (36, 8 + 2.5 * INCH, 36, 8 + 2.5 * INCH),
            "side_line": (75, 8 + 2.5 * INCH, 75, 8 + 2.5 * INCH),
        },
    ),
    "netball": (
        M,
        {
            "field": (30.5, 15.25),
            "centre_circle": (0, 0, 0.45),
            "goal_circle": (15.25, 0, 4.9),
            "side_line": (15.25, 7.625, 15.25, 7.625),
            "third_line": (30.5 / 6, 7.625, 30.5 / 6, 7.625),
        },
    ),
    "wrestling": (
        M,
        {
            "field": (12, 12),
            "contest_area": (0, 0, 4.5),
            "central_area": (0, 0, 3.5),
            "central_circle": (0, 0, 0.5),
            "mat_edge": (6, 6, 6, 6),
        },
    ),
    "lacrosse": (
        YD,
        {
            "field": (110, 60),
            "crease": (40, 0, 3),
            "goal_line": (40, 1, 40, 1),
            "restraining_line": (20, 30, 20, 30),
            "wing_line": (10, 20, 10, 20),
            "box": (55, 20, 20, 20),
            "halfway_line": (0, 30, 0, 30),
            "side_line": (55, 30, 55, 30),
        },
    ),
}
PAINT = {
    "soccer": (0.12, M), "soccer-any": (0.12, M), "soccer-9": (0.12, M), "soccer-7": (0.12, M),
    "beach-soccer": (0.1, M),
    "futsal": (0.08, M), "handball": (0.05, M), "handball-any": (0.05, M),
    "ice-hockey": (0.05, M), "ice-hockey-nhl": (2 * INCH, FT),
    "basketball": (0.05, M), "basketball-fiba-2009": (0.05, M), "basketball-nba": (2 * INCH, FT),
    "basketball-ncaa": (2 * INCH, FT), "basketball-nfhs": (2 * INCH, FT),
    "robocup": (0.05, M), "robocup-kid": (0.05, M), "robocup-adult": (0.05, M),
    "robocup-msl": (0.125, M), "robocup-ssl": (0.01, M), "robocup-ssl-a": (0.01, M),
    "field-hockey": (0.075, M), "australian-football": (0.1, M), "curling": (0.5 * INCH, FT),
    "netball": (0.05, M), "wrestling": (0.1, M), "lacrosse": (0.05, M),
}  # fmt: skip
WIDE_PAINT = {
    ("ice-hockey", "centre_line"): 0.3,
    ("ice-hockey", "blue_line_left"): 0.3,
    ("ice-hockey-nhl", "centre_line"): 12 * INCH * FT,
    ("ice-hockey-nhl", "blue_line_right"): 12 * INCH * FT,
    ("curling", "hog_line_left"): 4 * INCH * FT,
    ("lacrosse", "halfway_line"): 0.1,
}


def numbers(element):
    """An element as its row of the table has it, metres."""
    if hasattr(element, "radius_m"):
        return (*np.abs(element.center), element.radius_m)
    if hasattr(element, "position"):
        return tuple(np.abs(element.position))
    return (*np.abs(element.start), *np.abs(element.end))


def test_there_is_a_table_for_every_template():
    assert set(RULES) == set(PAINT) == set(field_names())


@pytest.mark.parametrize("name", field_names())
def test_every_number_is_that_of_the_rules(name):
    template, (unit, rules) = load_field(name), RULES[name]
    assert (template.length_m, template.width_m) == pytest.approx(np.array(rules["field"]) * unit, abs=2e-3)
    for element in (*template.circles, *template.arcs, *template.lines, *template.marks):
        row = rules[SIDE.sub("", element.name)]
        assert numbers(element) == pytest.approx(np.array(row, dtype=float) * unit, abs=2e-3), element.name


@pytest.mark.parametrize("name", field_names())
def test_every_row_is_in_the_template(name):
    template = load_field(name)
    drawn = {SIDE.sub("", e.name) for e in (*template.circles, *template.arcs, *template.lines, *template.marks)} | {
        "field",
        "free_throw",
        "free_throw_circle",
    }
    assert set(RULES[name][1]) <= drawn


@pytest.mark.parametrize("name", field_names())
def test_paint_is_as_wide_as_the_rules_say(name):
    value, unit = PAINT[name]
    assert load_field(name).marking_width_m == pytest.approx(value * unit, abs=1e-4)


@pytest.mark.parametrize(("name", "element"), WIDE_PAINT)
def test_some_lines_are_wider(name, element):
    template = load_field(name)
    assert template.paint_width(template.line_by_name[element]) == pytest.approx(WIDE_PAINT[name, element], abs=1e-4)


def test_the_free_throw_semicircle_is_about_the_middle_of_the_lines_paint():
    template = load_field("basketball")
    assert template.circle_by_name["free_throw_right"].center == pytest.approx((8.225, 0))
    line = template.line_ends(template.line_by_name["free_throw_line_right"])
    assert line[0, 0] == pytest.approx(8.225)


@pytest.mark.parametrize(
    "name", ["basketball", "basketball-nba", "basketball-ncaa", "basketball-nfhs", "basketball-fiba-2009"]
)
def test_the_three_point_arc_ends_where_its_straight_part_does(name):
    template = load_field(name)
    arc = template.polylines()["three_point_right"][[0, -1]]
    ends = [template.line_ends(template.line_by_name[f"corner_right_{side}"])[1] for side in ("bottom", "top")]
    np.testing.assert_allclose(sorted(arc.tolist()), sorted(np.array(ends).tolist()), atol=0.03)


def test_the_rim_of_a_disc_is_an_edge():
    template = load_field("curling")
    house = template.circle_by_name["twelve_foot_left"]
    assert {template.radius(house, edge) for edge in ("outer", "center", "inner")} == {house.radius_m}


def test_a_hog_line_lies_beyond_its_inner_edge_towards_the_middle_of_the_sheet():
    """A stone is in play where it clears the inner edge, which is the one towards the house, 21 ft before the tee."""
    template = load_field("curling")
    for side, sign in (("left", -1.0), ("right", 1.0)):
        line = template.line_ends(template.line_by_name[f"hog_line_{side}"])
        assert line[0, 0] == pytest.approx(sign * (36 * FT - 2 * INCH * FT), abs=1e-4)


def test_a_sheet_may_be_narrower_than_the_widest():
    """Where a hall is small, a sheet of 14 ft 6 in will do, and dividers stand for its side lines: with the width taken
    for known these bent cameras by 2 to 5 px at 0.4 px sigma.
    """
    template = load_field("curling")
    assert template.width_m - 2.0 * template.width_sd_m < 14.5 * FT


def test_a_sport_without_a_circle_says_so():
    with pytest.raises(ConfigError, match="beach-soccer has no circle"):
        field_of(load_config(None, ["field.template=beach-soccer"]))


def test_a_template_brings_the_options_of_its_sport():
    assert load_config(None, ["field.template=ice-hockey-nhl"]).camera == load_config("ice-hockey").camera
    chosen = load_config(None, ["field.template=basketball-nba", "camera.roll_sd_deg=9"])
    assert (chosen.field.template, chosen.camera.crown_shape) == ("basketball-nba", "flat")
    assert chosen.camera.roll_sd_deg == 9
    # what a configuration of the user's names wins, and the rest is that of the sport
    hall, tribune = load_config("futsal").camera, load_config("tribune").camera
    chosen = load_config("tribune", ["field.template=futsal"])
    assert (chosen.camera.crown_shape, chosen.camera.k1_sd) == (hall.crown_shape, hall.k1_sd)
    assert (chosen.camera.roll_sd_deg, chosen.camera.elevation_deg) == (tribune.roll_sd_deg, tribune.elevation_deg)
    assert chosen.mask == load_config("futsal").mask

"""The table of refusals: complete, in plain words, and the only place where they stand."""

import ast
import functools
import re
from pathlib import Path

import pytest

from circlecal import detection, stages
from circlecal.checks import CHECKS, words_of_check, words_of_limit
from circlecal.refusals import REFUSALS, explain, refuse

PACKAGE = Path(stages.__file__).parent.parent
FILES = [file for file in PACKAGE.rglob("*.py") if file.parent.name != "bench"]


def codes_in(tree, functions):
    """Every constant code that is given to one of these functions, by the position of the code."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and ast.unparse(node.func) in functions:
            place = functions[ast.unparse(node.func)]
            if len(node.args) > place and isinstance(node.args[place], ast.Constant):
                yield node.args[place].value


def test_every_code_that_is_raised_stands_in_the_table():
    places = {"refuse": 1, "failure": 0, "Verdict": 1, "record_failure": 2}
    only_intrinsics = {"needs_a_view", "needs_three_views", "views_too_alike", "not_definite", "no_common_plane"}
    raised = {code for file in FILES for code in codes_in(ast.parse(file.read_text(encoding="utf-8")), places)}
    raised |= {gate.code for gate in CHECKS.values()}
    raised -= {None, *only_intrinsics}
    assert len(raised) > 30
    assert raised <= REFUSALS.keys()


def test_what_the_detector_says_stands_in_the_table():
    folder = Path(detection.__file__).parent
    words = {
        node.value
        for file in folder.glob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    for word in ("no_field", "no_circle_found", "painted_share", "marking_rms_px", "band_width", "whole_share"):
        assert word in words
        assert (CHECKS[word].code if word in CHECKS else word) in REFUSALS


@pytest.mark.parametrize("refusal", REFUSALS.values(), ids=lambda refusal: refusal.code)
def test_words_are_for_people(refusal):
    assert re.fullmatch(r"[a-z]+(_[a-z]+)*", refusal.code)
    assert refusal.words[0].islower() and not refusal.words.endswith(".")
    assert len(refusal.words) < 110
    for text in (refusal.meaning, refusal.help):
        assert text[0].isupper() or text.startswith("circlecal ")
        assert text.endswith((".", ".*)"))
        options = "max_sigma_px", "focal_px", "camera.principal_point_sd_px"
        assert "_px" not in functools.reduce(lambda rest, name: rest.replace(name, ""), options, text)


def test_checks_say_it_in_words_and_keep_their_numbers_to_themselves():
    for name in CHECKS:
        words = words_of_check(name, "side_line_top")
        assert words and "{" not in words and not re.search(r"\d", words)
    assert words_of_check("marking_residual_px", "kp_3").startswith("kp_3 ")


def test_a_limit_says_on_which_side_of_it_a_value_passes():
    assert words_of_limit("height_m", "150") == "at most 150"
    assert words_of_limit("lowest_height_m", "1.5") == "at least 1.5"
    assert words_of_limit("of_a_later_version", "3") == "3"


def test_an_unknown_code_is_explained_by_its_stage():
    unknown = explain("something_new")
    assert explain("something_new", "ellipse").meaning == "No ellipse could be fitted."
    assert unknown.help and unknown.code == "something_new"


def test_a_stage_adds_what_is_particular():
    plain, detailed = refuse("edges", "no_edges"), refuse("ellipse", "arc_too_short", "40 degrees, 60 are needed")
    assert (plain.stage, plain.code, plain.reason) == ("edges", "no_edges", REFUSALS["no_edges"].words)
    assert detailed.reason == f"{REFUSALS['arc_too_short'].words}: 40 degrees, 60 are needed"


@pytest.mark.parametrize(
    ("code", "helps"),
    [
        ("line_beyond_field", "Turn the picture upright"),
        ("implausible_camera", "Turn a picture that lies on its side upright"),
        ("implausible_camera", "fisheye"),
        ("mark_contradicts_circle", "fisheye"),
        ("no_circle_found", "straight above"),
        ("no_circle_found", "mask.paint_bgr"),
        ("circle_support_too_low", "mask.paint_bgr"),
        ("no_band", "dark or noisy"),
    ],
)
def test_help_names_what_is_likeliest_wrong_with_the_picture(code, helps):
    assert helps in explain(code).help

"""What the page is told of an annotation."""

import numpy as np
import pytest

from circlecal.api.calls import calibrate_picture
from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.pictures.files import read_image
from circlecal.workbench.answers import answer, describe
from circlecal.workbench.doubts import find_wrong_name
from tests.workbench.test_measuring import SAMPLES

NAMES = ("side_line_top", "big_rect_right_main", "big_rect_right_top")
LINES = {line.name: np.linspace(line.start, line.end, 400) for line in load_field("soccer").lines}
"""Places (N, 2) along every straight marking, metres."""


@pytest.fixture(scope="module")
def broadcast_view() -> FieldView:
    view = calibrate_picture(read_image(SAMPLES / "broadcast_view.jpg"), load_config(), frame_id="x").view
    assert view is not None
    return view


def click(view: FieldView, kind: str, name: str | None, places_m: np.ndarray, count: int) -> AnnotatedMarking:
    """As many clicks as fit into the picture along places (N, 2)."""
    points = view.project(places_m)
    points = points[view.shows(np.nan_to_num(points, nan=-1.0))]
    points = points[np.linspace(0, len(points) - 1, count).astype(int)] + np.random.default_rng(0).normal(0, 0.3, 2)
    sigma = [0.5] * len(points)
    return AnnotatedMarking(kind=kind, name=name, points_px=points.tolist(), sigma_px=sigma, source="clicked")


@pytest.mark.parametrize("wrong", [None, "side_line_left"])
def test_recognised_lines_have_their_own_names_beside_one_that_was_clicked_under_a_wrong_name(broadcast_view, wrong):
    angles = np.linspace(0.0, 2 * np.pi, 200)
    circle = 9.15 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    markings = [
        click(broadcast_view, "curve", "centre_circle", circle, 100),
        click(broadcast_view, "line", "halfway_line", LINES["halfway_line"], 60),
    ]
    if wrong is not None:
        aslant = np.linspace((-10.0, -25.0), (15.0, -25.0), 200)
        markings.append(click(broadcast_view, "line", wrong, aslant, 3))
    truth = dict(enumerate(NAMES, len(markings)))
    markings += [click(broadcast_view, "line", None, LINES[name], 60) for name in NAMES]
    width, height = broadcast_view.camera.width, broadcast_view.camera.height
    annotation = Annotation(id="x", source="x.jpg", width=width, height=height, markings=markings)
    told = answer(annotation, load_config(), nameless=True)
    assert told.is_calibrated
    assert told.recognise() == truth


def named_frame(view: FieldView, *wrong: tuple[str, str]) -> tuple[Annotation, Annotation]:
    """A frame whose circle was measured and whose lines a person named, some of them wrongly (right name, given name),
    and the frame before that.
    """
    angles = np.linspace(0.0, 2 * np.pi, 200)
    circle = 9.15 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    names = ("halfway_line", *NAMES)
    markings = [click(view, "curve", "centre_circle", circle, 100)]
    markings += [click(view, "line", None, LINES[name], 60) for name in names]
    begun = Annotation(id="x", width=view.camera.width, height=view.camera.height, markings=markings)
    given = dict(wrong)
    named = [
        marking.model_copy(update={"name": given.get(name, name)})
        for name, marking in zip(("centre_circle", *names), markings, strict=True)
    ]
    return begun, begun.model_copy(update={"markings": named})


def test_a_wrong_name_on_a_calibrated_frame_is_told_first_with_the_right_one(broadcast_view):
    _, annotation = named_frame(broadcast_view, ("side_line_top", "side_line_right"))
    piece = click(broadcast_view, "line", None, LINES["side_line_top"], 30)
    annotation = annotation.model_copy(update={"markings": [*annotation.markings, piece]})
    told = describe(answer(annotation, load_config(), nameless=True))
    assert told["status"] == "calibrated"
    (wrong,) = told["wrong"]
    assert (wrong["names"], wrong["instead"]) == ({"2": "side_line_top"}, {"2": "side_line_right"})
    assert told["missing"].startswith("The name side line right contradicts the rest: ")
    assert told["missing"].endswith("It is probably side line top.")
    assert told["suggested"].get("5") in (None, "side_line_top"), "no further line is offered the wrong name"
    _, right = named_frame(broadcast_view)
    told = describe(answer(right, load_config(), nameless=True))
    assert (told["wrong"], told["missing"]) == ([], None)


def test_a_name_whose_marking_the_camera_does_not_show_is_wrong(broadcast_view):
    _, annotation = named_frame(broadcast_view, ("big_rect_right_top", "small_rect_left_main"))
    told = describe(answer(annotation, load_config(), nameless=True))
    assert [one["instead"] for one in told["wrong"]] == [{"4": "small_rect_left_main"}]


def test_of_a_refused_frame_the_name_is_found_without_which_everything_agrees(broadcast_view):
    begun, annotation = named_frame(broadcast_view, ("side_line_top", "big_rect_left_top"))
    few = annotation.model_copy(update={"markings": annotation.markings[:3]})
    told = describe(answer(few, load_config(), nameless=True))
    assert (told["status"], told["wrong"]) == ("refused", [])
    found = find_wrong_name(few, begun, load_config())
    assert found is not None
    assert found.describe()["instead"] == {"2": "big_rect_left_top"}
    assert found.likely in (None, "side_line_top"), "a circle and its halfway line hardly tell where a touchline is"
    assert find_wrong_name(few, few, load_config()) is None, "what was measured is not doubted"
    assert find_wrong_name(few, begun, load_config(), is_wanted=lambda: False) is None

"""What the page is told of an annotation."""

import numpy as np
import pytest

from circlecal.api.calls import calibrate_picture
from circlecal.config import load_config
from circlecal.field import load_field
from circlecal.field.view import FieldView
from circlecal.formats.annotation import AnnotatedMarking, Annotation
from circlecal.pictures.files import read_image
from circlecal.workbench.answers import answer
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

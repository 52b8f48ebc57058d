"""Small annotations of one synthetic view, made from the camera of the painted frame."""

import numpy as np
import pytest

from circlecal.field import FieldTemplate, load_field
from circlecal.field.view import FieldView
from circlecal.formats.cameras import CalibratedFrame
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.camera import Camera


@pytest.fixture(scope="session")
def soccer() -> FieldTemplate:
    """The field as the official model has it: markings without width."""
    return load_field("soccer").model_copy(update={"marking_width_m": 1e-9, "marking_width_sd_m": 0.0})


@pytest.fixture(scope="session")
def seen(frame_camera: Camera, soccer: FieldTemplate) -> AnnotatedFrame:
    """Circle, halfway line and centre mark where the camera puts them, off the pixel grid."""
    circle = frame_camera.project(soccer.polylines(1.0)["centre_circle"])
    halfway = frame_camera.project(soccer.polylines(1.0)["halfway_line"])
    inside = (halfway[:, 1] > 0) & (halfway[:, 1] < 539)
    shapes = (
        Shape("Circle central", "line", circle),
        Shape("Middle line", "line", halfway[inside][[0, -1]]),
        Shape("centre_mark", "points", frame_camera.project([[0.0, 0.0]])),
    )
    return AnnotatedFrame("view", 960, 540, shapes, "view.jpg")


@pytest.fixture
def calibrated(frame_camera: Camera, soccer: FieldTemplate) -> CalibratedFrame:
    """The view, calibrated without error on a flat field."""
    return CalibratedFrame(
        "view",
        960,
        540,
        FieldView(frame_camera),
        soccer,
        soccer.circles[0],
        "view.jpg",
    )


@pytest.fixture
def close():
    """Compare frames: same labels and kinds, points to 1e-9 px."""

    def check(first: AnnotatedFrame, second: AnnotatedFrame) -> None:
        assert (first.width, first.height) == (second.width, second.height)
        assert [(s.label, s.kind) for s in first.shapes] == [(s.label, s.kind) for s in second.shapes]
        for one, other in zip(first.shapes, second.shapes, strict=True):
            assert np.abs(one.points_px - other.points_px).max() < 1e-9

    return check

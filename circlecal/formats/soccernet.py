"""SoccerNet's line annotation: one JSON file per frame, in and out.

``{"Circle central": [{"x": 0.677, "y": 0.613}, ...], ...}``, normalised. Pixel = ``x (W - 1)``, ``y (H - 1)``: the
official evaluation's mapping, in which 0 and 1 are the centres of the outermost pixels. Points a little outside [0, 1]
occur and are taken as they are.

The class list of the public baseline spells ``"Goal left post left "`` with a trailing blank, later ones without:
both are read, and the blank is written.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, RootModel

from circlecal.formats.cameras import Size
from circlecal.formats.format import (
    MAX_POINTS,
    AnnotationFormat,
    Bounded,
    Content,
    FileModel,
    json_bytes,
    parse_content,
    require_size,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape

CIRCLE_CLASSES = ("Circle central", "Circle left", "Circle right")
SEGMENTATION_CLASSES = (
    "Big rect. left bottom",
    "Big rect. left main",
    "Big rect. left top",
    "Big rect. right bottom",
    "Big rect. right main",
    "Big rect. right top",
    "Circle central",
    "Circle left",
    "Circle right",
    "Goal left crossbar",
    "Goal left post left ",
    "Goal left post right",
    "Goal right crossbar",
    "Goal right post left",
    "Goal right post right",
    "Goal unknown",
    "Line unknown",
    "Middle line",
    "Side line bottom",
    "Side line left",
    "Side line right",
    "Side line top",
    "Small rect. left bottom",
    "Small rect. left main",
    "Small rect. left top",
    "Small rect. right bottom",
    "Small rect. right main",
    "Small rect. right top",
)
"""The classes of segmentation masks in the order of their ids, from 1; the name of one ends in a blank."""
LINE_CLASSES = tuple(
    name.strip() for name in SEGMENTATION_CLASSES if not name.startswith("Circle") and not name.endswith("unknown")
)
"""Straight classes in SoccerNet's order, without blanks at the end; six of them are goals and stand above the field."""
GOAL_CLASSES = tuple(name for name in LINE_CLASSES if name.startswith("Goal"))
UNKNOWN_CLASSES = ("Goal unknown", "Line unknown")
BLANK_CLASS = "Goal left post left"
FLAT_PITCH = (105.0, 68.0)


class ClassPoint(FileModel):
    """One point of a class, normalised."""

    x: Bounded
    y: Bounded


class _Annotation(RootModel[dict[str, Annotated[list[ClassPoint], Field(max_length=MAX_POINTS)]]]):
    pass


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frame of a line annotation; empty classes are left out.

    Raises
    ------
    InputError
        No such file of SoccerNet, or the size of the picture is not known.
    """
    width, height = require_size(path, size)
    identifier = path.stem.removesuffix(".soccernet")
    return [AnnotatedFrame(identifier, width, height, parse_classes(path, content, (width - 1, height - 1)))]


def parse_classes(path: Path, content: bytes, scale: Size) -> tuple[Shape, ...]:
    """Shapes of a file of points by class, whose numbers times ``scale`` are pixels.

    Raises
    ------
    InputError
        No such file.
    """
    return shapes_of_classes(parse_content(_Annotation, path, content).root, scale)


def shapes_of_classes(classes: Mapping[str, Sequence[ClassPoint]], scale: Size) -> tuple[Shape, ...]:
    """Points by class as shapes; empty classes are left out."""
    return tuple(
        Shape(name.strip(), "line", np.array([(p.x, p.y) for p in points], dtype=np.float64) * scale)
        for name, points in classes.items()
        if points
    )


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a line annotation."""
    (frame,) = frames
    return write_classes(frame, (frame.width - 1, frame.height - 1))


def write_classes(frame: AnnotatedFrame, scale: Size) -> bytes:
    """Points by class, pixels divided by ``scale``; shapes that share a label are put together."""
    record: dict[str, list[dict[str, float]]] = {}
    for shape in frame.shapes:
        label = f"{shape.label} " if shape.label == BLANK_CLASS else shape.label
        points = (shape.sample() / np.array(scale)).tolist()
        record.setdefault(label, []).extend({"x": x, "y": y} for x, y in points)
    return json_bytes(record)


def holds_classes(content: Content) -> bool:
    """Whether a file is an object of lists, as points by class are."""
    return isinstance(content.json, dict) and all(isinstance(points, list) for points in content.json.values())


FORMAT = AnnotationFormat(
    name="soccernet",
    recognises=holds_classes,
    read=read,
    write=write,
    file_name="{id}.json",
    marks_line_ends=True,
    draws_measured=True,
    holds_convention=False,
)

"""CVAT for images 1.1: one XML file with all frames, in and out.

``<image name width height>`` with ``<points>``, ``<polyline>``, ``<polygon>``, ``<ellipse>`` and ``<skeleton>`` of
named points. CVAT counts from the corner of the picture: pixel = theirs - 0.5. Boxes, masks and tags are left out. A
file that declares a document type is refused unread, so no entity is ever expanded. A refused frame has what was
measured in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from circlecal.errors import InputError
from circlecal.formats.cameras import Size, derive_shapes
from circlecal.formats.format import (
    MAX_POINTS,
    MAX_SIDE,
    OWN_KEY,
    AnnotationFormat,
    ids_of_pictures,
    require_size,
    says_paint,
    tell_convention,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape
from circlecal.geometry.projective import Array
from circlecal.names import show

_CORNER = 0.5
_LARGEST = 1e6
_LEFT_OUT = ("box", "mask", "cuboid")


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frames of a file, those without shapes too.

    Raises
    ------
    InputError
        Not XML, with a document type, not CVAT for images, or a number that is none.
    """
    root = _safe_root(path, content)
    if root.tag != "annotations":
        raise InputError(f"{path}: {root.tag}: is no CVAT file; its first element must be annotations")
    images = root.findall("image")
    if not images and root.find("track") is not None:
        raise InputError(f"{path}: track: is CVAT for video; export the task as CVAT for images 1.1")
    names = ids_of_pictures(image.get("name", "") for image in images)
    return [_frame(path, image, name, size) for image, name in zip(images, names, strict=True)]


def _safe_root(path: Path, content: bytes) -> ElementTree.Element:
    def refuse(*_: Any) -> None:
        raise InputError(f"{path}: DOCTYPE: declares a document type, which no export of CVAT has; remove it")

    scanner = expat.ParserCreate()
    scanner.StartDoctypeDeclHandler = refuse
    try:
        scanner.Parse(content, True)
        return ElementTree.fromstring(content)
    except (expat.ExpatError, ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: is not XML: {error}") from error


def _frame(path: Path, image: ElementTree.Element, name: str, size: Size | None) -> AnnotatedFrame:
    where = f"{path}: image {image.get('name', '')!r}"
    sides = [image.get("width"), image.get("height")]
    found = None
    if None not in sides:
        width, height = (_number(image, key, where) for key in ("width", "height"))
        if not (1 < width <= MAX_SIDE and 1 < height <= MAX_SIDE):
            raise InputError(f"{where}: width: a picture of {width:g} x {height:g} pixels is none")
        found = int(width), int(height)
    shapes: list[Shape] = []
    warnings: list[str] = []
    for element in image:
        if element.tag in _LEFT_OUT:
            warnings.append(
                f"{where}: {element.tag}: {element.get('label', '')!r} is no point, line or ellipse; left out"
            )
        shapes += _shapes(element, where)
    chosen = require_size(path, found, size)
    on_paint = says_paint({"convention": image.get(OWN_KEY)})
    return AnnotatedFrame(name, *chosen, tuple(shapes), image.get("name"), tuple(warnings), on_paint=on_paint)


def _shapes(element: ElementTree.Element, where: str) -> Iterator[Shape]:
    label = element.get("label", "").strip()
    if element.tag == "skeleton":
        for part in element:
            if part.get("outside") != "1":
                yield from _shapes(part, where)
    elif element.tag == "ellipse":
        yield Shape(label, "ellipse", _ellipse(element, f"{where}: {label}"))
    elif element.tag in ("points", "polyline", "polygon"):
        kind = "points" if element.tag == "points" else "line"
        points = _points(element.get("points", ""), f"{where}: {label}: points") - _CORNER
        if len(points):
            yield Shape(label, "points" if kind == "points" else "line", points)


def _points(text: str, where: str) -> Array:
    pairs = [pair.split(",") for pair in text.split(";")] if text.strip() else []
    if len(pairs) > MAX_POINTS:
        raise InputError(f"{where}: has {len(pairs)} points; at most {MAX_POINTS} are read")
    try:
        values = [[float(value) for value in pair] for pair in pairs]
    except ValueError as error:
        raise InputError(f"{where}: {error}") from error
    if any(len(pair) != 2 or not all(abs(value) <= _LARGEST for value in pair) for pair in values):
        raise InputError(f"{where}: must be pairs x,y of at most {_LARGEST:g} with ; between them")
    return np.array(values, dtype=np.float64).reshape(-1, 2)


def _ellipse(element: ElementTree.Element, where: str) -> Array:
    cx, cy, rx, ry = (_number(element, key, where) for key in ("cx", "cy", "rx", "ry"))
    for key, radius in (("rx", rx), ("ry", ry)):
        if radius <= 0:
            raise InputError(f"{where}: {key}: {radius:g} is no radius of an ellipse; it must be greater than 0")
    turn = math.radians(_number(element, "rotation", where)) if element.get("rotation") else 0.0
    center = np.array([cx, cy]) - _CORNER
    first = rx * np.array([math.cos(turn), math.sin(turn)])
    second = ry * np.array([-math.sin(turn), math.cos(turn)])
    return np.stack([center, center + first, center + second])


def _number(element: ElementTree.Element, key: str, where: str) -> float:
    text = element.get(key, "")
    try:
        value = float(text)
    except ValueError as error:
        raise InputError(f"{where}: {key}: {text!r} is no number") from error
    if not abs(value) <= _LARGEST:
        raise InputError(f"{where}: {key}: {text!r} is not finite, or far too large")
    return value


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file; numbers keep all their digits."""
    root = ElementTree.Element("annotations")
    ElementTree.SubElement(root, "version").text = "1.1"
    for number, frame in enumerate(frames):
        keys = {"id": str(number), "name": show(frame.image or f"{frame.id}.jpg")}
        keys |= {"width": str(frame.width), "height": str(frame.height)}
        keys |= {key: told["convention"] for key, told in tell_convention(frame).items()}
        image = ElementTree.SubElement(root, "image", keys)
        for shape in frame.shapes:
            common = {"label": show(shape.label), "source": "manual", "occluded": "0", "z_order": "0"}
            if shape.kind == "ellipse":
                ElementTree.SubElement(image, "ellipse", {**common, **_ellipse_keys(shape.points_px)})
            else:
                tag = "points" if shape.kind == "points" else "polyline"
                text = ";".join(f"{x!r},{y!r}" for x, y in (shape.points_px + _CORNER).tolist())
                ElementTree.SubElement(image, tag, {**common, "points": text})
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _ellipse_keys(points: Array) -> dict[str, str]:
    center, first, second = points[0] + _CORNER, points[1] - points[0], points[2] - points[0]
    values = {"cx": center[0], "cy": center[1], "rx": np.hypot(*first), "ry": np.hypot(*second)}
    values["rotation"] = math.degrees(math.atan2(first[1], first[0])) % 360.0
    return {key: repr(float(value)) for key, value in values.items()}


FORMAT = AnnotationFormat(
    name="cvat",
    recognises=lambda content: content.head == b"<",
    read=read,
    write=write,
    derive=derive_shapes,
    draws_measured=True,
    file_name="cvat.xml",
)

"""Label sets of annotation programs, so that nobody types class names: SoccerNet's where there are any.

CVAT takes a JSON list under *Raw* of a project's labels; Label Studio XML under *Labeling Interface*, code; LabelMe one
name a line with ``labelme --labels``.
"""

from __future__ import annotations

from collections.abc import Callable
from xml.sax.saxutils import quoteattr

from circlecal.field import FieldTemplate
from circlecal.formats.annotation import UNKNOWN_LINE
from circlecal.formats.format import json_bytes

_COLOURS = {"curve": "#33ddff", "line": "#ffb02e", "point": "#ff5ad0"}


def list_labels(template: FieldTemplate) -> dict[str, str]:
    """Kind (``curve``, ``line``, ``point``) of every label of a template; the last is a line that nobody knows."""
    kinds = (("curve", template.round_ones), ("line", template.lines), ("point", template.marks))
    found = {element.class_name or element.name: kind for kind, elements in kinds for element in elements}
    return {**found, UNKNOWN_LINE: "line"}


def _cvat(labels: dict[str, str]) -> bytes:
    shapes = {"curve": "polyline", "line": "polyline", "point": "points"}
    return json_bytes(
        [
            {"name": name, "color": _COLOURS[kind], "type": shapes[kind], "attributes": []}
            for name, kind in labels.items()
        ]
    )


def _labelstudio(labels: dict[str, str]) -> bytes:
    def write_tag(tag: str, name: str, kinds: tuple[str, ...]) -> str:
        inside = "".join(
            f"\n    <Label value={quoteattr(label)} background={quoteattr(_COLOURS[kind])}/>"
            for label, kind in labels.items()
            if kind in kinds
        )
        return f'  <{tag} name="{name}" toName="image">{inside}\n  </{tag}>\n'

    curves, lines = ("curve",), ("curve", "line")
    content = write_tag("PolygonLabels", "polygon", lines) + write_tag("EllipseLabels", "ellipse", curves)
    content += write_tag("KeyPointLabels", "keypoint", ("curve", "line", "point"))
    return f'<View>\n  <Image name="image" value="$image" zoom="true"/>\n{content}</View>\n'.encode()


def _labelme(labels: dict[str, str]) -> bytes:
    return "\n".join(["__ignore__", *labels, ""]).encode()


LABEL_SETS: dict[str, tuple[str, Callable[[dict[str, str]], bytes]]] = {
    "cvat": ("cvat-labels.json", _cvat),
    "labelstudio": ("labelstudio-labels.xml", _labelstudio),
    "labelme": ("labelme-labels.txt", _labelme),
}
"""Name of the file and what writes it, by program."""


def write_labels(program: str, template: FieldTemplate) -> tuple[str, bytes]:
    """Name and content of the label set of a program, one of :data:`LABEL_SETS`."""
    name, write = LABEL_SETS[program]
    return name, write(list_labels(template))

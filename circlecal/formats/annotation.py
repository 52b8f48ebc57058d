"""Annotations of the workbench (``circlecal annotate``): one JSON file per frame, with everything that is known of it.

A file stands by itself: it holds what the picture was measured to show as well as what a person named or clicked, each
point with its standard deviation, so that the same camera follows from it everywhere and no picture is needed again.
Pixels are the package's: (0, 0) is the centre of the top-left pixel. Points lie on the middle of the paint.

``markings[]`` has ``name`` (an element of the field template, a meet ``halfway_line x side_line_top``, a place on a
circle ``centre_circle top``, or null while nobody knows), ``kind`` (``curve``, ``line``, ``point``), ``points_px``,
``sigma_px``, ``source`` (``measured``, ``clicked``, ``imported``) and ``used``; what is not used is only offered. In
other formats a marking has its SoccerNet class where there is one, and a line without a name is ``Line unknown``.
"""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from circlecal.errors import CirclecalError, InputError
from circlecal.field import FieldTemplate, load_field
from circlecal.files import are_different, is_folder
from circlecal.formats.cameras import THINNEST_PAINT_M, Size
from circlecal.formats.format import (
    MAX_POINTS,
    MAX_SHAPES,
    AnnotationFormat,
    Bounded,
    Content,
    FileModel,
    Side,
    parse_content,
)
from circlecal.formats.shapes import AnnotatedFrame, Shape, scale_between
from circlecal.formats.soccernet import UNKNOWN_CLASSES
from circlecal.geometry.projective import Array
from circlecal.names import picture_name
from circlecal.observations import CircleEdge, CirclePoints, LineEnd, LinePoints, Observations
from circlecal.records.json_text import model_text
from circlecal.records.parts import Text
from circlecal.records.record import ResultRecord

_log = logging.getLogger(__name__)

UNKNOWN_LINE = UNKNOWN_CLASSES[1]
CURVE_POINTS, LINE_POINTS = 36, 6
"""Of a measured marking, in files of other programs: so many are drawn and moved by hand."""
SETTINGS = ("field.sizes.length", "field.sizes.width", "camera.crown_m", "camera.k1_mean", "field.template")
"""Options that an annotation may set for its frame."""

ANNOTATION_FOLDER = "annotations"
"""In the folder of a run."""
_NOT_IN_NAMES = frozenset("/\\:\0")

_BEGINNING = 200

Pair = Annotated[list[Bounded], Field(min_length=2, max_length=2)]
Sigma = Annotated[float, Field(ge=1e-4, le=1e4)]
Flag = Literal["no_field", "other_camera"]
"""What a person says of a frame as a whole: that it shows no field, or was not taken with this camera."""


class MarkingEnd(FileModel):
    """Where the paint of a line is seen to end, and whether another marking crosses it there."""

    point_px: Pair
    crossed: bool


class AnnotatedMarking(FileModel):
    """One marking of a frame, named or not."""

    name: Annotated[str, Field(min_length=1, max_length=200)] | None = None
    kind: Literal["curve", "line", "point"]
    edge: CircleEdge = "center"
    points_px: Annotated[list[Pair], Field(min_length=1, max_length=MAX_POINTS)]
    sigma_px: Annotated[list[Sigma], Field(min_length=1, max_length=MAX_POINTS)]
    ends: list[MarkingEnd] = Field([], max_length=8)
    source: Literal["measured", "clicked", "imported"] = "clicked"
    used: bool = True

    @model_validator(mode="after")
    def _as_many(self) -> Self:
        if len(self.sigma_px) != len(self.points_px):
            raise ValueError(f"{len(self.points_px)} points have {len(self.sigma_px)} standard deviations")
        if self.kind == "point" and len(self.points_px) != 1:
            raise ValueError(f"a point is one pixel, not {len(self.points_px)}")
        return self

    @property
    def points(self) -> Array:
        """Pixels (N, 2)."""
        return np.array(self.points_px, dtype=np.float64)

    @property
    def sigma(self) -> Array:
        """Standard deviations (N,) along the normal of the marking, pixels."""
        return np.array(self.sigma_px, dtype=np.float64)

    def scale(self, factor: Array) -> Self:
        """The marking on a picture that is wider and higher by factors (2,)."""

        def move(points: list[Pair]) -> list[Pair]:
            return ((np.array(points) + 0.5) * factor - 0.5).tolist()

        ends = [end.model_copy(update={"point_px": move([end.point_px])[0]}) for end in self.ends]
        sigma = (self.sigma * np.sqrt(factor.prod())).tolist()
        return self.model_copy(update={"points_px": move(self.points_px), "sigma_px": sigma, "ends": ends})


class Annotation(FileModel):
    """Everything that is known of one frame.

    ``revision`` counts the changes; ``settings`` are options for this frame (:data:`SETTINGS`); ``touched`` says
    whether a person has changed anything, or ``confirmed`` that the template lies on the paint; ``author`` and
    ``changed_at`` (ISO 8601, UTC) are of the last change. ``pixel_aspect`` is the width of a pixel over its height.
    ``circle`` is the one from which the picture was calibrated, where it is another than the field's usual one, and
    ``placed`` says whether all that is painted decided which marking is which.
    """

    annotation_version: Literal[1] = 1
    id: Annotated[str, Field(min_length=1)]
    source: Text | None = None
    time_s: float | None = None
    width: Side
    height: Side
    pixel_aspect: Annotated[float, Field(gt=0, lt=1e3)] = 1.0
    field: str = "soccer"
    circle: str | None = None
    placed: bool = False
    revision: Annotated[int, Field(ge=0)] = 0
    touched: bool = False
    confirmed: bool = False
    author: Annotated[str, Field(max_length=100)] = ""
    changed_at: Annotated[str, Field(max_length=40)] | None = None
    flag: Flag | None = None
    note: Annotated[str, Field(max_length=10_000)] = ""
    settings: dict[str, float | str] = Field({})
    markings: list[AnnotatedMarking] = Field([], max_length=MAX_SHAPES)

    @field_validator("settings")
    @classmethod
    def _known(cls, given: dict[str, float | str]) -> dict[str, float | str]:
        unknown = sorted(given.keys() - set(SETTINGS))
        if unknown:
            raise ValueError(f"{unknown[0]} cannot be set for one frame; known: {', '.join(SETTINGS)}")
        return given

    def says_what(self, other: Self) -> bool:
        """Whether it says of its frame what another one says, whoever said it and when."""
        ours, theirs = ((a.markings, a.note, a.flag, a.settings) for a in (self, other))
        return ours == theirs

    def is_of_another(self, picture: Path) -> bool:
        """Whether its ``source`` is another file than a picture, which is still there and of other content."""
        return self.source is not None and are_different(self.source, picture, by_content=True)

    def resize(self, width: int, height: int) -> Self:
        """The annotation on a picture of another size; the corners of the picture stay its corners.

        Raises
        ------
        InputError
            The other picture has another aspect.
        """
        if (width, height) == (self.width, self.height):
            return self
        factor = scale_between(self.id, (self.width, self.height), (width, height))
        markings = [marking.scale(factor) for marking in self.markings]
        return self.model_copy(update={"width": width, "height": height, "markings": markings})

    def observations(self, nameless: bool = True) -> Observations:
        """Curves and lines that are used; points are shapes, since their place is the template's.

        Parameters
        ----------
        nameless : bool
            Whether lines without a name are among them.
        """
        circles, lines = [], []
        for marking in self.markings:
            if not marking.used:
                continue
            if marking.kind == "curve" and marking.name is not None:
                circles.append(CirclePoints(marking.name, marking.edge, marking.points, marking.sigma))
            elif marking.kind == "line" and (nameless or marking.name is not None) and len(marking.points_px) > 1:
                ends = tuple(LineEnd(np.array(end.point_px), end.crossed) for end in marking.ends)
                lines.append(LinePoints(marking.name, marking.points, marking.sigma, ends))
        return Observations(self.width, self.height, tuple(circles), _join_lines(lines))

    def frame(self, nameless: bool = True) -> AnnotatedFrame:
        """The annotation as other formats and :func:`circlecal.formats.meaning.observe` take it."""
        template = load_template(self.field)
        shapes = tuple(shape for m in self.markings if m.used for shape in _shapes(m, template, nameless))
        image = picture_name(self.id, self.source, self.time_s)
        seen = self.observations(nameless)
        return AnnotatedFrame(
            self.id, self.width, self.height, shapes, image, observations=seen, field=self.field, on_paint=True
        )


def load_template(name: str) -> FieldTemplate | None:
    """The field of an annotation; None where it is somebody's own, and its file is not here."""
    try:
        return load_field(name)
    except CirclecalError:
        return None


def draw_measured(record: ResultRecord, image: str | None) -> AnnotatedFrame:
    """What a refused frame was measured to show, as shapes to go on from: the circle's points, and every line."""
    seen, markings = record.seen, []
    if seen is not None:
        markings = [m for m in markings_of(seen, "measured") if m.kind != "curve" or m.edge == "center"]
    field = "soccer" if record.field is None else str(record.field.template)
    template = load_template(field)
    shapes = tuple(shape for m in markings for shape in _shapes(m, template, True))
    marking_m = None if record.field is None else (record.field.sizes or {}).get("marking")
    on_paint = marking_m is None or marking_m > THINNEST_PAINT_M
    return AnnotatedFrame(record.id, record.width, record.height, shapes, image, on_paint=on_paint)


def _join_lines(lines: Sequence[LinePoints]) -> tuple[LinePoints, ...]:
    """The lines, those of one name as one."""
    named: dict[str, LinePoints] = {}
    nameless = []
    for line in lines:
        before = None if line.line is None else named.get(line.line)
        if line.line is None:
            nameless.append(line)
        elif before is None:
            named[line.line] = line
        else:
            points = np.concatenate([before.points_px, line.points_px])
            sigma = np.concatenate([before.sigma_px, line.sigma_px])
            named[line.line] = LinePoints(line.line, points, sigma, (*before.ends, *line.ends))
    return (*named.values(), *nameless)


def _shapes(marking: AnnotatedMarking, template: FieldTemplate | None, nameless: bool) -> list[Shape]:
    if marking.name is None:
        if marking.kind != "line" or not nameless:
            return []
        return [Shape(UNKNOWN_LINE, "line", _thin(marking.points, LINE_POINTS))]
    label = official_name(marking.name, template)
    if marking.kind == "point":
        return [Shape(label, "points", marking.points, sigma_px=marking.sigma_px[0])]
    return [Shape(label, "line", _thin(marking.points, CURVE_POINTS if marking.kind == "curve" else LINE_POINTS))]


def official_name(name: str, template: FieldTemplate | None) -> str:
    """SoccerNet's class of an element of the template, or its own name where it has none."""
    elements = () if template is None else template.elements
    return next((e.class_name for e in elements if e.name == name and e.class_name is not None), name)


def _thin(points: Array, count: int) -> Array:
    """At most so many of the points (N, 2), the ends among them."""
    if len(points) <= count:
        return points
    return points[np.unique(np.linspace(0, len(points) - 1, count).round().astype(int))]


def markings_of(observations: Observations, source: Literal["measured", "imported"]) -> list[AnnotatedMarking]:
    """Observations as markings of an annotation."""
    found = [
        _marking("curve", c.circle, c.points_px, c.sigma_px, source, edge=c.edge)
        for c in observations.circles
        if len(c.points_px)
    ]
    for line in observations.lines:
        ends = [MarkingEnd(point_px=end.point_px.tolist(), crossed=end.crossed) for end in line.ends]
        order = np.argsort(line.points_px @ _direction(line.points_px), kind="stable")
        found.append(_marking("line", line.line, line.points_px[order], line.sigma_px[order], source, ends=ends))
    points = [(mark.mark, mark.point_px, mark.sigma_px) for mark in observations.marks]
    points += [(point.name, point.point_px, point.sigma_px) for point in observations.keypoints]
    found += [_marking("point", name, px[None], np.array([sigma]), source) for name, px, sigma in points]
    return found


def _direction(points: Array) -> Array:
    span = np.ptp(points, axis=0)
    along = points[np.argmax(points[:, int(span[1] > span[0])])] - points[np.argmin(points[:, int(span[1] > span[0])])]
    return np.asarray(along)


def _marking(
    kind: Literal["curve", "line", "point"],
    name: str | None,
    points: Array,
    sigma: Array,
    source: Literal["measured", "imported"],
    *,
    edge: CircleEdge = "center",
    ends: list[MarkingEnd] | None = None,
) -> AnnotatedMarking:
    return AnnotatedMarking(
        name=name,
        kind=kind,
        edge=edge,
        points_px=np.round(points, 3).tolist(),
        sigma_px=np.maximum(np.round(sigma, 4), 1e-3).tolist(),
        ends=ends or [],
        source=source,
    )


def annotation_of_shapes(frame: AnnotatedFrame, observations: Observations, field: str) -> Annotation:
    """An annotation from what another program's file says of a frame, as it was understood."""
    return Annotation(
        id=frame.id,
        source=frame.image,
        width=frame.width,
        height=frame.height,
        field=field,
        touched=True,
        markings=markings_of(observations, "imported"),
    )


def annotation_path(folder: Path, frame_id: str) -> Path:
    """The file of a frame; names that are no names of files get a digest instead."""
    plain = frame_id not in ("", ".", "..") and _NOT_IN_NAMES.isdisjoint(frame_id)
    name = frame_id if plain else hashlib.sha256(frame_id.encode(errors="surrogateescape")).hexdigest()[:24]
    return folder / f"{name}.json"


@dataclass(frozen=True, slots=True)
class StoredAnnotation:
    """An annotation that a person made, and the digest of its file."""

    annotation: Annotation
    digest: str


def find_annotation(folder: Path | None, frame_id: str, picture: Path | None = None) -> StoredAnnotation | None:
    """What a person said of a frame in the workbench; None where nobody did, or of another picture of its name, which
    is told.

    Parameters
    ----------
    folder : path or None
        Of annotations.
    frame_id : str
        The frame.
    picture : path, optional
        Its picture: ``x.json`` beside ``x.png`` is taken where the folder has none, and no annotation whose ``source``
        is another file that is there.

    Raises
    ------
    InputError
        The file is damaged or cannot be read.
    """
    path = None if folder is None else annotation_path(folder, frame_id)
    if path is not None and path.is_file():
        stored = _load_file(path)
        is_taken = stored.annotation.touched and stored.annotation.id == frame_id
        return stored if is_taken and _is_own(stored.annotation, path, picture) else None
    beside = None if picture is None else picture.with_suffix(".json")
    if beside is None or not is_annotation_file(beside):
        return None
    stored = _load_file(beside)
    return stored if _is_own(stored.annotation, beside, picture) else None


def _is_own(annotation: Annotation, path: Path, picture: Path | None) -> bool:
    """Whether an annotation is not that of another picture; one that is, is told."""
    if picture is None or not annotation.is_of_another(picture):
        return True
    _log.warning("%s: is of %s, not of %s, and is not used", path, annotation.source, picture)
    return False


def is_annotation_file(path: Path) -> bool:
    """Whether a file is an annotation of the workbench, by its beginning."""
    if not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return b'"annotation_version"' in file.read(_BEGINNING)
    except OSError:
        return False


def require_annotations(folder: Path) -> None:
    """See that a folder that was named is there: what is read from it is optional, and would be missed in silence.

    Raises
    ------
    InputError
        There is no such folder.
    """
    if not is_folder(folder):
        raise InputError(f"{folder}: no such folder of annotations; circlecal annotate writes one")


def read_annotations(
    folder: Path | None, on_error: Callable[[InputError], None] | None = None
) -> Iterator[StoredAnnotation]:
    """All that people said, file by file; JSON of another kind is passed over.

    Parameters
    ----------
    folder : path or None
        Of annotations; one that is not there holds none.
    on_error : callable, optional
        Called with the error of each damaged file, and the others go on.

    Raises
    ------
    InputError
        Without ``on_error``, a file that is damaged or cannot be read.
    """
    for path in [] if folder is None or not folder.is_dir() else sorted(folder.glob("*.json")):
        try:
            content = Content.of(path).raw
            stored = None if _is_of_another_kind(content) else _store(path, content)
        except InputError as error:
            if on_error is None:
                raise
            on_error(error)
            continue
        if stored is not None and stored.annotation.touched:
            yield stored


def _is_of_another_kind(content: bytes) -> bool:
    """Whether a file holds sound JSON, and no annotation."""
    try:
        value = json.loads(content)
    except (ValueError, RecursionError):
        return False
    return not isinstance(value, dict) or "annotation_version" not in value


def digest_annotations(folder: Path | None, on_error: Callable[[InputError], None] | None = None) -> dict[str, str]:
    """Digests of all that people said, by the id of the frame; parameters and errors as :func:`read_annotations`."""
    return {stored.annotation.id: stored.digest for stored in read_annotations(folder, on_error)}


def _load_file(path: Path) -> StoredAnnotation:
    return _store(path, Content.of(path).raw)


def _store(path: Path, content: bytes) -> StoredAnnotation:
    return StoredAnnotation(parse_annotation(path, content), hashlib.sha256(content).hexdigest()[:12])


def parse_annotation(path: Path, content: bytes) -> Annotation:
    """The annotation of a file.

    Raises
    ------
    InputError
        One line with the file, the field and what is wrong with it.
    """
    return parse_content(Annotation, path, content)


def read(path: Path, content: bytes, size: Size | None) -> list[AnnotatedFrame]:
    """The frame of a file.

    Raises
    ------
    InputError
        No annotation of the workbench.
    """
    return [parse_annotation(path, content).frame()]


def annotation_bytes(annotation: Annotation) -> bytes:
    """Content of a file."""
    return (model_text(annotation) + "\n").encode()


def write(frames: Sequence[AnnotatedFrame]) -> bytes:
    """Content of a file from what a frame of another format was understood to show."""
    (frame,) = frames
    seen = frame.observations or Observations(frame.width, frame.height)
    return annotation_bytes(annotation_of_shapes(frame, seen, frame.field))


def _recognise(content: Content) -> bool:
    return content.mapping.keys() >= {"annotation_version", "markings"}


FORMAT = AnnotationFormat(
    name="workbench",
    recognises=_recognise,
    read=read,
    write=write,
    file_name="{id}.json",
    writes_observations=True,
)

"""What was seen in one frame, each thing with its standard deviation: the input of every estimate, whatever the source.

Pixels are those of the frame as stored (distorted). A picture, an annotation file or a keypoint detector all end here.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from circlecal.geometry.projective import Array
from circlecal.geometry.short_repr import ShortRepr

CircleEdge = Literal["outer", "inner", "center"]
_EDGES: tuple[CircleEdge, ...] = get_args(CircleEdge)


@dataclass(frozen=True, slots=True)
class MarkingKey:
    """Which marking something lies on: an element of the field template by name, and of circles and arcs the edge of
    the paint, or its centreline; for what is no marking, its own name.

    As text, the name and the edge with a blank between them.
    """

    name: str
    edge: CircleEdge | None = None

    def __str__(self) -> str:
        return self.name if self.edge is None else f"{self.name} {self.edge}"

    @classmethod
    def parse(cls, text: str) -> MarkingKey:
        """From text as results are written with."""
        name, _, last = text.rpartition(" ")
        edge = next((edge for edge in _EDGES if edge == last and name), None)
        return cls(text) if edge is None else cls(name, edge)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class CirclePoints(ShortRepr):
    """Points on one edge, or on the centreline (``"center"``), of one circular marking.

    Attributes
    ----------
    circle : str
        Name of the circle or arc in the field template.
    edge : {"outer", "inner", "center"}
        Where on the paint the points lie.
    points_px : (N, 2) array
        Pixels.
    sigma_px : (N,) array
        Standard deviation of each point along the normal of the marking.
    """

    circle: str
    edge: CircleEdge
    points_px: Array
    sigma_px: Array

    @property
    def key(self) -> MarkingKey:
        """The circle and its edge."""
        return MarkingKey(self.circle, self.edge)


@dataclass(frozen=True, slots=True, eq=False)
class LineEnd:
    """Where the paint of a straight marking ends in the picture (2,), and whether another one is seen to cross it
    there.
    """

    point_px: Array
    crossed: bool


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class LinePoints(ShortRepr):
    """Points on the centreline of one straight marking.

    ``line`` is the template's name, or None while it is not known which one it is; ``ends`` are those that are seen.
    ``width_px`` is how wide it is at half height, 0 where that was not measured, and ``blur_px`` the standard deviation
    of the picture's blur, which is a part of that width.
    """

    line: str | None
    points_px: Array
    sigma_px: Array
    ends: tuple[LineEnd, ...] = ()
    width_px: float = 0.0
    blur_px: float = 0.0

    @property
    def key(self) -> MarkingKey | None:
        """The marking, where it is known."""
        return None if self.line is None else MarkingKey(self.line)

    def clear(self) -> LinePoints:
        """A line of which nothing is seen and whose marking is not known: it keeps the place of this one among others,
        by whose number names are given.
        """
        return replace(self, line=None, points_px=self.points_px[:0], sigma_px=self.sigma_px[:0], ends=())


@dataclass(frozen=True, slots=True, eq=False)
class MarkPoint:
    """A spot of the template, seen at one pixel (2,)."""

    mark: str
    point_px: Array
    sigma_px: float

    @property
    def key(self) -> MarkingKey:
        """The spot."""
        return MarkingKey(self.mark)


@dataclass(frozen=True, slots=True, eq=False)
class Keypoint:
    """A point of known field position (2,), e.g. from a detector or an annotation; ``shift`` (3, 2) is how it moves
    with the marking width, the length and the width of the field, metres per metre, None where it does not.
    """

    name: str
    field_m: Array
    point_px: Array
    sigma_px: float
    shift: Array | None = None

    @property
    def key(self) -> MarkingKey:
        """The point, by its own name."""
        return MarkingKey(self.name)


@dataclass(frozen=True, slots=True, eq=False)
class Observations:
    """Everything that was seen in one frame of ``width`` x ``height`` pixels.

    ``curves`` are points (N, 2) on curved markings of which it is not known which they are: they only tell hypotheses
    apart, and are not written down.
    """

    width: int
    height: int
    circles: tuple[CirclePoints, ...] = ()
    lines: tuple[LinePoints, ...] = ()
    marks: tuple[MarkPoint, ...] = ()
    keypoints: tuple[Keypoint, ...] = ()
    curves: tuple[Array, ...] = ()

    def __eq__(self, other: object) -> bool:
        """Whether both hold the very parts that the other holds."""
        return self._parts == other._parts if isinstance(other, Observations) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._parts)

    @property
    def _parts(self) -> tuple[object, ...]:
        curves = tuple(map(id, self.curves))
        return self.width, self.height, self.circles, self.lines, self.marks, self.keypoints, curves

    def without(self, keys: Collection[MarkingKey]) -> Observations:
        """All but what was seen of some markings; further lines take the numbers of those that go, so that names which
        were given by number do not hold any more.
        """
        return replace(
            self,
            circles=tuple(circle for circle in self.circles if circle.key not in keys),
            lines=tuple(line for line in self.lines if line.key not in keys),
            marks=tuple(mark for mark in self.marks if mark.key not in keys),
            keypoints=tuple(point for point in self.keypoints if point.key not in keys),
        )

    def resize(self, width: int, height: int) -> Observations:
        """What was seen as it lies in a picture of another size, whose corners are those of the picture; standard
        deviations grow with the width.
        """
        factor, size = np.array([width / self.width, height / self.height]), width / self.width

        def move(pixels: Array) -> Array:
            return np.asarray((pixels + 0.5) * factor - 0.5)

        return Observations(
            width,
            height,
            tuple(replace(c, points_px=move(c.points_px), sigma_px=size * c.sigma_px) for c in self.circles),
            tuple(
                replace(
                    line,
                    points_px=move(line.points_px),
                    sigma_px=size * line.sigma_px,
                    ends=tuple(replace(end, point_px=move(end.point_px)) for end in line.ends),
                )
                for line in self.lines
            ),
            tuple(replace(m, point_px=move(m.point_px), sigma_px=size * m.sigma_px) for m in self.marks),
            tuple(replace(p, point_px=move(p.point_px), sigma_px=size * p.sigma_px) for p in self.keypoints),
            tuple(map(move, self.curves)),
        )

    def circle(self, name: str, edge: CircleEdge) -> CirclePoints | None:
        """The points of one edge of one circle, or None."""
        return next((c for c in self.circles if c.circle == name and c.edge == edge), None)

    def line(self, name: str) -> LinePoints | None:
        """The points of one named line, or None."""
        return next((line for line in self.lines if line.line == name), None)


def join_observations(first: Observations, second: Observations) -> Observations:
    """Observations of one frame from two sources."""
    return Observations(
        first.width,
        first.height,
        (*first.circles, *second.circles),
        (*first.lines, *second.lines),
        (*first.marks, *second.marks),
        (*first.keypoints, *second.keypoints),
        (*first.curves, *second.curves),
    )

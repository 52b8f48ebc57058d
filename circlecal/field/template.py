"""Field template: circles, arcs, lines and marks with their sizes, read from a YAML file of ``configs/fields``.

A template gives sizes the way the rules of its sport do, that is, to an edge of the paint; what the pictures show best
is the centreline of the paint, so every element derives its centreline from the edge that its size refers to and the
marking width.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationInfo, model_validator

from circlecal.geometry.homography import compass_label
from circlecal.geometry.projective import Array, freeze, meet

_OPERATORS: dict[type[ast.AST], Any] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}

LONGEST_SIZE = 200
"""Characters of an expression of sizes; the longest one of the templates has 40, and long ones are slow to parse."""


def evaluate_size(value: float | int | str, sizes: dict[str, float]) -> float:
    """Number, or arithmetic (``+ - * /``) over the template's named sizes, as a float.

    Raises
    ------
    ValueError
        For anything else, naming the part that is not understood.
    """

    def visit(node: ast.AST) -> float:
        match node:
            case ast.Expression(body=body):
                return visit(body)
            case ast.Constant(value=float() | int() as number) if not isinstance(number, bool):
                return float(number)
            case ast.Name(id=name) if name in sizes:
                return sizes[name]
            case ast.Name(id=name):
                raise ValueError(f"unknown size {name!r}; known: {', '.join(sorted(sizes))}")
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return float(_OPERATORS[type(op)](visit(left), visit(right)))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                return float(_OPERATORS[type(op)](visit(operand)))
        raise ValueError(f"only numbers, sizes and + - * / are allowed, not {ast.unparse(node)!r}")

    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"a size must be a number or an expression, not {value!r}")
    if isinstance(value, str) and len(value) > LONGEST_SIZE:
        raise ValueError(f"a size is an expression of at most {LONGEST_SIZE} characters")
    try:
        result = float(value) if not isinstance(value, str) else visit(ast.parse(value, mode="eval"))
    except (SyntaxError, ArithmeticError, RecursionError, MemoryError) as error:
        raise ValueError(f"cannot evaluate {value!r}: {error}") from error
    if not np.isfinite(result):
        raise ValueError(f"{value!r} is not finite")
    return result


def _apply_size(value: Any, info: ValidationInfo) -> Any:
    return evaluate_size(value, (info.context or {}).get("sizes", {}))


LARGEST_M, LARGEST_DEG = 1000.0, 720.0
"""No size of a field, no place on it and no angle is larger: markings are drawn in steps, whose number would have no
bound in a file that says anything else.
"""
Size = Annotated[float, BeforeValidator(_apply_size)]
Extension = Annotated[Size, Field(gt=0, le=LARGEST_M)]
Coordinate = Annotated[Size, Field(ge=-LARGEST_M, le=LARGEST_M)]
Angle = Annotated[Size, Field(ge=-LARGEST_DEG, le=LARGEST_DEG)]
Point = tuple[Coordinate, Coordinate]
Edge = Literal["outer", "inner", "center"]
MEET = " x "
"""Between the names of two lines in that of the place where they meet, as ``halfway_line x side_line_top``."""


NODES = 65
"""Points along each marking of :attr:`FieldTemplate.outlines`."""
AT_MIDDLE_M = 1e-6
"""A centre this near to the long or the short axis lies on it, metres: rounding of arithmetic over sizes."""


def unit_circle(angle_rad: Array) -> Array:
    """Directions (..., 2) on the field at angles (...,) from the x axis towards y."""
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


COMPASS: dict[str, Array] = {
    compass_label(outward): outward for outward in unit_circle(np.radians(np.arange(0.0, 360.0, 45.0)))
}
"""The eight directions (2,) from the middle of a circle by their names, as the main camera sees them: right, bottom
right and so on.
"""


@dataclass(frozen=True, slots=True)
class Extent:
    """A size of the field, its length or its width: the template's, and what the rules allow, all in metres.

    Attributes
    ----------
    size_m : float
        The template's.
    range_m : (2,) tuple of float, or None
        Smallest and largest that the rules allow; None where all fields are of one size.
    """

    size_m: float
    range_m: tuple[float, float] | None

    def beyond_rules(self, size_m: float) -> float:
        """By how much a size is outside of what the rules allow, metres: negative inside, and where they name none."""
        return -np.inf if self.range_m is None else max(self.range_m[0] - size_m, size_m - self.range_m[1])


class _Element(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="Unique name, snake case.")
    class_name: str | None = Field(None, description="SoccerNet class name, where there is one.")
    color: Literal["light", "dark", "red", "blue", "yellow"] = Field("light", description="Colour of the paint.")
    width_m: Extension | None = Field(None, description="Width of its paint where that is not the template's, metres.")


class Circle(_Element):
    """A full circle of the template."""

    center: Point = Field(description="Centre, metres.")
    radius_m: Extension = Field(description="Radius to the edge that the rules name, metres.")
    edge: Edge = Field("outer", description="Which edge of the paint the radius refers to.")
    fill: Literal["none", "logo", "disc"] = Field(
        "none",
        description="What may lie inside: a logo up to the line, or the circle is the rim of a painted disc, which is "
        "an edge and no line. Rims are looked for where no line is found.",
    )

    @property
    def span_deg(self) -> tuple[float, float]:
        """Angles of both ends, degrees: a full circle is an arc from 0 to 360."""
        return 0.0, 360.0


class Arc(Circle):
    """Part of a circle, counter-clockwise in the field frame (x towards y) between two angles."""

    start_deg: Angle = Field(description="Angle of the first end, degrees from the x axis towards y.")
    end_deg: Angle = Field(description="Angle of the last end; larger than start_deg.")

    @property
    def span_deg(self) -> tuple[float, float]:
        """Angles of both ends, degrees."""
        return self.start_deg, self.end_deg


class Line(_Element):
    """A straight marking between two points."""

    start: Point = Field(description="One end, metres.")
    end: Point = Field(description="The other end, metres.")
    paint: tuple[int, int] = Field(
        (0, 0),
        description="Direction from the given line to the middle of the paint, e.g. [0, 1]; [0, 0] where it is that.",
    )


class Mark(_Element):
    """A spot or a small cross."""

    position: Point = Field(description="Middle of the mark, metres.")
    diameter_m: Extension = Field(description="Diameter, metres.")


Ground = Literal["grass", "ice", "floor", "any"]
"""Playing surfaces by their colour: green (turf and green carpet), nearly white, everything else."""


class FieldTemplate(BaseModel):
    """Everything painted on one kind of field."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: str = Field(description="Name of the template.")
    title: str = Field(description="One line for people.")
    sport: str | None = Field(
        None,
        description="The sport; its templates differ in their sizes. null: one of its own. A template of yours without "
        "sport, ground, config or polarity has those of the package's template of its sport, or of one with its names.",
    )
    ground: Ground = Field(
        "any", description="What it is mostly painted on, told by the colour of a picture; where sports are told apart."
    )
    config: str | None = Field(
        None, description="Configuration of the sport, taken under what the user sets; null for the defaults."
    )
    polarity: Literal["light", "dark", "any"] = Field(
        "light", description="Whether the markings are lighter or darker than the surface; what is tried first."
    )
    has_leagues: bool = Field(
        True,
        description="Whether the size of the circle tells how large what is seen is, so that other sizes are other "
        "fields. false: circles of several sizes, about which any length and width may lie.",
    )
    sizes: dict[str, float] = Field(
        description="Named sizes in metres that the elements are computed from; each can be set by the user."
    )
    length_m: Extension = Field(description="Length of the field (x), metres.")
    width_m: Extension = Field(description="Width of the field (y), metres.")
    length_sd_m: Annotated[Size, Field(ge=0)] = Field(
        0.0, description="How much the length varies from field to field, metres."
    )
    width_sd_m: Annotated[Size, Field(ge=0)] = Field(
        0.0, description="How much the width varies from field to field, metres."
    )
    length_range_m: tuple[Size, Size] | None = Field(
        None, description="Shortest and longest field that the rules allow, metres; null where all are of one length."
    )
    width_range_m: tuple[Size, Size] | None = Field(
        None, description="Narrowest and widest field that the rules allow, metres; null where all are of one width."
    )
    marking_width_m: Extension = Field(description="Width of the paint, metres.")
    marking_width_sd_m: Annotated[Size, Field(ge=0)] = Field(description="How uncertain that width is, metres.")
    placement_sd_m: Annotated[Size, Field(ge=0)] = Field(
        0.0, description="How far each marking may lie from where the sizes put it, along x and along y, metres."
    )
    radius_sd_m: Annotated[Size, Field(ge=0)] = Field(
        0.0,
        description="By how much the radius that circles and arcs of one size share may differ from that size, metres.",
    )
    wander_sd_m: Annotated[Size, Field(ge=0)] = Field(
        0.0, description="How far the middle of worn or taped paint wanders across its marking, metres."
    )
    default_circle: str = Field(
        description="The circle or arc that is meant when the user names none; empty where the sport has none."
    )
    halfway_line: str | None = Field(description="The line through the middle of the default circle, or null.")
    circles: tuple[Circle, ...] = Field(description="Full circles.")
    arcs: tuple[Arc, ...] = Field((), description="Parts of circles.")
    lines: tuple[Line, ...] = Field((), description="Straight markings.")
    marks: tuple[Mark, ...] = Field((), description="Spots.")

    @model_validator(mode="after")
    def _names(self) -> FieldTemplate:
        names = [e.name for e in self.elements]
        doubled = sorted({n for n in names if names.count(n) > 1})
        if doubled:
            raise ValueError(f"names used twice: {', '.join(doubled)}")
        if self.default_circle not in {"", *(c.name for c in self.round_ones)}:
            raise ValueError(f"default_circle {self.default_circle!r} is not among the circles and arcs")
        if self.halfway_line is not None and self.halfway_line not in {line.name for line in self.lines}:
            raise ValueError(f"halfway_line {self.halfway_line!r} is not among the lines")
        return self

    @model_validator(mode="after")
    def _sound(self) -> FieldTemplate:
        for arc in self.arcs:
            if not 0.0 < arc.end_deg - arc.start_deg <= 360.0:
                raise ValueError(f"arc {arc.name!r}: end_deg must be larger than start_deg, by 360 at most")
        for line in self.lines:
            if np.allclose(line.start, line.end, rtol=0.0, atol=AT_MIDDLE_M):
                raise ValueError(f"line {line.name!r}: start and end are one point")
            if max(map(abs, line.paint)) > 1:
                raise ValueError(f"line {line.name!r}: paint tells a direction, such as [0, 1]")
        for name, extent in zip(("length", "width"), self.extents, strict=True):
            if extent.range_m is not None and not extent.range_m[0] <= extent.range_m[1]:
                raise ValueError(f"{name}_range_m {list(extent.range_m)}: the smallest comes first")
        self._require_room_for_circles()
        self._require_halfway_through_circle()
        return self

    def _require_room_for_circles(self) -> None:
        for circle in self.circles:
            for name, size_m, middle in zip(
                ("length_m", "width_m"), (self.length_m, self.width_m), circle.center, strict=True
            ):
                needed_m = 2.0 * (abs(middle) + circle.radius_m)
                if needed_m > size_m + 2.0 * self.marking_width_m:
                    raise ValueError(f"{name} is {size_m:g}, but circle {circle.name!r} needs {needed_m:g} m")

    def _require_halfway_through_circle(self) -> None:
        centers = {c.name: c.center for c in self.round_ones}
        if self.halfway_line is None or self.default_circle not in centers:
            return
        line = next(line for line in self.lines if line.name == self.halfway_line)
        along, toward = np.subtract(line.end, line.start), np.subtract(centers[self.default_circle], line.start)
        away_m = abs(along[0] * toward[1] - along[1] * toward[0]) / np.linalg.norm(along)
        if away_m > self.marking_width_m:
            middle = f"the middle of {self.default_circle!r}"
            raise ValueError(f"halfway_line {self.halfway_line!r} runs {away_m:.2g} m beside {middle}")

    @property
    def sport_name(self) -> str:
        """The sport; a template that names none is one of its own."""
        return self.sport or self.name

    @property
    def extents(self) -> tuple[Extent, Extent]:
        """Length and width, with what the rules allow."""
        return Extent(self.length_m, self.length_range_m), Extent(self.width_m, self.width_range_m)

    def move_markings(
        self, shift_of: Callable[[str], tuple[float, float]], growth_of: Callable[[float], float] = lambda _: 0.0
    ) -> FieldTemplate:
        """This field with each marking elsewhere, by so many metres along x and along y as its name says, and with
        circles and arcs whose radii are larger by so many metres as their radius says.
        """

        def move(element: Any, *keys: str) -> Any:
            dx, dy = shift_of(element.name)
            places = {key: getattr(element, key) for key in keys}
            return element.model_copy(update={key: (x + dx, y + dy) for key, (x, y) in places.items()})

        def redraw(circle: Any) -> Any:
            return move(circle, "center").model_copy(update={"radius_m": circle.radius_m + growth_of(circle.radius_m)})

        elsewhere = {
            "circles": tuple(redraw(circle) for circle in self.circles),
            "arcs": tuple(redraw(arc) for arc in self.arcs),
            "lines": tuple(move(line, "start", "end") for line in self.lines),
            "marks": tuple(move(mark, "position") for mark in self.marks),
        }
        return self.model_copy(update=elsewhere)

    def __copy__(self) -> FieldTemplate:
        """The template without what was derived from it, which need not hold for a copy that is changed."""
        copied = super().__copy__()
        for name in copied.__dict__.keys() - type(self).model_fields.keys():
            del copied.__dict__[name]
        return copied

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, FieldTemplate):
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in type(self).model_fields)

    @property
    def round_ones(self) -> tuple[Circle, ...]:
        """Full circles, then arcs."""
        return (*self.circles, *self.arcs)

    @property
    def elements(self) -> tuple[Circle | Line | Mark, ...]:
        """All markings: circles, arcs, lines, marks."""
        return (*self.round_ones, *self.lines, *self.marks)

    @cached_property
    def names(self) -> frozenset[str]:
        """Names of all markings."""
        return frozenset(element.name for element in self.elements)

    @cached_property
    def circle_by_name(self) -> dict[str, Circle]:
        """Full circles and arcs by name."""
        return {c.name: c for c in self.round_ones}

    @cached_property
    def line_by_name(self) -> dict[str, Line]:
        """Straight markings by name."""
        return {line.name: line for line in self.lines}

    @cached_property
    def mark_by_name(self) -> dict[str, Mark]:
        """Spots by name."""
        return {mark.name: mark for mark in self.marks}

    @cached_property
    def lone_marks(self) -> tuple[Mark, ...]:
        """Spots that no other marking runs through or near, by their own diameter."""
        drawn = self.outlines[1].reshape(-1, 2)
        return tuple(
            mark
            for mark in self.marks
            if np.linalg.norm(drawn - mark.position, axis=1).min(initial=np.inf) > 1.5 * mark.diameter_m
        )

    @cached_property
    def border(self) -> frozenset[str]:
        """Names of the markings that lie on the field's border all along: touchlines and goal lines."""
        border_m = 0.5 * np.array([self.length_m, self.width_m]) - self.marking_width_m
        names, nodes, _ = self.outlines
        on_border = np.asarray(np.any(np.all(np.abs(nodes) >= border_m, axis=1), axis=1), np.bool_)
        return frozenset(name for name, is_on in zip(names, on_border.tolist(), strict=True) if is_on)

    @cached_property
    def is_in_one_paint(self) -> bool:
        """Whether all markings have one colour, so that what is painted in another is none of them."""
        return len({e.color for e in self.elements}) <= 1

    def paint_width(self, element: _Element, marking_width_m: float | None = None) -> float:
        """Width of an element's paint in metres: its own one, or the given one or the template's."""
        usual = self.marking_width_m if marking_width_m is None else marking_width_m
        return usual if element.width_m is None else element.width_m

    def radius(self, circle: Circle, edge: Edge, marking_width_m: float | None = None) -> float:
        """Radius in metres of the outer or inner edge or of the centreline (``"center"``) of a circle's paint; the rim
        of a disc is all of them.
        """
        if circle.fill == "disc":
            return circle.radius_m
        width = self.paint_width(circle, marking_width_m)
        position = {"outer": 0.5, "center": 0.0, "inner": -0.5}
        return circle.radius_m + (position[edge] - position[circle.edge]) * width

    def line_ends(self, line: Line, marking_width_m: float | None = None) -> Array:
        """Ends (2, 2) of the centreline of a straight marking, metres, not to be written to."""
        return self.line_places[line.name][0] if marking_width_m is None else self._draw_line(line, marking_width_m)

    def line_shift(self, line: Line) -> Array:
        """How the centreline of a straight marking moves (3, 2), not to be written to: metres per metre of marking
        width, of length and of width of the field.

        Markings parallel to the halfway line go with the length, the touchlines with the width; sizes inside the
        penalty areas are fixed.
        """
        return self.line_places[line.name][1]

    @cached_property
    def line_places(self) -> dict[str, tuple[Array, Array]]:
        """Ends (2, 2) and shift (3, 2) of each straight marking by its name, as of :meth:`line_ends` and
        :meth:`line_shift`.
        """
        return {line.name: (freeze(self._draw_line(line)), freeze(self._shift_line(line))) for line in self.lines}

    def _draw_line(self, line: Line, marking_width_m: float | None = None) -> Array:
        shift = np.asarray(line.paint, dtype=np.float64) * self.paint_width(line, marking_width_m) / 2
        return np.array([line.start, line.end], dtype=np.float64) + shift

    def _shift_line(self, line: Line) -> Array:
        (x0, y0), (x1, y1) = line.start, line.end
        shift = np.zeros((3, 2))
        if line.width_m is None:
            shift[0] = np.asarray(line.paint, dtype=np.float64) / 2.0
        shift[1, 0] = np.sign(x0 + x1) / 2.0
        if y0 == y1 and abs(abs(y0) - self.width_m / 2) < 1e-6:
            shift[2, 1] = np.sign(y0) / 2.0
            shift[1, 0] = 0.0
        return shift

    def place_shift(self, place_m: Point) -> Array:
        """How the centre of a circle, an arc or a mark moves (3, 2) with the marking width, the length and the width
        of the field, metres per metre, from its place in metres.

        What belongs to one end goes with it, a corner with both sides; radii are fixed.
        """
        shift = np.zeros((3, 2))
        x, y = place_m
        if abs(x) > AT_MIDDLE_M:
            shift[1, 0] = np.sign(x) / 2.0
        if abs(abs(y) - self.width_m / 2) < AT_MIDDLE_M:
            shift[2, 1] = np.sign(y) / 2.0
        return shift

    def center_after_growth(self, circle: Circle, growth_m: Array) -> Array:
        """Centre (..., 2) of a circle or an arc on fields that are longer and broader by (..., 2), metres."""
        return np.asarray(circle.center + growth_m @ self.place_shift(circle.center)[1:])

    @cached_property
    def drawn_lines(self) -> tuple[Array, Array]:
        """Ends (T, 2, 2) and shifts (T, 3, 2) of all straight markings, as of :meth:`line_ends` and
        :meth:`line_shift`.
        """
        ends, shifts = zip(*self.line_places.values(), strict=True) if self.lines else ((), ())
        return freeze(np.array(ends).reshape(-1, 2, 2)), freeze(np.array(shifts).reshape(-1, 3, 2))

    @cached_property
    def outlines(self) -> tuple[tuple[str, ...], Array, Array]:
        """Names of all circles, arcs and lines, :data:`NODES` points along the centreline of each (K, N, 2), and shifts
        (K, 3, 2) as of :meth:`line_shift` and :meth:`place_shift`.
        """
        share = np.linspace(0.0, 1.0, NODES)
        curves = [
            self.curve_points(circle, "center", np.radians(first + share * (last - first)))
            for circle in self.round_ones
            for first, last in (circle.span_deg,)
        ]
        drawn, shifts = self.drawn_lines
        straight = drawn[:, :1] + share[:, None] * (drawn[:, 1:] - drawn[:, :1])
        names = tuple(element.name for element in (*self.round_ones, *self.lines))
        round_shifts = np.array([self.place_shift(circle.center) for circle in self.round_ones]).reshape(-1, 3, 2)
        points = np.concatenate([np.array(curves).reshape(-1, NODES, 2), straight])
        return names, freeze(points), freeze(np.concatenate([round_shifts, shifts]))

    def growth_of(self, marking_m: Array) -> tuple[Array, Array]:
        """How markings (..., N, 2) go with the length and the width of the field, which change their points along x and
        y: metres per metre by which each moves (..., 2), and by which each metre of its coordinates stretches (..., 2).

        What bounds the field, or reaches from side to side, stretches; what belongs to one end moves with it.
        """
        size = np.array([self.length_m, self.width_m])
        low, high = marking_m.min(axis=-2), marking_m.max(axis=-2)
        reaches = np.maximum(-low, high) >= size / 2 - self.marking_width_m
        is_beside = low * high > 0
        moves = np.where(is_beside & (reaches | (True, False)), np.sign(low) / 2.0, 0.0)
        return moves, np.where(reaches & ~is_beside, 1.0 / size, 0.0)

    def line_coordinates(self, line: Line) -> Array:
        """Homogeneous line (3,) of the centreline, ``a^2 + b^2 = 1``."""
        (x0, y0), (x1, y1) = self.line_ends(line)
        normal = np.array([y0 - y1, x1 - x0]) / np.hypot(x1 - x0, y1 - y0)
        return np.array([normal[0], normal[1], -normal @ (x0, y0)])

    def meet_lines(self, first: str, second: str) -> Array | None:
        """Where two straight markings meet, drawn on: (2,) metres; None where the field has not both of these names, or
        they are parallel.
        """
        if first not in self.line_by_name or second not in self.line_by_name:
            return None
        crossing = meet(*(self.line_coordinates(self.line_by_name[name]) for name in (first, second)))
        return None if abs(crossing[2]) < 1e-9 else np.asarray(crossing[:2] / crossing[2])

    @cached_property
    def line_rows(self) -> Array:
        """All straight markings as homogeneous lines (T, 3), as of :meth:`line_coordinates`."""
        return freeze(np.array([self.line_coordinates(line) for line in self.lines]).reshape(-1, 3))

    def polylines(self, step_m: float = 0.25) -> dict[str, Array]:
        """Centrelines of every element as polylines ``{name: (N, 2)}``, for drawing."""
        drawn = {circle.name: self._round_polyline(circle, step_m) for circle in self.round_ones}
        for line in self.lines:
            ends = self.line_ends(line)
            count = max(2, int(np.ceil(np.linalg.norm(ends[1] - ends[0]) / step_m)) + 1)
            drawn[line.name] = np.linspace(ends[0], ends[1], count)
        return drawn

    def curve_points(self, circle: Circle, edge: Edge, angle_rad: Array) -> Array:
        """Points (..., 2), metres, of one edge or the middle of a circle's paint at angles (...,) from the x axis."""
        return np.asarray(np.asarray(circle.center) + self.radius(circle, edge) * unit_circle(angle_rad))

    def _round_polyline(self, circle: Circle, step_m: float) -> Array:
        start, end = circle.span_deg
        count = max(8, int(np.ceil(np.radians(end - start) * self.radius(circle, "center") / step_m)) + 1)
        return self.curve_points(circle, "center", np.radians(np.linspace(start, end, count)))

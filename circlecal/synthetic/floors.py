"""Paint that is no marking of the field in view: other sports on the same ground, and what templates leave out."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from circlecal.field import Arc, Circle, FieldTemplate, Line, Mark
from circlecal.synthetic.scene import Color, ExtraPaint

Element = Circle | Line | Mark
Point = tuple[float, float]

WHITE: Color = (225, 230, 230)
YELLOW: Color = (50, 200, 225)
RED: Color = (45, 40, 180)
BLUE: Color = (170, 80, 35)
BLACK: Color = (35, 32, 30)
GREEN: Color = (70, 130, 50)
_INKS: tuple[Color, ...] = (WHITE, YELLOW, RED, BLUE, BLACK, GREEN)


def line(start: Point, end: Point) -> Line:
    """A line that no template names."""
    return Line(name="line", start=start, end=end)


def rectangle(x0: float, y0: float, x1: float, y1: float) -> tuple[Line, ...]:
    """The four sides of a rectangle between two corners."""
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    return tuple(line(corners[k], corners[(k + 1) % 4]) for k in range(4))


def circle(x: float, y: float, radius_m: float) -> Circle:
    """A full circle."""
    return Circle(name="circle", center=(x, y), radius_m=radius_m)


def arc(x: float, y: float, radius_m: float, start_deg: float, end_deg: float) -> Arc:
    """Part of a circle, from x towards y."""
    return Arc(name="arc", center=(x, y), radius_m=radius_m, start_deg=start_deg, end_deg=end_deg)


def spot(x: float, y: float, diameter_m: float) -> Mark:
    """A filled spot."""
    return Mark(name="spot", position=(x, y), diameter_m=diameter_m)


def dashes(start: Point, end: Point, dash_m: float, gap_m: float) -> tuple[Line, ...]:
    """A broken line."""
    a, b = np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)
    length = float(np.linalg.norm(b - a))
    offsets = np.arange(0.0, length, dash_m + gap_m)
    ends = np.minimum(offsets + dash_m, length)
    points = a + np.stack([offsets, ends])[..., None] / length * (b - a)
    return tuple(line((float(p[0]), float(p[1])), (float(q[0]), float(q[1]))) for p, q in zip(*points, strict=True))


def both_ends(elements: Iterable[Element]) -> tuple[Element, ...]:
    """Elements of the right half and the same turned onto the left half."""
    return tuple(e for element in elements for e in (element, _turn(element)))


def _turn(element: Element) -> Element:
    if isinstance(element, Line):
        return line((-element.start[0], -element.start[1]), (-element.end[0], -element.end[1]))
    if isinstance(element, Mark):
        return spot(-element.position[0], -element.position[1], element.diameter_m)
    x, y = -element.center[0], -element.center[1]
    if isinstance(element, Arc):
        return arc(x, y, element.radius_m, element.start_deg + 180.0, element.end_deg + 180.0)
    return circle(x, y, element.radius_m)


def rugby_lines(length_m: float, width_m: float) -> tuple[Element, ...]:
    """Rugby: goal lines, 22 m, broken 10 m and 5 m lines, halfway line; no circle."""
    half, side = length_m / 2, width_m / 2
    right: tuple[Element, ...] = (
        line((half, -side), (half, side)),
        line((half - 22.0, -side), (half - 22.0, side)),
        *dashes((10.0, -side), (10.0, side), 5.0, 5.0),
        *dashes((half - 5.0, -side), (half - 5.0, side), 3.0, 8.0),
        *dashes((0.0, side - 5.0), (half, side - 5.0), 3.0, 10.0),
        *dashes((0.0, side - 15.0), (half, side - 15.0), 3.0, 10.0),
    )
    outline = (line((-half, -side), (half, -side)), line((-half, side), (half, side)), line((0, -side), (0, side)))
    return (*outline, *both_ends(right))


def hockey_lines(length_m: float = 91.4, width_m: float = 55.0) -> tuple[Element, ...]:
    """Field hockey: outline, centre line, 22.9 m lines, shooting circles of 14.63 m about the goal posts."""
    half, side = length_m / 2, width_m / 2
    right: tuple[Element, ...] = (
        line((half - 22.9, -side), (half - 22.9, side)),
        arc(half, -1.83, 14.63, 180.0, 270.0),
        arc(half, 1.83, 14.63, 90.0, 180.0),
        line((half - 14.63, -1.83), (half - 14.63, 1.83)),
        spot(half - 6.4, 0.0, 0.15),
    )
    return (*rectangle(-half, -side, half, side), line((0.0, -side), (0.0, side)), *both_ends(right))


def basketball_lines(*, center: bool = True) -> tuple[Element, ...]:
    """Basketball: 28 x 15 m, lane, free-throw semicircle, three-point line."""
    three = float(np.degrees(np.arccos(6.6 / 6.75)))
    right: tuple[Element, ...] = (
        line((14.0, -2.45), (8.2, -2.45)),
        line((14.0, 2.45), (8.2, 2.45)),
        line((8.2, -2.45), (8.2, 2.45)),
        arc(8.2, 0.0, 1.8, 90.0, 270.0),
        arc(12.425, 0.0, 6.75, 90.0 + three, 270.0 - three),
        line((14.0, -6.6), (12.425 - 6.75 * float(np.sin(np.radians(three))), -6.6)),
        line((14.0, 6.6), (12.425 - 6.75 * float(np.sin(np.radians(three))), 6.6)),
        arc(12.425, 0.0, 1.25, 90.0, 270.0),
    )
    middle = (line((0.0, -7.5), (0.0, 7.5)), circle(0.0, 0.0, 1.8)) if center else ()
    return (*rectangle(-14.0, -7.5, 14.0, 7.5), *middle, *both_ends(right))


def handball_lines(*, halfway: bool = True) -> tuple[Element, ...]:
    """Handball: 40 x 20 m, goal area of 6 m, broken line of 9 m."""
    broken = tuple(arc(20.0, sign * 1.5, 9.0, a, a + 4.0) for sign in (-1.0, 1.0) for a in _dash_angles(sign))
    right: tuple[Element, ...] = (
        arc(20.0, -1.5, 6.0, 180.0, 270.0),
        arc(20.0, 1.5, 6.0, 90.0, 180.0),
        line((14.0, -1.5), (14.0, 1.5)),
        *broken,
        *dashes((11.0, -1.5), (11.0, 1.5), 0.5, 0.5),
        line((13.0, -0.5), (13.0, 0.5)),
        line((16.0, -0.08), (16.0, 0.08)),
    )
    middle = (line((0.0, -10.0), (0.0, 10.0)),) if halfway else ()
    return (*rectangle(-20.0, -10.0, 20.0, 10.0), *middle, *both_ends(right))


def _dash_angles(sign: float) -> list[float]:
    """Starts in degrees of the dashes of a quarter circle of 9 m inside the touchlines."""
    reach = float(np.degrees(np.arcsin(8.5 / 9.0)))
    angles = np.arange(180.0 - reach, 178.0, 7.0) if sign > 0 else np.arange(180.0, 178.0 + reach, 7.0)
    return [float(a) for a in angles]


def volleyball_lines() -> tuple[Element, ...]:
    """Volleyball: 18 x 9 m."""
    return (
        *rectangle(-9.0, -4.5, 9.0, 4.5),
        *(line((x, -4.5), (x, 4.5)) for x in (-3.0, 0.0, 3.0)),
    )


def tennis_lines() -> tuple[Element, ...]:
    """Tennis: 23.77 x 10.97 m."""
    x, doubles, singles, service = 11.885, 5.485, 4.115, 6.40
    return (
        *rectangle(-x, -doubles, x, doubles),
        *(line((-x, y), (x, y)) for y in (-singles, singles)),
        *(line((s, -singles), (s, singles)) for s in (-service, service)),
        line((-service, 0.0), (service, 0.0)),
    )


def rugby_paint(template: FieldTemplate, rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    """Rugby lines, mostly yellow, on a soccer field."""
    ink = YELLOW if rng.random() < 0.7 else (BLUE, RED, WHITE)[rng.integers(3)]
    lines = rugby_lines(template.length_m - float(rng.uniform(0, 8)), template.width_m - float(rng.uniform(0, 6)))
    return (ExtraPaint(lines, float(rng.uniform(0.06, 0.1)), ink, float(rng.uniform(0.5, 0.85))),)


def second_sport_paint(template: FieldTemplate, rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    """The lines of rugby or field hockey on a soccer field, in a colour of their own."""
    ink = (YELLOW, YELLOW, BLUE, RED)[rng.integers(4)]
    length, width = template.length_m - float(rng.uniform(0, 8)), template.width_m - float(rng.uniform(0, 6))
    lines = rugby_lines(length, width) if rng.random() < 0.5 else hockey_lines(min(length, 91.4), min(width, 55.0))
    return (ExtraPaint(lines, float(rng.uniform(0.06, 0.1)), ink, float(rng.uniform(0.5, 0.85))),)


def old_circle_paint(template: FieldTemplate, rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    """What is left of a circle that was painted anew, some decimetres beside its old place."""
    middle = template.circle_by_name[template.default_circle]
    x, y = np.asarray(middle.center) + rng.normal(0.0, 0.15, 2)
    radius = middle.radius_m + float(rng.normal(0.0, 0.08))
    old = circle(float(x), float(y), radius)
    return (ExtraPaint((old,), template.marking_width_m, WHITE, float(rng.uniform(0.08, 0.3))),)


def hall_paint(template: FieldTemplate, rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    """Lines of one to three other sports on the floor of a hall, each sport in its colour."""
    sports = (basketball_lines(center=bool(rng.random() < 0.4)), handball_lines(halfway=False), volleyball_lines())
    chosen = rng.permutation(len(sports))[: rng.integers(0, 4)]
    inks = rng.permutation(len(_INKS))
    return tuple(
        ExtraPaint(sports[sport], 0.05, _INKS[inks[k]], float(rng.uniform(0.6, 0.95))) for k, sport in enumerate(chosen)
    )


def rink_paint(template: FieldTemplate, rng: np.random.Generator) -> tuple[ExtraPaint, ...]:
    """Hash marks, brackets, creases and the referee's semicircle of a hockey rink, whose template has the spots."""
    end = template.length_m / 2 - 10.0
    side = template.width_m / 2
    hashes = [
        line((end + dx, y + sign * 4.5), (end + dx, y + sign * 5.1))
        for y in (-7.0, 7.0)
        for sign in (-1.0, 1.0)
        for dx in (-0.85, 0.85)
    ]
    brackets = [
        line((end + sx * 0.6, y + sy * 0.45), (end + sx * 1.8, y + sy * 0.45))
        for y in (-7.0, 7.0)
        for sx in (-1.0, 1.0)
        for sy in (-1.0, 1.0)
    ]
    crease = [arc(template.length_m / 2 - 4.0, 0.0, 1.8, 90.0, 270.0)]
    referee = (arc(0.0, side, 3.0, 180.0, 360.0),)
    return (ExtraPaint((*both_ends([*hashes, *brackets, *crease]), *referee), 0.05, RED, 0.75),)

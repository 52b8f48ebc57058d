"""A picture to draw on: sub-pixel lines and points, labels that keep apart, sizes that follow the picture's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, normalise_line
from circlecal.overlay.palette import BLACK, Color

Picture = NDArray[np.uint8]

_SHIFT = 4
_FONT = cv2.FONT_HERSHEY_SIMPLEX
_CAP_HEIGHT = 21.5
"""Height of a capital letter of the font at scale 1, pixels."""
_DIRECTIONS = np.array([[1, 0], [1, -1], [0, -1], [-1, -1], [-1, 0], [-1, 1], [0, 1], [1, 1]], dtype=np.float64)


def clip_segments(starts: Array, ends: Array, low: Array, high: Array) -> Array:
    """Parts (K, 2, 2) of segments (N, 2) to (N, 2) inside a box (Liang and Barsky 1984); nan drops a segment."""
    finite = np.isfinite(starts).all(axis=1) & np.isfinite(ends).all(axis=1)
    starts, ends = starts[finite], ends[finite]
    direction = ends - starts
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.stack([(low - starts) / direction, (high - starts) / direction])
    inside = (starts >= low) & (starts <= high)
    parallel = direction == 0
    enter = np.where(parallel, np.where(inside, -np.inf, np.inf), np.min(crossings, axis=0))
    leave = np.where(parallel, np.where(inside, np.inf, -np.inf), np.max(crossings, axis=0))
    first, last = np.maximum(enter.max(axis=1), 0.0), np.minimum(leave.min(axis=1), 1.0)
    kept = first <= last
    starts, direction = starts[kept], direction[kept]
    return np.stack([starts + t[kept, None] * direction for t in (first, last)], axis=1)


def text_size(text: str, height: float) -> tuple[int, int]:
    """Width and height of a line of text with capitals of ``height`` pixels."""
    (width, tall), below = cv2.getTextSize(text, _FONT, height / _CAP_HEIGHT, _weight(height))
    return int(width), int(tall + below)


def wrap(text: str, height: float, width: float) -> list[str]:
    """Break a text into lines no wider than ``width`` pixels, at spaces where there are any."""
    lines: list[str] = []
    for word in printable(text).split(" "):
        longer = f"{lines[-1]} {word}" if lines else word
        if lines and text_size(longer, height)[0] <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return lines


def printable(text: str) -> str:
    """The text on one line, with a question mark for what the font does not have."""
    return " ".join(text.split()).encode("ascii", "replace").decode("ascii")


def _weight(height: float) -> int:
    return max(1, round(height / 11.0))


def filter_legend(legend: Iterable[tuple[str, Color, bool]]) -> list[tuple[str, Color]]:
    """Words and colours of a legend, without those of which the picture, as each entry says, shows nothing."""
    return [(words, color) for words, color, is_shown in legend if is_shown]


@dataclass(slots=True)
class Canvas:
    """A copy of a frame, enlarged ``zoom`` times, that takes drawings in the frame's own pixels.

    Attributes
    ----------
    picture : (H * zoom, W * zoom, 3) uint8
        What is drawn on.
    zoom : int
        Enlargement.
    taken : list of (4,) tuples
        Boxes of the labels so far (left, top, right, bottom), drawn pixels.
    """

    picture: Picture
    zoom: int = 1
    taken: list[tuple[float, float, float, float]] = field(default_factory=list)

    @staticmethod
    def of(image: Picture, brightness: float = 1.0, zoom: int = 1) -> Canvas:
        """Canvas with a dimmed, grey (below full brightness) and enlarged copy of a frame."""
        picture = np.ascontiguousarray(image).copy()
        if brightness < 1.0:
            grey = cv2.cvtColor(cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
            picture = np.asarray(cv2.addWeighted(grey, 0.6 * brightness, picture, 0.4 * brightness, 0.0), np.uint8)
        if zoom > 1:
            picture = np.asarray(cv2.resize(picture, None, fx=zoom, fy=zoom, interpolation=cv2.INTER_CUBIC), np.uint8)
        return Canvas(picture, zoom)

    @property
    def width(self) -> int:
        """Width of the drawn picture."""
        return int(self.picture.shape[1])

    @property
    def height(self) -> int:
        """Height of the drawn picture."""
        return int(self.picture.shape[0])

    @property
    def unit(self) -> float:
        """Size of the drawn picture relative to 1920 x 1080."""
        return float(np.sqrt(self.width * self.height / (1920.0 * 1080.0)))

    @property
    def text_px(self) -> float:
        """Height of capitals, pixels."""
        return max(11.0, 22.0 * self.unit)

    def thickness(self, width: float) -> int:
        """Whole pixels for a line that is ``width`` pixels wide at 1920 x 1080."""
        return max(1, round(width * self.unit))

    def place(self, points: ArrayLike) -> Array:
        """Drawn pixels (..., 2) of frame pixels (..., 2)."""
        return (np.asarray(points, dtype=np.float64) + 0.5) * self.zoom - 0.5

    def segments(
        self, starts: ArrayLike, ends: ArrayLike, color: Color, width: float = 1.5, halo: bool = False
    ) -> None:
        """Draw segments between points (N, 2) and (N, 2) of the frame."""
        a, b = (self.place(p).reshape(-1, 2) for p in (starts, ends))
        margin = 4.0 + 4.0 * self.thickness(width)
        clipped = clip_segments(a, b, np.full(2, -margin), np.array([self.width + margin, self.height + margin]))
        whole = list(np.round(clipped * (1 << _SHIFT)).astype(np.int32))
        if whole and halo:
            cv2.polylines(
                self.picture, whole, False, BLACK, self.thickness(width) + self.thickness(2.0), cv2.LINE_AA, _SHIFT
            )
        if whole:
            cv2.polylines(self.picture, whole, False, color, self.thickness(width), cv2.LINE_AA, _SHIFT)

    def polyline(
        self, points: ArrayLike, color: Color, width: float = 1.5, halo: bool = False, dashed: bool = False
    ) -> None:
        """Draw a polyline (N, 2) of the frame, interrupted where points are nan; every other piece where dashed."""
        p = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        step = 2 if dashed else 1
        self.segments(p[:-1][::step], p[1:][::step], color, width, halo)

    def conic(self, conic: Array, color: Color, width: float = 1.5, dashed: bool = False) -> None:
        """Draw an ellipse; other conics are left out."""
        ellipse = ellipse_from_conic(conic) if np.isfinite(conic).all() else None
        if ellipse is not None:
            self.polyline(ellipse.points(np.linspace(0.0, 2 * np.pi, 361)), color, width, dashed=dashed)

    def line(self, line: ArrayLike, color: Color, width: float = 1.5, halo: bool = False, dashed: bool = False) -> None:
        """Draw a homogeneous line (3,) across the frame."""
        coefficients = np.asarray(line, dtype=np.float64)
        if not np.isfinite(coefficients).all() or not coefficients[:2].any():
            return
        a, b, c = normalise_line(coefficients)
        reach = float(self.width + self.height)
        middle = np.array([self.width, self.height]) / (2.0 * self.zoom)
        foot = middle - (a * middle[0] + b * middle[1] + c) * np.array([a, b])
        if np.abs(foot - middle).max() > reach:
            return
        t = np.linspace(-reach, reach, 201 if dashed else 2)
        self.polyline(foot + t[:, None] * np.array([b, -a]), color, width, halo, dashed)

    def points(self, points: ArrayLike, color: Color, diameter: float = 4.0) -> None:
        """Draw discs at points (N, 2) of the frame."""
        p = np.asarray(points, dtype=np.float64).reshape(-1, 2)
        self.segments(p, p, color, diameter)

    def disc(self, point: ArrayLike, color: Color, diameter: float = 9.0) -> None:
        """Draw one disc with a dark rim."""
        self.points(point, BLACK, diameter + 4.0)
        self.points(point, color, diameter)

    def circle(self, center: ArrayLike, radius: float, color: Color, width: float = 1.5) -> None:
        """Draw a circle of ``radius`` frame pixels."""
        t = np.linspace(0.0, 2 * np.pi, 73)
        self.polyline(np.asarray(center) + radius * np.stack([np.cos(t), np.sin(t)], axis=-1), color, width, halo=True)

    def cross(self, point: ArrayLike, color: Color, size: float = 22.0, width: float = 2.0) -> None:
        """Draw an upright cross of ``size`` pixels (at 1920 x 1080) with its middle left open."""
        p = np.asarray(point, dtype=np.float64)
        arms = (
            np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
            * max(size * self.unit, 7.0)
            / (2.0 * self.zoom)
        )
        self.segments(p + 0.3 * arms, p + arms, color, width, halo=True)

    def text(
        self, text: str, left: float, top: float, color: Color, height: float | None = None, halo: bool = True
    ) -> float:
        """Write a line of text with its top left corner at drawn pixels; return its width."""
        size = self.text_px if height is None else height
        line, scale = printable(text), size / _CAP_HEIGHT
        origin = (round(left), round(top + size))
        # a thicker weight is wider in some versions of OpenCV, so the halo is the same text moved about
        for dx, dy in np.round(_DIRECTIONS * max(1.0, size / 12.0)).astype(int) if halo else ():
            cv2.putText(
                self.picture, line, (origin[0] + dx, origin[1] + dy), _FONT, scale, BLACK, _weight(size), cv2.LINE_AA
            )
        cv2.putText(self.picture, line, origin, _FONT, scale, color, _weight(size), cv2.LINE_AA)
        return float(text_size(line, size)[0])

    def label(
        self, text: str, point: ArrayLike, color: Color, toward: ArrayLike | None = None, size: float = 0.8
    ) -> None:
        """Write beside a point of the frame where no other label stands, first in the direction ``toward`` (2,).

        A point outside the picture gets no label; a label that had to move far is tied to its point.
        """
        anchor = self.place(point).reshape(2)
        if not np.isfinite(anchor).all() or not self._is_inside(anchor):
            return
        height = max(8.0, size * self.text_px)
        width, tall = text_size(printable(text), height)
        first = np.array([1.0, -1.0]) if toward is None else np.asarray(toward, dtype=np.float64)
        first = first if np.isfinite(first).all() else np.array([1.0, -1.0])
        order = _DIRECTIONS[np.argsort(-_DIRECTIONS @ first / np.linalg.norm(_DIRECTIONS, axis=1), kind="stable")]
        for distance in (0.9, 1.8, 3.0, 4.5, 6.5):
            for direction in order:
                middle = anchor + direction * (distance * height + np.array([width / 2.0, tall / 2.0]))
                box = (middle[0] - width / 2, middle[1] - tall / 2, middle[0] + width / 2, middle[1] + tall / 2)
                if self._is_free(box):
                    self._write_label(text, anchor, box, color, height, tied=distance > 1.0)
                    return

    def _write_label(
        self, text: str, anchor: Array, box: tuple[float, float, float, float], color: Color, height: float, tied: bool
    ) -> None:
        if tied:
            nearest = np.clip(anchor, box[:2], box[2:])
            ends = (np.stack([anchor, nearest]) + 0.5) / self.zoom - 0.5
            self.polyline(ends, color, 1.0, halo=True)
        self.text(text, box[0], box[1], color, height)
        self.taken.append(box)

    def _is_inside(self, drawn: Array) -> bool:
        return bool((drawn >= 0).all() and drawn[0] < self.width and drawn[1] < self.height)

    def _is_free(self, box: tuple[float, float, float, float]) -> bool:
        left, top, right, bottom = box
        if left < 2 or top < 2 or right > self.width - 2 or bottom > self.height - 2:
            return False
        return not any(left < r and right > x and top < b and bottom > y for x, y, r, b in self.taken)

    def shade(
        self, left: float, top: float, right: float, bottom: float, color: Color = BLACK, share: float = 0.7
    ) -> None:
        """Blend a box (drawn pixels) towards a colour and keep labels out of it."""
        x0, y0 = max(0, round(left)), max(0, round(top))
        x1, y1 = min(self.width, round(right)), min(self.height, round(bottom))
        if x1 <= x0 or y1 <= y0:
            return
        part = self.picture[y0:y1, x0:x1]
        self.picture[y0:y1, x0:x1] = np.round((1.0 - share) * part + share * np.asarray(color)).astype(np.uint8)
        self.taken.append((left, top, right, bottom))

    def header(self, title: str, facts: Sequence[str] = (), legend: Sequence[tuple[str, Color]] = ()) -> Picture:
        """The drawing with a strip above it: a title, facts and a legend of colours."""
        return np.ascontiguousarray(np.vstack([self._strip(title, facts, legend), self.picture]))

    def footer(self, facts: Sequence[str] = (), legend: Sequence[tuple[str, Color]] = ()) -> Picture:
        """The drawing with a strip below it: facts and a legend of colours."""
        return np.ascontiguousarray(np.vstack([self.picture, self._strip("", facts, legend)]))

    def _strip(self, title: str, facts: Sequence[str], legend: Sequence[tuple[str, Color]]) -> Picture:
        size, gap = self.text_px, 0.75 * self.text_px
        width = self.width - 2 * gap
        heads = wrap(title, size, width) if title else []
        lines = heads + [line for fact in facts for line in wrap(fact, 0.8 * size, width)]
        rows = self._legend_rows(legend, width)
        strip = Canvas(
            np.full((round((len(lines) + len(rows)) * 1.75 * size + 1.2 * size), self.width, 3), 24, np.uint8)
        )
        top = gap
        for number, line in enumerate(lines):
            first = number < len(heads)
            strip.text(
                line, gap, top, (255, 255, 255) if first else (200, 200, 200), size if first else 0.8 * size, halo=False
            )
            top += 1.75 * size
        for row in rows:
            left = gap
            for text, color in row:
                cv2.rectangle(
                    strip.picture, (round(left), round(top)), (round(left + size), round(top + 0.8 * size)), color, -1
                )
                left += 1.4 * size
                left += strip.text(text, left, top, (200, 200, 200), 0.8 * size, halo=False) + 1.4 * size
            top += 1.75 * size
        return strip.picture

    def _legend_rows(self, legend: Sequence[tuple[str, Color]], width: float) -> list[list[tuple[str, Color]]]:
        rows: list[list[tuple[str, Color]]] = []
        used = width + 1.0
        for text, color in legend:
            need = 2.8 * self.text_px + text_size(printable(text), 0.8 * self.text_px)[0]
            if used + need > width:
                rows.append([])
                used = 0.0
            rows[-1].append((text, color))
            used += need
        return rows

"""Bands of graphics that a broadcaster lays over the picture: level boxes whose edges run along one row of pixels.

Their edges are the straightest and strongest lines of the picture, and cross the field where nothing is painted. What
is seen of the field ends at them as it does at the picture's border.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.projective import Array, Indices, Mask

__all__ = ["Band", "cover_bands", "fill_bands", "find_bands", "lie_clear", "lie_under"]

LEAST_STEP = 16
"""Levels by which an edge steps from one row to the next but one, in any colour: a red box may be as light as grass."""
EVERY, JOINED, JOINED_SHARE = 4, 12, 0.9
"""Each so many-th column is looked at, so many of them together, and the share of these that must step alike."""
LEAST_LENGTH, MOST_EDGES = 0.35, 24
"""Picture widths over which an edge runs along one row, where a line on the field is bent by the lens; and how many
edges there may be: a wall of level stripes has no boxes. With these limits, and edges in grey alone, 32 of 40 rendered
pictures under one or two boxes show one, none of 60 others and of 45 real soccer pictures; the caption in a real
picture of a court is found.
"""
HEIGHTS = (0.025, 0.3)
"""Least and largest height of a band, picture heights."""
TRIM = 0.02
"""Largest height of a stripe along a box's upper or lower edge, picture heights."""
OVERLAP = 0.8
"""Share of the shorter edge's columns that lie below or above the other edge."""
PLAIN_LEVELS, PLAIN_SHARE = 14.0, 0.5
"""Share of a band's places within so many gray levels of its median, in each colour: the ground of a box is plain, that
of the field between two level lines is as well, but has the colour of the field outside.
"""
UNLIKE_LEVELS = 18.0
"""Gray levels by which the box, and its rim, must differ from what lies above and below it, in the most different
colour: an olive box on grass in the shade differs by 22.
"""
BASE_ROWS = 4
"""Rows inside an edge from which a box's ground is told where its other edge steps nowhere along a row: on a crowd."""
GROUND_SHARE, BEYOND_SHARE = 0.5, 0.25
"""Least share of a row that has the ground's colour within a box, letters aside, and the largest of the rows beyond its
end: a crowd, or players and paint, have it here and there.
"""
LETTERS, SIDE_COLUMNS = (0.01, 0.4), 3
"""Share of a box's ground, from its edge to the bottom of the picture, that letters take, and columns to both sides of
it that do not have its colour: a track or a run-off beside the field has no letters, and goes on where the lens bends
its edge. Those of twelve rendered frames have 0.04 to 0.13, and end where their edge does.
"""
FIELD_SHARE, FIELD_EVERY = 0.25, 8
"""Share of the rest of the picture, each so many-th row and column, that may have the colour of a box at the most: what
lies between two boxes is field, and goes on beyond them.
"""
BESIDE_SHARE = 0.06
"""Share of the rest of the picture that may have the colour of a box which begins where another one ends: of field
between two boxes 0.10 to 0.19 has, of boxes 0.04 at most (ten rendered frames).
"""
FLAT_LEVELS, FLAT_SHARE = 3.0, 0.82
"""Levels off the usual one, in each colour, below which so much of a box lies that is drawn, not seen: of boxes in
rendered pictures 0.83 to 0.9, letters and the codec's noise beside them being the rest, of strips of field 0.08 to
0.62, of grass in 45 real pictures 0.41 at most. An olive box was left in the picture since 0.08 of the rest had its
colour, a light green one since more had its hue.
"""
BESIDE_HEIGHT = 0.012
"""Least height, picture heights, of what is seen of a box that begins where another one ends: the other may lie over
most of it, or be its own upper part. Two such boxes of 160 rendered pictures show 0.022 and 0.026 of it, without their
rims, and were left in the picture by :data:`HEIGHTS`.
"""
LIGHTER = 1.35
"""Times the usual brightness of the field's hue in a picture, from which on what has that hue is lighter than the field
anywhere: ten strips of field between two boxes are 0.8 to 1.12 times as bright, a light green box 1.7 times.
"""
MOST_GREY, LEAST_ALIKE = 0.97, 0.995
"""Cosine of the angle to grey below which a colour has a hue, and that between colours of the field in the sun and in
the shade: grass has 0.9 and 0.9998, and an olive box 0.98 to it.
"""
STRIP_SHARE = 0.1
"""Share of a box's rows, at the most, most of which has the colour of what lies above or below it: else the field is
seen between two boxes.
"""
SMOOTHED_PX = 121
"""Columns over which the colours are averaged that fill a band's place."""
CLEAR_PX = 8.0
"""Rows beside graphics, at 1920 px width, in which no paint is measured: a profile is about so long to either side."""
RIM_PX, OUTSIDE_PX = 3, 3
"""Rows of a band's rim that compression smears, and rows outside from which its place is filled."""


@dataclass(frozen=True, slots=True)
class Band:
    """A level box over the picture: first and last rows and columns, all within it."""

    top: int
    bottom: int
    left: int
    right: int


def find_bands(image: NDArray[np.uint8]) -> tuple[Band, ...]:
    """Level boxes over a picture (H, W, 3), from top to bottom."""
    height, width = image.shape[:2]
    if height < 64 or width < 4 * EVERY * JOINED:
        return ()
    columns = width // EVERY
    # the pixel that stands for each place is the first one there
    seen = image[:, : EVERY * columns]
    thinned = np.asarray(cv2.resize(seen, (columns, height), interpolation=cv2.INTER_NEAREST), np.uint8)
    gray = np.asarray(cv2.cvtColor(thinned, cv2.COLOR_BGR2GRAY), np.uint8)[:, :, None]
    boxes = _find_boxes(thinned, _find_level_edges(thinned), _find_level_edges(gray))
    widened = (replace(box, left=EVERY * box.left, right=min(EVERY * box.right, width - 1)) for box in boxes)
    return tuple(sorted(widened, key=lambda box: box.top))


def _find_boxes(image: NDArray[np.uint8], edges: list[Band], light_edges: list[Band]) -> list[Band]:
    """Boxes between two edges, and those that are grown from one edge beside them at which the brightness steps: at a
    board on a wall the colour alone does, and it ends about along a row.
    """
    height = len(image)
    found: list[Band] = []
    for k, upper in enumerate(edges):
        # the edge at which a box ends may be the beginning of another one, or this of a strip of field
        taken = found[-1].bottom if found else -1
        if upper.bottom < taken:
            continue
        top = max(_uppermost(edges[:k], upper.top, height), taken + 1)
        lower = (edge for edge in edges[k + 1 :] if _is_opposite(upper, edge, height))
        boxes = (_between(image, top, upper, edge) for edge in lower)
        # the nearest one: further away the field begins again, and ends at the next box
        found += [box for box in boxes if box is not None][:1]
    for edge, below in _list_beginnings(light_edges, found):
        box = _grow(image, edge, below, found)
        if box is not None:
            found.append(replace(box, top=_top_with_stripes(box, edges, found, height)))
    is_field = [_is_field_beside(image, box, found) or _is_strip_of_field(image, box, found) for box in found]
    kept = [box for box, is_none in zip(found, is_field, strict=True) if not is_none]
    # their stripes may have been counted to a strip of field above, as long as that was taken for a box
    return [
        replace(
            box,
            top=min(box.top, _top_with_stripes(box, edges, kept, height)),
            bottom=_bottom_with_stripe(box, edges, kept, height),
        )
        for box in kept
    ]


def _top_with_stripes(box: Band, edges: list[Band], others: list[Band], height: int) -> int:
    """The first row of a box with the narrow stripes along its upper edge, at most up to one of the others."""
    above = [edge for edge in edges if edge.top < box.top]
    taken = (other.bottom + 1 for other in others if other.top < box.top)
    return max([_uppermost(above, box.top, height), *taken])


def _bottom_with_stripe(box: Band, edges: list[Band], others: list[Band], height: int) -> int:
    """The last row of a box with the narrow stripe along its lower edge, which ends where the box does, at most up to
    one of the others: what is narrower than a box of its own without the rims of both.
    """
    most = box.bottom + round(TRIM * height)
    taken = min((other.top for other in others if other.top > box.bottom), default=height)
    for edge in edges:
        is_as_wide = max(abs(edge.left - box.left), abs(edge.right - box.right)) <= JOINED
        if box.bottom < edge.top and edge.bottom <= min(most, taken - 1) and is_as_wide:
            return edge.bottom
    return box.bottom


def _is_strip_of_field(image: NDArray[np.uint8], box: Band, found: list[Band]) -> bool:
    """Whether what was taken for a box runs across the whole picture beside no other box and has the colour, lighter or
    darker, of what lies on one side of it alone: the ground between a level touchline and the boards, in the shade or
    mown otherwise.
    """
    is_whole = box.left <= 0 and box.right >= image.shape[1] - 1
    if not is_whole or _is_beside(box, [other for other in found if other is not box]):
        return False
    usual, columns = _usual_colour(_inside_of(image, box)), slice(box.left, box.right + 1)
    sides = [
        image[first : first + OUTSIDE_PX, columns].astype(np.float32)
        for first in (box.top - RIM_PX - OUTSIDE_PX, box.bottom + RIM_PX + 1)
        if 0 <= first <= len(image) - OUTSIDE_PX
    ]
    # place by place: a crowd of many colours is grey on the average
    return len(sides) == 2 and sum(bool(_are_alike(side, usual).mean() > GROUND_SHARE) for side in sides) == 1


def _has_hue(colour: NDArray[np.float64]) -> bool:
    """Whether a colour (3,) is far enough from grey to be told in the shade."""
    return bool(colour.sum() < MOST_GREY * np.sqrt(3.0) * np.linalg.norm(colour))


def _are_alike(values: NDArray[np.floating], colour: NDArray[np.float64]) -> Mask:
    """Which colours (..., 3) are one colour (3,), lighter or darker."""
    along = values @ (colour / max(float(np.linalg.norm(colour)), 1e-9))  # nothing is like black
    return np.asarray(along > LEAST_ALIKE * np.linalg.norm(values, axis=-1))


def _is_field_beside(image: NDArray[np.uint8], box: Band, found: list[Band]) -> bool:
    """Whether what was taken for a box is the field between a box and a shadow or another box: the field goes on
    elsewhere, in the sun or in the shade.
    """
    if not _is_beside(box, [other for other in found if other is not box]) or _is_flat(image, box):
        return False
    usual, rest = _usual_colour(_inside_of(image, box)), _elsewhere(image, box)
    if _has_colour(rest, usual).mean() > BESIDE_SHARE:
        return True
    if not _has_hue(usual):
        return False
    seen = rest.astype(np.float32)
    alike = _are_alike(seen, usual)
    if alike.mean() <= BESIDE_SHARE:
        return False
    return bool(np.linalg.norm(usual) <= LIGHTER * np.median(np.linalg.norm(seen[alike], axis=-1)))


def _is_flat(image: NDArray[np.uint8], box: Band) -> bool:
    """Whether the ground of a box of a thinned picture has one colour, as nothing has that a lens sees; rows of another
    colour, such as those of a stripe, aside.
    """
    inside = _inside_of(image, box)
    if inside.size == 0:
        return False
    usual = _usual_colour(inside)
    rows = inside[_share_of_rows(_has_colour(inside, usual)) >= GROUND_SHARE]
    return rows.size > 0 and bool(_has_colour(rows, usual, FLAT_LEVELS).mean() >= FLAT_SHARE)


def _between(image: NDArray[np.uint8], top: int, upper: Band, lower: Band) -> Band | None:
    """The box of a thinned picture from row ``top`` to its lower edge; None where it is none.

    It is as wide as its rows go on in its colour, at most as both edges: one may be seen over a part of its length
    only, or go on as that of another thing.
    """
    box = Band(top, lower.bottom, max(upper.left, lower.left), min(upper.right, lower.right))
    if not _is_box(image, box):
        return None
    first, last = min(upper.left, lower.left), max(upper.right, lower.right)
    usual, rows = _usual_colour(_inside_of(image, box)), _inside_of(image, replace(box, left=0, right=image.shape[1]))
    goes_on = _share_of_rows(_has_colour(rows, usual).T) >= GROUND_SHARE
    others = np.flatnonzero(~goes_on)
    left, right = others[others < box.left], others[others > box.right]
    return replace(
        box,
        left=max(first, int(left[-1]) + 1) if len(left) else first,
        right=min(last, int(right[0]) - 1) if len(right) else last,
    )


def _list_beginnings(edges: list[Band], found: list[Band]) -> list[tuple[Band, bool]]:
    """The edges from which other boxes may be grown, and whether below them: those within no box to both sides, and
    then those at which a box ends, away from it.
    """
    lone = [edge for edge in edges if not any(box.top <= edge.top <= box.bottom for box in found)]
    ends = [(edge, below) for box in found for edge in edges for below in (True, False) if _ends_at(box, edge, below)]
    return [*((edge, below) for below in (True, False) for edge in lone), *ends]


def _ends_at(box: Band, edge: Band, below: bool) -> bool:
    """Whether an edge, in grey, is the lower, or the upper, one of a box, whose edges were found in colour."""
    return edge.top - RIM_PX <= (box.bottom if below else box.top) <= edge.bottom + RIM_PX


def _is_beside(box: Band, others: list[Band]) -> bool:
    """Whether a box begins or ends where one of the others does."""
    return any(other.top <= box.bottom + 1 and box.top <= other.bottom + 1 for other in others)


def _grow(image: NDArray[np.uint8], edge: Band, below: bool, others: list[Band]) -> Band | None:
    """The box of a thinned picture below or above a level edge, as far as the rows go on in the colour that they have
    at the edge, at most to another box, or with letters on it to the bottom of the picture; None where that does not
    end along a row, or the colour is back behind a stripe.
    """
    height, stripe = len(image), RIM_PX + round(TRIM * len(image))
    sides = (np.arange(edge.bottom + RIM_PX, height), np.arange(edge.top - RIM_PX, -1, -1))
    rows, outside = sides if below else sides[::-1]
    rows = rows[: round(HEIGHTS[1] * height) + stripe]
    room = _count_free(rows, edge, others)
    if room < BESIDE_HEIGHT * height:
        return None
    columns = slice(edge.left, edge.right + 1)
    ground = np.median(image[rows[:BASE_ROWS], columns], axis=(0, 1))
    is_ground = _has_colour(image[rows, columns], ground)
    own = np.flatnonzero(is_ground[:BASE_ROWS].all(axis=0))
    if len(own) < 2:
        return None
    left, right = edge.left + int(own[0]), edge.left + int(own[-1])
    share = _share_of_rows(is_ground[:, own[0] : own[-1] + 1])
    goes_on = share >= GROUND_SHARE
    reaches_other = room < len(rows) and bool(goes_on[:room].all())
    reaches_border = room == len(rows) and bool(goes_on.all()) and int(rows[-1]) == height - 1
    reaches_end = reaches_other or reaches_border
    first = room if reaches_end else int(np.argmin(goes_on))
    before = _share_of_rows(_has_colour(image[outside[:stripe], left : right + 1], ground))
    beyond = share[first + RIM_PX : first + stripe]
    if not reaches_end and (len(beyond) < RIM_PX or beyond.max() > BEYOND_SHARE):
        return None
    if before.max(initial=0.0) > BEYOND_SHARE:
        return None
    last = int(rows[first - 1])
    box = Band(edge.top, last, left, right) if below else Band(last, edge.bottom, left, right)
    if reaches_border and not _is_ticker(image, box, ground):
        return None
    is_beside = _is_beside(box, others)
    least = BESIDE_HEIGHT if is_beside else HEIGHTS[0]
    most_elsewhere = BESIDE_SHARE if is_beside and not _is_flat(image, box) else FIELD_SHARE
    return box if first >= least * height and _is_box(image, box, most_elsewhere) else None


def _is_ticker(image: NDArray[np.uint8], box: Band, ground: NDArray[np.float64]) -> bool:
    """Whether a box of a thinned picture with a ground's colour (3,) has letters on it, and ends to both sides."""
    rows = slice(box.top + RIM_PX, box.bottom + 1)
    letters = 1.0 - float(_has_colour(image[rows, box.left : box.right + 1], ground).mean())
    left, right = max(box.left - SIDE_COLUMNS, 0), box.right + 1
    beside = np.concatenate([image[rows, left : box.left], image[rows, right : right + SIDE_COLUMNS]], axis=1)
    goes_on = beside.size > 0 and float(_has_colour(beside, ground).mean()) > BEYOND_SHARE
    return LETTERS[0] <= letters <= LETTERS[1] and not goes_on


def _count_free(rows: NDArray[np.int_], edge: Band, others: list[Band]) -> int:
    """How many of the rows (R,) away from an edge come before another box."""
    beside = [box for box in others if min(box.right, edge.right) > max(box.left, edge.left)]
    is_taken = np.zeros(len(rows), np.bool_)
    for box in beside:
        is_taken |= (rows >= box.top) & (rows <= box.bottom)
    return int(np.argmax(is_taken)) if is_taken.any() else len(rows)


def _has_colour(image: NDArray[np.uint8], colour: NDArray[np.float64], levels: float = PLAIN_LEVELS) -> Mask:
    """Which places (H, W) of a picture have a colour (3,), but for less than so many levels."""
    low, high = np.floor(colour - levels) + 1.0, np.ceil(colour + levels) - 1.0
    if image.size == 0:
        return np.zeros(image.shape[:2], np.bool_)
    return np.asarray(cv2.inRange(np.ascontiguousarray(image), low, high)) > 0


def _share_of_rows(places: Mask) -> NDArray[np.float64]:
    """Share (H,) of each row of a mask (H, W) that is set."""
    return np.asarray(np.count_nonzero(places, axis=1) / max(places.shape[1], 1), np.float64)


def fill_bands(image: NDArray[np.uint8], bands: tuple[Band, ...]) -> NDArray[np.uint8]:
    """A copy of the picture in which each band's columns go evenly from what is above it to what is below it."""
    if not bands:
        return image
    filled = image.copy()
    for band in bands:
        first, last = band.top - RIM_PX, band.bottom + RIM_PX
        columns = slice(max(band.left - RIM_PX, 0), band.right + RIM_PX + 1)
        above = _rows_outside(image, first - OUTSIDE_PX, columns)
        below = _rows_outside(image, last + 1, columns)
        # paint beside the band would leave streaks in its place
        above, below = (None if rows is None else _smooth(rows) for rows in (above, below))
        above = below if above is None else above
        below = above if below is None else below
        if above is None or below is None:
            continue
        rows = np.arange(max(first, 0), min(last + 1, len(image)))
        share = ((rows - first) / max(last - first, 1))[:, None, None]
        filled[rows, columns] = np.rint((1.0 - share) * above + share * below).astype(np.uint8)
    return filled


def cover_bands(shape: tuple[int, ...], bands: tuple[Band, ...]) -> Mask:
    """Which places (H, W) of a picture the bands cover, with their rims."""
    covered = np.zeros(shape[:2], dtype=np.bool_)
    for band in bands:
        rows = slice(max(band.top - RIM_PX, 0), band.bottom + RIM_PX + 1)
        covered[rows, max(band.left - RIM_PX, 0) : band.right + RIM_PX + 1] = True
    return covered


def lie_under(points: Array, covered: Mask) -> Mask:
    """Which points (N, 2) of a picture graphics cover (H, W)."""
    height, width = covered.shape
    x, y = np.rint(points).astype(np.int64).T
    return np.asarray(covered[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)], np.bool_)


def lie_clear(points: Array, covered: Mask | None) -> Mask:
    """Which points (N, 2) of a picture lie neither under graphics (H, W) nor right above or below them, where what
    fills their place ends in a faint edge, and paint is cut lengthwise.
    """
    if covered is None:
        return np.ones(len(points), np.bool_)
    beside = np.array([0.0, CLEAR_PX * covered.shape[1] / 1920.0])
    return ~(lie_under(points, covered) | lie_under(points - beside, covered) | lie_under(points + beside, covered))


def _find_level_edges(image: NDArray[np.uint8]) -> list[Band]:
    """Where a thinned picture (H, W, C) steps along rows in one of its channels, from top to bottom; none where it does
    so everywhere.
    """
    width = image.shape[1]
    above, below = np.ascontiguousarray(image[:-2]), np.ascontiguousarray(image[2:])
    rows = _find_stepping_rows(above, below)
    above, below = above[rows], below[rows]
    alike = np.zeros((len(rows), width), np.uint8)
    for step in (cv2.subtract(below, above), cv2.subtract(above, below)) if len(rows) else ():
        large = cv2.threshold(step, LEAST_STEP, 1, cv2.THRESH_BINARY)[1]
        for channel in cv2.split(cv2.boxFilter(large, -1, (JOINED, 1), normalize=False)):
            alike = np.asarray(cv2.max(alike, channel), np.uint8)
    columns = alike > JOINED_SHARE * JOINED
    is_long = np.count_nonzero(columns, axis=1) >= LEAST_LENGTH * width
    rows, columns = rows[is_long], columns[is_long]
    edges, reach = [], JOINED // 2
    for run in np.split(np.arange(len(rows)), np.flatnonzero(np.diff(rows) > 1) + 1) if len(rows) else ():
        seen = np.flatnonzero(columns[run].any(axis=0))
        left, right = max(int(seen[0]) - reach, 0), min(int(seen[-1]) + reach, width)
        edges.append(Band(int(rows[run[0]]) + 1, int(rows[run[-1]]) + 1, left, right))
    return edges if len(edges) <= MOST_EDGES else []


def _find_stepping_rows(above: NDArray[np.uint8], below: NDArray[np.uint8]) -> Indices:
    """Rows of two thinned pictures (H, W, C) that differ in so many columns that an edge may run there: places that are
    joined hold at least :data:`JOINED_SHARE` of columns that step, but for the columns joined at both ends.
    """
    most, *others = cv2.split(cv2.absdiff(below, above))
    for channel in others:
        most = cv2.max(most, channel)
    large = cv2.threshold(most, LEAST_STEP, 1, cv2.THRESH_BINARY)[1]
    count = cv2.reduce(large, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)[:, 0]
    return np.flatnonzero(count >= JOINED_SHARE * LEAST_LENGTH * large.shape[1] - JOINED)


def _is_opposite(upper: Band, lower: Band, height: int) -> bool:
    """Whether two edges may be the upper and the lower one of one box."""
    overlap = min(upper.right, lower.right) - max(upper.left, lower.left)
    shorter = min(upper.right - upper.left, lower.right - lower.left)
    return HEIGHTS[0] * height <= lower.bottom - upper.top <= HEIGHTS[1] * height and overlap >= OVERLAP * shorter


def _uppermost(edges: list[Band], top: int, height: int) -> int:
    """The first row of a box whose upper edge is trimmed by narrow stripes."""
    for edge in reversed(edges):
        if top - edge.top > TRIM * height:
            break
        top = edge.top
    return top


def _is_box(image: NDArray[np.uint8], band: Band, most_elsewhere: float = FIELD_SHARE) -> bool:
    """Whether the inside of a band of a thinned picture is plain, and unlike what lies outside, as its rims are; at
    most a share of the rest of the picture has its colour.
    """
    columns = slice(band.left, band.right + 1)
    inside = _inside_of(image, band)
    if inside.size == 0:
        return False
    usual = _usual_colour(inside)
    if _has_colour(inside, usual).mean() < PLAIN_SHARE:
        return False
    behind = RIM_PX + round(TRIM * len(image))
    sides = [
        [np.median(side, axis=0) for side in (rim, outside, further) if side is not None]
        for rim, outside, further in (
            (
                _rows_outside(image, band.top + RIM_PX, columns),
                _rows_outside(image, band.top - RIM_PX - OUTSIDE_PX, columns),
                _rows_outside(image, band.top - behind - OUTSIDE_PX, columns),
            ),
            (
                _rows_outside(image, band.bottom - RIM_PX - OUTSIDE_PX + 1, columns),
                _rows_outside(image, band.bottom + RIM_PX + 1, columns),
                _rows_outside(image, band.bottom + behind + 1, columns),
            ),
        )
        if rim is not None and outside is not None
    ]
    # a stripe along a box is told from a line on the field by what lies behind it
    unlike = all(
        np.abs(own - seen).max() > UNLIKE_LEVELS for rim, *others in sides for own in (rim, usual) for seen in others
    )
    rows = image[band.top : band.bottom + 1, columns]
    strips = [(_share_of_rows(_has_colour(rows, outside)) > GROUND_SHARE).mean() for _, outside, *_ in sides]
    is_apart = unlike and sides and max(strips) <= STRIP_SHARE
    return bool(is_apart and _has_colour(_elsewhere(image, band), usual).mean() <= most_elsewhere)


def _inside_of(image: NDArray[np.uint8], band: Band) -> NDArray[np.uint8]:
    """Every second row of a band of a thinned picture, without its rims."""
    return image[band.top + RIM_PX : band.bottom - RIM_PX : 2, band.left : band.right + 1]


def _elsewhere(image: NDArray[np.uint8], band: Band) -> NDArray[np.uint8]:
    """Colours (R, C, 3) of the rows above and below a band of a thinned picture, a part of them."""
    every = FIELD_EVERY // EVERY
    return np.concatenate([image[: band.top : FIELD_EVERY, ::every], image[band.bottom + 1 :: FIELD_EVERY, ::every]])


def _usual_colour(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Median (3,) of each colour of a picture (H, W, 3)."""
    values = np.ascontiguousarray(image.reshape(-1, 3).T)
    return np.median(values, axis=1)


def _smooth(row: NDArray[np.float64]) -> NDArray[np.float64]:
    """A row of colours (C, 3) without what is narrower than :data:`SMOOTHED_PX` columns."""
    return np.asarray(cv2.blur(row[None], (SMOOTHED_PX, 1))[0], np.float64)


def _rows_outside(image: NDArray[np.uint8], first: int, columns: slice) -> NDArray[np.float64] | None:
    """Mean (C, 3) of some rows; None where they lie outside the picture."""
    if first < 0 or first + OUTSIDE_PX > len(image):
        return None
    return np.asarray(image[first : first + OUTSIDE_PX, columns].mean(axis=0), np.float64)

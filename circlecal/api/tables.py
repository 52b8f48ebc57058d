"""Tables of points of many frames, taken to the field or into their pictures with the results of a run."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from circlecal.errors import CirclecalError, InputError
from circlecal.field import load_field
from circlecal.files import Table, open_table, real_path
from circlecal.geometry.projective import Array
from circlecal.names import from_cell
from circlecal.records.log import read_records
from circlecal.records.record import ResultRecord

NO_SUCH_FRAME = "no such frame"
SEVERAL_CLIPS = "several clips have frames of such numbers; give its id, or a column video"
OUTSIDE = "outside the field"
OUTSIDE_PICTURE = "outside the picture"
EDGE_PX = 1.0
"""A point that lies so far outside the centres of the outermost pixels is in the picture: its border is half a pixel
further out, and boxes of detectors end a whole one further.
"""
_COLUMNS = ("frame", "x", "y")
_VIDEO = "video"
_DELIMITER_NAMES = {",": "comma", ";": "semicolon", "\t": "tab"}
_MISSING = frozenset(("", "nan", "-nan", "na", "n/a", "#n/a", "<na>", "null", "none"))
"""What pandas, R, MATLAB, C and spreadsheets write where there is no number, in small letters."""
_NUMBER = re.compile(r"(\d{1,12})(?:\.0+)?", re.ASCII)
"""Of a frame, also as programs write one that keep whole numbers as others."""


@dataclass(frozen=True, slots=True)
class TablePoint:
    """A point (2,) of a frame, which its id names, or its number in a tracked clip; the cells of its row, and the video
    that is the clip, empty where the row names none.
    """

    frame: str
    x: float
    y: float
    cells: tuple[str, ...] = ()
    video: str = ""


@dataclass(frozen=True, slots=True)
class PointTable:
    """Names of the columns of a table, where those of a point are among them, what separates them, and its points."""

    columns: tuple[str, ...]
    places: dict[str, int]
    delimiter: str
    points: list[TablePoint]


@dataclass(frozen=True, slots=True)
class ProjectedPoint:
    """Where a point is in the other frame, nan where it is nowhere; its standard deviation, nan where that is not
    known; and a note, such as why it is nowhere.
    """

    given: TablePoint
    x: float
    y: float
    sigma: float
    note: str


def read_points(lines: Iterable[str], name: str, further: Collection[str] = ()) -> PointTable:
    """Points of a CSV table with the columns ``frame``, ``x``, ``y`` and perhaps ``video``, in any order among others.

    Parameters
    ----------
    lines : iterable of str
        Of the table, the first with the names of the columns.
    name : str
        Named in errors.
    further : collection of str
        Columns that are to be written behind those of the table, which must not have them.

    Raises
    ------
    InputError
        A column is missing, or there already; a number is none, or a row is too long; with the line. A point of which
        a number is missing, or said to be, is nan: a player who was not seen.
    """
    table = open_table(lines, name, _COLUMNS, (_VIDEO,))
    doubled = next((column for column in table.columns if column in further), None)
    if doubled is not None:
        raise InputError(f"{name}, line 1: has a column {doubled!r}, which is written here; rename it")
    points = [_point_of(cells, table, f"{name}, line {number}") for number, cells in table.rows]
    return PointTable(table.columns, table.places, table.delimiter, points)


def _point_of(cells: list[str], table: Table, where: str) -> TablePoint:
    """The point of a row."""
    if len(cells) > len(table.columns):
        raise InputError(
            f"{where}: has {len(cells)} cells for {len(table.columns)} columns; quote cells that hold a "
            f"{_DELIMITER_NAMES[table.delimiter]}"
        )
    frame, x, y = (cells[table.places[column]] for column in _COLUMNS)
    video = cells[table.places[_VIDEO]] if _VIDEO in table.places else ""
    try:
        place = [np.nan if text.strip().lower() in _MISSING else float(text) for text in (x, y)]
    except ValueError as error:
        raise InputError(f"{where}: x and y must be numbers with a decimal point") from error
    if np.isinf(place).any():
        raise InputError(f"{where}: x and y must be finite")
    if np.isnan(place).any():
        place = [np.nan, np.nan]
    return TablePoint(from_cell(frame), place[0], place[1], tuple(cells), from_cell(video.strip()))


def project_table(
    results: Path, points: list[TablePoint], to: Literal["field", "image"], point_sigma_px: float = 0.0
) -> Iterator[ProjectedPoint]:
    """Take points to the field (metres) or into their pictures (pixels), in the order in which they were given.

    Parameters
    ----------
    results : path
        Folder of a run, its ``results.jsonl``, or a result file.
    points : list of TablePoint
        Pixels for ``field``, metres for ``image``. A frame that is no id is the number of one in the tracked clip.
    to : {"field", "image"}
        Where to.
    point_sigma_px : float
        How well pixels that are taken to the field are known, one standard deviation along x and along y.

    Raises
    ------
    InputError
        The results cannot be read.
    """
    by_id, by_number = _group_points(points)
    clips = _Clips({point.video for point in points})
    answers: dict[int, ProjectedPoint] = {}
    numbered: dict[int, ProjectedPoint] = {}
    for record in read_records(results):
        answers |= _project_of(record, points, by_id.get(record.id, []), to, point_sigma_px)
        if record.track is not None:
            meant = clips.add(record.path or "")
            of_number = [k for k in by_number.get(record.track.frame, []) if points[k].video in meant]
            numbered |= _project_of(record, points, of_number, to, point_sigma_px)
    for index, point in enumerate(points):
        found = numbered.get(index)
        if found is not None and clips.count(point.video) > 1:
            found = replace(_nowhere(point), note=SEVERAL_CLIPS)
        yield answers.get(index) or found or _nowhere(point)


class _Clips:
    """Which clips of a run the rows of a table can mean by what they write under ``video``: a path, or the mere name of
    a file in any folder; a row that writes nothing can mean each clip.
    """

    def __init__(self, videos: Collection[str]) -> None:
        self._wanted = {video: real_path(Path(video)) for video in videos if video}
        self._meaning: dict[str, set[str]] = {}
        self._found: dict[str, set[Path]] = defaultdict(set)

    def add(self, path: str) -> set[str]:
        """Take note of the clip at a path; what rows write that can mean it."""
        if path not in self._meaning:
            clip = real_path(Path(path))
            named = (video for video, place in self._wanted.items() if clip == place or clip.name == video)
            self._meaning[path] = {"", *named}
            for video in self._meaning[path]:
                self._found[video].add(clip)
        return self._meaning[path]

    def count(self, video: str) -> int:
        """Number of clips that a row can mean."""
        return len(self._found[video])


def _nowhere(point: TablePoint) -> ProjectedPoint:
    """A point of a frame that is not there."""
    return ProjectedPoint(point, np.nan, np.nan, np.nan, NO_SUCH_FRAME)


def _group_points(points: list[TablePoint]) -> tuple[dict[str, list[int]], dict[int, list[int]]]:
    """Places of points in their list by what names their frame, and by its number where that may be one."""
    by_id: dict[str, list[int]] = defaultdict(list)
    by_number: dict[int, list[int]] = defaultdict(list)
    for index, point in enumerate(points):
        by_id[point.frame].append(index)
        number = _NUMBER.fullmatch(point.frame.strip())
        if number is not None:
            by_number[int(number[1])].append(index)
    return by_id, by_number


def _project_of(
    record: ResultRecord,
    points: list[TablePoint],
    indices: list[int],
    to: Literal["field", "image"],
    point_sigma_px: float,
) -> dict[int, ProjectedPoint]:
    """Some of the points, by their places in the list, with one record."""
    own = [points[k] for k in indices]
    return dict(zip(indices, project_points(record, own, to, point_sigma_px), strict=True))


def project_points(
    record: ResultRecord, points: list[TablePoint], to: Literal["field", "image"], point_sigma_px: float = 0.0
) -> list[ProjectedPoint]:
    """Take points of one frame to the field (metres), where its pixels are known to a standard deviation of their own,
    or into its picture (pixels).
    """
    view = record.view
    if not points:
        return []
    if record.status != "calibrated" or view is None:
        return [ProjectedPoint(p, np.nan, np.nan, np.nan, explain_no_view(record)) for p in points]
    given = np.array([(p.x, p.y) for p in points])
    to_field = to == "field"
    found = view.to_field(given, True, point_sigma_px) if to_field else view.project(given, sigma=True)
    sigma = np.full(len(points), np.nan) if found.sigma is None else found.sigma
    in_picture = view.shows(given if to_field else found.points, EDGE_PX).tolist()
    off_field = _are_outside(record, found.points if to_field else given).tolist()
    nowhere = "on or above the horizon" if to_field else "behind the camera"
    places = zip(points, found.points.tolist(), sigma.tolist(), strict=True)
    return [
        ProjectedPoint(p, place[0], place[1], spread, _note(p, place[0], nowhere, off_field[k], in_picture[k]))
        for k, (p, place, spread) in enumerate(places)
    ]


def explain_no_view(record: ResultRecord) -> str:
    """Why nothing can be projected with a record: it was refused, or keys of it are missing."""
    if record.status != "calibrated":
        return f"refused: {record.code}"
    return f"the key {'image' if record.image is None else 'H_image_field'} is missing"


def _note(given: TablePoint, place: float, nowhere: str, is_off_field: bool, is_in_picture: bool) -> str:
    """What is to be said of a point: that it is nowhere, or lies outside field or picture."""
    if not np.isfinite(given.x):
        return "no point given"
    if not np.isfinite(place):
        return nowhere
    return " and ".join([OUTSIDE] * is_off_field + [OUTSIDE_PICTURE] * (not is_in_picture))


def _are_outside(record: ResultRecord, points_m: ArrayLike) -> Array:
    """Whether field points (N, 2) lie outside the field of a record's template, bool (N,)."""
    try:
        template = None if record.field is None else load_field(record.field.template, record.field.sizes)
    except CirclecalError:  # of somebody's own, and not here
        template = None
    points = np.asarray(points_m, dtype=np.float64)
    if template is None:
        return np.zeros(len(points), np.bool_)
    growth = np.zeros(2) if record.view is None else record.view.growth_m
    half = (np.array([template.length_m, template.width_m]) + growth) / 2.0
    return np.asarray((np.abs(points) > half).any(axis=1))

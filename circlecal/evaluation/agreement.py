"""How well two people agree who annotated frames in the workbench: markings, names, and the cameras that follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from circlecal.api.calls import calibrate_annotation, suit_annotation
from circlecal.config import Config
from circlecal.errors import InputError
from circlecal.field.view import FieldView
from circlecal.files import is_folder
from circlecal.formats.annotation import Annotation, is_annotation_file, read_annotations
from circlecal.formats.meaning import REFERENCE_WIDTH_PX
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.projective import Array
from circlecal.overlay.page_view import cell_centers
from circlecal.results import FrameCalibration

SAME_PAINT_PX = 8.0
"""Markings of two people that lie no further apart (median, pixels at 1920 px width) are one, whatever their names: two
markings of a pitch that are nearer to each other in a picture are too far away to be named.
"""
_BENT_POINTS, _CONIC_POINTS = 6, 6
"""Fewer points of a line are taken for a straight one, and fewer of a circle for no ellipse."""
_GRID = 24, 14
"""Columns and rows of pixels at which two cameras are compared."""
_BEYOND_M = 5.0
"""Pixels that show the ground further outside the field are not compared."""


@dataclass(frozen=True, slots=True)
class FrameAgreement:
    """Two annotations of a frame.

    Attributes
    ----------
    id : str
        The frame.
    authors : (str, str)
        Who annotated it; empty where that is not known.
    lines_px : dict of str to float or None
        Of each marking that both named, the median distance of the points of the one from the curve of the other; None
        where they mark parts that do not overlap.
    only_first, only_second : tuple of str
        Names that only one of them gave.
    renamed : tuple of (str, str)
        Names that they gave to one marking.
    flags : (str or None, str or None)
        What they say of the frame as a whole.
    calibrated : (bool, bool)
        Whether each annotation is enough for a camera.
    camera_px, camera_largest_px : float or None
        Median and largest distance in the picture between where the two cameras see one place of the field; None where
        one of them is missing.
    """

    id: str
    authors: tuple[str, str]
    lines_px: dict[str, float | None]
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]
    renamed: tuple[tuple[str, str], ...]
    flags: tuple[str | None, str | None]
    calibrated: tuple[bool, bool]
    camera_px: float | None
    camera_largest_px: float | None

    @property
    def median_px(self) -> float | None:
        """Of its lines."""
        known = [off for off in self.lines_px.values() if off is not None]
        return float(np.median(known)) if known else None

    @property
    def badness(self) -> tuple[int, float]:
        """By which the worst frame is found: what is said differently, then by how much the cameras differ."""
        differ = len(self.renamed) + (self.flags[0] != self.flags[1]) + (self.calibrated[0] != self.calibrated[1])
        return differ, self.camera_largest_px or self.median_px or 0.0


@dataclass(frozen=True, slots=True)
class LineRow:
    """One marking over all frames in which both named it."""

    name: str
    frames: int
    median_px: float | None
    largest_px: float | None
    only_first: int
    only_second: int


@dataclass(frozen=True, slots=True)
class Agreement:
    """Two sets of annotations: frames that both hold, the worst first, and those that only one holds."""

    frames: tuple[FrameAgreement, ...]
    only_first: tuple[str, ...]
    only_second: tuple[str, ...]

    def rows(self) -> list[LineRow]:
        """Of each marking, those that differ most first."""
        names = {name for f in self.frames for name in (*f.lines_px, *f.only_first, *f.only_second)}
        return sorted((self._row(name) for name in names), key=lambda row: (-(row.median_px or 0.0), row.name))

    def _row(self, name: str) -> LineRow:
        both = [frame.lines_px[name] for frame in self.frames if name in frame.lines_px]
        known = [off for off in both if off is not None]
        return LineRow(
            name,
            len(both),
            float(np.median(known)) if known else None,
            max(known, default=None),
            sum(name in frame.only_first for frame in self.frames),
            sum(name in frame.only_second for frame in self.frames),
        )

    def as_record(self) -> dict[str, Any]:
        """Ready for JSON."""
        return {
            "pixels_at_width": REFERENCE_WIDTH_PX,
            "frames": [asdict(frame) | {"median_px": frame.median_px} for frame in self.frames],
            "lines": [asdict(row) for row in self.rows()],
            "only_first": list(self.only_first),
            "only_second": list(self.only_second),
        }


def holds_annotations(folder: Path) -> bool:
    """Whether a folder has annotations of the workbench."""
    return is_folder(folder) and any(is_annotation_file(path) for path in sorted(folder.glob("*.json")))


def compare_annotations(first: Path, second: Path, config: Config) -> Agreement:
    """Compare two folders of annotations by the ids of their frames.

    Parameters
    ----------
    first, second : path
        Folders, as ``circlecal annotate --out`` fills them.
    config : Config
        Options with which cameras are estimated.

    Raises
    ------
    InputError
        An annotation is damaged, or no frame is in both.
    """
    ours, theirs = ({one.annotation.id: one.annotation for one in read_annotations(f)} for f in (first, second))
    both = sorted(ours.keys() & theirs.keys())
    if not both:
        raise InputError(f"{first}, {second}: hold annotations of no frame together; frames are compared by their ids")
    frames = [_compare(ours[name], theirs[name], config) for name in both]
    return Agreement(
        tuple(sorted(frames, key=lambda frame: frame.badness, reverse=True)),
        tuple(sorted(ours.keys() - theirs.keys())),
        tuple(sorted(theirs.keys() - ours.keys())),
    )


def _compare(first: Annotation, second: Annotation, config: Config) -> FrameAgreement:
    second = second.resize(first.width, first.height)
    per_pixel = REFERENCE_WIDTH_PX / first.width
    ours, theirs = (_join_markings(one) for one in (first, second))
    names = sorted(ours.keys() & theirs.keys())
    lines = {name: measure_apart(*ours[name], theirs[name][1]) for name in names}
    only = [{name: pieces[name] for name in sorted(pieces.keys() - set(names))} for pieces in (ours, theirs)]
    renamed = tuple(
        (mine, other)
        for mine, (kind, points) in only[0].items()
        for other, (other_kind, other_points) in only[1].items()
        if kind == other_kind
        and (apart := measure_apart(kind, points, other_points)) is not None
        and apart * per_pixel < SAME_PAINT_PX
    )
    found = [calibrate_annotation(one, suit_annotation(config, one)) for one in (first, second)]
    apart_px = measure_cameras(*found)
    return FrameAgreement(
        first.id,
        (first.author, second.author),
        {name: None if off is None else round(off * per_pixel, 3) for name, off in lines.items()},
        tuple(name for name in only[0] if all(name != mine for mine, _ in renamed)),
        tuple(name for name in only[1] if all(name != other for _, other in renamed)),
        renamed,
        (first.flag, second.flag),
        (found[0].status == "calibrated", found[1].status == "calibrated"),
        None if apart_px is None else round(float(np.median(apart_px)) * per_pixel, 3),
        None if apart_px is None else round(float(apart_px.max()) * per_pixel, 3),
    )


def _join_markings(annotation: Annotation) -> dict[str, tuple[str, Array]]:
    """Kind and points (N, 2) of what is named and used; of circles the points on the middle of the paint."""
    found: dict[str, tuple[str, Array]] = {}
    for marking in annotation.markings:
        if marking.name is None or not marking.used or marking.edge != "center":
            continue
        before = found.get(marking.name)
        points = marking.points if before is None else np.concatenate([before[1], marking.points])
        found[marking.name] = (marking.kind, points)
    return found


def measure_apart(kind: str, first: Array, second: Array) -> float | None:
    """Median distance (pixels) of the points of each of two markings from the other's curve; None where they do not
    overlap, or one has too few points for a curve.

    Parameters
    ----------
    kind : {"curve", "line", "point"}
        What both are.
    first, second : (N, 2), (M, 2) arrays
        Their points.
    """
    if kind == "point":
        return float(np.linalg.norm(first[0] - second[0]))
    measure = _off_conic if kind == "curve" else _off_line
    off = np.concatenate([measure(first, second), measure(second, first)])
    return float(np.median(off)) if len(off) else None


def _off_conic(points: Array, others: Array) -> Array:
    """Distances (N,) of points (N, 2) from the ellipse through others."""
    conic = fit_conic(others) if len(others) >= _CONIC_POINTS else None
    return np.zeros(0) if conic is None else np.abs(sampson_distance(conic, points))


def _off_line(points: Array, others: Array) -> Array:
    """Distances (K,) of those points (N, 2) that lie beside others (M, 2) from the line through these, which a lens
    bends a little.
    """
    if len(others) < 2:
        return np.zeros(0)
    middle = others.mean(axis=0)
    axes = np.linalg.svd(others - middle, full_matrices=False)[2]
    along, across = ((others - middle) @ axes.T).T
    fitted = np.polynomial.Polynomial.fit(along, across, 2 if len(others) >= _BENT_POINTS else 1)
    at, off = ((points - middle) @ axes.T).T
    beside = (at >= along.min()) & (at <= along.max())
    return np.asarray(np.abs(off - fitted(at))[beside])


def measure_cameras(first: FrameCalibration, second: FrameCalibration) -> Array | None:
    """Distances (N,) in the picture between where two cameras see places of the field that the first one shows, pixels;
    None where one is missing.
    """
    if first.status != "calibrated" or second.status != "calibrated" or first.view is None or second.view is None:
        return None
    pixels, places = _places_in_view(first.view, first)
    off = np.linalg.norm(second.view.project(places) - pixels, axis=1)
    known = off[np.isfinite(off)]
    return known if len(known) else None


def _places_in_view(view: FieldView, found: FrameCalibration) -> tuple[Array, Array]:
    """Pixels (N, 2) on a grid over a picture that show the field, and the places (N, 2) that they show."""
    pixels = cell_centers(view, *_GRID).reshape(-1, 2)
    places = view.to_field(pixels)
    half = np.array([found.template.length_m, found.template.width_m]) / 2.0 if found.template else np.array([60, 45])
    is_field = (np.abs(np.nan_to_num(places, nan=np.inf)) < half + _BEYOND_M).all(axis=1)
    return pixels[is_field], places[is_field]


def list_differences(frame: FrameAgreement) -> Sequence[str]:
    """What two people say differently of a frame, in words."""
    told = [f"{mine} / {other}" for mine, other in frame.renamed]
    if frame.flags[0] != frame.flags[1]:
        told.append(" / ".join(flag or "not flagged" for flag in frame.flags))
    return [text.replace("_", " ") for text in told]

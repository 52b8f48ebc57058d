"""Straight markings at full resolution, and the halfway line: the one through the middle of the circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.detection.circle import MeasuredCircle, unit_frame
from circlecal.detection.options import DetectorConfig, HalfwayConfig
from circlecal.geometry.projective import Array, fit_line, join, lift, line_distance, normalise_line, transform_lines
from circlecal.paint.bands import BandProfile, local_width, measure_band

__all__ = ["MeasuredLine", "MeasuredSegments", "find_halfway", "measure_segments", "segments_through_middle"]

_TRIED = 4  # lines nearest to the circle's centre
_INSIDE = 0.97  # half chords: the crossing with the circle itself is left out of the support
_NEARLY_CENTRAL = 0.12  # a supported line this near to the centre needs no comparison with others
_FURTHEST = 6.0  # half chords: where the picture shows a line outside the circle only, it shows it this near
_SAME_PAINT = (
    0.4  # least contrast of the line over that of the circle: streaks of the floor have less, one paint 0.6-2.7
)
_DIRECTIONS, _FEWEST_VOTES = 60, 8  # over half a turn; ridge points in three neighbouring ones
_OUTSIDE_SUPPORT = 0.7  # of a line that is seen outside the circle only


@dataclass(frozen=True, slots=True)
class MeasuredLine:
    """A line (3,) with profiles in order along it; ``support`` is the drawn share of its chord in the circle, or
    of what is seen of it where the picture shows it ``outside`` the circle only.
    """

    line: Array
    points: Array
    normals: Array
    band: BandProfile
    support: float
    outside: bool = False

    @property
    def ends(self) -> tuple[Array, Array]:
        """First and last supported place (2,), on the line."""
        on = np.flatnonzero(self.band.supported)
        if len(on) == 0:
            return self.points[0], self.points[-1]
        return self.points[on[0]], self.points[on[-1]]


@dataclass(frozen=True, slots=True)
class MeasuredSegments:
    """Profiles along several straight segments, one after the other; ``pieces`` (N,) tells which."""

    points: Array
    normals: Array
    band: BandProfile
    pieces: NDArray[np.int64]


def measure_segments(
    grey: NDArray[np.uint8], segments: Array, sign: float, config: DetectorConfig
) -> MeasuredSegments | None:
    """Profiles across straight segments (K, 2, 2) of the full picture, once; None where there is no segment."""
    if len(segments) == 0:
        return None
    unit = grey.shape[1] / 1280.0
    span = segments[:, 1] - segments[:, 0]
    length = np.hypot(span[:, 0], span[:, 1])
    count = np.maximum(6, (length / (2 * config.refinement.spacing_px1280 * unit)).astype(np.int64))
    pieces = np.repeat(np.arange(len(segments)), count)
    position = np.arange(len(pieces)) - np.repeat(np.cumsum(count) - count, count)
    points = segments[pieces, 0] + ((position + 0.5) / count[pieces])[:, None] * span[pieces]
    normals = np.stack([span[:, 1], -span[:, 0]], axis=-1) / np.maximum(length, 1e-9)[:, None]
    reach = np.full(len(points), max(config.refinement.line_reach_px1280 * unit, 3.0))
    band = measure_band(grey, points, normals[pieces], reach, pieces, sign, config.refinement)
    return MeasuredSegments(points, normals[pieces], band, pieces)


def find_halfway(
    grey: NDArray[np.uint8], circle: MeasuredCircle, segments: Array, config: DetectorConfig
) -> MeasuredLine | None:
    """Choose and measure the line through the circle's middle.

    Parameters
    ----------
    grey : (H, W) uint8
        Full picture.
    circle : MeasuredCircle
    segments : (K, 2, 2) array
        Ends of the straight runs, px.
    config : DetectorConfig

    Returns
    -------
    MeasuredLine or None
        None where no line is near the middle or none is drawn there.
    """
    if len(segments) == 0:
        return None
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))
    lines = join(lift(segments[:, 0]), lift(segments[:, 1]))
    local = normalise_line(transform_lines(to_unit, lines))
    distance = np.abs(local[:, 2])
    best: tuple[float, MeasuredLine] | None = None
    for index in np.argsort(distance)[:_TRIED]:
        if distance[index] > config.halfway.distance:
            break
        measured = _followed(grey, circle, local[index], config)
        refined = abs(float(normalise_line(transform_lines(to_unit, measured.line))[2]))
        if not _drawn(measured, config.halfway) or refined > config.halfway.distance:
            continue
        if _contrast(measured.band) < _SAME_PAINT * _contrast(circle.band):
            continue
        if measured.outside and refined > _NEARLY_CENTRAL:
            continue
        value = measured.support - refined
        if best is None or value > best[0]:
            best = value, measured
        if refined <= _NEARLY_CENTRAL:
            break
    return None if best is None else best[1]


def segments_through_middle(points: Array, normals: Array, circle: MeasuredCircle, config: HalfwayConfig) -> Array:
    """Straight pieces (K, 2, 2) through the middle of a circle, from the directions in which ridge points (N, 2) inside
    it run: shorter and fainter ones than a search over the whole picture finds.
    """
    to_unit = np.linalg.inv(unit_frame(circle.ellipse))
    local = lift(points) @ to_unit[:2].T
    inside = (local * local).sum(axis=-1) < _INSIDE**2
    points, normals = points[inside], normals[inside]
    lines = np.concatenate([normals, -(normals * points).sum(axis=-1, keepdims=True)], axis=1)
    through = normalise_line(transform_lines(to_unit, lines))
    near = np.abs(through[:, 2]) <= 0.5 * config.distance
    points, direction = points[near], np.arctan2(through[near, 1], through[near, 0]) % np.pi
    bins = (direction * (_DIRECTIONS / np.pi)).astype(np.int64) % _DIRECTIONS
    votes = np.bincount(bins, minlength=_DIRECTIONS)
    votes = votes + np.roll(votes, 1) + np.roll(votes, -1)
    peaks = np.flatnonzero((votes >= np.roll(votes, 1)) & (votes > np.roll(votes, -1)) & (votes >= _FEWEST_VOTES))
    found = []
    for peak in peaks[np.argsort(-votes[peaks])][:_TRIED]:
        members = points[np.abs((bins - peak + _DIRECTIONS // 2) % _DIRECTIONS - _DIRECTIONS // 2) <= 1]
        line = fit_line(members)
        for tolerance in (8.0, 4.0):
            off = np.abs(line_distance(line, members))
            line = fit_line(members, (off <= max(float(np.median(off)), tolerance)).astype(np.float64))
        along = members @ np.array([line[1], -line[0]])
        ends = members[[int(np.argmin(along)), int(np.argmax(along))]]
        found.append(ends - line_distance(line, ends)[:, None] * line[:2])
    return np.array(found).reshape(-1, 2, 2)


def _contrast(band: BandProfile) -> float:
    """Usual contrast of what is drawn, grey levels."""
    return float(np.median(np.abs(band.contrast[band.supported]))) if band.supported.any() else 0.0


def _drawn(line: MeasuredLine, config: HalfwayConfig) -> bool:
    """Whether enough of the line is drawn inside the circle, or a little there and enough of it altogether."""
    if line.outside:
        return line.support >= _OUTSIDE_SUPPORT
    if line.support >= config.support:
        return True
    visible = max(1, int(np.count_nonzero(line.band.inside)))
    whole = float(np.count_nonzero(line.band.supported)) / visible
    return line.support >= config.support_with_rest and whole >= config.support


def _followed(grey: NDArray[np.uint8], circle: MeasuredCircle, local: Array, config: DetectorConfig) -> MeasuredLine:
    """Follow a line, given in the unit circle's frame, through the circle and beyond; fit it inside the circle."""
    unit = grey.shape[1] / 1280.0
    refinement = config.refinement
    start, end, extent = _visible_chord(local, circle, grey.shape, config.halfway)
    length = float(np.hypot(*(end - start)))
    count = int(np.clip(length / (refinement.spacing_px1280 * unit), 12, refinement.samples))
    share = (np.arange(count) + 0.5) / count
    chords = extent[0] + share * (extent[1] - extent[0])
    pieces = np.arange(count) * 4 // count
    reach = np.full(count, max(refinement.line_reach_px1280 * unit, 3.0))
    inner = np.abs(chords) <= _INSIDE
    outside = extent[0] >= 1.0 or extent[1] <= -1.0
    line = normalise_line(join(lift(start), lift(end)))
    points, normals, band = _along_line(grey, start, end, share, reach, pieces, circle.sign, config)
    on = band.supported & ((np.abs(chords) <= 1.2) | outside)
    if np.count_nonzero(on) >= 8:
        line = fit_line(points[on] + band.offset[on, None] * normals[on])
        start, end = (p - float(line_distance(line, p)) * line[:2] for p in (start, end))
        reach = np.maximum(refinement.narrow_reach_px1280 * unit, 3.0) + local_width(band)
        points, normals, band = _along_line(grey, start, end, share, reach, pieces, circle.sign, config)
    judged = band.inside if outside else inner & band.inside
    support = float(np.count_nonzero(band.supported & judged)) / max(1, int(np.count_nonzero(judged)))
    return MeasuredLine(line, points, normals, band, support, outside)


def _along_line(
    grey: NDArray[np.uint8],
    start: Array,
    end: Array,
    share: Array,
    reach: Array,
    pieces: NDArray[np.int64],
    sign: float,
    config: DetectorConfig,
) -> tuple[Array, Array, BandProfile]:
    points = start + share[:, None] * (end - start)
    normal = normalise_line(join(lift(start), lift(end)))[:2]
    normals = np.tile(normal, (len(points), 1))
    return points, normals, measure_band(grey, points, normals, reach, pieces, sign, config.refinement)


def _visible_chord(
    local: Array, circle: MeasuredCircle, shape: tuple[int, ...], config: HalfwayConfig
) -> tuple[Array, Array, tuple[float, float]]:
    """Ends (2,) in the picture of a line given in the unit circle's frame, and their places in half chords."""
    frame = unit_frame(circle.ellipse)[:2]
    foot = -local[2] * local[:2]
    half_chord = np.sqrt(max(0.05, 1.0 - local[2] ** 2)) * np.array([-local[1], local[0]])
    middle, step = frame[:, :2] @ foot + frame[:, 2], frame[:, :2] @ half_chord
    limit = np.array([shape[1] - 1.0, shape[0] - 1.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossings = np.stack([-middle / step, (limit - middle) / step])
    low, high = float(np.nanmax(crossings.min(axis=0))), float(np.nanmin(crossings.max(axis=0)))
    # the picture may show the line on one side of the circle only
    reach = config.extent if low < 1.0 and high > -1.0 else _FURTHEST
    low, high = max(-reach, low), min(reach, high)
    if not low < high:
        low, high = -1.0, 1.0
    return middle + low * step, middle + high * step, (low, high)

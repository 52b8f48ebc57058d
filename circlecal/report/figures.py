"""Figures of a run as shapes on a unit canvas: histograms, and the match as a row of columns. Draws nothing itself."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from circlecal.geometry.projective import Array
from circlecal.report.reading import FrameRow

_BINS = 28
_LOG_FROM = 20.0
"""Largest over smallest value from which an axis is logarithmic."""
_SMALLEST_SHARE = 1e-6
"""Smaller values than this share of the largest count as it."""
_TINY = 1e-12
COLUMNS = 400
"""Most columns of the timeline; more frames share one."""
LONGEST_STRETCHES = 40


@dataclass(frozen=True, slots=True)
class Bar:
    """One bin of a histogram: its limits, and how many calibrated and refused frames fall in it."""

    low: float
    high: float
    calibrated: int
    refused: int


@dataclass(frozen=True, slots=True)
class Tick:
    """A labelled place on an axis, 0 to 1."""

    at: float
    label: str


@dataclass(frozen=True, slots=True)
class Histogram:
    """Bins of equal width on a linear or logarithmic axis, with the median and the 90th percentile.

    ``median_at`` and ``p90_at`` are their places on the axis, 0 to 1.
    """

    bars: tuple[Bar, ...]
    ticks: tuple[Tick, ...]
    highest: int
    median: float
    p90: float
    median_at: float
    p90_at: float
    logarithmic: bool


def histogram(calibrated: Sequence[float], refused: Sequence[float], typical: Sequence[float] = ()) -> Histogram | None:
    """Histogram of one quantity over calibrated and refused frames; None where there is no value.

    Median and 90th percentile are those of ``typical``, of all values where it is empty. The axis is logarithmic where
    the positive values span more than a factor of 20; zeros then count as the smallest value of the axis.
    """
    values = np.array([*calibrated, *refused], dtype=np.float64)
    if not values.size:
        return None
    positive = values[values > 0]
    largest = float(positive.max(initial=0.0))
    logarithmic = bool(positive.size and largest > max(_LOG_FROM * positive.min(), _TINY))
    floor = max(float(positive.min(initial=np.inf)), _SMALLEST_SHARE * largest)

    def place(of: Sequence[float] | Array) -> Array:
        array = np.asarray(of, dtype=np.float64)
        return np.log10(np.maximum(array, floor)) if logarithmic else array

    low, high = float(place(values).min()), float(place(values).max())
    if not logarithmic:
        low = 0.0 if high > 0 and low < 0.5 * high else low
    if high - low < 1e-9 * max(1.0, abs(high)):
        low, high = low - 0.5 * max(abs(low), 1e-3), high + 0.5 * max(abs(high), 1e-3)
    edges = np.linspace(low, high, _BINS + 1)
    counts = [np.histogram(place(part), edges)[0] for part in (calibrated, refused)]
    limits = 10.0**edges if logarithmic else edges
    bars = tuple(
        Bar(float(limits[k]), float(limits[k + 1]), int(counts[0][k]), int(counts[1][k])) for k in range(_BINS)
    )
    median, p90 = (float(v) for v in np.percentile(typical or values, [50, 90]))
    at = [float(np.clip((v - low) / (high - low), 0.0, 1.0)) for v in place([median, p90])]
    return Histogram(
        bars=bars,
        ticks=_log_ticks(low, high) if logarithmic else _linear_ticks(low, high),
        highest=int((counts[0] + counts[1]).max()),
        median=median,
        p90=p90,
        median_at=at[0],
        p90_at=at[1],
        logarithmic=logarithmic,
    )


def _linear_ticks(low: float, high: float) -> tuple[Tick, ...]:
    raw = (high - low) / 4.0
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(m for m in (1.0, 2.0, 5.0, 10.0) if m * power >= raw) * power
    values = np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step
    return tuple(Tick((float(v) - low) / (high - low), short(float(v))) for v in values)


def _log_ticks(low: float, high: float) -> tuple[Tick, ...]:
    for digits in ((1, 2, 5), (1, 3), (1,)):
        powers = range(math.floor(low), math.ceil(high) + 1)
        values = [m * 10.0**p for p in powers for m in digits if low <= math.log10(m * 10.0**p) <= high]
        if len(values) <= 6:
            break
    kept = values[:: max(1, math.ceil(len(values) / 6))]
    return tuple(Tick((math.log10(v) - low) / (high - low), short(v)) for v in kept)


def short(value: float | None) -> str:
    """A number with three significant digits, and without an exponent where people write none."""
    if value is None or not math.isfinite(value):
        return "-"
    if value and not 1e-3 <= abs(value) < 1e6:
        return f"{value:.2e}"
    decimals = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2 if abs(value) >= 1 else 3
    text = f"{value:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


@dataclass(frozen=True, slots=True)
class Column:
    """Neighbouring frames ``first`` to ``last`` (positions in the run): how many of them were refused, mostly why, and
    the medians of predicted sigma, pan and focal length of the calibrated ones. ``place`` counts the columns, and
    ``is_cut`` tells that a shot of a tracked clip begins in this one.
    """

    place: int
    first: int
    last: int
    refused: int
    code: str | None
    sigma_px: float | None
    pan_deg: float | None = None
    focal_px: float | None = None
    is_cut: bool = False

    @property
    def frames(self) -> int:
        """How many frames share the column."""
        return self.last - self.first + 1


@dataclass(frozen=True, slots=True)
class Stretch:
    """Refused frames in a row, ``first`` to ``last`` (positions in the run), with the reasons, most frequent first."""

    first: int
    last: int
    codes: tuple[tuple[str, int], ...]

    @property
    def frames(self) -> int:
        """How long it is."""
        return self.last - self.first + 1


@dataclass(frozen=True, slots=True)
class Curve:
    """How the camera of a clip moves: what is drawn, its unit, its range, and for columns with a value their height.

    ``heights`` holds a column, its value, and the value's place in the range, 0 to 1, each.
    """

    name: str
    unit: str
    low: float
    high: float
    heights: tuple[tuple[Column, float, float], ...]


@dataclass(frozen=True, slots=True)
class Timeline:
    """One video, or all pictures: its name ("" for pictures), columns, refused stretches, and how many there are."""

    name: str
    first: int
    last: int
    columns: tuple[Column, ...]
    stretches: tuple[Stretch, ...]
    stretch_count: int

    @property
    def sigma_range(self) -> tuple[float, float] | None:
        """Smallest and largest of the columns' positive sigmas, pixels at 1920 px width."""
        known = [column.sigma_px for column in self.columns if column.sigma_px]
        return (min(known), max(known)) if known else None

    @property
    def cuts(self) -> tuple[Column, ...]:
        """Columns in which a shot of a tracked clip begins."""
        return tuple(column for column in self.columns if column.is_cut)

    @property
    def curves(self) -> tuple[Curve, ...]:
        """Pan and focal length along a clip; none for pictures, whose order says nothing."""
        if not self.name:
            return ()
        wanted = (("pan", "degrees", "pan_deg", False), ("focal length", "px", "focal_px", True))
        found = (
            _curve(name, unit, [(c, getattr(c, key)) for c in self.columns], log) for name, unit, key, log in wanted
        )
        return tuple(curve for curve in found if curve is not None)

    def sigma_share(self, column: Column) -> float:
        """Where a column's sigma stands between smallest and largest, 0 to 1, on a logarithmic scale."""
        if not self.sigma_range or not column.sigma_px:
            return 0.0
        low, high = np.log(self.sigma_range)
        return float((np.log(column.sigma_px) - low) / (high - low)) if high > low else 0.5


def timelines(rows: Sequence[FrameRow]) -> list[Timeline]:
    """One timeline per video, and one of all frames that are pictures."""
    names = [row.path or "" if row.time_s is not None else "" for row in rows]
    starts = [k for k in range(len(rows)) if k == 0 or names[k] != names[k - 1]]
    return [
        _timeline(names[start], start, end - 1, rows)
        for start, end in zip(starts, [*starts[1:], len(rows)], strict=True)
    ]


def _timeline(name: str, first: int, last: int, rows: Sequence[FrameRow]) -> Timeline:
    count = last - first + 1
    edges = np.linspace(first, last + 1, min(count, COLUMNS) + 1).round().astype(int)
    columns = tuple(_column(k, int(edges[k]), int(edges[k + 1]) - 1, rows) for k in range(len(edges) - 1))
    stretches = _stretches(first, last, rows)
    longest = sorted(stretches, key=lambda s: -s.frames)[:LONGEST_STRETCHES]
    return Timeline(name, first, last, columns, tuple(sorted(longest, key=lambda s: s.first)), len(stretches))


def _curve(name: str, unit: str, values: Sequence[tuple[Column, float | None]], logarithmic: bool) -> Curve | None:
    """A curve through the columns that have a value; None for fewer than two."""
    known = [(column, value) for column, value in values if value is not None and (value > 0 or not logarithmic)]
    if len(known) < 2:
        return None
    low, high = min(value for _, value in known), max(value for _, value in known)

    def share(value: float) -> float:
        if high <= low:
            return 0.5
        return float(np.log(value / low) / np.log(high / low)) if logarithmic else (value - low) / (high - low)

    return Curve(name, unit, low, high, tuple((column, value, share(value)) for column, value in known))


def _column(place: int, first: int, last: int, rows: Sequence[FrameRow]) -> Column:
    part = rows[first : last + 1]
    codes = count_refusals(part)
    return Column(
        place,
        first,
        last,
        sum(not row.calibrated for row in part),
        codes[0][0] if codes else None,
        median_known([row.sigma_px for row in part if row.calibrated]),
        median_known([row.pan_deg for row in part]),
        median_known([row.focal_px for row in part]),
        any(_begins_shot(k, rows) for k in range(first, last + 1)),
    )


def _begins_shot(k: int, rows: Sequence[FrameRow]) -> bool:
    """Whether a shot of a tracked clip begins with a frame that is not the clip's first."""
    return k > 0 and rows[k].path == rows[k - 1].path and rows[k].shot != rows[k - 1].shot


def median_known(values: Iterable[float | None]) -> float | None:
    """Median of the values that are not None; None where all are."""
    known = [value for value in values if value is not None]
    return float(np.median(known)) if known else None


def _stretches(first: int, last: int, rows: Sequence[FrameRow]) -> list[Stretch]:
    found: list[Stretch] = []
    start: int | None = None
    for k in range(first, last + 2):
        refused = k <= last and not rows[k].calibrated
        if refused and start is None:
            start = k
        elif not refused and start is not None:
            found.append(Stretch(start, k - 1, count_refusals(rows[start:k])))
            start = None
    return found


def count_refusals(rows: Iterable[FrameRow]) -> tuple[tuple[str, int], ...]:
    """The codes of refused frames and how many frames have each, the most frequent first."""
    return tuple(Counter(code for row in rows if (code := row.refusal_code) is not None).most_common())


def clock(seconds: float) -> str:
    """A time in a video: ``1:02:03`` or ``2:03.52``; neighbours of a clip of 50 frames a second share a tenth."""
    whole, hundredths = divmod(round(seconds * 100), 100)
    minutes, second = divmod(whole, 60)
    hours, minute = divmod(minutes, 60)
    text = f"{hours}:{minute:02}:{second:02}" if hours else f"{minute}:{second:02}"
    return f"{text}.{hundredths:02}".rstrip("0") if hundredths else text

"""Straight markings, sub-pixel: profiles across rough segments, and a line through both edges of the paint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.homogeneous import Array, line_distance
from circlecal.profiles import Brightness, measure_bands, sample_profiles, smooth_along
from circlecal.results import LineCue, Segment

__all__ = ["ONE_ROUND", "TWO_ROUNDS", "WIDE_ROUND", "Rounds", "measure_lines"]

SHORTEST_PX, FEWEST_POINTS = 10.0, (8, 16)
"""Of a straight marking: its length, and a third of its profiles, within these limits, on which it is seen."""
Rounds = tuple[tuple[float, float], ...]
"""Share of the search to both sides, and how many times as far apart the profiles are."""
TWO_ROUNDS: Rounds = ((1.0, 2.0), (0.6, 1.0))
"""The first finds the line, the second measures it."""
ONE_ROUND: Rounds = ((0.6, 1.0),)
"""For lines that were fitted to this picture."""
WIDE_ROUND: Rounds = ((1.0, 1.0),)
"""For pieces that go on from others: they lie askew by less than a measurement feels."""
SMOOTHING_REACH = 3
"""Profiles over which the smoothing along a marking reaches."""
PLAIN_WIDTH_PX = 8.0
"""Across markings wider than this (at 1920 px width) the profiles are drawn out: they must show the surface beside it.
"""


def measure_lines(
    picture: Brightness,
    segments: Sequence[Segment],
    noise: float,
    search_px: float,
    spacing_px: float,
    rounds: Rounds = TWO_ROUNDS,
    widths_px: Array | None = None,
) -> list[LineCue | None]:
    """Sub-pixel points along rough straight markings, and the total least squares line through both edges of each.

    Each profile gives the two crossings of half the band's height; the line is fitted to both edges together, so
    their common bias (bloom) cancels, and the points that are kept are the flux-weighted middles. All markings are
    measured together; those that turn out to be wide once more.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    segments : sequence of Segment
        K rough markings.
    noise : float
        Grey-level noise of the picture.
    search_px : float
        How far to both sides a marking may lie, pixels at 1920 px width.
    spacing_px : float
        Distance of the profiles, pixels.
    rounds : tuple of (float, float)
        Shares of that search, and multiples of that distance, of one measurement after the other.
    widths_px : (K, 2) array, optional
        Widths that are expected at the ends, 0 where nothing is known of them.

    Returns
    -------
    list of LineCue or None
        Without names; None where no straight marking is there.
    """
    unit = picture.shape[1] / 1920.0
    scale = max(1.0, 1.5 * unit)
    found: list[LineCue | None] = [None] * len(segments)
    ends = np.array([(s.start, s.end) for s in segments]).reshape(-1, 2, 2)
    length = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    which = np.flatnonzero(length >= SHORTEST_PX)
    expected = np.zeros((len(segments), 2)) if widths_px is None else widths_px
    for reach_share, step in rounds:
        if len(which) == 0:
            return found
        samples = _band_samples(
            picture, ends[which], expected[which], noise, reach_share * search_px * unit, spacing_px, step
        )
        lines, kept = _robust_lines(samples, len(which), scale)
        enough = np.bincount(samples.piece[kept], minlength=len(which)) >= np.clip(samples.drawn // 3, *FEWEST_POINTS)
        normal = lines[:, None, :2]
        ends[which] -= ((ends[which] * normal).sum(axis=-1) + lines[:, 2:])[..., None] * normal
        which, lines = which[enough], lines[enough]
    wide = []
    for line, index, label in zip(lines, which, np.flatnonzero(enough), strict=True):
        mine = np.flatnonzero(kept & (samples.piece == label))
        cue = found[index] = _measured_line(line, ends[index], samples, mine, int(samples.drawn[label]))
        if cue.width_px > 1.5 * max(PLAIN_WIDTH_PX * unit, expected[index].max()):
            wide.append((index, cue.width_px))
    if wide:
        again = [Segment(*ends[index]) for index, _ in wide]
        widths = np.array([(width, width) for _, width in wide])
        wider = measure_lines(picture, again, noise, search_px, spacing_px, rounds[-1:], widths)
        for (index, _), again_seen in zip(wide, wider, strict=True):
            found[index] = again_seen or found[index]
    return found


@dataclass(frozen=True, slots=True)
class _BandSamples:
    """Valid profiles across several markings: middles (N, 2), both edges (2, N, 2), sigma (N,), which marking (N,);
    and how many profiles were drawn on each marking (K,).
    """

    middles: Array
    edges: Array
    sigma: Array
    piece: NDArray[np.int_]
    drawn: NDArray[np.int_]


def _band_samples(
    picture: Brightness,
    ends: Array,
    widths: Array,
    noise: float,
    reach_px: float,
    spacing_px: float,
    step: float,
) -> _BandSamples:
    """Profiles across straight pieces with these ends (K, 2, 2) and expected widths there (K, 2); ``step`` 1 is the
    full density.
    """
    unit = picture.shape[1] / 1920.0
    span = ends[:, 1] - ends[:, 0]
    length = np.hypot(span[:, 0], span[:, 1])
    fine = np.maximum(8, (length / spacing_px).astype(int))
    drawn = np.minimum(fine, np.maximum(24, (fine / step).astype(int)))
    # copies of both ends, dropped below, keep the smoothing from reaching into the next piece
    stored = drawn + 2 * SMOOTHING_REACH
    piece = np.repeat(np.arange(len(ends)), stored)
    position = np.arange(len(piece)) - np.repeat(np.cumsum(stored) - stored, stored) - SMOOTHING_REACH
    own = (position >= 0) & (position < drawn[piece])
    share = np.clip(position / (drawn[piece] - 1), 0.0, 1.0)
    base = ends[piece, 0] + share[:, None] * span[piece]
    normals = (np.stack([-span[:, 1], span[:, 0]], axis=-1) / length[:, None])[piece]
    half = reach_px + 8.0 * max(unit, 0.5) + 2.0
    offsets = np.arange(-half, half + 0.25, 0.5 * step)
    width = widths[piece, 0] + share * (widths[piece, 1] - widths[piece, 0])
    stretch = np.maximum(1.0, width / (PLAIN_WIDTH_PX * unit))
    normals = normals * stretch[:, None]
    profiles = smooth_along(sample_profiles(picture, base, normals, offsets), 1.0)
    bands = measure_bands(profiles, offsets, reach_px, noise)
    valid = own & bands.valid & (bands.width < 24 * max(unit, 0.5))
    base, normals = base[valid], normals[valid]
    middles = base + bands.center[valid, None] * normals
    edges = base + np.stack([bands.left[valid], bands.right[valid]])[..., None] * normals
    return _BandSamples(middles, edges, (bands.sigma * stretch)[valid], piece[valid], drawn)


def _measured_line(line: Array, ends: Array, samples: _BandSamples, mine: NDArray[np.int_], drawn: int) -> LineCue:
    points = samples.middles[mine]
    position = points @ (ends[1] - ends[0])
    first, last = points[np.argmin(position)], points[np.argmax(position)]
    rms = float(np.sqrt(np.mean(line_distance(line, points) ** 2)))
    width = float(np.median(np.linalg.norm(samples.edges[1, mine] - samples.edges[0, mine], axis=-1)))
    segment = Segment(first, last, len(points) / drawn)
    return LineCue(None, line, points, samples.sigma[mine], segment, rms, width_px=width)


def _robust_lines(samples: _BandSamples, count: int, scale_px: float) -> tuple[Array, NDArray[np.bool_]]:
    """Lines (K, 3) through both edges by reweighted total least squares; which profiles (N,) they keep."""
    member = (samples.piece[:, None] == np.arange(count)).astype(np.float64)
    origin = samples.middles.mean(axis=0) if len(samples.middles) else np.zeros(2)
    (x, y), (mx, my) = np.moveaxis(samples.edges - origin, -1, 0), (samples.middles - origin).T
    moments = np.stack([np.full(len(mx), 2.0), *(m.sum(axis=0) for m in (x, y, x * x, x * y, y * y))])
    weights = np.ones(len(mx))
    for scale in scale_px * np.array([8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0]):
        mass, sx, sy, xx, xy, yy = (moments * weights) @ member
        mass = np.maximum(mass, 1e-12)
        sx, sy = sx / mass, sy / mass
        # direction of the greater eigenvector of the 2 x 2 scatter
        angle = 0.5 * np.arctan2(2 * (xy / mass - sx * sy), xx / mass - sx * sx - yy / mass + sy * sy)
        a, b = -np.sin(angle), np.cos(angle)
        c = -a * sx - b * sy
        distance = a[samples.piece] * mx + b[samples.piece] * my + c[samples.piece]
        weights = 1.0 / (1.0 + (distance / scale) ** 2) ** 2
    lines = np.stack([a, b, c - a * origin[0] - b * origin[1]], axis=-1)
    return lines, np.abs(distance) < 3.0 * scale_px

"""Straight markings, sub-pixel: profiles across rough segments, and a line through both edges of the paint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Mask, line_distance
from circlecal.paint.bands import Bands, measure_bands, rise_above_noise, stand_out
from circlecal.paint.profiles import GrayPicture, Profiles, sample_profiles, smooth_along
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
ROBUST_SCALES = (8.0, 4.0, 2.0, 1.0, 1.0, 1.0, 1.0)
"""Of the robust fit of a line, round by round."""
SMOOTHING_REACH = 3
"""Profiles over which the smoothing along a marking reaches."""
PLAIN_WIDTH_PX = 8.0
"""Across markings wider than this (at 1920 px width) the profiles are drawn out: they must show the surface beside it.
"""
BESIDE_PX = (3.3, 5.4)
"""Where the ground right beside thin paint is looked at, from its middle, pixels at 1920 px width: far paint is 2 to 4
wide.
"""
THIN_PX, STRIP_PX = 5.0, 12.0
"""Width of thin paint at the most, and of what such paint may have been taken for, pixels at 1920 px width. Paint at
the rim of a lighter strip stands out along 1 to 11 times as much of the line as strip and paint together do, and
scatters less about it; paint that is wider stands out along 0.1 to 0.95 times as much (169 lines of rendered frames).
"""
EXPECTED_PX = 3.0
"""Width that is expected of thin paint at the most, where one is expected, pixels at 1920 px width."""
LEAST_UNIT = 2 / 3
"""Pixels per pixel at 1920 px width, at the least, for these lengths: smaller pictures are blurred as much, in pixels,
as those of 1280 px width.
"""
ALONG_BORDER, BORDER_PX = 0.5, 2.0
"""Share of the profiles across a marking that leave the picture, from which on it runs along the border and is measured
there all the same; and pixels of the surface that must be seen between its paint and the border.
"""
STANDS_OUT_SHARE = 0.5
"""Of its width, over which thin paint stands out above the ground right beside it: 0.5 to 0.6 along 100 rendered lines.
"""


def measure_lines(
    picture: GrayPicture,
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
    measured together; those that turn out to be wide once more, and thin ones against the ground right beside them: far
    touchlines lie at the rim of a lighter or darker strip, whose edge would be taken for one of theirs.

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
        cue = found[index] = _make_cue(line, ends[index], samples, mine, int(samples.drawn[label]))
        if cue.width_px > 1.5 * max(PLAIN_WIDTH_PX * unit, expected[index].max()):
            wide.append((index, cue.width_px))
    if wide:
        again = [Segment(*ends[index]) for index, _ in wide]
        widths = np.array([(width, width) for _, width in wide])
        wider = measure_lines(picture, again, noise, search_px, spacing_px, rounds[-1:], widths)
        for (index, _), again_seen in zip(wide, wider, strict=True):
            found[index] = again_seen or found[index]
    blurred = max(unit, LEAST_UNIT)
    may_be_thin = (expected.max(axis=1) <= EXPECTED_PX * blurred).tolist()
    thin = [
        (k, cue)
        for k, cue in enumerate(found)
        if cue is not None and may_be_thin[k] and cue.width_px <= STRIP_PX * blurred
    ]
    reach_px = rounds[-1][0] * search_px * unit
    standing = _measure_standing(picture, [cue for _, cue in thin], noise, reach_px, spacing_px)
    for (k, cue), narrower in zip(thin, standing, strict=True):
        found[k] = _choose_thinner(cue, narrower, THIN_PX * blurred)
    return found


def _measure_standing(
    picture: GrayPicture, cues: Sequence[LineCue], noise: float, reach_px: float, spacing_px: float
) -> list[LineCue | None]:
    """Thin markings measured by how they stand out above the ground right beside them; None where they do not."""
    if not cues:
        return []
    ends = np.array([(cue.segment.start, cue.segment.end) for cue in cues])
    samples = _band_samples(picture, ends, np.zeros((len(cues), 2)), noise, reach_px, spacing_px, 1.0, stands_out=True)
    lines, kept = _robust_lines(samples, len(cues), max(1.0, 1.5 * picture.shape[1] / 1920.0))
    own = [np.flatnonzero(kept & (samples.piece == k)) for k in range(len(cues))]
    return [
        _make_cue(lines[k], ends[k], samples, mine, int(samples.drawn[k])) if len(mine) >= FEWEST_POINTS[0] else None
        for k, mine in enumerate(own)
    ]


def _choose_thinner(cue: LineCue, standing: LineCue | None, thin_px: float) -> LineCue:
    """The marking as it stands out above the ground right beside it, where it does so along as much of its length, and
    where it is no thin one along a straighter line.
    """
    if standing is None or len(standing.points_px) < len(cue.points_px):
        return cue
    if cue.width_px > thin_px and standing.rms_px > cue.rms_px:
        return cue
    return replace(standing, width_px=min(cue.width_px, standing.width_px / STANDS_OUT_SHARE))


@dataclass(frozen=True, slots=True)
class _BandSamples:
    """Valid profiles across several markings, in order: middles (2, N), both edges (2, 2, N: which edge, x or y),
    sigma (N,), which marking (N,); and how many profiles were drawn on each marking (K,).
    """

    middles: Array
    edges: Array
    sigma: Array
    piece: NDArray[np.int_]
    drawn: NDArray[np.int_]


def _band_samples(
    picture: GrayPicture,
    ends: Array,
    widths: Array,
    noise: float,
    reach_px: float,
    spacing_px: float,
    step: float,
    *,
    stands_out: bool = False,
) -> _BandSamples:
    """Profiles across straight pieces with these ends (K, 2, 2) and expected widths there (K, 2); ``step`` 1 is the
    full density. Bands lie above the surface, or above the ground right beside each of their places.
    """
    unit = picture.shape[1] / 1920.0
    first, span = ends[:, 0].T, (ends[:, 1] - ends[:, 0]).T
    length = np.hypot(*span)
    fine = np.maximum(8, (length / spacing_px).astype(int))
    drawn = np.minimum(fine, np.maximum(24, (fine / step).astype(int)))
    # copies of both ends, dropped below, keep the smoothing from reaching into the next piece
    stored = drawn + 2 * SMOOTHING_REACH
    piece = np.arange(len(ends)).repeat(stored)
    position = np.arange(len(piece)) - (np.cumsum(stored) - stored + SMOOTHING_REACH).take(piece)
    last = drawn.take(piece) - 1
    own = (position >= 0) & (position <= last)
    share = np.minimum(np.maximum(position / last, 0.0), 1.0)
    # along each piece: where it begins, where it leads, its normal, its width and how that grows
    along = np.concatenate([first, span, [-span[1] / length, span[0] / length], [widths[:, 0], np.diff(widths)[:, 0]]])
    along = along.take(piece, axis=1)
    base, normals = along[:2] + share * along[2:4], along[4:6]
    half = reach_px + 8.0 * max(unit, 0.5) + 2.0
    offsets = np.arange(-half, half + 0.25, 0.5 * step)
    stretch = None
    if widths.max() > PLAIN_WIDTH_PX * unit:
        stretch = np.maximum(1.0, (along[6] + share * along[7]) / (PLAIN_WIDTH_PX * unit))
        normals = normals * stretch
    profiles = sample_profiles(picture, base.T, normals.T, offsets)
    bordering = _run_along_border(profiles, piece, stored)
    if bordering.any():
        beside = base.T[bordering], normals.T[bordering]
        profiles[bordering] = sample_profiles(picture, *beside, offsets, repeat_border=True)
    profiles = smooth_along(profiles, 1.0)
    if stands_out:
        nearest, farthest = BESIDE_PX
        blurred = max(unit, LEAST_UNIT)
        profiles = stand_out(profiles, offsets, (nearest * blurred, farthest * blurred))
    bands = measure_bands(profiles, offsets, reach_px)
    if bordering.any():
        own &= ~bordering | _show_both_sides(picture, base, normals, bands)
    valid = np.flatnonzero(own & rise_above_noise(bands, noise) & (bands.width < 24 * max(unit, 0.5)))
    base, normals = base.take(valid, axis=1), normals.take(valid, axis=1)
    middles = base + bands.center.take(valid) * normals
    edges = base + np.array([bands.left.take(valid), bands.right.take(valid)])[:, None] * normals
    sigma = bands.sigma(noise) * (1.0 if stretch is None else stretch)
    return _BandSamples(middles, edges, sigma.take(valid), piece.take(valid), drawn)


def _run_along_border(profiles: Profiles, piece: NDArray[np.int_], count: NDArray[np.int_]) -> Mask:
    """Which profiles (N, S) across pieces (N,), so many on each (K,), are of one that runs so near to the picture's
    border that most of its profiles leave the picture.
    """
    leaves = np.isnan(profiles[:, 0]) != np.isnan(profiles[:, -1])
    share = np.bincount(piece, leaves, len(count)) / count
    return np.asarray((share > ALONG_BORDER)[piece])


def _show_both_sides(picture: GrayPicture, base: Array, normals: Array, bands: Bands) -> Mask:
    """Which bands across places (2, N) have some of the surface in the picture beside both of their edges."""
    last = np.array(picture.shape[::-1])[:, None] - 1.0 - BORDER_PX
    edges = base + np.array([bands.left, bands.right])[:, None] * normals
    return np.asarray(((edges >= BORDER_PX) & (edges <= last)).all(axis=(0, 1)))


def _make_cue(line: Array, ends: Array, samples: _BandSamples, mine: NDArray[np.int_], drawn: int) -> LineCue:
    points = samples.middles.take(mine, axis=1).T
    position = points @ (ends[1] - ends[0])
    first, last = points[position.argmin()], points[position.argmax()]
    distance = line_distance(line, points)
    across = samples.edges[1] - samples.edges[0]
    width = float(median_of_rows(np.hypot(across[0].take(mine), across[1].take(mine))))
    segment = Segment(first, last, len(points) / drawn)
    rms = sqrt(float(distance @ distance) / len(points))
    return LineCue(None, line, points, samples.sigma.take(mine), segment, rms, width_px=width)


def _robust_lines(samples: _BandSamples, count: int, scale_px: float) -> tuple[Array, NDArray[np.bool_]]:
    """Lines (K, 3) through both edges by reweighted total least squares; which profiles (N,) they keep."""
    member = (samples.piece[:, None] == np.arange(count)).astype(np.float64)
    origin = samples.middles.sum(axis=1) / max(samples.middles.shape[1], 1)
    (mx, my), (x, y) = samples.middles - origin[:, None], np.moveaxis(samples.edges - origin[:, None], 1, 0)
    moments = np.array([np.full(len(mx), 2.0), *(m[0] + m[1] for m in (x, y, x * x, x * y, y * y))])
    weighted = moments
    for scale in ROBUST_SCALES:
        mass, *sums = weighted @ member
        sx, sy, xx, xy, yy = sums / np.maximum(mass, 1e-12)
        # direction of the greater eigenvector of the 2 x 2 scatter
        angle = 0.5 * np.arctan2(2 * (xy - sx * sy), xx - sx * sx - yy + sy * sy)
        a, b = -np.sin(angle), np.cos(angle)
        lines = np.array([a, b, -a * sx - b * sy])
        by_x, by_y, constant = lines.take(samples.piece, axis=1)
        distance = by_x * mx + by_y * my + constant
        weighted = moments / np.square(1.0 + np.square(distance / (scale * scale_px)))
    lines[2] -= origin @ lines[:2]
    return lines.T, np.abs(distance) < 3.0 * scale_px

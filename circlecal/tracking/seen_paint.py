"""Where a picture shows the paint of the markings that a camera puts into view.

The paint is looked for across the marking at each place. What is kept of a frame is small: places on the field, pixels,
normals and standard deviations, from which the frame can be fitted again when its tripod is known better.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.paint.bands import MeasuredCurve, measure_curve
from circlecal.paint.profiles import GrayPicture
from circlecal.tracking.faint_paint import PaintStrength, measure_faint
from circlecal.tracking.markings import CLEAR_PX_M, NARROWEST_PX, SPACING_PX, Places
from circlecal.tracking.one_line import JUMP_PX, keep_one_line
from circlecal.tracking.thin_paint import measure_thin

ACROSS_PX = 5.0
"""Least reach of a profile to both sides beyond the paint, pixels at 1920 px width."""
FARTHEST_SIGMA_PX = 12.0
"""A marking whose place is less certain than this, pixels at 1920 px width, is another one as likely."""
USUAL_BLUR, BIAS_BY_BLUR = 0.3, 0.3
"""Quantile of the blurs along a picture's markings that is the picture's own, and by how much the middle of a marking
may be off per pixel of further blur. A far touchline before a strip of another colour looks broad on one side: over
three rendered clips its middles are off by 0.06 px where the blur is the usual one, by 0.3 with one pixel more, by
0.8 with two and a half.
"""
FAINT_BIAS_PX = 4.0
"""By how much the middle of such paint may be off, pixels at 1920 px width: before boards it is off by 0.3 to 1 in all
frames of three rendered clips, to one side, and a number of frames does not lower that.
"""
PIECE_BIAS_PX = 8.0
"""By how much paint that only whole pieces of a line show may be off, pixels at 1920 px width: all their places, three
times as many as repeat an error elsewhere, are one measurement.
"""
LEAST_SHARE = 0.35
"""Share of the places of a marking with paint below which what was found is not the marking: of a halfway line that a
pan of 44 px smears, 12 of 60 places showed a false ridge, and 3 such frames of 58 made a pitch 0.6 m too short.
Markings that are seen have 0.6 to 1, between players and in worn paint 0.45.
"""
BROAD_PX, MISSED_PLACES, MISSED_SHARE = 2.0, 24, 0.35
"""A marking whose paint is broader than so many pixels at so many places, and shows in less than this share of all, is
not where the camera puts it: in real clips the halfway line, 12 px beside its place and 7 px broad, while circle and
touchline agreed; it showed at 0 to 0.3 of its places where it crossed its own, right ones show at 0.38 and more.
"""
OPTICAL_BLUR_PX = 2.2
"""Width that optics and encoding add to paint, pixels at 1920 px width."""
SMEARED = 2.5
"""Paint that moved across by so many of its own widths in the picture, blurred, while the shutter was open, is too pale
to be expected.
"""
PALE = 1.0
"""Paint that moved across by so many of its own widths is too pale for its absence to say anything: by half. Of a
halfway line that a rendered pan of 7 to 11 px smears no place is found, where all else shows its paint.
"""
BESIDE_PX, BESIDE_BIAS_PX = 4.0, 2.0
"""How near to the edge of another marking's paint a middle is drawn towards that, and by how much it may then be off,
pixels at 1920 px width: over twelve rendered clips nearer ones are off by 0.4 to 0.5, on average 0.2 towards the other
one, all others by 0.2. One such place of a frame made a pitch 0.03 m too short, two of another frame 0.07 m too long.
Where a pan of 30 px smears the front of a penalty area over the last places of its arc, these are off by 0.5 to 1.3,
inward in all frames.
"""
BIAS_BY_SMEAR = 0.3
"""By how much the middle of paint that moves while the shutter is open may be off, per pixel of its way across it: in
fast pans of four rendered clips, encoded, middles are off by two to four times as much as elsewhere, to one side along
a whole marking, so that neither its length nor the number of frames averages it out. Over eleven rendered clips, which
were looked at, mean errors of frames are 0.27 (median) and 0.53 px (90 %) at 1920 px width with 0.1, and 0.20 and 0.40
with it; the worst clip has 0.79 and 1.43 with 0.1, and 0.55 and 0.90 with it; of eight clips 0.5 is better in three and
worse in five. One clip, whose smeared frames tell the length of its pitch, has 0.09 with 0.1, and 0.27 with it. The
tripod is fitted with it, and frames are followed without. Followed with it, 14 of 87 frames of two real clips lost
their answers, all of which lay on their paint, and one pitch the evidence of its length; a clip that pans by 220 px a
frame, encoded strongly, had its worst frame 10.2 px off instead of 15.7, at 2.5 instead of 4.1 standard deviations.
"""
NARROW_SHARE = 0.7
"""Share of the width that its marking usually has in a picture, as a share of the one that the camera expects, below
which paint is that of another one: at the corner of a penalty area in a fast pan the sharp line is seen beside the
smeared one. In smeared frames of twelve rendered clips such middles are off by 0.5 to 1.3 px at 1920 px width, others
by 0.3.
"""
NARROW_PAINT = 0.6
"""Paint is narrow up to so much of the width that it is seen with: the picture's blur is what makes it broad.
"""
PIECE = 24
"""Places in a row within which paint has one usual contrast."""
FEWEST_PLACES = 8
"""Fewer places are not looked at: they have no neighbours that paint is known by."""


@dataclass(frozen=True, slots=True)
class MeasuredFrame:
    """Paint that a picture shows of the markings.

    Attributes
    ----------
    marking, field_m : (M,), (M, 2) arrays
        Which marking, and where on it before it moves with the sizes of the field: see
        :func:`circlecal.tracking.markings.place_markings`.
    points_px, normals : (M, 2) arrays
        Middle of the paint, and the direction across it in which it was measured.
    width_px, scale_px_m : (M,) arrays
        Full width at half the peak, and pixels per metre across the marking.
    bias_px : (M,) array
        By how much the middle may be off along the normal, a standard deviation, because of what lies beside the paint.
    expected, painted : (K,) int arrays
        Of each marking the number of places that the camera puts before grass and that are broad enough to be expected
        to show paint, and of those that do.
    missing : int
        Number of markings that should be seen broadly and are not seen at all.
    """

    marking: Indices
    field_m: Array
    points_px: Array
    normals: Array
    width_px: Array
    scale_px_m: Array
    bias_px: Array
    expected: Indices
    painted: Indices
    missing: int = 0

    @classmethod
    def unseen(cls, expected: Indices) -> MeasuredFrame:
        """A frame without paint, of whose markings so many places (K,) are expected to show it."""
        empty, none = np.zeros((0, 2)), np.zeros(0)
        nowhere = np.zeros(0, dtype=expected.dtype)
        return cls(nowhere, empty, empty, empty, none, none, none, expected, np.zeros_like(expected))

    @property
    def painted_share(self) -> float:
        """Share of the expected places that show paint, 0 where none is expected."""
        return float(self.painted.sum() / max(self.expected.sum(), 1))

    def doubt_smear(self, blur_px: Array) -> MeasuredFrame:
        """The paint of a picture that moved so far (2,) while the shutter was open, with what the encoder makes of
        smeared paint as a further error of its middle.
        """
        return replace(self, bias_px=np.hypot(self.bias_px, BIAS_BY_SMEAR * np.abs(self.normals @ blur_px)))

    def leave_out(self, marking: int) -> MeasuredFrame:
        """The frame without the paint of one marking."""
        kept = self.marking != marking
        per_place = ("marking", "field_m", "points_px", "normals", "width_px", "scale_px_m", "bias_px")
        return replace(self, **{name: getattr(self, name)[kept] for name in per_place})


def measure_markings(
    picture: GrayPicture,
    places: Places,
    spread_px: Array,
    unit: float,
    count: int,
    blur_px: Array | None = None,
    grass: NDArray[np.uint8] | None = None,
) -> tuple[MeasuredFrame, Indices]:
    """Look for paint at places.

    Parameters
    ----------
    picture : (H, W) uint8
        Gray levels.
    places : Places
        Where the camera puts the markings.
    spread_px : (M,) array
        Standard deviation of the places along their normals.
    unit : float
        Width of the picture over 1920.
    count : int
        Number K of markings.
    blur_px : (2,) array, optional
        Way of the picture while the shutter was open.
    grass : (h, w) uint8, optional
        Playing surface in a reduced picture: what is seen elsewhere is not the marking.

    Returns
    -------
    MeasuredFrame, (P,) int array
        The paint, and the numbers of the places that show it.
    """
    blur_px = np.zeros(2) if blur_px is None else blur_px
    smear = np.abs(places.normals @ blur_px) / (places.width_px + OPTICAL_BLUR_PX * unit)
    keep = (spread_px < FARTHEST_SIGMA_PX * unit) & (smear < SMEARED)
    if grass is not None:
        keep &= _lie_on(grass, places.pixels, picture)
    index = np.flatnonzero(keep)
    beside = _lie_beside_others(places, blur_px, unit)[index]
    asked = _AskedPlaces.of(places.take(index), spread_px[index], smear[index], beside, blur_px, unit, count)
    expected = asked.count_places(asked.is_expected)
    if len(index) < FEWEST_PLACES:
        return MeasuredFrame.unseen(expected), index[:0]
    found, is_alone = asked.measure(picture)
    on, missing = asked.tell_markings(found)
    on, is_double = asked.leave_one_line(on, found)
    expected = np.where(is_double, 0, expected)
    return asked.collect(found, is_alone, on, expected, missing), index[on]


def _lie_beside_others(places: Places, blur_px: Array, unit: float) -> Mask:
    """Which places (M,) have the paint of another marking right beside them, as far as it was smeared.

    It draws their middles to itself: at corners, where an arc ends at a line, and where a circle crosses one.
    """
    is_beside = np.zeros(len(places.marking), np.bool_)
    if len(is_beside) == 0:
        return is_beside
    way, spacing = float(np.hypot(*blur_px)), SPACING_PX * unit
    near = BESIDE_PX * unit + places.width_px / 2.0
    reach = float(near.max()) + way / 2.0 + 1.5 * spacing
    pairs = cKDTree(places.pixels).query_pairs(reach, output_type="ndarray")
    pairs = pairs[places.marking[pairs[:, 0]] != places.marking[pairs[:, 1]]]
    one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    apart = places.pixels[one] - places.pixels[other]
    # the other's paint goes on to its next place, and was smeared; paint is smoothed along its own marking
    along = np.broadcast_to(blur_px / max(way, 1e-9), apart.shape)
    tangents = np.column_stack([places.normals[:, 1], -places.normals[:, 0]])
    for direction, length in ((along, way / 2.0), (tangents[other], spacing / 2.0), (tangents[one], spacing)):
        way_along = (apart * direction).sum(axis=1)
        apart = apart - np.clip(way_along, -length, length)[:, None] * direction
    is_beside[one[np.hypot(*apart.T) < near[other]]] = True
    return is_beside


def _lie_on(grass: NDArray[np.uint8], pixels: Array, picture: GrayPicture) -> Mask:
    """Which pixels (M, 2) of a picture lie on the playing surface of a reduced one."""
    height, width = picture.shape
    rows, columns = grass.shape
    at = (pixels * (columns / width, rows / height)).astype(int)
    return np.asarray(grass[np.clip(at[:, 1], 0, rows - 1), np.clip(at[:, 0], 0, columns - 1)] > 0, np.bool_)


@dataclass(frozen=True, slots=True)
class _AskedPlaces:
    """The M places on K markings at which paint is looked for.

    Attributes
    ----------
    places : Places
        Where.
    spread_px, smear, moved_px : (M,) arrays
        Standard deviation of a place along its normal, how far the paint moved across while the shutter was open, in
        its own widths in the picture, and in pixels.
    is_beside : (M,) bool
        Which lie right beside the paint of another marking, as far as it was smeared.
    blur_px : (2,) array
        Way of the picture in that time.
    unit : float
        Width of the picture over 1920.
    count : int
        K.
    """

    places: Places
    spread_px: Array
    smear: Array
    is_beside: Mask
    moved_px: Array
    blur_px: Array
    unit: float
    count: int

    @classmethod
    def of(
        cls, places: Places, spread_px: Array, smear: Array, is_beside: Mask, blur_px: Array, unit: float, count: int
    ) -> _AskedPlaces:
        """Places with what is known of them."""
        return cls(places, spread_px, smear, is_beside, np.abs(places.normals @ blur_px), blur_px, unit, count)

    @property
    def is_expected(self) -> Mask:
        """Where paint is broad enough to be expected."""
        return np.asarray(self.places.width_px > NARROWEST_PX, np.bool_)

    @property
    def is_far(self) -> Mask:
        """Where what lies beside the paint may be taken for it."""
        return np.asarray(self.places.scale_px_m < CLEAR_PX_M * self.unit, np.bool_)

    def count_places(self, chosen: Mask) -> Indices:
        """Number of chosen places of each marking (K,)."""
        return np.bincount(self.places.marking[chosen], minlength=self.count)

    def number_pieces(self) -> NDArray[np.int64]:
        """Growing numbers (M,) of the pieces of markings within which paint has one usual contrast."""
        marking = self.places.marking
        looked_for = np.bincount(marking, minlength=self.count)
        start = np.searchsorted(marking, np.arange(self.count))
        pieces_of = np.where(looked_for > 0, (looked_for - 1) // PIECE + 1, 0)
        first = np.cumsum(pieces_of) - pieces_of
        return ((np.arange(len(marking)) - start[marking]) // PIECE + first[marking]).astype(np.int64)

    def measure(self, picture: GrayPicture) -> tuple[MeasuredCurve, Mask]:
        """The paint across the markings, and which places show it alone rather than along whole pieces of a line."""
        places, pieces = self.places, self.number_pieces()
        reach = max(ACROSS_PX * self.unit, 3.5) + 2.0 * self.spread_px + places.width_px + 0.5 * self.moved_px
        # profiles cross the paint at its middle: of an offset less than their step they tell a half or the double
        middles = places.pixels + places.offset_middles(self.blur_px)[:, None] * places.normals
        found = measure_curve(picture, middles, places.normals, reach, pieces)
        is_thin = self.is_far & (self.smear < PALE)
        found = measure_thin(picture, found, is_thin, pieces, self.unit)
        is_alone = found.supported
        return self._measure_faint(picture, found, is_thin & ~self.is_expected & ~is_alone, pieces, reach), is_alone

    def _measure_faint(
        self, picture: GrayPicture, found: MeasuredCurve, faint: Mask, pieces: NDArray[np.int64], reach: Array
    ) -> MeasuredCurve:
        """The paint (M,), with that of lines too thin for single places along their pieces."""
        if not faint.any():
            return found
        on, scale = found.supported, self.places.scale_px_m[found.supported]
        paint = PaintStrength.of(found.contrast[on], found.width[on], scale, scale > CLEAR_PX_M * self.unit)
        if paint is None:
            return found
        height, width = paint.ridges(self.places.scale_px_m, self.places.width_px, self.moved_px)
        return measure_faint(picture, found, faint, pieces, height, width, reach, self.unit)

    def tell_markings(self, found: MeasuredCurve) -> tuple[Mask, int]:
        """Which places (M,) show paint as broad as this camera shows it, blurred, on markings that show enough of it;
        and how many markings should be seen broadly and are not.
        """
        places = self.places
        blurred = OPTICAL_BLUR_PX * self.unit + 1.0 + self.moved_px
        on = found.supported & (found.width < 1.6 * places.width_px + 2.0 * blurred)
        on &= ~self._look_narrow(found, on)
        looked_for = np.bincount(places.marking, minlength=self.count)
        share = self.count_places(np.asarray(on, np.bool_)) / np.maximum(looked_for, 1)
        broad = self.count_places(np.asarray((places.width_px > BROAD_PX) & (self.smear < PALE), np.bool_))
        missing = int(np.count_nonzero((broad >= MISSED_PLACES) & (share < MISSED_SHARE)))
        return np.asarray(on & (share[places.marking] >= LEAST_SHARE), np.bool_), missing

    def _look_narrow(self, found: MeasuredCurve, on: Mask) -> Mask:
        """Which places (M,) of those with paint show narrower paint than the others on their marking."""
        breadth = found.width / np.hypot(np.hypot(self.places.width_px, self.moved_px), OPTICAL_BLUR_PX * self.unit)
        usual = np.zeros(self.count)
        for marking in np.unique(self.places.marking[on]):
            usual[marking] = np.median(breadth[on & (self.places.marking == marking)])
        return np.asarray(breadth < NARROW_SHARE * usual[self.places.marking], np.bool_)

    def leave_one_line(self, on: Mask, found: MeasuredCurve) -> tuple[Mask, Mask]:
        """Those of the places (M,) with paint that lie on the one line of a far marking, and which markings (K,) are
        two lines.
        """
        is_far = on & self.is_far
        kept, is_double = keep_one_line(is_far, found.offset, self.places.marking, JUMP_PX * self.unit, self.count)
        return on & (kept | ~is_far), is_double

    def collect(self, found: MeasuredCurve, is_alone: Mask, on: Mask, expected: Indices, missing: int) -> MeasuredFrame:
        """The frame with the paint of some places (M,), of whose markings so many places (K,) are expected to show it,
        and so many markings are not seen.
        """
        shown = self.places.take(np.flatnonzero(on))
        variance = _blur_variance(found.width[on], shown.width_px, self.moved_px[on], self.unit)
        by_blur = shown.shift_by_blur(variance)
        bias = _bias_sigmas(found.width[on], shown.width_px, self.moved_px[on])
        bias = np.hypot(bias, shown.offset_middles(self.blur_px) + by_blur)
        bias = np.where(self.is_beside[on], np.maximum(bias, BESIDE_BIAS_PX * self.unit), bias)
        faint_bias = np.where(is_alone[on], FAINT_BIAS_PX, PIECE_BIAS_PX) * self.unit
        return MeasuredFrame(
            shown.marking,
            shown.field_m,
            shown.pixels + (found.offset[on] - by_blur)[:, None] * shown.normals,
            shown.normals,
            found.width[on],
            shown.scale_px_m,
            np.where(self.is_expected[on], bias, faint_bias),
            expected,
            self.count_places(np.asarray(on & self.is_expected, np.bool_)),
            missing,
        )


def _bias_sigmas(width_px: Array, paint_px: Array, moved_px: Array) -> Array:
    """By how much a middle may be off (M,) where the paint looks broader than paint does in this picture, pixels.

    A full width w at half the peak, of paint of width p that moved by m, comes of a blur ``b^2 = w^2 - p^2 - m^2``.
    """
    if len(width_px) == 0:
        return np.zeros(0)
    blur = np.sqrt(np.maximum(width_px**2 - paint_px**2 - moved_px**2, 0.0))
    at = int(USUAL_BLUR * (len(blur) - 1))
    usual = float(np.partition(blur, at)[at])
    return np.asarray(BIAS_BY_BLUR * np.maximum(blur - usual, 0.0))


def _blur_variance(width_px: Array, paint_px: Array, moved_px: Array, unit: float) -> float:
    """Variance of the blur of a picture's optics, pixels squared, by how broad its narrow paint (M,) looks.

    Paint of width p that moved across by m is two even spreads with variances of p^2 / 12 and m^2 / 12. With the blur's
    own v the paint has about the full width at half the peak w of a normal distribution, so that
    ``v = w^2 / (8 log 2) - (p^2 + m^2) / 12``, as long as the blur is what is broad.
    """
    is_narrow = np.hypot(paint_px, moved_px) < NARROW_PAINT * width_px
    if np.count_nonzero(is_narrow) < FEWEST_PLACES:
        return (OPTICAL_BLUR_PX * unit) ** 2 / (8.0 * np.log(2.0))
    own = width_px**2 / (8.0 * np.log(2.0)) - (paint_px**2 + moved_px**2) / 12.0
    return max(float(np.median(own[is_narrow])), 0.0)

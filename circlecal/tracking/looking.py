"""To look at a picture with a known tripod: the markings in view, their paint, and the head that it says."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.detection.field_region import FieldRegion, find_field_region
from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array
from circlecal.paint.brightness import brightness_of_paint
from circlecal.paint.colour import surface_colour
from circlecal.rig.tripod import PLACE, TripodEstimate
from circlecal.stages.mask import MaskConfig
from circlecal.tracking.coarse_motion import coarsen
from circlecal.tracking.frame_paint import add_by_part, number_parts, residuals_of
from circlecal.tracking.head_fit import (
    LEAST_INFORMATION,
    HeadFit,
    LinearPaint,
    count_crossing,
    fit_head,
    follow_common,
)
from circlecal.tracking.markings import DrawnTemplate, place_markings, template_curves
from circlecal.tracking.motion import SmallPicture
from circlecal.tracking.painters import align_errors, move_by_errors
from circlecal.tracking.search import GridViews, RidgePicture, map_ridges, search_heads
from circlecal.tracking.seen_paint import MeasuredFrame, measure_markings

LEAST_PLACES = 36
"""Places with paint, 9 px apart at 1920 px width, that confirm a head: two or three markings."""
LEAST_PAINTED, LEAST_EXPLAINED = 0.45, 0.75
"""Share of the expected places that show paint, and of these that the head explains: of right heads 0.5 to 1 and 0.9 to
1, of wrong ones 0.05 to 0.35.
"""
LEAST_FOUND = 0.5
"""Share of the expected places that show paint where a head was found by searching alone: a wrong one of a rendered
clip, with the boards taken for the touchline, had 0.45, the right one 0.96.
"""
SURE_PAINTED, SURE_EXPLAINED = 0.7, 0.95
"""Shares of painted places and of explained ones from which on no other proposal is looked at: of ten right heads in
faint paint 0.74 to 0.94 and 1, of wrong ones at most 0.41 and 1.
"""
LEAST_CROSSING = 1.25
"""How far the paint tells the pan where a head was found by searching alone, as a number of places on a marking square
to the way of the picture while the head pans: a touchline looks the same under any pan, but for what surface and lens
make of it. In rendered clips one or two touchlines have 0.00002 to 0.85, a penalty area seen from far beside it 1.9 to
4.6, a circle or a penalty area before the camera 16 to 40.
"""
LARGEST_RMS_PX = 1.6
"""Of the paint about the head's markings, pixels at 1920 px width."""
LARGEST_HEAD_SIGMA_PX = 3.0
"""Standard deviation by which the paint alone leaves the middle and the border of the picture open, pixels at 1920."""
FOUND_SD_PX, FOUND_SD_ZOOM = 5.0, 0.012
"""Of a head that was just found by searching, pixels at 1920 px width and logarithm of the focal length."""
SMALL_WIDTH_PX = 320
LEAST_GRASS = 0.15
"""Share of the picture that the playing surface covers where a search is worth it."""
BESIDE_GRASS_PX = 4
"""By how much the playing surface is broader at its sides than its largest patches, pixels of 240 in a row: behind a
halfway line near the picture's border the strip of grass is too small to count, and the line would lie beside it.
"""
OTHER_SURFACE = 15.0
"""Distance of the median colours of two surfaces, levels of a and b of CIE Lab, from which on they are different ones:
that of one pitch stays within 3 over a clip, the dark run-off before it is 40 away.
"""
THUMBNAIL, CUT_LEVELS = (32, 18), 12.0
"""Size of the pictures by which shots are told apart, and how far they differ on average across a cut, gray levels:
neighbours in a fast pan by 2 to 8.
"""


@dataclass(frozen=True)
class LookedAt:
    """A picture in the shapes that tracking needs it in.

    Attributes
    ----------
    gray : (H, W) uint8
        Brightness, along the colour of the paint where that is known, and darkness where paint is dark: markings are
        lighter than their surface in it.
    small : SmallPicture
        Reduced, for motion.
    reduced : (h, w, 3) uint8
        Colours in a reduced picture.
    region : FieldRegion
        Playing surface in it.
    mask : MaskConfig
        How paint, surface and ridges are found.
    """

    gray: NDArray[np.uint8]
    small: SmallPicture
    reduced: NDArray[np.uint8]
    region: FieldRegion
    mask: MaskConfig

    @classmethod
    def of(cls, picture: NDArray[np.uint8], mask: MaskConfig, beside: LookedAt | None = None) -> LookedAt:
        """Prepare a BGR picture (H, W, 3); the playing surface is taken from a picture beside it where one is given."""
        gray = brightness_of_paint(picture, mask.paint_bgr, mask.other_paint_bgr)
        if mask.paint_bgr is None and mask.detector.marking == "dark":
            gray = np.asarray(cv2.bitwise_not(gray), np.uint8)
        if beside is not None and beside.gray.shape == gray.shape:
            return cls(gray, SmallPicture.of(gray), beside.reduced, beside.region, mask)
        height, width = gray.shape
        step = max(1, width // (2 * SMALL_WIDTH_PX))
        # every so many-th pixel is enough for the averaging, and much faster to fetch
        fetched = cv2.resize(picture, (width // step, height // step), interpolation=cv2.INTER_NEAREST)
        size = SMALL_WIDTH_PX, round(SMALL_WIDTH_PX * height / width)
        colours = np.asarray(cv2.resize(fetched, size, interpolation=cv2.INTER_AREA), np.uint8)
        region = find_field_region(colours, mask.detector.field_region)
        return cls(gray, SmallPicture.of(gray), colours, region, mask)

    @cached_property
    def coarse(self) -> SmallPicture:
        """For the motion of a smeared picture."""
        return coarsen(self.small)

    @cached_property
    def grass(self) -> NDArray[np.uint8]:
        """Playing surface, not 0, in a reduced picture (h, w), with the lines at its sides."""
        return np.asarray(cv2.dilate(self.region.hull, np.ones((1, 2 * BESIDE_GRASS_PX + 1), np.uint8)), np.uint8)

    @property
    def shows_surface(self) -> bool:
        """Whether the playing surface covers enough of the picture for a search to be worth it."""
        return self.region.area_share >= LEAST_GRASS

    @cached_property
    def colour(self) -> Array | None:
        """Median a and b (2,) of the playing surface in CIE Lab, levels; None where there is none."""
        found = surface_colour(self.reduced, self.region.hull)
        return None if found is None else found[1:]

    def take_other_surface(self) -> LookedAt:
        """The picture with what is broadest beside the playing surface in the place of it: a smooth dark run-off that
        fills the lower picture has more pixels of one colour than mown grass.
        """
        return replace(self, region=find_field_region(self.reduced, self.mask.detector.field_region, self.region))

    def take_surface(self, colour: Array | None) -> LookedAt:
        """The picture with the playing surface that is more like a colour (2,), where the first one is not."""
        if colour is None or self.colour is None or np.hypot(*(self.colour - colour)) < OTHER_SURFACE:
            return self
        other = self.take_other_surface()
        nearer = other.colour is not None and np.hypot(*(other.colour - colour)) < np.hypot(*(self.colour - colour))
        return other if nearer else self

    @property
    def size(self) -> tuple[int, int]:
        """Width and height."""
        return self.gray.shape[1], self.gray.shape[0]

    def differs_from(self, other: LookedAt) -> bool:
        """Whether the other picture, shown before or after, belongs to another shot: hardly anything is alike."""
        if self.gray.shape != other.gray.shape:
            return True
        own, before = (cv2.resize(p.small.gray, THUMBNAIL, interpolation=cv2.INTER_AREA) for p in (self, other))
        return float(np.mean(cv2.absdiff(own, before))) > CUT_LEVELS

    @cached_property
    def ridges(self) -> RidgePicture:
        """For a search."""
        return map_ridges(self.gray, self.grass, self.mask.detector.ridges)


@dataclass(frozen=True, slots=True)
class Look:
    """What a look brought: the paint, the head that it says, and where the middle (2,) of the picture is."""

    measured: MeasuredFrame
    fit: HeadFit
    is_confirmed: bool
    middle_px: Array

    @property
    def worth(self) -> float:
        """How much paint there is, as far as it should be there and is explained."""
        return float(self.measured.painted.sum() * self.measured.painted_share * self.fit.inlier_share)

    @property
    def is_in_place(self) -> bool:
        """Whether nearly all paint is where the head puts it, though it may not tell the head: a touchline alone leaves
        the pan open.
        """
        seen = self.measured
        is_seen = len(seen.marking) >= LEAST_PLACES and seen.painted_share > SURE_PAINTED and seen.missing == 0
        return is_seen and self.fit.inlier_share > SURE_EXPLAINED

    @property
    def is_found(self) -> bool:
        """Whether the paint alone tells the head, without one that is known beside it."""
        return self.is_confirmed and self.crossing >= LEAST_CROSSING

    @property
    def crossing(self) -> float:
        """How far the explained paint tells the pan, as a number of places: see :func:`count_crossing`."""
        explained, by_angle = self.fit.explained, self.fit.by_head / np.exp(self.fit.head[0])
        points, normals = self.measured.points_px[explained], self.measured.normals[explained]
        return count_crossing(by_angle[explained], normals, points - self.middle_px)

    @property
    def is_sure(self) -> bool:
        """Whether no other head is worth a look."""
        seen = self.measured.painted_share
        return self.is_found and seen > SURE_PAINTED and self.fit.inlier_share > SURE_EXPLAINED

    def is_better(self, other: Look) -> bool:
        """Whether this look explains more paint."""
        return self.worth > other.worth


@dataclass(frozen=True)
class Place:
    """A tripod before a field, as pictures are looked at with it."""

    tripod: TripodEstimate
    template: FieldTemplate
    drawn: DrawnTemplate

    @classmethod
    def of(cls, tripod: TripodEstimate, template: FieldTemplate) -> Place:
        """The tripod before the template's field."""
        return cls(tripod, template, template_curves(template))

    @property
    def unit(self) -> float:
        """Width of the pictures over 1920."""
        return self.tripod.size[0] / 1920.0

    @cached_property
    def views(self) -> GridViews:
        """What the tripod may put into view, for a search."""
        return GridViews.of(self.tripod, self.drawn, self.template)

    def look(
        self,
        picture: LookedAt,
        head: Array,
        covariance: Array,
        by_common: Array | None = None,
        blur_px: Array | None = None,
    ) -> Look:
        """Look where a head puts the markings, and fit it to their paint.

        Parameters
        ----------
        picture : LookedAt
            Of the tripod's size.
        head, covariance : (3,), (3, 3) arrays
            Where the head is expected to be.
        by_common : (3, K) array, optional
            How the expected head follows the common parameters; where it was found in the picture itself, as the
            markings in view make it follow, when None.
        blur_px : (2,) array, optional
            Way of the picture while the shutter was open.
        """
        tripod = self.tripod
        model = tripod.model
        theta, by_own, by_all = model.linearise_one(head, tripod.mean)
        width = self.template.marking_width_m + tripod.mean[PLACE["width"]]
        places = place_markings(self.drawn, theta, model.projection, width)
        by_head, by_tripod = places.by_theta @ by_own, places.by_theta @ by_all
        if by_common is None:
            by_common = follow_common(by_head, by_tripod)
        spread = np.sqrt(_variance(by_head, covariance) + _variance(by_tripod + by_head @ by_common, tripod.covariance))
        measured, at = measure_markings(
            picture.gray, places, spread, self.unit, len(self.drawn.names), blur_px, picture.grass
        )
        away = ((measured.points_px - places.pixels[at]) * measured.normals).sum(axis=1)
        start = LinearPaint(head, away, -by_head[at], -by_tripod[at])
        fit = fit_head(measured, start, np.asarray(np.linalg.inv(covariance)), tripod, self.drawn, by_common)
        return Look(measured, fit, self.is_confirmed(measured, fit), model.projection.center)

    def follow_paint(self, head: Array, measured: MeasuredFrame) -> Array:
        """How a head (3,) that was found by its paint follows the common parameters (3, K)."""
        theta, by_own, by_all = self.tripod.model.linearise_one(head, self.tripod.mean)
        _, rows = residuals_of(measured, self.drawn, theta, self.tripod.model.projection)
        return follow_common(rows @ by_own, rows @ by_all)

    @cached_property
    def by_errors(self) -> Array:
        """How the common parameters follow painters' errors (K, E)."""
        return align_errors(self.tripod, self.drawn)

    def follow_errors(self, look: Look) -> tuple[Array, float]:
        """How the paint of a look pulls its head along with painters' errors (3, E), and how far these leave the paint
        off its markings: the square of its weighted sums in parts of the field, as of
        :func:`circlecal.tracking.head_fit.compare_spread`.
        """
        fit, seen, tripod = look.fit, look.measured, self.tripod
        count = self.by_errors.shape[1]
        if count == 0 or len(seen.marking) == 0:
            return np.zeros((len(fit.head), count)), 0.0
        theta, _, by_all = tripod.model.linearise_one(fit.head, tripod.mean)
        _, rows = residuals_of(seen, self.drawn, theta, tripod.model.projection)
        errors = move_by_errors(seen, self.drawn, theta, tripod.model.projection)
        weighted = (fit.by_head * fit.weight[:, None]).T
        moved = errors + rows @ (by_all @ self.by_errors)
        known = fit.information + LEAST_INFORMATION * np.eye(len(fit.head))
        moved = moved - fit.by_head @ np.linalg.solve(known, weighted @ moved)
        parts, at = np.unique(number_parts(seen), return_inverse=True)
        left = add_by_part(at, len(parts), fit.weight[:, None] * moved)
        return np.asarray(-weighted @ errors), float((left**2).sum())

    def is_confirmed(self, measured: MeasuredFrame, fit: HeadFit) -> bool:
        """Whether the paint that should be there is there, explained by the head, and places it."""
        if len(measured.marking) < LEAST_PLACES or measured.painted_share < LEAST_PAINTED or measured.missing > 0:
            return False
        if fit.inlier_share < LEAST_EXPLAINED or fit.rms_px > LARGEST_RMS_PX * self.unit:
            return False
        covariance = np.linalg.inv(fit.information + 1e-3 * np.eye(3))
        sigma = np.sqrt(np.diag(covariance)) * (self.tripod.size[0] / 2, np.exp(fit.head[0]), np.exp(fit.head[0]))
        return bool(sigma.max() < LARGEST_HEAD_SIGMA_PX * self.unit)

    def propose(self, picture: LookedAt) -> Array:
        """Heads (N, 3) that may be the picture's, the likeliest first."""
        searched = search_heads(picture.ridges, self.views)
        # a camera that hardly moves looks where it looked
        return np.concatenate([searched, (self.tripod.head_low + self.tripod.head_high)[None] / 2.0])

    def proposal_covariance(self, head: Array, sd_px: float = FOUND_SD_PX, sd_zoom: float = FOUND_SD_ZOOM) -> Array:
        """Covariance (3, 3) of a proposed head, by standard deviations in pixels at 1920 px width and of the logarithm
        of the focal length.
        """
        turn = sd_px * self.unit / np.exp(head[0])
        return np.diag(np.array([sd_zoom, turn, turn]) ** 2)

    def confirm(self, picture: LookedAt, head: Array, blur_px: Array | None = None) -> Look | None:
        """Look where the head should be, in a picture that moved so far (2,) while the shutter was open; None where the
        paint does not confirm it.
        """
        spread = self.proposal_covariance(head)
        look = self.look(picture, head, spread, None, blur_px)
        look = self.look(picture, look.fit.head, spread / 16.0, look.fit.by_common, blur_px)
        return look if look.is_confirmed else None

    def find(self, picture: LookedAt) -> Look | None:
        """Search for the head; None where the paint confirms none."""
        best: Look | None = None
        for head in self.propose(picture):
            spread = self.proposal_covariance(head)
            look = self.look(picture, head, spread)
            if len(look.measured.marking) < LEAST_PLACES // 2:
                continue
            look = self.look(picture, look.fit.head, spread / 16.0, look.fit.by_common)
            if look.is_found and look.measured.painted_share > LEAST_FOUND and (best is None or look.is_better(best)):
                best = look
                if look.is_sure:
                    break
        return best


def _variance(rows: Array, covariance: Array) -> Array:
    return np.asarray(np.maximum(((rows @ covariance) * rows).sum(axis=1), 0.0))

"""Old coats of a circle: what is left of it where it was painted anew, some decimetres beside its old place.

The middle of both together lies up to a pixel beside the middle of the new paint, a little more here and less there, as
the old circle has another middle and another radius: cameras that hang on the circle are led astray by it. Across the
paint the picture shows the sum of two bands, and the fainter one is told from the other by where it lies all round, not
place by place.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate, unit_circle
from circlecal.field.view import FieldView
from circlecal.geometry.least_squares import NormalState, StoppingRule, minimise
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array
from circlecal.paint.coat_bands import (
    REACH_M,
    SECTORS,
    CoatBands,
    CoatProfiles,
    draw_old_band,
    exchange_bands,
    find_sectors,
)
from circlecal.paint.coat_places import find_pairs, foretell_coats
from circlecal.paint.profiles import GrayPicture, sample_profiles

__all__ = ["OldCoat", "find_old_coats", "remove_old_coat", "sample_coats"]

PLACES, SAMPLES = 9, 35
"""In each sector, whose profiles tell one mean profile; and samples of a profile."""
FEWEST_SECTORS = 18
"""Sectors in view: less of a circle does not tell where another one lies. Of 12 rendered circles of which 21 to 31 are
in view ten coats are told; from none of 120 frames without one, among them short arcs, is a coat.
"""
BESIDE_PX = 4.0
"""How far beyond an old coat profiles reach, for the blur."""
LEAST_STRENGTH, ALIKE, MOST_GROWTH_M = 0.12, 0.9, 0.25
"""Of an old coat that is believed: fainter ones move nothing; of two coats that are more alike than the second the
profiles do not say which is the new one; and a compass is set a few centimetres wrong, so what differs by more in its
radius is another circle. Where new paint is worn as well its old coat has up to 0.85 of its light: of ten rendered
circles whose coats have 0.65 to 0.85 all are measured more truly without that, by 0.5 px instead of 0.15 (root mean
square along the circle). Of eight rendered circles that have coats of 0.92 to 0.97 the fainter one is the old one on
two.
"""
LEAST_GAIN, LEAST_ALIKE_GAIN = 87.0, 350.0
"""By how much the second band must lower the chi-square, in units of what is left per sample: on 33 of 34 rendered
circles with an old coat by 104 to 5,800, on 40 without one by 72 at most where its strength is told. And where two
coats may be alike: without one of them the cameras of three rendered circles that gain 490 to 870 explain more, none of
a rendered and two real ones that gain 150 to 260.
"""
FIRST_GAIN_SHARE, FIRST_SHARE = 0.35, 0.75
"""Of the least gain, and of the least strength, what the first steps must reach for the best start to be followed
further; and of its growth, what the largest one must cover. The old coats of 363 rendered circles gain 0.66 or more of
the least gain by then, those that are alike 0.43 or more of theirs; of nine in ten the strength is within an eighth.
"""
OUTLINE, FAR_PX = 720, 20_000.0
"""Corners of the outline of what an old coat may light, and pixels within which they are drawn."""
GLANCE_RULE = StoppingRule(1e-3, unit=np.inf, iterations=3)
FIRST_RULE = StoppingRule(1e-3, unit=np.inf, iterations=5)
RULE = StoppingRule(1e-4, unit=np.inf, iterations=12)
"""Of one band and of all starts, on half as many sectors, and of the best one after that."""


@dataclass(frozen=True, slots=True)
class OldCoat:
    """A fainter circle beside the paint.

    Attributes
    ----------
    angle : (B,) array
        Of sectors of the circle, radians.
    scale : (B,) array
        Pixels per metre across the curve there.
    light : (B,) array
        Gray levels that the new paint adds there.
    place_m, beside_m : (B,) arrays
        How far outside the camera's curve the new paint's middle lies there, and how far outside that the old one's.
    blur_px : (B,) array
        Standard deviation of the blur across the curve there.
    width_m, old_width_m : float
        Width of the new paint, and of the old one.
    growth_m : float
        By how much the old circle's radius is larger.
    strength : float
        The old paint's light over that of the new one.
    gain : float
        By how much it lowers the chi-square, in units of what is left per sample.
    """

    angle: Array
    scale: Array
    light: Array
    place_m: Array
    beside_m: Array
    blur_px: Array
    width_m: float
    old_width_m: float
    growth_m: float
    strength: float
    gain: float

    def is_told(self, least_gain: float = LEAST_GAIN) -> bool:
        """Whether it stands out by so much gain, and its radius is about that of the new one."""
        is_strong = self.gain >= least_gain and self.strength >= LEAST_STRENGTH
        return is_strong and abs(self.growth_m) <= MOST_GROWTH_M

    @property
    def is_alike(self) -> bool:
        """Whether it has so much light that it may as well be the new one."""
        return self.strength > ALIKE

    def shine(self, angle: Array, outside_m: Array) -> Array:
        """Gray levels (N,) that it adds at places so far outside the camera's curve, by their angle (N,)."""
        values = self.scale, self.light, self.place_m, self.beside_m, self.blur_px
        scale, light, place, beside, blur = (np.interp(angle, self.angle, row, period=2.0 * np.pi) for row in values)
        width, old_width = self.width_m * scale, self.old_width_m * scale
        added = draw_old_band((outside_m - place) * scale, width, old_width, beside * scale, blur)
        return np.asarray(light * self.strength * added)


def sample_coats(picture: GrayPicture, view: FieldView, circle: Circle, template: FieldTemplate) -> CoatProfiles | None:
    """Median profiles across the paint in sectors of a circle; None where too few of them are in the picture.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    view : FieldView
        Where the camera sees the field.
    circle, template : Circle, FieldTemplate
        What is looked at.
    """
    edges = 2.0 * np.pi * np.arange(SECTORS) / SECTORS
    angle = edges[:, None] + 2.0 * np.pi / SECTORS * (np.arange(PLACES) + 0.5) / PLACES
    middle, inner, outer = (
        view.project(view.circle_points(circle, edge, angle, template)) for edge in ("center", "inner", "outer")
    )
    tangent = np.roll(middle, -1, axis=1) - np.roll(middle, 1, axis=1)
    tangent[:, [0, -1]] = middle[:, [1, -1]] - middle[:, [0, -2]]
    across = np.stack([tangent[..., 1], -tangent[..., 0]], axis=-1)
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9)
    width = ((outer - inner) * across).sum(axis=-1)
    across *= np.sign(width)[..., None]
    scale = np.abs(width).mean(axis=1) / template.marking_width_m
    reach = (REACH_M + template.marking_width_m) * scale + BESIDE_PX
    known = np.isfinite(reach)
    if np.count_nonzero(known) < FEWEST_SECTORS:
        return None
    share = np.linspace(-1.0, 1.0, SAMPLES)
    normals = across[known] * reach[known, None, None]
    sampled = sample_profiles(picture, middle[known].reshape(-1, 2), normals.reshape(-1, 2), share)
    profiles = sampled.astype(np.float64).reshape(-1, PLACES, SAMPLES)
    seen = np.isfinite(profiles).all(axis=(1, 2))
    if np.count_nonzero(seen) < FEWEST_SECTORS:
        return None
    level = median_of_rows(profiles[seen].swapaxes(0, 1))
    noise = 1.4826 / np.sqrt(2.0) * float(median_of_rows(np.abs(np.diff(level, axis=1)).ravel()))
    at = np.flatnonzero(known)[seen]
    turn = (across[at] ** 2).mean(axis=1)
    return CoatProfiles(angle.mean(axis=1)[at], scale[at], reach[at, None] * share, level, turn, max(noise, 0.3))


def find_old_coats(profiles: CoatProfiles, width_m: float, may_be_alike: bool = False) -> tuple[OldCoat, ...]:
    """What may be the old one of two circles that explain profiles of paint of about a width best: the fainter one; of
    two that are alike each of both, where they may be; none where nothing is surely told.
    """
    joined = _join_sectors(profiles)
    one = CoatBands(joined, width_m, has_old=False)
    alone = minimise(one, one.evaluate(one.expected[None]), GLANCE_RULE).state
    starts = _list_starts(joined, one, alone, may_be_alike)
    if len(starts) == 0:
        return ()
    two = CoatBands(joined, width_m, has_old=True)
    least_gain = LEAST_ALIKE_GAIN if may_be_alike else LEAST_GAIN
    rule = replace(FIRST_RULE, bar=_largest_cost(alone.cost[0], FIRST_GAIN_SHARE * least_gain, joined))
    both = minimise(two, two.evaluate(starts), rule).state
    first, gain = both.parameters[[np.argmin(both.cost)]], _gain(alone.cost[0], both.cost.min(), joined)
    if gain < FIRST_GAIN_SHARE * least_gain or not _may_be_old(two, first):
        return ()
    one, two = (CoatBands(profiles, width_m, has_old=has_old) for has_old in (False, True))
    alone = minimise(one, one.evaluate(alone.parameters), RULE).state
    rule = replace(RULE, bar=_largest_cost(alone.cost[0], least_gain, profiles))
    states = [minimise(two, two.evaluate(first), rule).state]
    if two.read(states[0].parameters).strength[0, 0] > ALIKE:
        states.append(minimise(two, two.evaluate(exchange_bands(states[0].parameters)), RULE).state)
    told = [_describe(two, it.parameters, profiles, _gain(alone.cost[0], it.cost[0], profiles)) for it in states]
    told.sort(key=lambda coat: coat.strength)
    if not told[0].is_told(least_gain) or (told[0].is_alike and not may_be_alike):
        return ()
    return tuple(told) if told[0].is_alike else (told[0],)


def _list_starts(profiles: CoatProfiles, one: CoatBands, alone: NormalState, may_be_alike: bool) -> Array:
    """Parameters (K, P) of pairs of bands from which the best pair may be found: beside the one band that is all there
    is, and apart from it where two coats may be alike.
    """
    places = foretell_coats(profiles, one, alone)
    starts = np.concatenate([np.tile(np.append(alone.parameters[0], (0.0, 0.0)), (len(places), 1)), places], axis=1)
    if not may_be_alike:
        return starts
    pairs = find_pairs(profiles, one)
    more = np.zeros((len(pairs), starts.shape[1]))
    more[:, :3], more[:, -3:] = pairs[:, :3], pairs[:, 3:]
    return np.concatenate([starts, more])


def _gain(alone: float, both: float, profiles: CoatProfiles) -> float:
    """By how much a cost is lower than that of one band, in units of what is left per sample."""
    return float((alone - both) / max(both / profiles.level.size, 1e-12))


def _may_be_old(two: CoatBands, first: Array) -> bool:
    """Whether the second of a pair of bands (1, P) after the first steps has about the strength and size of a coat."""
    strength, growth_m = float(two.read(first).strength[0, 0]), abs(float(first[0, -3]))
    return strength >= FIRST_SHARE * LEAST_STRENGTH and FIRST_SHARE * growth_m <= MOST_GROWTH_M


def _largest_cost(alone: float, gain: float, profiles: CoatProfiles) -> float:
    """The cost of two bands that are a gain over the cost of one: starts that promise none so low are given up."""
    return alone / (1.0 + gain / profiles.level.size)


def _describe(problem: CoatBands, parameters: Array, profiles: CoatProfiles, gain: float) -> OldCoat:
    """The old coat of the pair of bands that parameters (1, P) stand for."""
    scale, bands = profiles.scale, problem.read(parameters)
    light, place, beside = problem.fit_light(bands)[0], bands.place[0] / scale, bands.beside[0] / scale
    widths = float(bands.width[0, 0] / scale[0]), float(bands.old_width[0, 0] / scale[0])
    growth, strength = float(parameters[0, -3]), float(bands.strength[0, 0])
    return OldCoat(profiles.angle, scale, light, place, beside, bands.blur[0], *widths, growth, strength, gain)


def _join_sectors(profiles: CoatProfiles) -> CoatProfiles:
    """The profiles with two neighbouring sectors each as one: first steps need no more."""
    number = find_sectors(profiles.angle, SECTORS) // 2
    first = np.flatnonzero(np.diff(number) == 0)

    def join(values: Array) -> Array:
        return np.asarray(0.5 * (values[first] + values[first + 1]))

    angle, scale, offset_px, level, turn = (
        join(values) for values in (profiles.angle, profiles.scale, profiles.offset_px, profiles.level, profiles.turn)
    )
    return CoatProfiles(angle, scale, offset_px, level, turn, float(profiles.noise / np.sqrt(2.0)))


def remove_old_coat(
    picture: GrayPicture, view: FieldView, circle: Circle, radius_m: float, coat: OldCoat
) -> NDArray[np.float32]:
    """The picture (H, W) without the light of an old coat of a circle with a radius."""
    height, width = picture.shape
    reach_m = float(np.abs(coat.place_m + coat.beside_m).max()) + coat.old_width_m + REACH_M
    ring = unit_circle(np.linspace(0.0, 2.0 * np.pi, OUTLINE, endpoint=False))
    near = np.zeros((height, width), np.uint8)
    for radius, value in ((radius_m + reach_m, 1), (radius_m - reach_m, 0)):
        rim = view.project(np.asarray(circle.center) + radius * ring)
        rim = rim[np.isfinite(rim).all(axis=1)]
        cv2.fillPoly(near, [np.rint(np.clip(rim, -FAR_PX, FAR_PX)).astype(np.int32)], value)
    y, x = np.nonzero(near)
    field = view.to_field(np.stack([x, y], axis=-1).astype(np.float64)) - np.asarray(circle.center)
    outside_m = np.linalg.norm(field, axis=1) - radius_m
    light = coat.shine(np.arctan2(field[:, 1], field[:, 0]), outside_m)
    cleaned = picture.astype(np.float32)
    cleaned[y, x] -= np.nan_to_num(light).astype(np.float32)
    return cleaned

"""Old coats of a circle: what is left of it where it was painted anew, some decimetres beside its old place.

The middle of both together lies up to a pixel beside the middle of the new paint, a little more here and less there, as
the old circle has another middle and another radius: cameras that hang on the circle are led astray by it. Across the
paint the picture shows the sum of two bands of one width, and the fainter one is told from the other by where it lies
all round, not place by place.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erf

import cv2
import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.least_squares import DenseProblem, NormalState, StoppingRule, minimise
from circlecal.geometry.projective import Array
from circlecal.paint.profiles import GrayPicture, sample_profiles

__all__ = ["CoatProfiles", "OldCoat", "find_old_coat", "harmonics", "remove_old_coat", "sample_coats"]

SECTORS, PLACES, SAMPLES = 60, 9, 35
"""Of the circle, whose profiles tell one mean profile each; places in each of them; and samples of a profile."""
FEWEST_SECTORS = 34
"""Sectors in view: less of a circle does not tell where another one lies."""
REACH_M, BESIDE_PX = 0.4, 4.0
"""How far beside the paint profiles reach: metres, as far as an old coat may lie, and pixels, for the blur."""
ORDER = 3
"""Of the circle's own place round the camera's curve, in harmonics of the angle: what a camera gets wrong by a tilt, a
lens or a crown.
"""
OPAQUE = 0.8
"""Share of an old coat's light that the new paint over it hides: paint that is worn shows some of it. Of 0.5 and 0.8
the second told both coats of more of six rendered circles.
"""
STEPS_M, GROWTHS_M = (-0.2, -0.07, 0.07, 0.2), (-0.08, 0.0, 0.08)
"""Places of an old circle's middle along both axes, and what its radius may be larger, from which the fit starts."""
STARTS = 5
"""Best of these that are followed."""
ROBUST = 3.0
"""Standard deviations from which on residuals count less (Cauchy's loss): players and other paint."""
PLACE_SD_M, BLUR_SD, WIDTH_SD, STRENGTH_SD = 0.2, 0.7, 0.25, 0.7
"""What is known beforehand, standard deviations: of every harmonic, metres, and of the logarithms of blur, width and
strength about their usual values.
"""
USUAL_BLUR_PX, USUAL_STRENGTH = 0.8, 0.3
"""Standard deviation of a picture's blur, and light of an old coat over that of the new paint, before they are told."""
STRENGTHS, MOST_GROWTH_M = (0.12, 0.65), 0.25
"""Of an old coat that is believed: fainter ones move nothing, and of two like ones nobody knows which is the new one.
And by how much its radius may differ: a compass is set a few centimetres wrong, what lies farther is another circle.
"""
LEAST_GAIN = 87.0
"""By how much the second band must lower the chi-square, in units of what is left per sample: on 33 of 34 rendered
circles with an old coat by 104 to 5,800, on 40 without one by 72 at most where its strength is one of those.
"""
FAINT, LEAST_FORETOLD = 0.05, 5.0
"""Strength of a faint coat, beside which the linear model foretells how much a stronger one at the best of the places
where starts are lowers the chi-square, and how much it must for any to be followed: 27 of 29 coats that are told on
rendered circles have 6.6 or more, 28 of 44 real circles less than this, which saves them most of the time.
"""
LEAST_FIRST_GAIN = 35.0
"""The gain after the first steps, below which the best start is not followed further."""
OUTLINE, FAR_PX = 720, 20_000.0
"""Corners of the outline of what an old coat may light, and pixels within which they are drawn."""
FIRST_RULE = StoppingRule(1e-3, unit=np.inf, iterations=3)
RULE = StoppingRule(1e-4, unit=np.inf, iterations=12)
"""Of all starts, and of the best one after that."""
_STEPS, _RELATIVE = (0.01,) * 6, (1, 2, 3, 4)
"""Differences of place (pixels), blurs, width and strength (shares) and place beside, which tell derivatives."""
_PHI_AT = np.linspace(-5.0, 5.0, 2001)
_PHI = np.array([0.5 * (1.0 + erf(z / 2.0**0.5)) for z in _PHI_AT.tolist()])


@dataclass(frozen=True, slots=True)
class CoatProfiles:
    """Mean profiles across a circle's paint in B sectors.

    Attributes
    ----------
    angle : (B,) array
        Of the sectors' middles on the field, radians.
    scale : (B,) array
        Pixels per metre across the curve.
    offset_px : (B, S) array
        Where the samples lie, pixels outwards from the camera's curve.
    level : (B, S) array
        Gray levels.
    turn : (B, 2) array
        Squares of the profiles' directions along the picture's rows and columns: a pan blurs along the rows.
    noise : float
        Their standard deviation from sample to sample.
    """

    angle: Array
    scale: Array
    offset_px: Array
    level: Array
    turn: Array
    noise: float


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
    width_m : float
        Width of the paint.
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
    strength: float
    gain: float

    @property
    def is_told(self) -> bool:
        """Whether it stands out, is surely the fainter one of both, and a circle of about the same size."""
        is_fainter = STRENGTHS[0] <= self.strength <= STRENGTHS[1]
        return self.gain >= LEAST_GAIN and is_fainter and abs(float(self.beside_m.mean())) <= MOST_GROWTH_M

    def shine(self, angle: Array, outside_m: Array) -> Array:
        """Gray levels (N,) that it adds at places so far outside the camera's curve, by their angle (N,)."""
        values = self.scale, self.light, self.place_m, self.beside_m, self.blur_px
        scale, light, place, beside, blur = (np.interp(angle, self.angle, row, period=2.0 * np.pi) for row in values)
        added = _old_band((outside_m - place) * scale, self.width_m * scale, beside * scale, blur)
        return np.asarray(light * self.strength * added)


def harmonics(angle: Array, order: int = ORDER) -> Array:
    """1, cosines and sines (N, 2 order + 1) of an angle (N,) and of its multiples."""
    multiples = angle[:, None] * np.arange(1, order + 1)
    waves = np.stack([np.cos(multiples), np.sin(multiples)], axis=-1).reshape(len(angle), -1)
    return np.concatenate([np.ones((len(angle), 1)), waves], axis=1)


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
        view.project(template.curve_points(circle, edge, angle)) for edge in ("center", "inner", "outer")
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
    level = np.asarray(np.median(profiles[seen], axis=1), np.float64)
    noise = 1.4826 / np.sqrt(2.0) * float(np.median(np.abs(np.diff(level, axis=1))))
    at = np.flatnonzero(known)[seen]
    turn = (across[at] ** 2).mean(axis=1)
    return CoatProfiles(angle.mean(axis=1)[at], scale[at], reach[at, None] * share, level, turn, max(noise, 0.3))


def find_old_coat(profiles: CoatProfiles, width_m: float) -> OldCoat | None:
    """The fainter circle beside paint of about a width that explains its profiles best, if it is surely told."""
    if _foretell_gain(_join_sectors(profiles), width_m) < LEAST_FORETOLD:
        return None
    one = _Coats(profiles, width_m, has_old=False)
    alone = minimise(one, one.evaluate(one.expected[None]), RULE).state
    two = _Coats(profiles, width_m, has_old=True)
    starts = _start_coats(alone.parameters[0])
    first = two.evaluate(starts[np.argsort(two.cost(starts))[:STARTS]])
    first = minimise(two, first, FIRST_RULE).state
    best = first.select(np.array([np.argmin(first.cost)]))
    if _gain(alone.cost[0], best.cost[0], profiles) < LEAST_FIRST_GAIN:
        return None
    both = minimise(two, best, RULE).state
    coat = two.describe(both.parameters[0], _gain(alone.cost[0], both.cost[0], profiles))
    return coat if coat.is_told else None


def _start_coats(alone: Array) -> Array:
    """Parameters (K, P) of two bands from which a fit starts, beside those (Q,) of one alone."""
    beside = np.stack(np.meshgrid(GROWTHS_M, STEPS_M, STEPS_M, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.concatenate([np.tile(np.append(alone, 0.0), (len(beside), 1)), beside], axis=1)


def _join_sectors(profiles: CoatProfiles) -> CoatProfiles:
    """The profiles with two neighbouring sectors each as one: a glance needs no more."""
    number = np.rint(profiles.angle / (2.0 * np.pi / SECTORS) - 0.5).astype(np.int64) // 2
    first = np.flatnonzero(np.diff(number) == 0)

    def join(values: Array) -> Array:
        return np.asarray(0.5 * (values[first] + values[first + 1]))

    angle, scale, offset_px, level, turn = (
        join(values) for values in (profiles.angle, profiles.scale, profiles.offset_px, profiles.level, profiles.turn)
    )
    return CoatProfiles(angle, scale, offset_px, level, turn, float(profiles.noise / np.sqrt(2.0)))


def _foretell_gain(profiles: CoatProfiles, width_m: float) -> float:
    """By how much the linear model expects a second band to lower the chi-square, in units of what one band leaves per
    sample: at the best of the places from which fits start, with the strength that suits it there.
    """
    one = _Coats(profiles, width_m, has_old=False)
    alone = minimise(one, one.evaluate(one.expected[None]), FIRST_RULE).state
    two = _Coats(profiles, width_m, has_old=True)
    faint = _start_coats(alone.parameters[0])
    faint[:, len(one.expected)] = np.log(FAINT / USUAL_STRENGTH)
    left = one.residuals(alone.parameters)
    added = (two.residuals(faint) - left) / FAINT
    weight = 1.0 / (1.0 + (left / ROBUST) ** 2)
    by_strength = np.maximum(-(weight * left * added).sum(axis=1), 0.0)
    gain = by_strength**2 / np.maximum((weight * added**2).sum(axis=1), 1e-12)
    return float(gain.max() / max(alone.cost[0] / profiles.level.size, 1e-12))


def _gain(alone: float, both: float, profiles: CoatProfiles) -> float:
    """By how much a cost is lower than that of one band, in units of what is left per sample."""
    return float((alone - both) / max(both / profiles.level.size, 1e-12))


class _Coats(DenseProblem):
    """One band of paint round a camera's curve, or two: harmonics of its place, logarithms of blur along rows and
    columns and of width over their usual values, and the same of the old one's strength, and its place. The light of
    each sector, and the ground's with its slope, are fitted within it.
    """

    def __init__(self, profiles: CoatProfiles, width_m: float, *, has_old: bool) -> None:
        self._profiles, self._width_m, self._has_old = profiles, width_m, has_old
        self._waves = harmonics(profiles.angle)
        slope = profiles.offset_px / np.abs(profiles.offset_px).max(axis=1, keepdims=True)
        self._ground = np.linalg.qr(np.stack([np.ones_like(slope), slope], axis=-1))[0]
        self._level = self._leave_out_ground(profiles.level)
        self._prior = np.append(np.full(2 * ORDER + 1, PLACE_SD_M), (BLUR_SD, BLUR_SD, WIDTH_SD))
        if has_old:
            self._prior = np.concatenate([self._prior, [STRENGTH_SD], np.full(3, PLACE_SD_M)])
        self.expected = np.zeros(len(self._prior))

    def evaluate(self, parameters: Array) -> NormalState:
        """Costs, gradients and normal equations at parameters (K, P), by differences.

        Each harmonic moves the bands of all sectors, each by its wave there: one difference in the bands' place tells
        the derivatives by all of them.
        """
        count = len(parameters)
        read = self._read(parameters)
        varied = [np.stack([values] * (len(_STEPS) + 1)) for values in read]
        for k, step in enumerate(_STEPS):
            varied[k][k + 1] += step * (varied[k][k + 1] if k in _RELATIVE else 1.0)
        off = self._residuals(*(values.reshape(-1, *values.shape[2:]) for values in varied))
        off = off.reshape(len(_STEPS) + 1, count, *self._level.shape)
        residual, slope = off[0], (off[1:] - off[0]) / np.array(_STEPS)[:, None, None, None]
        scale, waves = self._profiles.scale, self._waves
        by_place, by_beside = (
            slope[k][:, None] * (wave.T * scale)[:, :, None] for k, wave in ((0, waves), (5, waves[:, :3]))
        )
        shape = [by_place, *(slope[k][:, None] for k in (1, 2, 3))]
        if self._has_old:
            shape += [slope[4][:, None], by_beside]
        flat = np.concatenate(shape, axis=1).reshape(count, parameters.shape[1], -1)
        residual = residual.reshape(count, -1)
        weighted = flat / (1.0 + (residual / ROBUST) ** 2)[:, None]
        gradient = (weighted @ residual[..., None])[..., 0] + parameters / self._prior**2
        normal = weighted @ flat.transpose(0, 2, 1) + np.diag(1.0 / self._prior**2)
        return NormalState(parameters, self._loss(residual, parameters), gradient, normal)

    def cost(self, parameters: Array) -> Array:
        """Costs (K,) at parameters (K, P)."""
        return self._loss(self.residuals(parameters), parameters)

    def residuals(self, parameters: Array) -> Array:
        """What the bands of parameters (K, P) leave of the profiles (K, B S), standard deviations."""
        return self._residuals(*self._read(parameters)).reshape(len(parameters), -1)

    def describe(self, parameters: Array, gain: float) -> OldCoat:
        """The old coat that parameters (P,) stand for."""
        bands = self._read(parameters[None])
        place, along_rows, along_columns, width, strength, beside = (values[0] for values in bands)
        light = self._fit_light(self._draw(*bands))[0]
        profiles, scale = self._profiles, self._profiles.scale
        blur = _turn_blur(along_rows, along_columns, profiles.turn)[:, 0]
        sizes = blur, float(width[0] / scale[0]), float(strength[0, 0])
        return OldCoat(profiles.angle, scale, light, place / scale, beside / scale, *sizes, gain)

    def _loss(self, residual: Array, parameters: Array) -> Array:
        robust = ROBUST**2 * np.log1p((residual / ROBUST) ** 2).sum(axis=-1)
        return np.asarray(robust + ((parameters / self._prior) ** 2).sum(axis=-1))

    def _read(self, parameters: Array) -> tuple[Array, Array, Array, Array, Array, Array]:
        """Place (K, B), blur along rows and along columns (K, 1, 1) and width (K, B) of the band, strength (K, 1, 1)
        and place beside it (K, B) of the old one; pixels.
        """
        first, scale = 2 * ORDER + 1, self._profiles.scale
        place = parameters[:, :first] @ self._waves.T * scale
        rows, columns = (USUAL_BLUR_PX * np.exp(parameters[:, k, None, None]) for k in (first, first + 1))
        width = self._width_m * np.exp(parameters[:, first + 2, None]) * scale
        if not self._has_old:
            return place, rows, columns, width, np.zeros((len(place), 1, 1)), np.zeros_like(place)
        strength = USUAL_STRENGTH * np.exp(parameters[:, first + 3, None, None])
        return place, rows, columns, width, strength, parameters[:, first + 4 :] @ self._waves[:, :3].T * scale

    def _draw(
        self, place: Array, along_rows: Array, along_columns: Array, width: Array, strength: Array, beside: Array
    ) -> Array:
        """Bands (K, B, S) of the light of one gray level, without their means and slopes."""
        blur = _turn_blur(along_rows, along_columns, self._profiles.turn)
        x = self._profiles.offset_px - place[..., None]
        band = _blur_band(x, width[..., None], blur)
        if self._has_old:
            band = band + strength * _old_band(x, width[..., None], beside[..., None], blur)
        return self._leave_out_ground(band)

    def _fit_light(self, band: Array) -> Array:
        """Gray levels (K, B) that the bands (K, B, S) add to the profiles."""
        light = (band * self._level).sum(axis=-1) / np.maximum((band * band).sum(axis=-1), 1e-9)
        return np.asarray(np.maximum(light, 0.0))

    def _residuals(self, *bands: Array) -> Array:
        """What bands leave of the profiles (K, B, S), standard deviations."""
        band = self._draw(*bands)
        return np.asarray((self._level - self._fit_light(band)[..., None] * band) / self._profiles.noise)

    def _leave_out_ground(self, values: Array) -> Array:
        """Profiles (..., B, S) without their means and slopes."""
        ground = self._ground
        return np.asarray(values - np.einsum("bsi,...bi->...bs", ground, np.einsum("bsi,...bs->...bi", ground, values)))


def _turn_blur(along_rows: Array, along_columns: Array, turn: Array) -> Array:
    """Blur (..., B, 1) across profiles that are turned so against the picture's rows."""
    return np.asarray(np.sqrt(along_rows**2 * turn[:, :1] + along_columns**2 * turn[:, 1:]))


def _old_band(x: Array, width: Array, away: Array, blur: Array | float) -> Array:
    """What an old band so far away adds to a new one of its width about zero that hides most of it; pixels."""
    shared = _blur_band(x - 0.5 * away, np.maximum(width - np.abs(away), 0.0), blur)
    return _blur_band(x - away, width, blur) - OPAQUE * shared


def _blur_band(x: Array, width: Array, blur: Array | float) -> Array:
    """A band of light of a width about zero, blurred, at places x; pixels."""
    return _phi((x + 0.5 * width) / blur) - _phi((x - 0.5 * width) / blur)


def _phi(z: Array) -> Array:
    """Normal distribution function."""
    return np.asarray(np.interp(z, _PHI_AT, _PHI))


def remove_old_coat(
    picture: GrayPicture, view: FieldView, circle: Circle, radius_m: float, coat: OldCoat
) -> NDArray[np.float32]:
    """The picture (H, W) without the light of an old coat of a circle with a radius."""
    height, width = picture.shape
    reach_m = float(np.abs(coat.place_m + coat.beside_m).max()) + coat.width_m + REACH_M
    turn = np.linspace(0.0, 2.0 * np.pi, OUTLINE, endpoint=False)
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
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

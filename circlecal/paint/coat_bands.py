"""Two bands of paint round a camera's curve, one of them an old coat: what they leave of profiles across the circle.

A band is the difference of two blurred steps. The new paint hides most of the old where both lie, which steps at two of
the same edges: all is told by four steps, and the derivatives by as many bells. Each band has its own width: fields are
painted with 5 to 12 cm, and not always with the width of the year before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.least_squares import DenseProblem, NormalState
from circlecal.geometry.projective import Array, Indices

__all__ = ["CoatBands", "CoatProfiles", "draw_old_band", "harmonics"]

SECTORS, REACH_M = 60, 0.4
"""Into which the circle is cut, and how far beside the new paint an old coat may lie."""
ORDER = 3
"""Of the circle's own place round the camera's curve, in harmonics of the angle: what a camera gets wrong by a tilt, a
lens or a crown.
"""
OPAQUE = 0.8
"""Share of an old coat's light that the new paint over it hides: paint that is worn shows some of it. Of 0.5 and 0.8
the second told both coats of more of six rendered circles.
"""
ROBUST = 3.0
"""Standard deviations from which on residuals count less (Cauchy's loss): players and other paint."""
PLACE_SD_M, BLUR_SD, WIDTH_SD, STRENGTH_SD = 0.2, 0.7, 0.25, 0.7
"""What is known beforehand, standard deviations: of every harmonic, metres, and of the logarithms of blur, width and
strength about their usual values, and of the old width about the new one.
"""
USUAL_BLUR_PX, USUAL_STRENGTH = 0.8, 0.3
"""Standard deviation of a picture's blur, and light of an old coat over that of the new paint, before they are told."""
_FIRST, _ALONE = 2 * ORDER + 1, 2 * ORDER + 4
"""Numbers of the harmonics, and of all parameters of one band."""
_NEW = np.array([1.0, -1.0])
"""Heights of the steps of the new band."""
_ERF = (0.3480242, -0.0958798, 0.7478556, 0.47047)
"""Abramowitz and Stegun 7.1.25: the error function to 2.5e-5."""


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
        Where the samples lie, pixels outwards from the camera's curve: evenly, as far inwards as outwards.
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
class CoatShape:
    """Where K pairs of bands lie in B sectors, pixels: the new one's place, both ones' blur, the width of each, and the
    place of the old one beside it (K, B); its strength (K, 1); squares of the blur along rows and columns (K, 1).
    """

    place: Array
    blur: Array
    width: Array
    strength: Array
    old_width: Array
    beside: Array
    rows: Array
    columns: Array


def find_sectors(angle: Array, count: int) -> Indices:
    """Numbers (N,) of the sectors, of so many round the circle, whose middles lie at an angle (N,)."""
    return np.rint(angle * (count / (2.0 * np.pi)) - 0.5).astype(np.int64)


def harmonics(angle: Array, order: int = ORDER) -> Array:
    """1, cosines and sines (N, 2 order + 1) of an angle (N,) and of its multiples."""
    multiples = angle[:, None] * np.arange(1, order + 1)
    waves = np.stack([np.cos(multiples), np.sin(multiples)], axis=-1).reshape(len(angle), -1)
    return np.concatenate([np.ones((len(angle), 1)), waves], axis=1)


def draw_old_band(x: Array, width: Array, old_width: Array, beside: Array, blur: Array) -> Array:
    """What an old band of a width, so far beside a new one about zero, adds to it, at places x; all of them pixels."""
    half, old_half = 0.5 * width, 0.5 * old_width
    edges = beside - old_half, beside + old_half, -half, half
    up, down, new_up, new_down = (_step((x - edge) / blur)[0] for edge in edges)
    hidden = np.maximum(np.minimum(up, new_up) - np.maximum(down, new_down), 0.0)
    return np.asarray(up - down - OPAQUE * hidden)


def exchange_bands(parameters: Array) -> Array:
    """Parameters (K, P) of pairs of bands, each with the old one as the new one."""
    exchanged = parameters.copy()
    exchanged[:, :3] += parameters[:, _ALONE + 2 :]
    exchanged[:, _ALONE - 1] += parameters[:, _ALONE + 1]
    exchanged[:, _ALONE + 1 :] *= -1.0
    exchanged[:, _ALONE] = -2.0 * np.log(USUAL_STRENGTH) - parameters[:, _ALONE]
    return exchanged


class CoatBands(DenseProblem):
    """One band of paint round a camera's curve, or two.

    Parameters are harmonics of its place, metres, logarithms of blur along rows and along columns and of width over
    their usual values, and the same of the old one's strength, of its width over that of the new one, and growth and
    shift of its circle, metres. The light of each sector, and the ground's with its slope, are fitted within it.
    """

    def __init__(self, profiles: CoatProfiles, width_m: float, *, has_old: bool) -> None:
        self._profiles, self._width_m, self._has_old = profiles, width_m, has_old
        self._waves = harmonics(profiles.angle)
        share = profiles.offset_px[0] / np.abs(profiles.offset_px[0]).max()
        ground = np.linalg.qr(np.stack([np.ones_like(share), share], axis=-1))[0]
        self._without_ground = np.eye(len(share)) - ground @ ground.T
        self._level = profiles.level @ self._without_ground
        self._prior = np.append(np.full(_FIRST, PLACE_SD_M), (BLUR_SD, BLUR_SD, WIDTH_SD))
        if has_old:
            self._prior = np.concatenate([self._prior, [STRENGTH_SD, WIDTH_SD], np.full(3, PLACE_SD_M)])
        self.expected = np.zeros(len(self._prior))

    def evaluate(self, parameters: Array) -> NormalState:
        """Costs, gradients and normal equations at parameters (K, P).

        What a parameter does in a sector is one of few things that happen to the bands there, so many times: the sums
        over the samples are those of these things alone.
        """
        residual, slope, turned = self._linearise(parameters)
        weighted = slope * weigh(residual)
        gram = weighted.transpose(1, 2, 0, 3) @ slope.transpose(1, 2, 3, 0)
        along = (weighted * residual).sum(axis=-1).transpose(1, 2, 0).reshape(len(parameters), 1, -1)
        by_parameter = turned.reshape(len(parameters), -1, turned.shape[-1])
        gradient = (along @ by_parameter)[:, 0] + parameters / self._prior**2
        normal = by_parameter.swapaxes(1, 2) @ (gram @ turned).reshape(by_parameter.shape)
        loss = self._loss(residual.reshape(len(parameters), -1), parameters)
        return NormalState(parameters, loss, gradient, normal + np.diag(1.0 / self._prior**2))

    def cost(self, parameters: Array) -> Array:
        """Costs (K,) at parameters (K, P)."""
        band, _ = self._draw(self.read(parameters))
        return self._loss(self._leave(band)[0].reshape(len(band), -1), parameters)

    def linearise(self, parameters: Array) -> tuple[Array, Array]:
        """What the bands of parameters (K, P) leave of the profiles (K, B, S), standard deviations, and its derivatives
        by them (K, P, B, S).
        """
        residual, slope, turned = self._linearise(parameters)
        return residual, (turned.swapaxes(2, 3) @ slope.transpose(1, 2, 0, 3)).swapaxes(1, 2)

    def _linearise(self, parameters: Array) -> tuple[Array, Array, Array]:
        """What is left of the profiles (K, B, S), standard deviations, its derivatives by all that happens to the bands
        of a sector (A, K, B, S), and how much of that each parameter does there (K, B, A, P).
        """
        bands = self.read(parameters)
        band, slope = self._draw(bands)
        residual, light = self._leave(band)
        by_light = (slope * (residual * self._profiles.noise - light[..., None] * band)).sum(axis=-1)
        by_light *= (light > 0.0) / np.maximum((band * band).sum(axis=-1), 1e-9)
        slope = -(by_light[..., None] * band + light[..., None] * slope) / self._profiles.noise
        across = self._waves * self._profiles.scale[:, None]
        turn = self._profiles.turn / bands.blur[..., None]
        turned = np.zeros((*band.shape[:2], len(slope), len(self._prior)))
        turned[..., 0, :_FIRST] = across
        turned[..., 1, _FIRST], turned[..., 1, _FIRST + 1] = bands.rows * turn[..., 0], bands.columns * turn[..., 1]
        turned[..., 2, _FIRST + 2] = bands.width
        if self._has_old:
            turned[..., 3, _ALONE], turned[..., 4, _ALONE + 1] = 1.0, bands.old_width
            turned[..., 5, _ALONE + 2 :] = across[:, :3]
        return residual, slope, turned

    def gain(self, parameters: Array) -> Array:
        """By how much the bands of parameters (K, P) lower the loss of each sector (K, B)."""
        left = self._leave(self._draw(self.read(parameters))[0])[0]
        bare = self._level / self._profiles.noise
        return np.asarray(_robust(bare) - _robust(left))

    def hint(self, alone: Array, beside_m: Array) -> Array:
        """By how much a faint old coat beside the band of parameters (P,), everywhere so far (A,), changes what that
        leaves of the profiles (A, B, S), over its strength.
        """
        bands = self.read(alone[None])
        band, _ = self._draw(bands)
        light = self._leave(band)[1]
        old = draw_old_band(
            self._profiles.offset_px - bands.place[..., None],
            bands.width[..., None],
            bands.old_width[..., None],
            (beside_m[:, None] * self._profiles.scale)[..., None],
            bands.blur[..., None],
        )
        old = old @ self._without_ground
        share = (old * band).sum(axis=-1) / np.maximum((band * band).sum(axis=-1), 1e-9)
        return np.asarray(-light[..., None] * (old - share[..., None] * band) / self._profiles.noise)

    def read(self, parameters: Array) -> CoatShape:
        """The bands that parameters (K, P) stand for."""
        scale = self._profiles.scale
        rows, columns = (USUAL_BLUR_PX**2 * np.exp(2.0 * parameters[:, k, None]) for k in (_FIRST, _FIRST + 1))
        blur = np.sqrt(rows * self._profiles.turn[:, 0] + columns * self._profiles.turn[:, 1])
        width = self._width_m * np.exp(parameters[:, _FIRST + 2, None]) * scale
        place = parameters[:, :_FIRST] @ self._waves.T * scale
        strength, old_width, beside = np.zeros((len(place), 1)), width, np.zeros_like(place)
        if self._has_old:
            strength = USUAL_STRENGTH * np.exp(parameters[:, _ALONE, None])
            old_width = width * np.exp(parameters[:, _ALONE + 1, None])
            beside = parameters[:, _ALONE + 2 :] @ self._waves[:, :3].T * scale
        return CoatShape(place, blur, width, strength, old_width, beside, rows, columns)

    def fit_light(self, bands: CoatShape) -> Array:
        """Gray levels (K, B) that the new paint adds."""
        return self._leave(self._draw(bands)[0])[1]

    def _draw(self, bands: CoatShape) -> tuple[Array, Array]:
        """Bands (K, B, S) of the light of one gray level, without their means and slopes, and their derivatives by
        place, blur, width, strength (its logarithm), old width and place beside (6, K, B, S), or by the first
        three alone.
        """
        edges, weight = _place_edges(bands)
        if not self._has_old:
            edges, weight = edges[:2], weight[:2]
        z = (self._profiles.offset_px - edges[..., None]) / bands.blur[..., None]
        step, bell = _step(z)
        bell *= -(weight / bands.blur)[..., None]
        slope = [bell.sum(axis=0), (bell * z).sum(axis=0), 0.5 * (bell[1] - bell[0])]
        if self._has_old:
            wider = 0.5 * (bell[3] - bell[2])
            slope[2] += wider * (bands.old_width / bands.width)[..., None]
            old = weight.copy()
            old[:2] -= _NEW[:, None, None]
            slope += [(old[..., None] * step).sum(axis=0), wider, bell[2] + bell[3]]
        band = (weight[..., None] * step).sum(axis=0)
        return band @ self._without_ground, np.array(slope) @ self._without_ground

    def _leave(self, band: Array) -> tuple[Array, Array]:
        """What bands (K, B, S) leave of the profiles, standard deviations, and their light (K, B), gray levels."""
        light = (band * self._level).sum(axis=-1) / np.maximum((band * band).sum(axis=-1), 1e-9)
        light = np.maximum(light, 0.0)
        return np.asarray((self._level - light[..., None] * band) / self._profiles.noise), light

    def _loss(self, residual: Array, parameters: Array) -> Array:
        return np.asarray(_robust(residual) + ((parameters / self._prior) ** 2).sum(axis=-1))


def _robust(residual: Array) -> Array:
    """Cauchy's loss of residuals (..., S), summed."""
    return np.asarray(ROBUST**2 * np.log1p((residual / ROBUST) ** 2).sum(axis=-1))


def weigh(residual: Array) -> Array:
    """How much residuals count, standard deviations."""
    return np.asarray(1.0 / (1.0 + (residual / ROBUST) ** 2))


def _place_edges(bands: CoatShape) -> tuple[Array, Array]:
    """The steps (4, K, B) of both bands, up and down those of the new one and then those of the old one: where, and how
    high. What the new paint hides begins at the later one of the steps up, and ends at the earlier one of those down.
    """
    half, old_half = 0.5 * bands.width, 0.5 * bands.old_width
    old = bands.place + bands.beside
    edges = np.array([bands.place - half, bands.place + half, old - old_half, old + old_half])
    hidden = OPAQUE * (np.abs(bands.beside) < half + old_half)
    begins, ends = hidden * (edges[0] > edges[2]), hidden * (edges[1] <= edges[3])
    weight = bands.strength * np.array([-begins, ends, 1.0 - (hidden - begins), (hidden - ends) - 1.0])
    weight[0] += 1.0
    weight[1] -= 1.0
    return edges, weight


def _step(z: Array) -> tuple[Array, Array]:
    """Normal distribution function and density."""
    bell = np.exp(-0.5 * z * z)
    t = np.abs(z)
    t *= _ERF[3] / np.sqrt(2.0)
    t += 1.0
    np.reciprocal(t, out=t)
    half = _ERF[2] * t
    for factor in (_ERF[1], _ERF[0]):
        half += factor
        half *= t
    half *= -0.5 * bell
    half += 0.5
    bell *= 1.0 / np.sqrt(2.0 * np.pi)
    return np.copysign(half, z) + 0.5, bell

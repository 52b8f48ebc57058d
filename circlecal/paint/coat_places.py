"""Where an old coat may lie beside the paint, told at a glance: most circles have none, and no second band is fitted.

What one band leaves of the profiles is compared with what a faint second one would add, sector by sector at places
beside the paint, and summed along the circles that an old coat may have.
"""

from __future__ import annotations

import numpy as np

from circlecal.geometry.least_squares import NormalState
from circlecal.geometry.projective import Array, Indices
from circlecal.paint.coat_bands import REACH_M, SECTORS, CoatBands, CoatProfiles, find_sectors, harmonics, weigh

__all__ = ["find_pairs", "foretell_coats"]

GROWTHS_M, STEPS_M = np.linspace(-0.12, 0.12, 5), np.linspace(-0.32, 0.32, 9)
"""What the radius of an old circle may be larger, and places of its middle along both axes."""
AWAY_M = np.linspace(-REACH_M, REACH_M, 21)
"""Places beside the paint of one sector, between which what speaks for an old coat is interpolated."""
LEAST_GAIN, LEAST_STRENGTH = 12.0, 0.035
"""By how much a coat must be foretold to lower the chi-square, in units of what one band leaves per sample, and its
foretold strength, for any to be looked for. The one band has taken in part of the coat, so both are foretold too small:
60 rendered circles whose coat is told have 14 or more at 0.036 or more, 36 of 48 real circles without one have less, at
smaller gains or, where they reach 24, at strengths of 0.01 to 0.034.
"""
MOST, APART_M = 3, 0.1
"""Places that are told, and how far they lie apart at least."""
FIRSTS, PAIRS = 8, 6
"""Circles along which most paint lies, for each of which a second one is looked for; and pairs that are told. Of eight
rendered circles with two coats that are alike the best two bands were reached from these pairs on seven, from places
beside one band on two.
"""


def _list_places() -> Array:
    """Growth and shift (K, 3) of the circles that an old coat may have."""
    places = np.stack(np.meshgrid(GROWTHS_M, STEPS_M, STEPS_M, indexing="ij"), axis=-1).reshape(-1, 3)
    return np.asarray(places[np.abs(places[:, 0]) + np.hypot(places[:, 1], places[:, 2]) <= REACH_M])


def _share_out(places_m: Array) -> Array:
    """Weights (SECTORS / 2, A, K) of the places beside the paint of each two sectors, between which the circles (K, 3)
    run there.
    """
    angle = np.asarray(4.0 * np.pi / SECTORS * (np.arange(SECTORS // 2) + 0.5), np.float64)
    off = (harmonics(angle, 1) @ places_m.T)[:, None] - AWAY_M[:, None]
    return np.asarray(np.maximum(1.0 - np.abs(off) / (AWAY_M[1] - AWAY_M[0]), 0.0))


_PLACES_M = _list_places()
_WEIGHTS = _share_out(_PLACES_M)


def find_pairs(profiles: CoatProfiles, one: CoatBands) -> Array:
    """Growth and shift of two circles, metres, of the first beside the camera's curve and of the second beside the
    first (K, 6): pairs that together follow the paint of most sectors, the best first.

    One band that is fitted to two coats of like strength runs along one here and along the other there, and what it
    leaves does not tell the second. So each sector counts for that circle of a pair that explains it better.

    Parameters
    ----------
    profiles : CoatProfiles
        Of every two sectors.
    one : CoatBands
        One band.
    """
    shifted = np.tile(one.expected, (len(AWAY_M), 1))
    shifted[:, 0] = AWAY_M
    weights = _WEIGHTS[find_sectors(profiles.angle, SECTORS // 2)]
    gain = np.einsum("ba,bak->kb", one.gain(shifted).T, weights)
    first = _pick(gain.sum(axis=1), FIRSTS)
    away = _PLACES_M - _PLACES_M[first][:, None]
    both = np.maximum(gain[first][:, None], gain).sum(axis=-1)
    both[np.linalg.norm(away, axis=-1) < APART_M] = 0.0
    second = both.argmax(axis=1)
    pairs = np.concatenate([_PLACES_M[first], away[np.arange(len(first)), second]], axis=1)
    return np.asarray(pairs[np.argsort(-both.max(axis=1), kind="stable")[:PAIRS]])


def foretell_coats(profiles: CoatProfiles, one: CoatBands, alone: NormalState) -> Array:
    """Growth and shift (K, 3) of circles, metres, that an old coat beside one band may have, best first.

    For each of them a score test tells how much a coat lowers the chi-square beside all that the one band may do
    instead (Rao 1948, *Large sample tests of statistical hypotheses concerning several parameters*).

    Parameters
    ----------
    profiles : CoatProfiles
        Of every two sectors.
    one, alone : CoatBands, NormalState
        The one band, and where it explains the profiles best.
    """
    residual, slope = (values[0] for values in one.linearise(alone.parameters))
    hint = one.hint(alone.parameters[0], AWAY_M).swapaxes(0, 1)
    weighted = hint * weigh(residual)[:, None]
    by_own = (weighted * hint).sum(axis=-1, keepdims=True)
    table = np.concatenate([weighted @ residual[..., None], by_own, weighted @ slope.transpose(1, 2, 0)], axis=-1)
    weights = _WEIGHTS[find_sectors(profiles.angle, SECTORS // 2)].reshape(-1, len(_PLACES_M))
    gradient, own, mixed = np.split(weights.T @ table.reshape(len(weights), -1), (1, 2), axis=1)
    taken = np.linalg.solve(alone.normal[0], np.column_stack([alone.gradient[0], mixed.T]))
    score = mixed @ taken[:, 0] - gradient[:, 0]
    strength = score / np.maximum(own[:, 0] - (mixed * taken[:, 1:].T).sum(axis=1), 1e-9)
    left = alone.cost[0] / profiles.level.size
    gain = np.where(strength >= LEAST_STRENGTH, strength * score, 0.0) / max(left, 1e-12)
    return np.asarray(_PLACES_M[_pick(gain, MOST if gain.max() >= LEAST_GAIN else 0)])


def _pick(gain: Array, most: int) -> Indices:
    """Numbers of the places that gain most, so many at most and some way apart."""
    left = gain.copy()
    picked: list[int] = []
    while len(picked) < most and left.max() > 0.0:
        picked.append(int(np.argmax(left)))
        left[np.linalg.norm(_PLACES_M - _PLACES_M[picked[-1]], axis=1) < APART_M] = 0.0
    return np.array(picked, np.int64)

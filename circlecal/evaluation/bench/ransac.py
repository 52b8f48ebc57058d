"""``circlecal bench ransac``: good fits under outliers, and speed beside OpenCV and scikit-image in the same run."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from circlecal.geometry.conic_fits import fit_conic, refine_conic
from circlecal.geometry.conics import sampson_distance
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.projective import Array, Mask, apply_homography, similarity_normalisation
from circlecal.geometry.ransac import msac_costs, ransac_conic, sample_conics

HYPOTHESES = 1000
OUTLIER_SHARES = ((0.1, 0.5), (0.3, 0.5), (0.5, 0.5), (0.6, 0.5), (0.5, 1.0))
"""Share of outliers and noise of the inliers, pixels."""
SPEED_POINTS = 800
SKIMAGE_TRIALS = 5
OUTLIER_BAND_PX = 25.0
"""Standard deviation of the outliers about the ellipse, across it."""
LEG_CLUSTERS = 6
"""Places on the ellipse at which the other outliers stand, as legs of players do: 20 px wide and 90 px high."""


@dataclass(frozen=True, slots=True)
class Robustness:
    """Share of draws whose fit lies within 1.5 times (or 0.1 px) of the fit on the true inliers."""

    outliers: float
    sigma_px: float
    draws: int
    good: float


@dataclass(frozen=True, slots=True)
class Speed:
    """Best of several runs in milliseconds, and how many times faster circlecal's is."""

    name: str
    ms: float
    ratio: float


def robustness(draws: int, seed: int, advance: Callable[[str], None] = lambda _: None) -> list[Robustness]:
    """Row 14 and its neighbours: 400 points of a circle, outliers half about the ellipse, half in vertical clusters."""
    rows = []
    for share, sigma in OUTLIER_SHARES:
        good = 0
        for index in range(draws):
            good += _one_fit(share, sigma, np.random.default_rng([seed, index]))
            advance(f"outliers {share:.0%}")
        rows.append(Robustness(share, sigma, draws, good / draws))
    return rows


def _one_fit(share: float, sigma_px: float, rng: np.random.Generator) -> bool:
    ellipse, points, inliers = sample_contaminated_ellipse(400, share, sigma_px, rng)
    robust = ransac_conic(points, 4 * sigma_px, rng, hypotheses=HYPOTHESES)
    refined = None if robust is None else refine_conic(points[robust.inliers], robust.conic)
    start = fit_conic(points[inliers], "taubin")
    oracle = None if start is None else refine_conic(points[inliers], start)
    if refined is None or oracle is None:
        return False
    truth = ellipse.points(np.linspace(0, 2 * np.pi, 100))

    def rms(conic: Array) -> float:
        return float(np.sqrt(np.mean(sampson_distance(conic, truth) ** 2)))

    return rms(refined[0]) < max(1.5 * rms(oracle[0]), rms(oracle[0]) + 0.1)


def sample_contaminated_ellipse(
    count: int, share: float, sigma_px: float, rng: np.random.Generator
) -> tuple[Ellipse, Array, Mask]:
    """An ellipse as a main camera sees it, points on it with outliers first, and which are inliers."""
    longer = rng.uniform(400, 700)
    ellipse = Ellipse(rng.normal((960, 540), 50), (longer, rng.uniform(0.2, 0.5) * longer), rng.normal() * 0.05)
    angles = rng.uniform(0, 2 * np.pi, count)
    points = ellipse.points(angles) + rng.normal(0, sigma_px, (count, 2))
    outliers = int(count * share)
    band = outliers // 2
    points[:band] += ellipse.normals(angles[:band]) * rng.normal(0, OUTLIER_BAND_PX, (band, 1))
    cluster = np.arange(outliers - band) * LEG_CLUSTERS // max(outliers - band, 1)
    feet = ellipse.points(rng.uniform(0, 2 * np.pi, LEG_CLUSTERS))
    points[band:outliers] = feet[cluster] + rng.uniform(-1, 1, (outliers - band, 2)) * (10, 45)
    return ellipse, points, np.arange(count) >= outliers


def speed(seed: int, runs: int = 7) -> list[Speed]:
    """Row 15: a thousand hypotheses scored on 800 points, one thread, everything in this run."""
    cv2.setNumThreads(1)
    rng = np.random.default_rng(seed)
    _, points, _ = sample_contaminated_ellipse(SPEED_POINTS, 0.3, 0.5, rng)
    T = similarity_normalisation(points)
    local, threshold = apply_homography(T, points), 2.0 * T[0, 0]
    ours = _best_ms(lambda: msac_costs(sample_conics(local, HYPOTHESES, rng), local, threshold), runs)
    whole = _best_ms(lambda: ransac_conic(points, 2.0, rng, hypotheses=HYPOTHESES), runs)
    loop = _best_ms(lambda: _opencv_loop(points, rng), max(2, runs // 2))
    slow = _best_ms(lambda: _skimage(points), 1) * HYPOTHESES / SKIMAGE_TRIALS
    return [
        Speed("circlecal, hypotheses and scores", ours, 1.0),
        Speed("circlecal, with local refits", whole, whole / ours),
        Speed("loop over cv2.fitEllipseDirect, scored with numpy", loop, loop / ours),
        Speed(f"skimage.measure.ransac(EllipseModel), {SKIMAGE_TRIALS} trials scaled up", slow, slow / ours),
    ]


def _opencv_loop(points: Array, rng: np.random.Generator) -> float:
    single = points.astype(np.float32)
    best = np.inf
    for picks in rng.integers(0, len(points), (HYPOTHESES, 5)):
        (x, y), (first, second), angle = cv2.fitEllipseDirect(single[picks])
        if first > 0 and second > 0:
            c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
            u = ((single[:, 0] - x) * c + (single[:, 1] - y) * s) / (first / 2)
            v = ((single[:, 1] - y) * c - (single[:, 0] - x) * s) / (second / 2)
            value = u * u + v * v - 1
            gradient = 4 * ((u / (first / 2)) ** 2 + (v / (second / 2)) ** 2)
            best = min(best, float(np.minimum(value * value / gradient, 4.0).mean()))
    return best


def _skimage(points: Array) -> object:
    from skimage.measure import EllipseModel, ransac

    return ransac(points, EllipseModel, 5, 2.0, max_trials=SKIMAGE_TRIALS, rng=0)


def _best_ms(call: Callable[[], object], runs: int) -> float:
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times) * 1e3

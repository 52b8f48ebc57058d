"""Stage ``rays``: which edge points are the inner and which the outer edge of the marking, by casting rays from its
centre.

Magera et al. 2025, section 4.4: "the first detected edges along the rays belong to the inner circle, the second ones
to the outer". Where the marking is narrower than the picture's blur two edges are a fiction; there, and everywhere, the
middle of the band is measured from its flux (:mod:`circlecal.paint.along_curve`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from circlecal.geometry.ellipses import Ellipse, ellipse_from_conic
from circlecal.geometry.projective import Array
from circlecal.geometry.ransac import ransac_conic
from circlecal.paint.along_curve import RIM_PX, WIDTH_RATIO, RaysConfig, along_normals, bands_along
from circlecal.paint.bands import Bands
from circlecal.paint.profiles import GrayPicture
from circlecal.refusals import Confidence, refuse
from circlecal.results import EdgePoints, MarkingMask, RayPoints

SEPARABLE_RATIO = 1.8
"""Two edges are told apart where the band is so many times wider than the narrowest paint, which is the blur's width:
of narrower bands the blur moves both edges outwards.
"""
FIRST_STEP = 4.0
"""The first look at the rough ellipse takes profiles this many times as far apart."""


def cast_rays(
    picture: GrayPicture,
    edges: EdgePoints,
    mask: MarkingMask,
    relative_width: float,
    config: RaysConfig,
    rng: np.random.Generator,
) -> RayPoints:
    """Inner, outer and centreline points of the circle's marking.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field (:func:`circlecal.paint.profiles.to_gray`).
    edges : EdgePoints
        From the stage ``edges``.
    mask : MarkingMask
        Its rough ellipse gives the first centre; the centre need not be inside the picture.
    relative_width : float
        Marking width over the radius of its centreline; 0 of the rim of a disc, which has one edge.
    config : RaysConfig
        Options.
    rng : numpy.random.Generator
        For the robust fit that re-estimates the centre.

    Raises
    ------
    EstimationError
        ``no_circle_found`` without a rough ellipse, ``no_band`` where too few rays meet a band.
    """
    rough = None if mask.conic is None else ellipse_from_conic(mask.conic)
    if rough is None:
        raise refuse("rays", "no_circle_found")
    unit = picture.shape[1] / 1920.0
    # the detector has fitted a circle that it accepts to the picture itself
    fitted = mask.source == "detector" and mask.confidence is Confidence.ACCEPTED
    center_fit = rough if fitted else _first_look(picture, rough, edges.noise, relative_width, config, rng)
    if center_fit is None:
        raise refuse("rays", "no_band")
    second = _centreline(picture, center_fit, edges.noise, config.refine_px * unit, relative_width, config, 1.0)
    if len(second.points) < 12:
        raise refuse("rays", "no_band")
    if relative_width == 0.0:
        nothing = np.zeros((0, 2))
        edges = replace(edges, points_px=nothing, normals=nothing, contrast=nothing[:, 0], sigma_px=nothing[:, 0])
    outer, inner, rays, rejected = _pair_edges(edges, center_fit, second, relative_width, config, unit)
    return RayPoints(
        center_px=center_fit.center,
        outer_px=edges.points_px[outer],
        outer_sigma_px=edges.sigma_px[outer],
        inner_px=edges.points_px[inner],
        inner_sigma_px=edges.sigma_px[inner],
        center_line_px=second.points,
        center_line_sigma_px=second.bands.sigma(edges.noise),
        rays=rays,
        rejected=len(rejected) + second.rejected,
        rejected_px=edges.points_px[rejected],
        rough=center_fit,
    )


def _first_look(
    picture: GrayPicture,
    rough: Ellipse,
    noise: float,
    relative_width: float,
    config: RaysConfig,
    rng: np.random.Generator,
) -> Ellipse | None:
    """Robust ellipse through the band's middle near a rough one; None where too few rays meet a band."""
    unit = picture.shape[1] / 1920.0
    first = _centreline(picture, rough, noise, config.search_px * unit, relative_width, config, FIRST_STEP)
    threshold = 3.0 * unit + 3.0 * first.bands.sigma(noise)
    fit = ransac_conic(first.points, threshold, rng, hypotheses=300, method="taubin", confidence=0.999)
    return None if fit is None or fit.inliers.sum() < 12 else ellipse_from_conic(fit.conic)


class _Centreline:
    """Band centres along an ellipse: points, measurements, eccentric angles, and the narrowest width (the picture's
    blur).
    """

    def __init__(self, points: Array, bands: Bands, angles: Array, rejected: int) -> None:
        self.points = points
        self.bands = bands
        self.angles = angles
        self.rejected = rejected
        self.blur_width = float(np.percentile(bands.width, 10)) if len(points) else float("nan")


def even_angles(ellipse: Ellipse, spacing_px: float, maximum: int) -> Array:
    """Eccentric angles (N,) at even arc length."""
    dense = np.linspace(0.0, 2 * np.pi, 721)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(ellipse.points(dense), axis=0).T))])
    count = int(np.clip(length[-1] / spacing_px, 64, maximum))
    return np.interp(np.arange(count) * length[-1] / count, length, dense)


def _centreline(
    picture: GrayPicture,
    ellipse: Ellipse,
    noise: float,
    search_px: float,
    relative_width: float,
    config: RaysConfig,
    step: float,
) -> _Centreline:
    """Band centres at the configured spacing, or ``step`` times as far apart for a first look."""
    angles = even_angles(ellipse, step * config.spacing_px, config.maximum)
    points, normals = ellipse.points_and_normals(angles)
    height, width = picture.shape
    inside = ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
    angles, points, normals = angles[inside], points[inside], normals[inside]
    predicted = _predict_width(ellipse, points, normals, relative_width)
    if relative_width == 0.0:
        predicted = np.full(len(points), RIM_PX * width / 1920.0)
    middle, chosen, plausible = bands_along(picture, points, normals, predicted, noise, search_px, config, step)
    return _Centreline(middle, chosen, angles[plausible], int((~plausible).sum()))


def _predict_width(ellipse: Ellipse, points: Array, normals: Array, relative_width: float) -> Array:
    """Width (N,) of the band along the normal in pixels, to first order: the ellipse scaled about its centre."""
    return relative_width * along_normals(points - ellipse.center, normals)


def _pair_edges(
    edges: EdgePoints, ellipse: Ellipse, centreline: _Centreline, relative_width: float, config: RaysConfig, unit: float
) -> tuple[NDArray[np.int_], NDArray[np.int_], int, NDArray[np.int_]]:
    """Indices of the outer and the inner edge point of each accepted ray, the number of rays, and the rejected points.

    Each ray is one bin of the eccentric angle; along it, from the centre outwards, the first crossing must rise into
    the band and the second fall out of it, with a plausible width between them.
    """
    angles = ellipse.parameter(edges.points_px)
    feet, normals = ellipse.points_and_normals(angles)
    foot_distance = along_normals(edges.points_px - feet, normals)
    near = np.abs(foot_distance) < 2 * config.refine_px * unit + 6.0
    outward = along_normals(edges.normals, normals)
    rays = int(np.clip(2 * np.pi * np.sqrt(np.mean(np.square(ellipse.semi_axes))), 64, config.maximum))
    ray = np.floor((angles / (2 * np.pi) % 1.0) * rays).astype(int)
    order = np.flatnonzero(near & (np.abs(outward) > 0.7))
    # by ray, then outwards: near points lie well within so many pixels
    span = 8.0 * config.refine_px * unit + 24.0
    order = order[np.argsort(ray[order] * span + foot_distance[order], kind="stable")]
    inner, outer = order[:-1], order[1:]
    paired = (ray[inner] == ray[outer]) & (outward[inner] > 0) & (outward[outer] < 0)
    inner, outer = inner[paired], outer[paired]
    gap = foot_distance[outer] - foot_distance[inner]
    middle = 0.5 * (foot_distance[outer] + foot_distance[inner])
    predicted = _predict_width(ellipse, feet[inner], normals[inner], relative_width)
    low, high = WIDTH_RATIO
    good = (gap > low * predicted) & (gap < high * predicted + 2.0)
    local_width, local_middle, known = _along(centreline, angles[inner])
    good &= known & (local_width > SEPARABLE_RATIO * centreline.blur_width)
    good &= np.abs(middle - local_middle) < 1.0 + 0.25 * gap
    inner, outer = inner[good], outer[good]
    rejected = near
    rejected[inner] = rejected[outer] = False
    return outer, inner, rays, np.flatnonzero(rejected)


def _along(centreline: _Centreline, angles: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Width, offset and presence of the measured band at other angles."""
    turned = angles % (2 * np.pi)
    index = np.searchsorted(centreline.angles, turned)
    left, right = (index - 1) % len(centreline.angles), index % len(centreline.angles)
    before, after = _wrap_angle(turned - centreline.angles[left]), _wrap_angle(centreline.angles[right] - turned)
    share = before / np.maximum(before + after, 1e-12)
    width, middle = (
        values[left] + share * (values[right] - values[left])
        for values in (centreline.bands.width, centreline.bands.center)
    )
    return width, middle, np.minimum(np.abs(before), np.abs(after)) < np.radians(1.0)


def _wrap_angle(angle: Array) -> Array:
    return (angle + np.pi) % (2 * np.pi) - np.pi

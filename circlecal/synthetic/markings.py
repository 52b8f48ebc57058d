"""Noisy observations of the markings straight from a camera, without a picture, and outliers as pictures have them."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate, unit_circle
from circlecal.geometry.camera import Camera
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import FLAT, Surface
from circlecal.observations import CircleEdge, CirclePoints, LinePoints, MarkPoint
from circlecal.synthetic.cameras import inside_frame

Spacing = Literal["image", "field"]

MIN_SIGMA_PX = 1e-3
_CURVE_SAMPLES = 3600
_BAND_SD_PX = 25.0
_LEG_CLUSTERS = 6
_LEG_HEIGHT_PX = 70.0
_LEG_SD_PX = 3.0


def circle_points(
    camera: Camera,
    template: FieldTemplate,
    edge: CircleEdge,
    count: int,
    sigma_px: float,
    rng: np.random.Generator,
    spacing: Spacing = "image",
    marking_width_m: float | None = None,
    *,
    circle: str | None = None,
    surface: Surface = FLAT,
    phase: float | None = None,
) -> CirclePoints:
    """Points on one edge of a circle's paint, spread over what the frame shows of it.

    Parameters
    ----------
    camera : Camera
        The view, lens included.
    template : FieldTemplate
        Field.
    edge : {"outer", "inner", "center"}
        Edge of the paint, or its centreline.
    count : int
        Number of points; none come back where the frame shows nothing of the edge.
    sigma_px : float
        Standard deviation of the noise along x and along y; the stated sigma is the same, but at least 1e-3.
    rng : Generator
        Randomness: the phase first, then the noise.
    spacing : {"image", "field"}
        Equal steps along the curve in the picture, or of the angle on the field.
    marking_width_m : float, optional
        Width of the paint if not the template's.
    circle : str, optional
        Name of the circle; the template's default one if not given.
    surface : Surface
        Shape of the ground.
    phase : float, optional
        Where the first point lies, as a share of one step; drawn if not given. Give the same one to both edges for the
        same angles on them.

    Returns
    -------
    CirclePoints
        In order along the curve. Noise may carry a point past the border of the frame.
    """
    element = template.circle_by_name[circle or template.default_circle]
    radius = template.radius(element, edge, marking_width_m)
    start = rng.random() if phase is None else phase

    def on_field(angles: Array) -> Array:
        return np.asarray(element.center) + radius * unit_circle(angles)

    dense = np.linspace(0.0, 2 * np.pi, _CURVE_SAMPLES + 1)
    shares = (np.arange(count) + start) / max(count, 1)
    angles = _spread(dense, camera.project(surface.lift(on_field(dense))), shares, camera, spacing)
    pixels = camera.project(surface.lift(on_field(angles)))
    return CirclePoints(element.name, edge, _noisy(pixels, sigma_px, rng), _state_sigma(len(pixels), sigma_px))


def line_points(
    camera: Camera,
    template: FieldTemplate,
    line: str,
    count: int,
    sigma_px: float,
    rng: np.random.Generator,
    *,
    surface: Surface = FLAT,
) -> LinePoints:
    """Points on the centreline of a straight marking, evenly apart in the picture, with both ends of what it shows.

    The other parameters are those of :func:`circle_points`; ``count`` is at least 2.
    """
    ends = template.line_ends(template.line_by_name[line])
    dense = np.linspace(0.0, 1.0, _CURVE_SAMPLES + 1)

    def on_field(along: Array) -> Array:
        return np.asarray(ends[0] + along[:, None] * (ends[1] - ends[0]))

    shares = np.linspace(0.0, 1.0, count)
    along = _spread(dense, camera.project(surface.lift(on_field(dense))), shares, camera, "image")
    pixels = camera.project(surface.lift(on_field(along)))
    return LinePoints(line, _noisy(pixels, sigma_px, rng), _state_sigma(len(pixels), sigma_px))


def mark_point(
    camera: Camera,
    template: FieldTemplate,
    mark: str,
    sigma_px: float,
    rng: np.random.Generator,
    *,
    surface: Surface = FLAT,
) -> MarkPoint | None:
    """A spot with noise, or None where it lies outside the frame."""
    pixel = camera.project(surface.lift(template.mark_by_name[mark].position))
    if not inside_frame(pixel, camera.width, camera.height):
        return None
    return MarkPoint(mark, _noisy(pixel, sigma_px, rng), max(sigma_px, MIN_SIGMA_PX))


def add_outliers(
    points: CirclePoints, share: float, rng: np.random.Generator
) -> tuple[CirclePoints, NDArray[np.bool_]]:
    """Replace a share of the points by outliers; the order is lost.

    Half of the outliers fill a band of 25 px standard deviation around the curve, as shadows and mowing edges do; half
    stand in six upright clusters of 70 px on it, as legs do.

    Returns
    -------
    points : CirclePoints
        As many as before, with the stated sigmas unchanged.
    inliers : (N,) bool array
        Which of them are still on the curve.
    """
    if not 0.0 <= share < 1.0:
        raise ValueError(f"share must be in [0, 1), not {share}")
    total = len(points.points_px)
    outliers = round(share * total)
    legs = outliers // 2
    order = rng.permutation(total)
    pixels = points.points_px[order].copy()
    sources = points.points_px[rng.integers(0, max(total, 1), outliers)]
    band = sources[legs:] + rng.normal(0.0, _BAND_SD_PX, (outliers - legs, 2))
    feet = points.points_px[rng.integers(0, max(total, 1), _LEG_CLUSTERS)] if total else np.zeros((_LEG_CLUSTERS, 2))
    upright = np.stack([rng.normal(0.0, _LEG_SD_PX, legs), -rng.uniform(-0.1, 0.9, legs) * _LEG_HEIGHT_PX], axis=-1)
    pixels[:legs] = feet[np.arange(legs) % _LEG_CLUSTERS] + upright
    pixels[legs:outliers] = band
    return replace(points, points_px=pixels, sigma_px=points.sigma_px[order]), np.arange(total) >= outliers


def _spread(parameter: Array, pixels: Array, shares: Array, camera: Camera, spacing: Spacing) -> Array:
    """Curve parameters at shares (K,) of the visible length, from dense samples (S,) and their pixels (S, 2)."""
    inside = inside_frame(pixels, camera.width, camera.height)
    step = np.linalg.norm(np.diff(pixels, axis=0), axis=1) if spacing == "image" else np.diff(parameter)
    visible = inside[1:] & inside[:-1]
    if not visible.any():
        return np.zeros(0)
    starts, lengths = parameter[:-1][visible], step[visible]
    travelled = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.clip(shares, 0.0, 1.0) * travelled[-1]
    piece = np.clip(np.searchsorted(travelled, wanted, side="right") - 1, 0, len(lengths) - 1)
    width = np.diff(parameter)[visible][piece]
    return np.asarray(starts[piece] + (wanted - travelled[piece]) / lengths[piece] * width)


def _noisy(pixels: Array, sigma_px: float, rng: np.random.Generator) -> Array:
    return np.asarray(pixels + sigma_px * rng.standard_normal(pixels.shape))


def _state_sigma(count: int, sigma_px: float) -> Array:
    return np.full(count, max(sigma_px, MIN_SIGMA_PX))

"""Whether the markings that a camera puts into view are there: those of a wrong circle's camera are not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from circlecal.camera_fit.model import INDEX, Frame, view
from circlecal.detection.config import RefinementConfig
from circlecal.detection.refine import measure_band
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.homogeneous import Array
from circlecal.results import Agreement, CameraFit

__all__ = ["expected_markings"]

SPACING_PX = 4.0
"""Distance of the profiles along a marking, pixels at 1920 px width."""
LARGEST_SIGMA_PX = 4.0
"""Where a marking's place is less certain than this, pixels at 1920 px width, it is not looked for."""
SHORTEST_WIDTHS = 0.03
"""Shorter parts of a marking, picture widths, are not judged."""
PIECES = 4
"""Of a marking, between which its contrast may differ."""
NEAREST_M = 0.5
"""Depth before the camera from which on the field counts as seen."""
ACROSS_PX, SIGMAS = 4.0, 2.0
"""Reach of a profile to both sides: pixels at 1920 px width, and standard deviations of the marking's place."""
THINNEST = 0.2, 0.6
"""Paint must be as wide in the picture as this share of the quantile of the circle's own, which was seen."""
_SIZES = ("width", "length", "breadth")


def expected_markings(
    picture: NDArray[np.uint8],
    fit: CameraFit,
    template: FieldTemplate,
    circle: Circle,
    known: frozenset[str],
    region: NDArray[np.bool_] | None,
) -> Agreement:
    """Look for every marking of the template where the camera puts it, but for those that the camera was fitted to.

    Parameters
    ----------
    picture : (H, W) uint8
        Brightness, with the markings lighter than the field.
    fit : CameraFit
        The camera, with the covariance that says how well each marking's place is known.
    template : FieldTemplate
        The field.
    circle : Circle
        The circle that the camera was fitted to.
    known : frozenset of str
        Markings that it was fitted to beside the circle.
    region : (h, w) bool or None
        The playing surface in a reduced picture.

    Returns
    -------
    Agreement
    """
    frame = Frame(fit.camera.width, fit.camera.height, fit.crown_shape, max(circle.radius_m, 1e-3))
    unit = frame.width / 1920.0
    names, nodes, shifts = template.outlines
    outline = np.array([template.length_m, template.width_m]) / 2 - template.marking_width_m
    on_outline = np.asarray((np.abs(nodes) >= outline).all(axis=1), np.bool_)
    inner = ~np.asarray(on_outline.any(axis=-1), np.bool_)
    own = names.index(circle.name)
    wanted = [own, *(k for k, name in enumerate(names) if inner[k] and name not in known and k != own)]
    names, nodes, shifts = tuple(names[k] for k in wanted), nodes[wanted], shifts[wanted]
    sizes = fit.theta[[INDEX[name] for name in _SIZES]]
    points = (nodes + np.einsum("s,ksi->ki", sizes, shifts)[:, None]).reshape(-1, 2)
    pixels, normals, sigma, scale, seen = _predicted(fit, frame, points, shifts, nodes.shape[1])
    element, base, normal, spread, across = _samples(pixels, normals, sigma, scale, seen, SPACING_PX * unit)
    visible = np.asarray(((base > 0) & (base < (frame.width - 1, frame.height - 1))).all(axis=1), np.bool_)
    visible &= spread < LARGEST_SIGMA_PX * unit
    mine = element == 0
    if not (visible & mine).any():
        return Agreement((), np.zeros(0), np.zeros(0))
    visible &= ~mine & np.asarray(across >= THINNEST[1] * np.quantile(across[visible & mine], THINNEST[0]))
    if region is not None:
        rows, columns = region.shape
        at = np.clip((base * (columns / frame.width, rows / frame.height)).astype(int), 0, (columns - 1, rows - 1))
        visible &= np.asarray(region[at[:, 1], at[:, 0]])
    count = np.bincount(element[visible], minlength=len(names))
    visible &= count[element] * SPACING_PX >= SHORTEST_WIDTHS * 1920.0
    element, base, normal = element[visible], base[visible], normal[visible]
    kept, element = np.unique(element, return_inverse=True)
    if len(kept) == 0:
        return Agreement((), np.zeros(0), np.zeros(0))
    count = np.bincount(element)
    reach = max(ACROSS_PX * unit, 3.0) + SIGMAS * spread[visible] + template.marking_width_m * across[visible]
    position = np.arange(len(element)) - np.repeat(np.cumsum(count) - count, count)
    pieces = element * PIECES + position * PIECES // count[element]
    band = measure_band(picture, base, normal, reach, pieces, 1.0, RefinementConfig())
    share = np.asarray(np.bincount(element, band.supported.astype(np.float64)) / count, np.float64)
    return Agreement(tuple(names[k] for k in kept), count.astype(np.float64) * (SPACING_PX * unit), share)


def _predicted(
    fit: CameraFit, frame: Frame, points: Array, shifts: Array, nodes: int
) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]]:
    """Of the nodes (K N, 2) of K markings: pixels and normals (K, N, 2), standard deviation of the place along the
    normal and pixels per metre of ground there (K, N), and whether they are in front of the camera.
    """
    markings = len(points) // nodes
    seen = view(fit.theta[None], points[None, :, 0], points[None, :, 1], frame)
    pixels = seen.pixels[0].T.reshape(markings, nodes, 2)
    tangent = np.gradient(pixels, axis=1)
    tangent /= np.maximum(np.hypot(tangent[..., :1], tangent[..., 1:]), 1e-9)
    normals = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    by_theta, by_field = (rows[0] for rows in seen.gradient(normals.reshape(1, -1, 2).swapaxes(1, 2)))
    by_sizes = np.einsum("ksi,ikn->skn", shifts, by_field.reshape(2, markings, nodes)).reshape(len(_SIZES), -1)
    by_theta[[INDEX[name] for name in _SIZES]] += by_sizes
    variance = (by_theta * (fit.covariance @ by_theta)).sum(axis=0)
    sigma = np.sqrt(np.maximum(variance, 0.0)).reshape(markings, nodes)
    scale = np.hypot(*by_field).reshape(markings, nodes)
    ahead = (seen.depth[0] > NEAREST_M) & (np.abs(pixels.reshape(-1, 2)) < 4.0 * frame.width).all(axis=1)
    return pixels, normals, sigma, scale, ahead.reshape(markings, nodes)


def _samples(
    pixels: Array, normals: Array, sigma: Array, scale: Array, seen: NDArray[np.bool_], spacing_px: float
) -> tuple[NDArray[np.int_], Array, Array, Array, Array]:
    """Places at equal steps along the markings: which marking (M,), pixels, normals (M, 2), sigma and scale (M,)."""
    markings, nodes = seen.shape
    length = np.hypot(*np.moveaxis(np.diff(pixels, axis=1), -1, 0))
    length = np.where(seen[:, 1:] & seen[:, :-1], length, 0.0).ravel()
    end = np.cumsum(length)
    along = np.arange(0.5 * spacing_px, end[-1], spacing_px)
    span = np.minimum(np.searchsorted(end, along, side="right"), len(length) - 1)
    share = ((along - (end[span] - length[span])) / np.maximum(length[span], 1e-9))[:, None]
    element = span // (nodes - 1)
    first = element * nodes + span % (nodes - 1)

    def between(values: Array) -> Array:
        flat = values.reshape(markings * nodes, -1)
        return np.asarray(flat[first] + share * (flat[first + 1] - flat[first]))

    return element, between(pixels), between(normals), between(sigma)[:, 0], between(scale)[:, 0]

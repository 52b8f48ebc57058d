"""Where the markings of a field must be in the picture by a camera, how surely, and how wide their paint is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.projective import Array
from circlecal.line_naming.predicted_markings import PredictedMarkings, predict_markings
from circlecal.results import CameraFit

__all__ = ["SPACING_PX", "MarkingPlaces", "lie_on_surface", "place_markings"]

SPACING_PX = 4.0
"""Distance of the places along a marking, pixels at 1920 px width."""

_SIZES = ("width", "length", "breadth")


@dataclass(frozen=True, slots=True)
class MarkingPlaces:
    """M places at equal steps along what the picture may show of K markings.

    Attributes
    ----------
    names : tuple of str
        The template's, of the K markings.
    element : (M,) int64
        To which marking a place belongs.
    base, normal : (M, 2) arrays
        Pixels, and unit vectors across the marking.
    spread : (M,) array
        Standard deviation of the place along its normal, pixels.
    across : (M,) array
        Pixels across the marking per metre of ground.
    """

    names: tuple[str, ...]
    element: NDArray[np.int_]
    base: Array
    normal: Array
    spread: Array
    across: Array

    def take(self, kept: NDArray[np.bool_]) -> MarkingPlaces:
        """Some of the places (M,)."""
        rest = (getattr(self, name)[kept] for name in MarkingPlaces.__slots__[1:])
        return MarkingPlaces(self.names, *rest)


def place_markings(fit: CameraFit, template: FieldTemplate, wanted: Sequence[int]) -> MarkingPlaces:
    """Places along markings of the template, by their index in its outlines, as a camera shows them."""
    model = fit.model
    names, nodes, shifts = template.outlines
    nodes, shifts = nodes[list(wanted)], shifts[list(wanted)]
    sizes = fit.theta[[INDEX[name] for name in _SIZES]]
    drawn = predict_markings(fit.theta, nodes + np.einsum("s,ksi->ki", sizes, shifts)[:, None], model)
    sigma = _predict_sigmas(fit, drawn, shifts)
    return _sample_markings(tuple(names[k] for k in wanted), drawn, sigma, SPACING_PX * model.width / 1920.0)


def lie_on_surface(pixels: Array, region: NDArray[np.bool_] | None, width: int, height: int) -> NDArray[np.bool_]:
    """Which pixels (M, 2) lie in the picture and on the playing surface (h, w) of the picture reduced; all of the
    picture is surface where None is given.
    """
    visible = np.asarray(((pixels > 0) & (pixels < (width - 1, height - 1))).all(axis=1), np.bool_)
    if region is None:
        return visible
    rows, columns = region.shape
    at = np.clip((pixels * (columns / width, rows / height)).astype(int), 0, (columns - 1, rows - 1))
    return np.asarray(visible & region[at[:, 1], at[:, 0]])


def _predict_sigmas(fit: CameraFit, drawn: PredictedMarkings, shifts: Array) -> Array:
    """Standard deviation (K, N) of the places along their normals, pixels."""
    by_theta = drawn.by_theta.copy()
    by_theta[[INDEX[name] for name in _SIZES]] += np.einsum("ksi,ikn->skn", shifts, drawn.by_field)
    rows = by_theta.reshape(len(by_theta), -1)
    variance = (rows * (fit.covariance @ rows)).sum(axis=0)
    return np.sqrt(np.maximum(variance, 0.0)).reshape(by_theta.shape[1:])


def _sample_markings(
    names: tuple[str, ...], drawn: PredictedMarkings, sigma: Array, spacing_px: float
) -> MarkingPlaces:
    """Places at equal steps along what the picture may show of the markings, with sigma (K, N)."""
    markings, nodes = sigma.shape
    length = drawn.length_px.ravel()
    end = np.cumsum(length)
    along = np.arange(0.5 * spacing_px, end[-1], spacing_px)
    span = np.minimum(np.searchsorted(end, along, side="right"), len(length) - 1)
    share = ((along - (end[span] - length[span])) / np.maximum(length[span], 1e-9))[:, None]
    element = span // (nodes - 1)
    node = element * nodes + span % (nodes - 1)

    def between(values: Array) -> Array:
        flat = values.reshape(markings * nodes, -1)
        return np.asarray(flat[node] + share * (flat[node + 1] - flat[node]))

    spread, across = between(sigma)[:, 0], between(drawn.across)[:, 0]
    return MarkingPlaces(names, element, between(drawn.pixels), between(drawn.normals), spread, across)

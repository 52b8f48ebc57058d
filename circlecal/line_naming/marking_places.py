"""Where the markings of a field must be in the picture by a camera, how surely, and how wide their paint is there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera_parameters import INDEX
from circlecal.geometry.projective import Array
from circlecal.line_naming.predicted_markings import PredictedMarkings, predict_markings
from circlecal.results import CameraFit

__all__ = ["SPACING_PX", "MarkingPlaces", "lie_on_surface", "place_markings"]

SPACING_PX = 4.0
"""Distance of the places along a marking, pixels at 1920 px width."""

_SHIFTS = [INDEX[name] for name in ("width", "length", "breadth")]
_SIZES = [INDEX[name] for name in ("length", "breadth")]
OPEN_SIZE_M, END_SIGMAS = 2.0, 2.0
"""Standard deviation, metres, by which the field's sizes slide a straight marking along itself, from which on it may
end before places that are less than so many of them from its end: of a rendered field of 92 m the sides of the penalty
areas lay 6 m beside the places that a length of 105 +- 9 m gives them; its camera, 0.7 px off, was refused.
"""


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
    is_sure : (M,) bool
        Whether the marking reaches as far, whatever the field's sizes.
    """

    names: tuple[str, ...]
    element: NDArray[np.int_]
    base: Array
    normal: Array
    spread: Array
    across: Array
    is_sure: NDArray[np.bool_]

    def take(self, kept: NDArray[np.bool_]) -> MarkingPlaces:
        """Some of the places (M,)."""
        rest = (getattr(self, name)[kept] for name in MarkingPlaces.__slots__[1:])
        return MarkingPlaces(self.names, *rest)


def place_markings(fit: CameraFit, template: FieldTemplate, wanted: Sequence[int]) -> MarkingPlaces:
    """Places along markings of the template, by their index in its outlines, as a camera shows them."""
    model = fit.model
    names, nodes, shifts = template.outlines
    nodes, shifts = nodes[list(wanted)], shifts[list(wanted)]
    grown = _grow(fit.view, nodes, template) + fit.theta[INDEX["width"]] * shifts[:, None, 0]
    drawn = predict_markings(fit.theta, grown, model)
    sigma = _predict_sigmas(fit, drawn, shifts)
    spacing_px = SPACING_PX * model.width / 1920.0
    open_shares = _open_shares(fit, nodes, template)
    return _sample_markings(tuple(names[k] for k in wanted), drawn, sigma, open_shares, spacing_px)


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
    by_theta[_SHIFTS] += np.einsum("ksi,ikn->skn", shifts, drawn.by_field)
    rows = by_theta.reshape(len(by_theta), -1)
    variance = (rows * (fit.covariance @ rows)).sum(axis=0)
    return np.sqrt(np.maximum(variance, 0.0)).reshape(by_theta.shape[1:])


def _grow(view: FieldView, nodes: Array, template: FieldTemplate) -> Array:
    """Nodes (K, N, 2) of markings where a longer and broader field has them."""
    return view.grow(nodes, template) if np.any(view.growth_m) else nodes


def _open_shares(fit: CameraFit, nodes: Array, template: FieldTemplate) -> Array:
    """Shares (K,) of markings with nodes (K, N, 2), at each of their ends, that may lie beyond it where the field has
    another size.
    """
    sizes = fit.covariance[np.ix_(_SIZES, _SIZES)]
    if np.sqrt(sizes.diagonal().max()) <= OPEN_SIZE_M:
        return np.zeros(len(nodes))
    span = nodes[:, -1] - nodes[:, 0]
    length_m = np.maximum(np.linalg.norm(span, axis=1), 1e-9)
    ends = nodes[:, [0, -1]]
    moved = [_grow(replace(fit.view, growth_m=metre), nodes, template)[:, [0, -1]] - ends for metre in np.eye(2)]
    slides = np.einsum("skei,ki->kes", np.array(moved), span / length_m[:, None])
    sd_m = np.sqrt(np.maximum(np.einsum("kes,st,ket->ke", slides, sizes, slides), 0.0)).max(axis=1)
    return np.where(sd_m > OPEN_SIZE_M, END_SIGMAS * sd_m / length_m, 0.0)


def _sample_markings(
    names: tuple[str, ...], drawn: PredictedMarkings, sigma: Array, open_share: Array, spacing_px: float
) -> MarkingPlaces:
    """Places at equal steps along what the picture may show of the markings, with sigma (K, N) and shares (K,) at their
    ends that may lie beyond them.
    """
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
    of_marking = (span % (nodes - 1) + share[:, 0]) / (nodes - 1)
    is_sure = np.minimum(of_marking, 1.0 - of_marking) >= open_share[element]
    return MarkingPlaces(names, element, between(drawn.pixels), between(drawn.normals), spread, across, is_sure)

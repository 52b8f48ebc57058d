"""Intrinsics from concentric circles in three views (Huang, Zhang and Cheung 2015).

Concentric circles have infinitely many common self-polar triangles: the imaged centre and any two points of the
vanishing line that are conjugate for the ellipses. Such points are vanishing points of orthogonal directions; scaled
to the same length for E they are those of orthogonal unit vectors. Each view so brings two linear equations,
``v1^T w v2 = 0`` and ``v1^T w v1 = v2^T w v2``, in the image of the absolute conic ``w = K^-T K^-1``; three views
determine it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera import image_center
from circlecal.geometry.concentric import imaged_center
from circlecal.geometry.conics import normalise_conic
from circlecal.geometry.projective import Array
from circlecal.observations import Observations
from circlecal.solvers.interface import failure, intrinsics_solver
from circlecal.solvers.primitives import concentric_edges

VIEWS = 3
RANK_TOLERANCE = 1e-9
"""Least fifth singular value in shares of the first: below it the views do not determine the absolute conic."""
_ENTRIES = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@intrinsics_solver
def intrinsics(
    views: Sequence[Observations], template: FieldTemplate, circle: Circle, rng: np.random.Generator
) -> Array:
    """Calibration matrix (3, 3) of a camera with one zoom from at least three views of both edges of a circle."""
    if len(views) < VIEWS:
        raise failure("needs_three_views", f"three views are needed, {len(views)} given")
    width, height = views[0].width, views[0].height
    x, y = image_center(width, height)
    T = np.array([[width / 2.0, 0.0, x], [0.0, width / 2.0, y], [0.0, 0.0, 1.0]])
    pairs = []
    for view in views:
        outer, inner = concentric_edges(view, template, circle, rng)
        pairs.append((T.T @ outer.conic @ T, T.T @ inner.conic @ T))
    return T @ intrinsics_from_pairs(pairs)


def intrinsics_from_pairs(pairs: Sequence[tuple[Array, Array]]) -> Array:
    """Calibration matrix (3, 3) from outer and inner conics (3, 3) of each view, in a frame of unit scale."""
    rows = []
    for outer, inner in pairs:
        found = imaged_center(outer, inner)
        if found is None:
            raise failure("no_real_center", "no real eigenvector lies inside the inner ellipse of a view")
        rows += _view_rows(normalise_conic(outer), found.center)
    system = np.array(rows)
    _, singular, vectors = np.linalg.svd(system / np.linalg.norm(system, axis=1, keepdims=True))
    if singular[4] <= RANK_TOLERANCE * singular[0]:
        raise failure("views_too_alike", "the views see the circle under the same direction")
    omega = np.zeros((3, 3))
    for value, (i, j) in zip(vectors[5], _ENTRIES, strict=True):
        omega[i, j] = omega[j, i] = value
    omega = omega * np.sign(omega[2, 2])
    if np.linalg.eigvalsh(omega)[0] <= 0:
        raise failure("not_definite", "the image of the absolute conic is not definite")
    K = np.linalg.inv(np.linalg.cholesky(omega).T)
    return K / K[2, 2]


def _view_rows(conic: Array, center: Array) -> list[Array]:
    """Both equations (6,) of one view in the entries of the image of the absolute conic."""
    vanishing = conic @ center
    first = np.cross(vanishing, [1.0, 0.0, 0.0] if abs(vanishing[0]) < abs(vanishing[1]) else [0.0, 1.0, 0.0])
    second = np.cross(vanishing, conic @ first)
    first = first / np.sqrt(first @ conic @ first)
    second = second / np.sqrt(second @ conic @ second)
    return [_quadratic(first, second), _quadratic(first, first) - _quadratic(second, second)]


def _quadratic(a: Array, b: Array) -> Array:
    """Coefficients (6,) of ``a^T w b`` in the entries of a symmetric w."""
    return np.array([a[i] * b[j] + (a[j] * b[i] if i != j else 0.0) for i, j in _ENTRIES])

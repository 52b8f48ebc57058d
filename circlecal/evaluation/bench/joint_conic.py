"""One conic through the points of both edges of a circle's paint, for the row that compares it with one edge."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.concentric import vanishing_line
from circlecal.geometry.conic_fits import fit_conic, refine_conic
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, apply_homography


def scaling_homology(conic: ArrayLike, center: ArrayLike, factor: float) -> Array:
    """Image (3, 3) of scaling the field by ``factor`` about the circle's centre.

    ``k I + (1 - k) c l^T / (l^T c)`` with the vanishing line l.
    """
    c = np.asarray(center, dtype=np.float64)
    line = vanishing_line(conic, c)
    return factor * np.eye(3) + (1.0 - factor) * np.outer(c, line) / (line @ c)


def joint_conic(
    outer_px: ArrayLike,
    inner_px: ArrayLike,
    center: ArrayLike,
    outer_radius: float,
    inner_radius: float,
    rounds: int = 4,
) -> Array | None:
    """Outer conic from the points of both edges and the imaged centre.

    The inner points are moved onto the outer edge by the image of a scaling about the centre, which the conic itself
    defines; fit and move are repeated until they agree.

    Parameters
    ----------
    outer_px, inner_px : (N, 2), (M, 2) arrays
        Points of the two edges.
    center : (3,) array
        Imaged centre, homogeneous.
    outer_radius, inner_radius : float
        Radii on the field.
    rounds : int
        Repetitions; two or three are enough.

    Returns
    -------
    (3, 3) array or None
        None where the points fit no ellipse.
    """
    outer, inner = np.asarray(outer_px, dtype=np.float64), np.asarray(inner_px, dtype=np.float64)
    conic = fit_conic(outer, "direct")
    for _ in range(rounds):
        if conic is None or ellipse_from_conic(conic) is None:
            return None
        moved = apply_homography(scaling_homology(conic, center, outer_radius / inner_radius), inner)
        together = np.concatenate([outer, moved])
        closed = fit_conic(together, "direct")
        refined = None if closed is None else refine_conic(together, closed)
        conic = closed if refined is None else refined[0]
    return conic

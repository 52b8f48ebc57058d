"""Planes on which an ellipse is the image of a circle, for a known focal length (Chen, Wu and Wada 2004, section 2).

The ellipse E becomes a cone ``Q = K^T E K`` of rays. With eigenvalues ``l1 >= l2 > 0 > l3`` it has circular sections
across two normals, ``n = (sqrt(l1 - l2) e1 +- sqrt(l2 - l3) e3) / sqrt(l1 - l3)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.geometry.conics import normalise_conic
from circlecal.geometry.projective import Array, Mask


@dataclass(frozen=True, slots=True)
class Sections:
    """Circular sections of K cones (K, 2, ...): unit normals away from the camera, plane distances, circle centres."""

    normals: Array
    distances: Array
    centers: Array


def circular_sections(conics: Array, focal_px: Array, center_px: Array, radius_m: float) -> Sections:
    """Both circular sections of the cones over one conic (3, 3), for focal lengths (K,) and square pixels.

    Distances and centres are those of a circle of radius ``radius_m``, in the camera's frame; not finite where the
    focal length makes the cone degenerate.
    """
    K = np.zeros((len(focal_px), 3, 3))
    K[:, 0, 0] = K[:, 1, 1] = focal_px
    K[:, :2, 2], K[:, 2, 2] = center_px, 1.0
    cones = normalise_conic(np.swapaxes(K, 1, 2) @ conics @ K)
    usable: Mask = np.asarray(np.isfinite(cones).all(axis=(1, 2)))
    cones = np.where(usable[:, None, None], cones, np.diag([1.0, 1.0, -1.0]))
    values, vectors = np.linalg.eigh(cones)
    low, middle, high = values.T
    spread = high - low
    e1, e3 = vectors[..., 2], vectors[..., 0]
    a, b = np.sqrt((high - middle) / spread)[:, None] * e1, np.sqrt((middle - low) / spread)[:, None] * e3
    normals = np.stack([a + b, a - b], axis=1)
    rays = np.linalg.solve(cones[:, None], normals[..., None])[..., 0]
    rays = rays * np.sign(rays[..., 2:])
    normals = normals * np.sign(np.sum(normals * rays, axis=-1, keepdims=True))
    along = np.einsum("kij,knj->kni", cones, normals)
    level = np.sum(normals * along, axis=-1)
    across = along - level[..., None] * normals
    offset = across / middle[:, None, None]
    distances = radius_m / np.sqrt(np.maximum(np.sum(offset**2, axis=-1) - level / middle[:, None], 1e-300))
    distances = np.where(usable[:, None], distances, np.nan)
    return Sections(normals, distances, distances[..., None] * (normals - offset))

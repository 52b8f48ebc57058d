"""Concentric circles: the imaged centre from two conics, and the vanishing line from one and that centre.

Sources: Huang et al. 2015 (the imaged centre is an eigenvector); Magera et al. 2025, section 3.3 (case 3).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from circlecal.geometry.conics import normalise_conic, polar
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array


@dataclass(frozen=True, slots=True)
class ConcentricCenter:
    """Imaged centre (3,), and how far its eigenvalue is isolated from the others, in mean eigenvalues.

    ``pair_split`` is the relative distance between the two eigenvalues that are equal without noise; the centre means
    something only where it is well below ``gap``.
    """

    center: Array
    gap: float
    pair_split: float


def vanishing_line(conic: ArrayLike, center: ArrayLike) -> Array:
    """Vanishing line (3,) of the field: the polar ``E c`` of a circle's imaged centre (Magera et al. 2025, eq. 4).

    The polar of a circle's centre is the line at infinity (eq. 3), and a polar's image is the polar in the image.
    """
    return polar(conic, center)


def imaged_center(outer: ArrayLike, inner: ArrayLike) -> ConcentricCenter | None:
    """Imaged centre of two concentric circles: eigenvector of ``E_outer^-1 E_inner`` (Magera et al. 2025, section 3.3).

    Both conics are scaled to det = -1, so without noise the eigenvalues are ``k^(2/3), k^(2/3), k^(-4/3)`` with ``k =
    r_outer / r_inner``; the isolated one belongs to the centre. With noise the double eigenvalue splits, and the real
    eigenvector that lies inside the inner ellipse is right more often than the most isolated one.

    Parameters
    ----------
    outer, inner : (3, 3) arrays
        Conics of the two edges of the marking.

    Returns
    -------
    ConcentricCenter or None
        None where no real eigenvector lies inside the inner ellipse, or where the inner ellipse does not lie inside the
        outer one (the eigenvalue of the centre is then not the smallest).
    """
    e_outer, e_inner = normalise_conic(outer), normalise_conic(inner)
    ellipse = ellipse_from_conic(e_inner)
    if ellipse is None or ellipse_from_conic(e_outer) is None:
        return None
    # E_inner c = lambda E_outer c in the frame in which the inner ellipse is the unit circle: well conditioned
    frame = ellipse.frame()
    local_outer = normalise_conic(frame.T @ e_outer @ frame)
    local_inner = normalise_conic(frame.T @ e_inner @ frame)
    values, vectors = np.linalg.eig(np.linalg.solve(local_outer, local_inner))
    real = np.abs(values.imag) < 1e-9 * np.abs(values)
    vectors = vectors.real
    inside = np.einsum("ik,ij,jk->k", vectors, local_inner, vectors) < 0
    # the eigenvectors are conjugate to each other for both conics: one at most lies inside
    candidates = np.flatnonzero(real & inside)
    if candidates.size == 0:
        return None
    best = candidates[0]
    rest = np.delete(values, best)
    if not values[best].real < rest.real.min():
        return None
    size = np.mean(np.abs(values))
    center = frame @ vectors[:, best]
    center = center / center[2]
    return ConcentricCenter(
        center=center,
        gap=float(np.min(np.abs(values[best] - rest)) / size),
        pair_split=float(np.abs(rest[0] - rest[1]) / size),
    )

"""One circle, a line through its centre and an ordinary pinhole camera: the imaged centre needs not be seen.

A camera with square pixels and a known principal point has seven unknowns; the ellipse brings five constraints and a
line through the centre brings two. For a candidate centre on the line the homography is known in closed form
(:func:`circlecal.geometry.homography.homography_from_circle`); its first two columns, the vanishing points of the
line's direction and of the one across it, must be orthogonal and of equal length on the focal plane. Both conditions
are linear in 1/f^2; eliminating it leaves a cubic equation for where on the line the centre is.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from circlecal.geometry.conics import line_conic_meet, normalise_conic, pole
from circlecal.geometry.projective import Array

LARGEST_OFFSET = 0.6
"""Half chords from the chord's middle within which the imaged centre is looked for: at an offset s the depths of the
chord's ends have the ratio (1 + s) / (1 - s), here 4; cameras beside a field see their circles with ratios below 2.
"""
NEARLY_REAL = 1e-3
"""Largest imaginary part, half chords, of a root that counts as real: noise parts two roots that lie so near to each
other into a pair of complex ones, between which the centre lies.
"""


def pinhole_centers(conic: ArrayLike, line: ArrayLike, principal_point: ArrayLike, scale_px: float) -> Array:
    """Imaged centres on a line through the circle's centre that an ordinary pinhole camera allows.

    Let the line meet the ellipse E in ``m - h`` and ``m + h``. A centre ``m + s h`` has the polar on which the line's
    direction vanishes at ``v1 = h + s m`` (Magera et al. 2025, eq. 4 and 5), with ``v1^T E v1 = (1 - s^2) h^T E h``.
    The direction across it vanishes at the line's pole v2, wherever the centre is. Scaled to ``v^T E v = 1``, both are
    the columns of the homography: with ``w = 1 / f^2``, ``(x1 x2 + y1 y2) w + z1 z2 = 0`` and
    ``(x1^2 + y1^2 - x2^2 - y2^2) w + z1^2 - z2^2 = 0``.

    Parameters
    ----------
    conic : (3, 3) array
        Image of the circle.
    line : (3,) array
        Image of a line through the circle's centre (its direction on the field need not be known).
    principal_point : (2,) array
        Known principal point; pixels are square and undistorted.
    scale_px : float
        Typical size of the picture, for the conditioning.

    Returns
    -------
    (K, 3) array
        At most three, also such that need an imaginary focal length; none where the line misses the circle. Where the
        camera stands in the vertical plane of the line the condition holds everywhere and the roots mean nothing.
    """
    x, y = np.asarray(principal_point, dtype=np.float64)
    T = np.array([[scale_px, 0.0, x], [0.0, scale_px, y], [0.0, 0.0, 1.0]])
    E = normalise_conic(T.T @ np.asarray(conic, dtype=np.float64) @ T)
    along = T.T @ np.asarray(line, dtype=np.float64)
    ends = line_conic_meet(E, along)
    if ends is None:
        return np.zeros((0, 3))
    m, h = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    v2 = pole(E, along)
    x2, y2, z2 = v2 / np.sqrt(v2 @ E @ v2)
    x1, y1, z1 = (Polynomial(coefficients) for coefficients in zip(h, m, strict=True))
    square = Polynomial([1.0, 0.0, -1.0]) * (h @ E @ h)  # v1^T E v1, by which v2 is scaled instead of v1
    dot, product = x1 * x2 + y1 * y2, z1 * z2
    lengths, depths = x1**2 + y1**2 - square * (x2**2 + y2**2), z1**2 - square * z2**2
    roots = (dot * depths - lengths * product).roots()
    offset = np.unique(roots.real[np.abs(roots.imag) <= NEARLY_REAL])
    return (m + offset[np.abs(offset) <= LARGEST_OFFSET, None] * h) @ T.T

"""The centre mark at a kick-off: the ball lies on it, and only its rim and its near half are seen.

A ball whose place is known hides a known part of the mark: it touches the ground in the mark's middle, and is seen
above it by its radius times the cosine of the angle at which the ground is seen, which the mark's own shape tells.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from circlecal.geometry.projective import Array, normalise_line
from circlecal.paint.centre_mark import LEAST_LINE, SeenMark
from circlecal.paint.profiles import GrayPicture
from circlecal.paint.rectified_line import (
    STEP_PX,
    RectifiedLine,
    across_directions,
    disc_coverage,
    measure_contrast,
    rectify_line,
)

__all__ = ["find_mark_under_ball"]

BALL_HALVES = 0.75, 0.82, 0.89, 0.96, 1.03
"""Radii of balls that are tried, in half axes of the mark across the line: of 0.11 m beside marks of 0.21 to 0.3 m."""
SMALLEST_PX = 1.3
"""Half axis of the mark along the line, pixels, below which too little of it is seen before a ball."""
MOST_MISFIT = 0.2
"""Share of the brightness beside the line that mark and ball may leave unexplained. With these limits 17 marks of 34
rendered kick-offs are found, all within 0.7 px of their place (at 1280 px width), and none in 44 other rendered frames,
16 of which have a player before the mark.
"""
MARK_CONTRAST, LEAST_BALL = (0.6, 1.8), 0.9
"""Brightness of the mark, and least one of the ball, over the ground, times that of the line's own paint."""
SIGMA_PX = 0.5
"""Least standard deviation of the place, pixels: the ball's edge is not the mark's."""
FINE_PX, REFINED_PX = 0.1, 2.0
"""Pixels between places at which the mark's own shape is compared at last, and how far these reach."""
BLURS_CLEAR, FEWEST_CLEAR, LEAST_ALIKE = 2.0, 20, 0.8
"""Standard deviations of the blur beyond the ball's edge from which on its light no longer matters, places there of
which a shape can be told, and the least correlation of these with the mark's shape: the rim of a ball that lies beside
the mark would be taken for it else.
"""
BLURS_BESIDE = 1.5
"""Standard deviations of the blur that belong to a shape around it."""


def find_mark_under_ball(
    picture: GrayPicture,
    line: Array,
    line_points_px: Array,
    conic: Array,
    diameter_radii: float,
    width_radii: float,
    blur_px: float,
    offset: tuple[float, float],
) -> SeenMark | None:
    """Find the disc on the halfway line on which a ball lies.

    The parameters are those of :func:`circlecal.paint.centre_mark.find_centre_mark`.

    Returns
    -------
    SeenMark or None
        None where no ball lies on such a disc, or too little is seen of it.
    """
    seen = rectify_line(picture, line, line_points_px, conic, diameter_radii / 2, blur_px, offset)
    if seen is None or seen.half_px[0] < SMALLEST_PX:
        return None
    contrast = measure_contrast(seen)
    if contrast < LEAST_LINE:
        return None
    inner = width_radii / diameter_radii * seen.half_px[1] + blur_px
    if not _may_show_ball(seen, inner, contrast):
        return None
    along = np.gradient(seen.base, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    across = across_directions(conic, normalise_line(line), seen.base)
    middle = len(seen.base) // 2
    axes = np.stack([along[middle], across[middle]], axis=-1)
    scenes = [_place_ball(seen, share * seen.half_px[1], axes, blur_px) for share in BALL_HALVES]
    found = [(*_search(scene, inner, offset, contrast), scene) for scene in scenes]
    misfit, row, scene = min(found, key=lambda one: one[0])
    if misfit > MOST_MISFIT:
        return None
    place, alike = _refine(scene, inner, row)
    if alike < LEAST_ALIKE:
        return None
    point = np.array([np.interp(place, seen.position, seen.base[:, axis]) for axis in range(2)])
    noise = float(np.sqrt(misfit / (1.0 - misfit)))
    return SeenMark(point, float(np.hypot(SIGMA_PX, noise * blur_px)), 1.0 / max(noise, 1e-6))


def _may_show_ball(seen: RectifiedLine, inner_px: float, contrast: float) -> bool:
    """Whether something beside the line is half as bright as a ball would be, as far from it as a small one reaches."""
    beside = (np.abs(seen.across) > inner_px) & (np.abs(seen.across) <= BALL_HALVES[0] * seen.half_px[1])
    lit = np.nan_to_num(seen.values[:, beside])
    return bool(beside.any() and lit.mean(axis=1).max() >= 0.5 * LEAST_BALL * contrast)


@dataclass(frozen=True, slots=True)
class _Scene:
    """A mark on a line, and a ball that touches the ground in its middle.

    ``ball`` (2,) is where the ball's middle is ``seen``, along the line and along the field's other axis from the
    mark's, px.
    """

    seen: RectifiedLine
    radius_px: float
    blur_px: float
    ball: Array

    @property
    def half_px(self) -> tuple[float, float]:
        """Half axes of the mark along and across the line."""
        return self.seen.half_px

    @property
    def reach(self) -> tuple[float, float, float]:
        """From where to where along the line around the mark's middle, and how far beside it, all is looked at, px."""
        b, a = self.half_px
        t, s = self.ball
        spare = 2.0 * self.blur_px + 2.0
        before, behind = min(t - self.radius_px, -b) - spare, max(t + self.radius_px, b) + spare
        return before, behind, max(a, abs(s) + self.radius_px) + BLURS_BESIDE * self.blur_px + 2.0

    def beyond_ball(self, t: Array, s: Array) -> Array:
        """How far beyond the ball's edge places lie that are ``t`` along the line from the mark's middle and ``s``
        beside it, px; negative on the ball.
        """
        return self.seen.distance_px(t - self.ball[0], s - self.ball[1]) - self.radius_px

    def cover(self, t: Array, s: Array) -> tuple[Array, Array]:
        """Shares of mark and of ball at such places."""
        ball = np.asarray(ndtr(-self.beyond_ball(t, s) / self.blur_px))
        return disc_coverage(t, s, *self.half_px, self.blur_px) * (1.0 - ball), ball


def _place_ball(seen: RectifiedLine, radius_px: float, axes: Array, blur_px: float) -> _Scene:
    """The scene with a ball of such a radius; ``axes`` (2, 2) are the directions of the line and of the field's other
    axis in the picture, as columns.
    """
    b, a = seen.half_px
    above_px = radius_px * float(np.sqrt(max(0.0, 1.0 - (b / a) ** 2)))
    return _Scene(seen, radius_px, blur_px, np.linalg.solve(axes, np.array([0.0, -above_px])))


def _search(scene: _Scene, inner_px: float, offset: tuple[float, float], contrast: float) -> tuple[float, int]:
    """The least share of the brightness that mark, ball and even ground leave unexplained, and at which row the mark's
    middle lies then; infinite where nowhere both are as bright as they must be.
    """
    seen, (before, behind, beside) = scene.seen, scene.reach
    t = np.arange(np.floor(before / STEP_PX), np.ceil(behind / STEP_PX) + 1.0) * STEP_PX
    columns = (np.abs(seen.across) > inner_px) & (np.abs(seen.across) <= beside)
    size = len(t) * np.count_nonzero(columns)
    first = int(np.rint(-t[0] / STEP_PX))
    rows = np.arange(first, len(seen.position) - (len(t) - 1 - first))
    place = seen.position[rows] / seen.length if len(rows) else np.zeros(0)
    rows = rows[(place >= offset[0]) & (place <= offset[1])]
    if len(rows) == 0 or size == 0:
        return np.inf, 0
    mark, ball = scene.cover(t[:, None], seen.across[columns][None])
    shapes = np.stack([mark.ravel(), ball.ravel(), np.ones(size)], axis=-1)
    windows = seen.values[:, columns][rows[:, None] - first + np.arange(len(t))].reshape(len(rows), size)
    known = np.isfinite(windows).all(axis=1)
    windows = np.where(known[:, None], windows, 0.0)
    normal = shapes.T @ shapes
    if np.linalg.cond(normal) > 1e9:
        return np.inf, 0
    moments = windows @ shapes
    level = np.linalg.solve(normal, moments.T).T
    left = (windows**2).sum(axis=1) - (level * moments).sum(axis=1)
    whole = ((windows - windows.mean(axis=1, keepdims=True)) ** 2).sum(axis=1)
    mark_shown, ball_shown = level[:, :2].T / contrast
    fits = known & (mark_shown >= MARK_CONTRAST[0]) & (mark_shown <= MARK_CONTRAST[1]) & (ball_shown >= LEAST_BALL)
    misfit = np.where(fits & (whole > 0.0), left / np.maximum(whole, 1e-9), np.inf)
    best = int(np.argmin(misfit))
    return float(misfit[best]), int(rows[best])


def _refine(scene: _Scene, inner_px: float, row: int) -> tuple[float, float]:
    """Where along the line, px, the mark's own shape fits best what is seen of it outside the ball, and how alike the
    two are (their correlation).
    """
    seen, (b, a) = scene.seen, scene.half_px
    t = seen.position - seen.position[row]
    spare = BLURS_BESIDE * scene.blur_px
    rows = np.abs(t) <= b + 2.0 * scene.blur_px + REFINED_PX + 2.0
    columns = (np.abs(seen.across) > inner_px) & (np.abs(seen.across) <= a + spare + 2.0)
    values, along, beside = seen.values[rows][:, columns], t[rows][:, None], seen.across[columns][None]
    clear = (scene.beyond_ball(along, beside) > BLURS_CLEAR * scene.blur_px) & np.isfinite(values)
    shifts = np.arange(-REFINED_PX, REFINED_PX + FINE_PX / 2, FINE_PX)
    shape = disc_coverage(along - shifts[:, None, None], beside[None], b, a, scene.blur_px)[:, clear]
    if np.count_nonzero(clear) < FEWEST_CLEAR:
        return 0.0, 0.0
    about = values[clear] - values[clear].mean()
    shape = shape - shape.mean(axis=1, keepdims=True)
    alike = shape @ about / np.maximum(np.linalg.norm(shape, axis=1) * np.linalg.norm(about), 1e-9)
    best = int(np.argmax(alike))
    return float(seen.position[row] + shifts[best]), float(alike[best])

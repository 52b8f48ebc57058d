"""Where the paint of a circle, an arc or any other curve lies: bands across it that are as wide and as bright as the
marking, and their middles without those that leave their neighbours.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from circlecal.field import Arc, Circle, FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.medians import quantile
from circlecal.geometry.projective import Array, Mask
from circlecal.observations import CircleEdge
from circlecal.paint.bands import SIGMA_FLOOR_PX, Bands, measure_bands, rise_above_noise
from circlecal.paint.edge_pairs import measure_edge_pairs
from circlecal.paint.predicted_width import WIDE_PX
from circlecal.paint.profiles import GrayPicture, sample_profiles, smooth_along

__all__ = [
    "RIM_PX",
    "WIDTH_RATIO",
    "RaysConfig",
    "along_normals",
    "bands_along",
    "leave_out_single",
    "measure_along_curve",
    "measure_along_model",
    "sample_curve",
    "select_steady",
]

CLEAR_OF_ENDS_PX = 6.0
"""An arc ends on a line: nearer than this beyond the search its paint is not told from the line's, at 1920 px width."""
CLEAR_OF_BORDER_PX = 3.0
"""So much ground, pixels at 1920 px width, must be seen between the half height of the paint and the picture's border,
beyond which the ground is taken to go on as at the border: with less of it the tail of the paint is taken for ground.
"""
WIDTH_RATIO = 0.4, 2.5
"""Width of a band over the one that the field template predicts, within which it may be the marking: blur widens thin
paint (a few pixels come on top), wear narrows it. Paint of another width is said by ``field.sizes.marking``.
"""
CONTRAST_RATIO = 0.35, 3.0
"""Contrast of a band over the typical one around it, beyond which it is no paint: a player's sock or a shadow."""
SMOOTHING_SAMPLES = 1.0
"""Mean over neighbouring profiles, in samples of a curve that is sampled as densely as asked; fewer of a coarse one."""
STEADY_PX, STEADY_SHARE = 1.0, 0.05
"""Largest distance of steady points from the running median along it, pixels at 1920 px width, or in widths of paint:
the middle of worn paint wanders by 0.03 of its width (40 rendered robots' fields, measured along the true curve).
"""
WIDE_SEARCHES = 2.0
"""The profiles of wide paint of more than so many searches are stretched by as much as it is wider, so that they hold
the ground on both sides of it, and its middle is looked for as much farther away.
"""
FEWEST_WIDE, RAGGED_SHARE = 16, 0.005
"""Places of wide paint in a row of places, fewer of which are measured like thin paint; and standard deviation of a
middle between its edges, in widths: those of worn paint scatter by 0.005 to 0.01 about the true circles of 14 rendered
robots' fields, by their flux 0.02 to 0.06.
"""
EDGED_SHARE = 0.5
"""Paint that shows both edges at a smaller share of the places at which it is a band has none: rinks' centre lines are
checkered.
"""
BLURRED_PX = 7.2
"""Width of a narrower line as defocus and motion leave it, pixels at 1920 px width."""
WIDEST = 0.25
"""Paint that a camera predicts wider, in picture widths, is no marking that could be measured."""
RIM_PX = 4.5
"""Width, pixels at 1920 px width, in which the rim of a disc shows where edges stand out as bands: three times what the
filter and the usual blur of a picture add up to."""
COMPANY_PX, LEAST_COMPANY, COMPANY_ROUNDS = 72.0, 0.45, 2
"""Where so much of a curve to both sides of a place, pixels at 1920 px width, shows a smaller share of bands than most
of the curve does, what is found may be grass: on bare ground every third place or so shows something that stands out.
What is left then has less company, and is looked at once more.
"""
GRASS_CONTRAST = 0.6
"""Contrast of a band with little company, over the usual one of those with enough, below which it is grass: paint
between two players has little company as well. Of the points that lie beside the true circle in five rendered frames of
worn paint some 20 of 220 are left; the camera of one that had followed the grass behind a worn half came from 39 to
6 px. Without the contrast the end of a short arc behind a player was lost, and 0.8 px became 7.
"""


class RaysConfig(BaseModel):
    """Options of the stage ``rays``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    maximum: int = Field(
        4096, ge=64, le=32000, description="Most rays that are cast; otherwise one per pixel of the ellipse."
    )
    search_px: float = Field(
        6, gt=0, le=200, description="First search to both sides of the rough ellipse, pixels at 1920 px width."
    )
    refine_px: float = Field(
        4.5, gt=0, le=200, description="Search after the first fit; must hold what lens and crown bend the ellipse by."
    )
    spacing_px: float = Field(2.0, ge=0.5, le=20, description="Distance of the measured band centres, pixels.")


def measure_along_model(
    picture: GrayPicture,
    view: FieldView,
    circle: Circle,
    template: FieldTemplate,
    noise: float,
    config: RaysConfig,
) -> tuple[Array, Array]:
    """Middle of a circle's or an arc's paint along the curve that a camera predicts, lens and crown included.

    An ellipse that was fitted to a part of the circle leaves the paint beyond that part; the camera leads further.
    Points that leave their neighbours' offset from the curve lie on players, and are left out.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    view : FieldView
        Where the camera sees the field.
    circle, template : Circle, FieldTemplate
        What is looked for.
    noise : float
        Grey-level noise of the picture.
    config : RaysConfig

    Returns
    -------
    points_px : (N, 2) array
    sigma_px : (N,) array
    """
    height, width = picture.shape
    search = 2 * config.refine_px * width / 1920.0
    points, across, sides, along = sample_curve(view, circle, template, config)
    if circle.fill == "disc":
        sides = np.array([[-0.5], [0.5]]) * np.full(len(points), RIM_PX * width / 1920.0)
    inside = _lie_in_picture(points, sides, width, height)
    if isinstance(circle, Arc):
        clear = search + CLEAR_OF_ENDS_PX * width / 1920.0
        inside &= (along[:-1] > clear) & (along[:-1] < along[-1] - clear)
    return _measure_steady(picture, points[inside], across[inside], sides[:, inside], search, noise, config)


def sample_curve(
    view: FieldView, circle: Circle, template: FieldTemplate, config: RaysConfig
) -> tuple[Array, Array, Array, Array]:
    """Places along the middle of a circle's or an arc's paint at even distances in the picture, nan behind the camera.

    Returns
    -------
    points, across : (N, 2) arrays
        Pixels, and unit vectors across the curve.
    sides : (2, N) array
        Where the inner and the outer edge of the paint lie, pixels along these vectors, which may point either way.
    along : (N + 1,) array
        How far along the curve the places are, pixels, and how long it is.
    """
    angle = np.radians(np.linspace(*circle.span_deg, 2881))

    def project_edge(edge: CircleEdge, at: Array) -> Array:
        return view.project(view.circle_points(circle, edge, at, template))

    steps = np.linalg.norm(np.diff(project_edge("center", angle), axis=0), axis=-1)
    length = np.concatenate([[0.0], np.cumsum(np.nan_to_num(steps))])
    count = int(np.clip(length[-1] / config.spacing_px, 64, 2 * config.maximum))
    angle = np.interp(np.arange(count) * length[-1] / count, length, angle)
    points = project_edge("center", angle)
    across = _normals_of(points)
    sides = np.stack([along_normals(project_edge(edge, angle) - points, across) for edge in ("inner", "outer")])
    return points, across, sides, np.arange(count + 1) * length[-1] / count


def measure_along_curve(
    picture: GrayPicture, points: Array, sides: Array, search_px: float, noise: float, config: RaysConfig
) -> tuple[Array, Array]:
    """Middle of the paint along any curve, as :func:`measure_along_model` measures it.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    points : (N, 2) array
        Places along the curve, pixels.
    sides : (2, N, 2) array
        Both edges of the paint there.
    search_px : float
        How far to both sides the paint may lie.
    noise : float
        Grey-level noise of the picture.
    config : RaysConfig

    Returns
    -------
    points_px : (K, 2) array
    sigma_px : (K,) array
    """
    across = _normals_of(points)
    away = np.stack([along_normals(side - points, across) for side in sides])
    inside = _lie_in_picture(points, away, picture.shape[1], picture.shape[0])
    given = picture, points[inside], across[inside], away[:, inside]
    return _measure_steady(*given, search_px, noise, config, BLURRED_PX * picture.shape[1] / 1920.0)


def _measure_steady(
    picture: GrayPicture,
    points: Array,
    across: Array,
    sides: Array,
    search_px: float,
    noise: float,
    config: RaysConfig,
    least_px: float = 0.0,
) -> tuple[Array, Array]:
    """Middles (K, 2) of the paint across places (N, 2), and their sigmas (K,), without those that leave their
    neighbours' offset. Where paint is wide between its sides (2, N) its edges tell the middle; blur leaves it at least
    so wide.
    """
    if len(points) == 0:
        return np.zeros((0, 2)), np.zeros(0)
    unit = picture.shape[1] / 1920.0
    width = np.abs(sides[1] - sides[0])
    predicted = np.maximum(width, least_px)
    _, bands, plausible = bands_along(picture, points, across, predicted, noise, search_px, config, 1.0)
    offset, sigma = np.full(len(points), np.nan), np.zeros(len(points))
    offset[plausible], sigma[plausible] = bands.center, bands.sigma(noise)
    wide = np.flatnonzero(width > WIDE_PX * unit)
    if len(wide) >= FEWEST_WIDE:
        middle, found = measure_edge_pairs(picture, points[wide], across[wide], width[wide], search_px)
        if np.count_nonzero(found) >= EDGED_SHARE * np.count_nonzero(plausible[wide]):
            # of paint that is nearer on one side the middle of the picture is not that of the paint
            offset[wide] = np.where(found, middle - sides[:, wide].mean(axis=0), np.nan)
            sigma[wide] = np.hypot(SIGMA_FLOOR_PX, RAGGED_SHARE * width[wide])
    seen = np.flatnonzero(np.isfinite(offset))
    limit = np.maximum(STEADY_PX * unit, STEADY_SHARE * predicted[seen])
    kept = seen[select_steady(offset[seen], limit)]
    return points[kept] + offset[kept, None] * across[kept], sigma[kept]


def select_steady(offsets: Array, limit: Array) -> NDArray[np.bool_]:
    """Which offsets (N,) from a curve lie within limits (N,) of the running median of their neighbourhood."""
    if len(offsets) < 16:
        return np.zeros(len(offsets), dtype=np.bool_)
    from scipy.ndimage import median_filter

    return np.asarray(np.abs(offsets - median_filter(offsets, size=max(9, len(offsets) // 8), mode="nearest")) < limit)


def bands_along(
    picture: GrayPicture,
    points: Array,
    normals: Array,
    predicted: Array,
    noise: float,
    search_px: float,
    config: RaysConfig,
    step: float,
) -> tuple[Array, Bands, NDArray[np.bool_]]:
    """Middles (K, 2) and measurements of the bands across a curve that are as wide and as bright as the marking, and
    which of the curve's points (N,) they belong to.
    """
    wide = max(WIDE_SEARCHES * search_px, WIDE_PX * picture.shape[1] / 1920.0)
    widest = float(predicted.max(initial=0.0))
    # where paint is wide its middle may lie so far off that the ends of shorter profiles are painted, too
    reach = search_px + 0.5 * min(widest, wide) + 4.0 + (search_px if widest > wide else 0.0)
    stretch = np.maximum(1.0, predicted / wide)
    tap = min(0.5 * step, 1.0)
    offsets = np.arange(-reach, reach + 0.25, tap)
    sampled = sample_profiles(picture, points, stretch[:, None] * normals, offsets, repeat_border=True)
    bands = measure_bands(smooth_along(sampled, SMOOTHING_SAMPLES / step), offsets, search_px).stretch(stretch)
    low, high = WIDTH_RATIO
    plausible = rise_above_noise(bands, noise) & _lie_clear_of_border(picture, points, normals, bands)
    plausible &= (bands.width < high * predicted + 4.0) & (bands.width > low * predicted)
    plausible &= _even_contrast(bands.contrast, plausible)
    spacing_px = step * config.spacing_px
    plausible = leave_out_single(plausible, bands.contrast, COMPANY_PX * picture.shape[1] / 1920.0 / spacing_px)
    chosen = bands.take(plausible)
    middle = points[plausible] + chosen.center[:, None] * normals[plausible]
    return middle, chosen, plausible


def _lie_in_picture(points: Array, sides: Array, width: int, height: int) -> Mask:
    """Which places (N, 2) lie in the picture, with paint between sides (2, N) that is not too wide to be a marking."""
    inside = np.isfinite(points).all(axis=1) & ((points >= 0) & (points <= (width - 1, height - 1))).all(axis=1)
    return np.asarray(inside & (np.abs(sides[1] - sides[0]) < WIDEST * width), np.bool_)


def _lie_clear_of_border(picture: GrayPicture, points: Array, normals: Array, bands: Bands) -> Mask:
    """Which bands (N,) across points (N, 2) show ground on both sides before the picture ends."""
    height, width = picture.shape
    clear_px = CLEAR_OF_BORDER_PX * width / 1920.0
    ends = points + np.stack([bands.left - clear_px, bands.right + clear_px])[..., None] * normals
    return np.asarray(((ends >= 0) & (ends <= (width - 1, height - 1))).all(axis=(0, 2)), np.bool_)


def _normals_of(points: Array) -> Array:
    """Unit normals (N, 2) of a curve through points (N, 2)."""
    tangent = np.gradient(points, axis=0)
    across = np.stack([tangent[:, 1], -tangent[:, 0]], axis=-1)
    return np.asarray(across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-9))


def along_normals(vectors: Array, normals: Array) -> Array:
    """Lengths (N,) of vectors (N, 2) along unit normals (N, 2)."""
    return vectors[:, 0] * normals[:, 0] + vectors[:, 1] * normals[:, 1]


def _even_contrast(contrast: Array, valid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Contrast near the running median of its neighbourhood: far paint is fainter than near paint, players are
    neither.
    """
    if valid.sum() < 16:
        return valid
    from scipy.ndimage import median_filter

    known = np.flatnonzero(valid)
    filled = np.interp(np.arange(len(contrast)), known, contrast[known])
    typical = np.maximum(median_filter(filled, size=max(9, len(contrast) // 8), mode="nearest"), 1e-6)
    share = contrast / typical
    return (share > CONTRAST_RATIO[0]) & (share < CONTRAST_RATIO[1])


def leave_out_single(found: Mask, contrast: Array, reach: float) -> Mask:
    """The bands that were found along a curve (N,) without those that are single and faint."""
    for _ in range(COMPANY_ROUNDS):
        joined = found & _have_company(found, reach)
        if not joined.any():
            return joined
        found = joined | (found & (contrast > GRASS_CONTRAST * np.median(contrast[joined])))
    return found


def _have_company(found: Mask, reach: float) -> Mask:
    """Which of the bands that were found along a curve (N,) have others about them at enough places, so many of these
    to both sides, compared with where most are found.
    """
    from scipy.ndimage import uniform_filter1d

    if not found.any():
        return found
    share = uniform_filter1d(found.astype(np.float64), 2 * max(round(reach), 2) + 1, mode="nearest")
    return np.asarray(share >= LEAST_COMPANY * quantile(share[found], 0.9), np.bool_)

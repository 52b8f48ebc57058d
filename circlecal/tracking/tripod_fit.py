"""The tripod from frames whose markings were measured: heads and what all frames share, in one least-squares problem.

Every frame has its focal length, pan and tilt; all else is common. The normal equations are an arrow: each frame's
block is eliminated, and what is left is as large as the common part, however many frames there are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.options import CameraConfig
from circlecal.camera.rig_options import RigConfig
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel, project
from circlecal.geometry.projective import Array, Indices
from circlecal.geometry.surface import Surface
from circlecal.paint.profiles import median_of_rows
from circlecal.rig.tripod import COMMON, PLACE, TripodEstimate, TripodModel
from circlecal.tracking.markings import (
    CLEAR_PX_M,
    FAINT_BIAS_PX,
    SPACING_PX,
    DrawnTemplate,
    MeasuredFrame,
    grow_places,
    rows_of,
)

ITERATIONS = 15
ARRIVED = 1e-4
"""Share of the cost by which the last step must lower it for another one."""
FIRST_DAMPING = 1e-4
LOSS_SCALE = 2.0
"""Of the Geman-McClure loss, standard deviations: paint that lies further off is something else."""
WIDE = 8.0
"""By how much wider it is at first."""
ROLL_SD_DEG = 0.6
"""Prior of the camera's roll on the head."""
LEVER_BY_ZOOM_SD_M = 0.2
"""Prior of the lever arm's change while the focal length grows e-fold."""
POINT_BY_ZOOM_PX, KAPPA_BY_ZOOM = 4.0, 0.015
"""Priors of how far principal point (pixels at 1920 px width) and radial distortion change with that."""
MODEL_SIGMA_PX, CORRELATION_PX = 0.25, 60.0
"""What paint, surface and lens leave of an ideal marking, pixels at 1920 px width, and over which length along it
neighbours repeat that.
"""
WIDTH_SD_M = 0.015
"""How far the width of the paint may be from the template's, metres: the Laws of the Game allow at most 12 cm, and
grounds have 9 to 12. It is estimated with the rest only where that is asked for, since it takes what the surface and
the lens leave over (6 cm on a real clip), and else considered: a broader line moves all centrelines.
"""
LEAST_LEVER_M = 0.0
"""Least lever arm, metres: the entrance pupil of a camera lies before the axes of its head, on real ones by 0.1 to 1.3.
"""
FARTHEST_PX = 6.0
"""Paint further off, pixels at 1920 px width, counts as so far off where frames of a false calibration are told."""
LEAST_CLEAR = 20
"""Places on markings that are not mistaken for what lies beside them, by which a frame is told. The foot of the boards
behind a far touchline was 6 px off in right frames of a real clip, and a pitch 2.6 m too broad the better one with it;
circle and penalty area in one picture are 20 px off where the length is by 1.8 m.
"""
LEAST_NOISE_PX = 0.05
"""Of a measured middle, pixels."""
PART_M, MOST_PARTS = 5.0, 1000
"""Size of a part of the field, metres, within which all paint of a marking may be off alike, in a frame and in all
frames: neighbours are within 3 places of 9 px, and frames by 0.02 to 0.04 px at 1920 px width of 0.11 to 0.16; parts of
10 m make as much of it. And more parts than any field has along a side.
"""
BEYOND_PARTS = 1.5
"""How many times as much markings are off alike as parts of them tell, the rest being alike over the whole of a marking
or taken up by the fit. Over eight rendered clips of two seeds the mean square of the tripod's errors by their standard
deviations is 1.57 without it, 1.05 with it, and the true place lies in the 90 % region of 89 and 94 % of all points.
Two real clips of one ground put its length 0.2 m and the camera's distance 0.28 m apart, 2.9 and 4.2 standard
deviations without all this, 1.4 and 2.0 with it.
"""
NEIGHBOUR_PX = 40.0
"""Places nearer to each other than this, pixels at 1920 px width, are neighbours."""
NEIGHBOURS_ALIKE = 1.8
"""By how much the smoothing along a marking makes its noise look smaller in the differences of neighbours."""
LARGEST_STEP = 0.3
"""Of the logarithm of focal length and of angles, in one iteration."""


@dataclass(frozen=True, slots=True)
class HeadedFrame:
    """A measured frame with its head.

    Attributes
    ----------
    name : str
        Of the frame.
    head : (3,) array
        Logarithm of the focal length, pan and tilt on the head.
    measured : MeasuredFrame
        Its markings.
    """

    name: str
    head: Array
    measured: MeasuredFrame


def common_priors(config: CameraConfig, rig: RigConfig, template: FieldTemplate, unit: float) -> tuple[Array, Array]:
    """Means and standard deviations (K,) of the common parameters before any frame; the axis has none.

    The pitch may have any size that its rules allow. That most have the template's is another hypothesis, which is
    fitted beside this one.
    """
    mean, sd = np.zeros(len(COMMON)), np.full(len(COMMON), np.inf)

    def know(name: str, value: float, spread: float) -> None:
        mean[PLACE[name]], sd[PLACE[name]] = value, spread

    for name in ("lean_x", "lean_y"):
        know(name, 0.0, np.radians(rig.lean_sd_deg))
    know("head_roll", 0.0, np.radians(ROLL_SD_DEG))
    know("lever", rig.lever_m, rig.lever_sd_m)
    know("lever_by_zoom", 0.0, LEVER_BY_ZOOM_SD_M)
    for name in ("pp_x", "pp_y"):
        know(name, 0.0, config.principal_point_sd_px * unit)
        know(f"{name}_by_zoom", 0.0, POINT_BY_ZOOM_PX * unit)
    radial = config.distortion == "radial"
    know("kappa_1", config.k1_mean if radial else 0.0, config.k1_sd if radial else 0.0)
    know("kappa_1_by_zoom", 0.0, KAPPA_BY_ZOOM if radial else 0.0)
    know("kappa_2", 0.0, config.k2_sd if radial else 0.0)
    know("log_aspect", float(np.log(config.aspect)), config.aspect_sd)
    flat = config.crown_shape == "flat"
    know("crown", 0.0 if flat else config.crown_m, 0.0 if flat else config.crown_sd_m)
    know("width", 0.0, WIDTH_SD_M)
    extents = (
        ("length", template.length_m, template.length_sd_m, template.length_range_m),
        ("breadth", template.width_m, template.width_sd_m, template.width_range_m),
    )
    for name, size, spread, extent in extents:
        if extent is None or spread == 0.0:
            know(name, 0.0, spread)
        else:
            # mean and standard deviation of a uniform distribution
            know(name, sum(extent) / 2.0 - size, (extent[1] - extent[0]) / np.sqrt(12.0))
    return mean, sd


@dataclass(frozen=True, slots=True)
class _Normal:
    """Cost and blocks of the normal equations: own (F, 3, 3), mixed (F, 3, K), common (K, K), and their gradients."""

    cost: float
    H_oo: Array
    H_oc: Array
    H_cc: Array
    g_o: Array
    g_c: Array
    costs: Array
    rms_px: Array
    clear_rms_px: Array

    def scale(self, factor: float) -> _Normal:
        """The equations where all information is so many times as much."""
        blocks = ("H_oo", "H_oc", "H_cc", "g_o", "g_c")
        return replace(self, **{name: factor * getattr(self, name) for name in blocks})


def residuals_of(
    measured: MeasuredFrame, drawn: DrawnTemplate, theta: Array, model: ProjectionModel
) -> tuple[Array, Array]:
    """Distances (M,) of the paint from where a camera (P,) puts it, px, and their derivatives (M, P) by it."""
    places = grow_places(drawn, measured.marking, measured.field_m, theta)
    seen = project(theta[None], places[None], model)
    away = ((measured.points_px - seen.pixels[0]) * measured.normals).sum(axis=1)
    return away, -rows_of(drawn, measured.marking, measured.field_m, seen, measured.normals)


def sigmas_of(measured: MeasuredFrame, residuals_px: Array, unit: float, alike: float = 1.0) -> Array:
    """Standard deviations (M,) of a frame's paint along the normals, with what neighbours repeat of the model's error.

    The noise is read off the differences of neighbours, which no camera explains: it is the same for every model. Faint
    paint, which is measured along whole pieces of a line, tells nothing of it. What the models leave does not average
    out over a number of frames that are ``alike`` in it.
    """
    if len(residuals_px) == 0:
        return np.zeros(0)
    step = np.hypot(*np.diff(measured.points_px, axis=0).T)
    is_alone = measured.bias_px < FAINT_BIAS_PX * unit
    near = np.flatnonzero(
        (np.diff(measured.marking) == 0) & (step < NEIGHBOUR_PX * unit) & is_alone[1:] & is_alone[:-1]
    )
    noise, spacing = LEAST_NOISE_PX, SPACING_PX * unit
    if len(near) >= 8:
        spacing = max(float(median_of_rows(step[near])), 1.0)
        change = np.abs(np.diff(residuals_px)[near])
        noise = max(LEAST_NOISE_PX, NEIGHBOURS_ALIKE * 1.4826 / np.sqrt(2.0) * float(median_of_rows(change)))
    repeats = max(CORRELATION_PX * unit / spacing, 1.0)
    model = MODEL_SIGMA_PX * unit * np.sqrt(alike)
    return np.asarray(np.sqrt(noise**2 + (model**2 + measured.bias_px**2) * repeats))


def _evaluate(
    frames: Sequence[HeadedFrame],
    heads: Array,
    common: Array,
    model: TripodModel,
    drawn: DrawnTemplate,
    sigmas: Sequence[Array],
    loss_scale: float,
) -> _Normal:
    theta, by_own, by_common = model.linearise(heads, common)
    F, K = len(frames), len(COMMON)
    H_oo, H_oc, H_cc, g_o, g_c = (np.zeros(s) for s in ((F, 3, 3), (F, 3, K), (K, K), (F, 3), (K,)))
    costs, rms, clear_rms = np.zeros(F), np.zeros(F), np.zeros(F)
    unit = model.projection.width / 1920.0
    faint, farthest = FAINT_BIAS_PX * unit, FARTHEST_PX * unit
    for k, frame in enumerate(frames):
        away, rows = residuals_of(frame.measured, drawn, theta[k], model.projection)
        values = away / sigmas[k]
        squared = values * values
        share = 1.0 / (1.0 + squared / loss_scale**2)
        weight = share * share
        jacobian = np.concatenate([rows @ by_own[k], rows @ by_common[k]], axis=1) / sigmas[k][:, None]
        weighted = jacobian * weight[:, None]
        H, g = weighted.T @ jacobian, weighted.T @ values
        H_oo[k], H_oc[k], g_o[k] = H[:3, :3], H[:3, 3:], g[:3]
        H_cc += H[3:, 3:]
        g_c += g[3:]
        costs[k] = float((squared * share).sum())
        is_told = frame.measured.bias_px < faint
        rms[k] = _rms(away[is_told] if is_told.any() else away, farthest)
        is_clear = is_told & (frame.measured.scale_px_m > CLEAR_PX_M * unit)
        enough = np.count_nonzero(is_clear) >= LEAST_CLEAR
        clear_rms[k] = min(rms[k], _rms(away[is_clear], farthest)) if enough else rms[k]
    return _Normal(float(costs.sum()), H_oo, H_oc, H_cc, g_o, g_c, costs, rms, clear_rms)


def _rms(away: Array, farthest: float) -> float:
    """Root mean square of distances (M,), none of which counts more than the farthest; 0 of none: a frame may show
    nothing but a line that is left out.
    """
    return float(np.sqrt(np.mean(np.minimum(np.abs(away), farthest) ** 2))) if len(away) else 0.0


@dataclass(frozen=True, slots=True)
class TripodFit:
    """A tripod with the heads (F, 3) of its frames, their root mean square residuals (F,), px, without those of paint
    too faint to be expected, those of paint that is not mistaken for what lies beside it where these are less (F,), and
    the cost.
    """

    estimate: TripodEstimate
    heads: Array
    rms_px: Array
    clear_rms_px: Array
    cost: float


def fit_tripod(
    frames: Sequence[HeadedFrame],
    start: TripodEstimate,
    mean: Array,
    sd: Array,
    drawn: DrawnTemplate,
    prior_precision: Array | None = None,
    is_width_free: bool = False,
    alike: float = 1.0,
    *,
    parts_m: float | None = None,
) -> TripodFit:
    """Heads and common parameters of frames, from a start.

    Parameters
    ----------
    frames : sequence of HeadedFrame
        Measured frames with their heads.
    start : TripodEstimate
        Where the common parameters start.
    mean, sd : (K,) arrays
        Priors of the common parameters; a standard deviation of 0 fixes one at its mean.
    drawn : DrawnTemplate
        The field.
    prior_precision : (K, K) array, optional
        What earlier frames say, instead of ``sd``.
    is_width_free : bool
        Whether the width of the paint is estimated with the rest, instead of considered.
    alike : float
        Number of frames that repeat the same error of the models.
    parts_m : float, optional
        Size of the parts of the field within which paint is off alike, by which the covariance is told: of answers
        :data:`PART_M`, with all that models leave; infinite where whole markings may be beside their places. Without
        it what models leave counts by the cost alone.
    """
    unit = start.size[0] / 1920.0
    model = start.model
    free = free_parameters(sd, is_width_free)
    precision = np.diag(1.0 / np.where(sd > 0, sd, np.inf) ** 2) if prior_precision is None else prior_precision
    common = mean.copy()
    common[free] = start.mean[free]
    heads = np.array([frame.head for frame in frames])
    sigmas = [
        _sigmas(frame, head, common, model, drawn, unit, alike) for frame, head in zip(frames, heads, strict=True)
    ]

    def prior_cost(values: Array) -> float:
        away = np.zeros(len(COMMON))
        away[free] = (values - mean)[free]
        return float(away @ precision @ away)

    for loss_scale in (WIDE * LOSS_SCALE, LOSS_SCALE):
        damping = FIRST_DAMPING
        now = _evaluate(frames, heads, common, model, drawn, sigmas, loss_scale)
        for _ in range(ITERATIONS):
            change_o, change_c = _step(now, precision, common - mean, free, damping)
            shorten = max(1.0, float(np.abs(change_o).max(initial=0.0)) / LARGEST_STEP)
            moved_heads, moved = heads + change_o / shorten, common + change_c / shorten
            then = _evaluate(frames, moved_heads, moved, model, drawn, sigmas, loss_scale)
            before, after = now.cost + prior_cost(common), then.cost + prior_cost(moved)
            if after < before:
                heads, common, now = moved_heads, moved, then
                damping = max(damping / 10.0, 1e-10)
                if before - after < ARRIVED * max(before, 1.0):
                    break
            else:
                damping *= 10.0
                if damping > 1e4:
                    break
    lever = PLACE["lever"]
    if lever in free and common[lever] < LEAST_LEVER_M <= mean[lever]:
        mean, sd, common = mean.copy(), sd.copy(), common.copy()
        mean[lever], sd[lever] = LEAST_LEVER_M, 0.0
        held = [replace(frame, head=head) for frame, head in zip(frames, heads, strict=True)]
        start = replace(start, mean=common)
        return fit_tripod(held, start, mean, sd, drawn, prior_precision, is_width_free, alike, parts_m=parts_m)
    told = now
    # where only noise is left it may be less than it is taken to be
    is_noise = alike == 1.0 and float(np.mean(now.rms_px)) <= MODEL_SIGMA_PX * unit
    if len(frames) > 1 and (is_noise or parts_m is not None):
        part_m = PART_M if parts_m is None else parts_m
        spread = _measure_spread(frames, heads, common, model, drawn, sigmas, now, precision, free, part_m)
        told = now.scale(1.0 / (spread if is_noise else max(spread, 1.0)))
    covariance = np.zeros((len(COMMON), len(COMMON)))
    reduced = _eliminate(told, precision, 0.0)[0]
    covariance[np.ix_(free, free)] = inverse_of_normal(reduced[np.ix_(free, free)])
    # all else follows where the paint is broader or narrower than it is taken to be (a parameter that is considered)
    follows = np.zeros(len(COMMON))
    if not is_width_free:
        follows[free] = -covariance[np.ix_(free, free)] @ reduced[free, PLACE["width"]]
        follows[PLACE["width"]] = 1.0
    # where the models leave more than the noise, all is that much less certain
    values = sum(len(frame.measured.marking) for frame in frames)
    covariance *= max(1.0, now.cost / max(values - 3 * len(frames), 1))
    covariance += np.outer(follows, follows) * sd[PLACE["width"]] ** 2
    surface = replace(start.surface, crown_m=float(common[PLACE["crown"]]))
    estimate = replace(
        start,
        surface=surface,
        mean=common,
        covariance=(covariance + covariance.T) / 2,
        head_low=heads.min(axis=0),
        head_high=heads.max(axis=0),
        used=tuple(frame.name for frame in frames),
    )
    return TripodFit(estimate, heads, now.rms_px, now.clear_rms_px, now.cost + prior_cost(common))


def number_parts(measured: MeasuredFrame, part_m: float = PART_M) -> Indices:
    """Number (M,) of marking and part of the field of each place of a frame: what is off there is off alike."""
    x, y = np.floor(measured.field_m / part_m).astype(np.int_).T
    return np.asarray((measured.marking * MOST_PARTS + x) * MOST_PARTS + y, np.int_)


def add_by_part(at: Indices, count: int, values: Array) -> Array:
    """Sums (count, V) of values (M, V) of places, by the parts (M,) in which they lie."""
    found = np.zeros((count, values.shape[1]))
    np.add.at(found, at, values)
    return found


def _measure_spread(
    frames: Sequence[HeadedFrame],
    heads: Array,
    common: Array,
    model: TripodModel,
    drawn: DrawnTemplate,
    sigmas: Sequence[Array],
    now: _Normal,
    precision: Array,
    free: Indices,
    part_m: float,
) -> float:
    """Variance of the paint about its markings, as a share of what it is taken to have.

    Within a part of the field the distances need not be independent of each other, so each part counts with their
    weighted sum, over all frames: with ``a`` the weights and ``J`` the derivatives of the weighted distances ``r``,
    ``(a . r)^2`` has the mean ``|a|^2 - a^T J (J^T J)^-1 J^T a`` where all variances are as they are taken to be.
    """
    theta, by_own, by_common = model.linearise(heads, common)
    parts, part = np.unique(
        np.concatenate([number_parts(frame.measured, part_m) for frame in frames]), return_inverse=True
    )
    count = len(parts)
    away, size = np.zeros((2, count))
    reduced, solved = _eliminate(now, precision, 0.0)
    shared = np.zeros((count, len(COMMON)))
    explained = 0.0
    last = 0
    for k, frame in enumerate(frames):
        off, rows = residuals_of(frame.measured, drawn, theta[k], model.projection)
        at = part[last : last + len(off)]
        last += len(off)
        weight = (1.0 + (off / sigmas[k] / LOSS_SCALE) ** 2) ** -2.0 / sigmas[k] ** 2
        away += np.bincount(at, weight * off, count)
        size += np.bincount(at, weight, count)
        own = add_by_part(at, count, weight[:, None] * (rows @ by_own[k]))
        explained += float((own * np.linalg.solve(now.H_oo[k] + 1e-6 * np.eye(3), own.T).T).sum())
        shared += add_by_part(at, count, weight[:, None] * (rows @ by_common[k])) - own @ solved[k, :, :-1]
    inverse = inverse_of_normal(reduced[np.ix_(free, free)])
    explained += float(np.einsum("ci,ij,cj->", shared[:, free], inverse, shared[:, free]))
    as_taken = size.sum() / len(frames)  # one frame's, so that few frames tell little
    share = ((away**2).sum() + as_taken) / (max(size.sum() - explained, 0.0) + as_taken)
    return float(BEYOND_PARTS * share)


def count_alike(fit: TripodFit) -> float:
    """Number of a fit's frames that repeat the same error of the models.

    All frames show the same paint on the same surface through the same lens. Where these are as the models have them,
    as in rendered clips, only the noise is left, and that differs from frame to frame; what is left beyond it is the
    models' own error, and all frames repeat it.
    """
    usual = MODEL_SIGMA_PX * fit.estimate.size[0] / 1920.0
    excess = (float(np.mean(fit.rms_px)) / usual) ** 2 - 1.0
    return 1.0 + (len(fit.heads) - 1) * min(max(excess, 0.0), 1.0)


def free_parameters(sd: Array, is_width_free: bool = False) -> Indices:
    """Common parameters that are estimated, by their standard deviations (K,) before any frame."""
    is_free = sd > 0
    is_free[PLACE["width"]] &= is_width_free
    return np.asarray(np.flatnonzero(is_free), dtype=np.int_)


def _sigmas(
    frame: HeadedFrame, head: Array, common: Array, model: TripodModel, drawn: DrawnTemplate, unit: float, alike: float
) -> Array:
    away, _ = residuals_of(frame.measured, drawn, model.thetas(head[None], common)[0], model.projection)
    return sigmas_of(frame.measured, away, unit, alike)


def _eliminate(now: _Normal, precision: Array, damping: float) -> tuple[Array, Array]:
    """The common block after the frames' own ones are eliminated, and their solved blocks (F, 3, K + 1)."""
    own = now.H_oo + (damping * np.einsum("foo->fo", now.H_oo) + 1e-6)[:, :, None] * np.eye(3)
    solved = np.linalg.solve(own, np.concatenate([now.H_oc, now.g_o[..., None]], axis=2))
    whole = now.H_cc + precision
    whole = whole + damping * np.diag(np.diag(whole))
    return whole - np.einsum("foc,fod->cd", now.H_oc, solved[..., :-1]), solved


def _step(now: _Normal, precision: Array, away: Array, free: Indices, damping: float) -> tuple[Array, Array]:
    reduced, solved = _eliminate(now, precision, damping)
    gradient = now.g_c + precision @ away - np.einsum("foc,fo->c", now.H_oc, solved[..., -1])
    change = np.zeros(len(away))
    change[free] = -inverse_of_normal(reduced[np.ix_(free, free)]) @ gradient[free]
    return -solved[..., -1] - solved[..., :-1] @ change, change


def inverse_of_normal(matrix: Array) -> Array:
    """Inverse of a normal matrix of quantities of very different size."""
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    return np.asarray(np.linalg.pinv(matrix / np.outer(size, size), rcond=1e-13, hermitian=True) / np.outer(size, size))


def start_tripod(
    name: str, theta: Array, size: tuple[int, int], surface: Surface, mean: Array, sd: Array
) -> TripodEstimate:
    """A tripod to start from at cameras (F, P) that were calibrated alone.

    The axis lies behind the entrance pupils by the lever arm that is expected; all else that is common is the median.
    """
    model = TripodModel(ProjectionModel(*size, replace(surface, crown_m=1.0)), float(np.median(theta[:, 0])))
    common = mean.copy()
    for parameter in ("pp_x", "pp_y", "kappa_1", "crown", "length", "breadth"):
        if sd[PLACE[parameter]] > 0:
            common[PLACE[parameter]] = np.median(theta[:, INDEX[parameter]])
    common[PLACE["head_roll"]] = np.median(theta[:, INDEX["roll"]])
    level = common.copy()
    level[:3] = 0.0
    # with the axis at the origin the model's positions are what the lever arm adds
    beyond = model.thetas(model.own_of(theta, level)[:, :3], level)[:, 4:7]
    common[:3] = np.median(theta[:, 4:7] - beyond, axis=0)
    heads = model.own_of(theta, common)[:, :3]
    covariance = np.diag(np.where(np.isfinite(sd), sd, 1.0) ** 2)
    return TripodEstimate(
        name, size, model.log_focal, surface, common, covariance, heads.min(axis=0), heads.max(axis=0)
    )

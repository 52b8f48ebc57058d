"""The tripod from frames whose markings were measured, with what is known of any tripod before any frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from circlecal.camera.options import (
    BEND_SD,
    USUAL_FOCAL_WIDTHS,
    CameraConfig,
    usual_k1_by_focal,
    usual_kappa,
    usual_kappa_by_zoom,
)
from circlecal.camera.rig_options import RigConfig
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array, Indices
from circlecal.geometry.surface import Surface
from circlecal.rig.tripod import COMMON, PLACE, PaintersShare, TripodEstimate, TripodModel
from circlecal.tracking.frame_paint import MODEL_SIGMA_PX, PART_M, HeadedFrame
from circlecal.tracking.markings import DrawnTemplate
from circlecal.tracking.painters import align_errors, list_errors, name_errors
from circlecal.tracking.tripod_problem import RULE, TripodProblem, TripodState

LOSS_SCALE = 2.0
"""Of the Geman-McClure loss, standard deviations: paint that lies further off is something else."""
WIDE = 8.0
"""By how much wider it is at first."""
ROLL_SD_DEG = 0.6
"""Prior of the camera's roll on the head."""
LEVER_BY_ZOOM_SD_M = 0.2
"""Prior of the lever arm's change while the focal length grows e-fold."""
POINT_BY_ZOOM_PX, KAPPA_BY_ZOOM = 4.0, 0.015
"""Priors of how far principal point (pixels at 1920 px width) and radial distortion change with that, the latter about
what broadcast zooms do.
"""
WIDTH_SD_M = 0.015
"""How far the width of the paint may be from the template's, metres: the Laws of the Game allow at most 12 cm, and
grounds have 9 to 12. It is estimated with the rest only where that is asked for, since it takes what the surface and
the lens leave over (6 cm on a real clip), and else considered: a broader line moves all centrelines.
"""
LEAST_LEVER_M = 0.0
"""Least lever arm, metres: the entrance pupil of a camera lies before the axes of its head, on real ones by 0.1 to 1.3.
"""
LEVER = PLACE["lever"]


def common_priors(
    config: CameraConfig,
    rig: RigConfig,
    template: FieldTemplate,
    picture: tuple[int, int],
    focal_widths: float = USUAL_FOCAL_WIDTHS,
) -> tuple[Array, Array]:
    """Means and standard deviations (K,) of the common parameters before any frame, for pictures of a size, quoted at a
    focal length in picture widths.

    Of the axis nothing is known, unless the user says where the camera stands: who measures that measures its tripod.
    The pitch may have any size that its rules allow. That most have the template's is another hypothesis, which is
    fitted beside this one.
    """
    mean, sd = np.zeros(len(COMMON)), np.full(len(COMMON), np.inf)

    def know(name: str, value: float, spread: float) -> None:
        mean[PLACE[name]], sd[PLACE[name]] = value, spread

    if config.position_m is not None:
        for name, place, spread in zip(COMMON[:3], config.position_m, config.position_sd_m, strict=True):
            know(name, place, spread)
    for name in ("lean_x", "lean_y"):
        know(name, 0.0, np.radians(rig.lean_sd_deg))
    know("head_roll", 0.0, np.radians(ROLL_SD_DEG))
    know("lever", rig.lever_m, rig.lever_sd_m)
    know("lever_by_zoom", 0.0, LEVER_BY_ZOOM_SD_M)
    shift, spreads = config.principal_point_shift(*picture), config.principal_point_sd(*picture)
    for name, off, spread in zip(("pp_x", "pp_y"), shift, spreads, strict=True):
        know(name, float(off), spread)
        know(f"{name}_by_zoom", 0.0, POINT_BY_ZOOM_PX * picture[0] / 1920.0)
    radial = config.distortion == "radial"
    know("kappa_1", usual_kappa(config, focal_widths, picture) if radial else 0.0, config.k1_sd if radial else 0.0)
    by_zoom = usual_kappa_by_zoom(config, focal_widths)
    know("kappa_1_by_zoom", by_zoom if radial else 0.0, KAPPA_BY_ZOOM if radial else 0.0)
    bend = usual_k1_by_focal(config)
    know("kappa_1_by_focal", bend, BEND_SD if bend > 0.0 else 0.0)
    know("kappa_2", config.k2_mean if radial else 0.0, config.k2_sd if radial else 0.0)
    know("log_aspect", *config.log_aspect(*picture))
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
class TripodFit:
    """A tripod with the heads (F, 3) of its frames, their root mean square residuals (F,), px, without those of paint
    too faint to be expected, those of paint that is not mistaken for what lies beside it where these are less (F,), the
    cost, how much of it is the prior's, and how many times the variance that it is taken to have the paint has about
    its markings: less than 1 only where nothing but noise is left.
    """

    estimate: TripodEstimate
    heads: Array
    rms_px: Array
    clear_rms_px: Array
    cost: float
    prior_cost: float = 0.0
    spread: float = 1.0

    def cost_by(self, spread: float) -> float:
        """The cost where the paint has so many times the variance that it is taken to have."""
        return (self.cost - self.prior_cost) / spread + self.prior_cost


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
    rule: StoppingRule = RULE,
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
    rule : StoppingRule
        When the optimum is reached.
    """
    free = free_parameters(sd, is_width_free)
    precision = np.diag(1.0 / np.where(sd > 0, sd, np.inf) ** 2) if prior_precision is None else prior_precision
    problem, heads, common = TripodProblem.of(frames, start, drawn, mean, precision, free, alike)
    rough = problem.minimise(heads, common, WIDE * LOSS_SCALE)
    at = problem.minimise(rough.heads, rough.common, LOSS_SCALE, rule)
    if LEVER in free and at.common[LEVER] < LEAST_LEVER_M <= mean[LEVER]:
        mean, sd, common = mean.copy(), sd.copy(), at.common.copy()
        mean[LEVER], sd[LEVER] = LEAST_LEVER_M, 0.0
        held = [replace(frame, head=head) for frame, head in zip(frames, at.heads, strict=True)]
        start = replace(start, mean=common)
        return fit_tripod(
            held, start, mean, sd, drawn, prior_precision, is_width_free, alike, parts_m=parts_m, rule=rule
        )
    rms, clear_rms = problem.distances(at)
    # where only noise is left it may be less than it is taken to be
    is_noise = alike == 1.0 and float(np.mean(rms)) <= MODEL_SIGMA_PX * problem.unit
    spread = _measure_spread(problem, at, is_noise, parts_m)
    painters: PaintersShare | None = None
    if parts_m is not None and np.isfinite(parts_m) and name_errors(drawn):
        # what earlier frames say followed the errors, what any tripod has does not
        known = align_errors(start if prior_precision is not None else None, drawn)
        by_errors = problem.follow_errors(at, LOSS_SCALE, known)
        left = _measure_spread(problem, at, is_noise, parts_m, by_errors)
        covariance = _tell_covariance(problem, at, left, sd, is_width_free)
        painters = PaintersShare(covariance, list_errors(by_errors, drawn))
    estimate = replace(
        start,
        surface=replace(start.surface, crown_m=float(at.common[PLACE["crown"]])),
        mean=at.common,
        covariance=_tell_covariance(problem, at, spread, sd, is_width_free),
        head_low=at.heads.min(axis=0),
        head_high=at.heads.max(axis=0),
        used=tuple(frame.name for frame in frames),
        painters=painters,
    )
    return TripodFit(estimate, at.heads, rms, clear_rms, float(at.cost[0]), at.prior_cost, spread)


def _measure_spread(
    problem: TripodProblem, at: TripodState, is_noise: bool, parts_m: float | None, by_errors: Array | None = None
) -> float:
    """Variance by which the paint is told to be about its markings, as a share of what it is taken to have; less than 1
    only where nothing but noise is left. Painters' errors, which the common parameters follow by ``by_errors`` (K, E),
    are no part of it.
    """
    if len(problem.frames) < 2 or not (is_noise or parts_m is not None):
        return 1.0
    spread = problem.measure_spread(at, LOSS_SCALE, PART_M if parts_m is None else parts_m, by_errors)
    return spread if is_noise else max(spread, 1.0)


def _tell_covariance(problem: TripodProblem, at: TripodState, spread: float, sd: Array, is_width_free: bool) -> Array:
    """Covariance (K, K) of the common parameters, where the paint is spread about its markings so much more than it is
    taken to be.

    Where the models leave more than the noise, all is that much less certain. And where the width of the paint is
    considered, all else follows where it is broader or narrower than it is taken to be.
    """
    free = problem.free
    reduced, _ = at.normal.scale(1.0 / spread).eliminate(problem.precision)
    inverse = problem.invert(reduced)
    places = sum(len(frame.measured.marking) for frame in problem.frames) - 3 * len(problem.frames)
    covariance = np.zeros((len(COMMON), len(COMMON)))
    covariance[np.ix_(free, free)] = inverse * max(1.0, at.normal.cost / max(places, 1))
    if not is_width_free:
        follows = np.zeros(len(COMMON))
        follows[free] = -inverse @ reduced[free, PLACE["width"]]
        follows[PLACE["width"]] = 1.0
        covariance += np.outer(follows, follows) * sd[PLACE["width"]] ** 2
    return np.asarray((covariance + covariance.T) / 2)


def count_alike(fit: TripodFit) -> float:
    """Number of a fit's frames that repeat the same error of the models.

    All frames show the same paint on the same surface through the same lens. Where these are as the models have them,
    as in rendered clips, only the noise is left, and that differs from frame to frame; what is left beyond it is the
    models' own error, and all frames repeat it.
    """
    return 1.0 + (len(fit.heads) - 1) * min(excess_of(fit), 1.0)


def excess_of(fit: TripodFit) -> float:
    """What the models leave of the paint beyond noise, as a share of the noise's mean square."""
    usual = MODEL_SIGMA_PX * fit.estimate.size[0] / 1920.0
    return max((float(np.mean(fit.rms_px)) / usual) ** 2 - 1.0, 0.0)


def free_parameters(sd: Array, is_width_free: bool = False) -> Indices:
    """Common parameters that are estimated, by their standard deviations (K,) before any frame."""
    is_free = sd > 0
    is_free[PLACE["width"]] &= is_width_free
    return np.asarray(np.flatnonzero(is_free), dtype=np.int_)


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

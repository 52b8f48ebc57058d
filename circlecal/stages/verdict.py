"""Stage ``verdict``: accept the calibration, or refuse it with a reason. Refusing beats inventing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import CROWN, LOG_FOCAL
from circlecal.geometry.conics import circle_conic, sampson_distance, transform_conic
from circlecal.geometry.homography import projects_in_front
from circlecal.geometry.projective import Array
from circlecal.line_naming.reach import chord_checks, reach_checks
from circlecal.observations import MarkingKey
from circlecal.paint.predicted_width import RESIDUAL_WIDTHS, mean_paint_width
from circlecal.refusals import REFUSALS, Confidence
from circlecal.results import Attempt, CameraFit, Check, Cues, EllipseFits, Verdict

NOISE_SIGMAS = 3.0
"""Residuals within this many of the observations' own standard deviations are noise."""
CIRCLE_SIGMAS = 2.0
"""Standard deviations of painters' errors that a residual of the circle may have, where other markings hold the camera:
the right camera of a rendered rink has 1.6 to 1.8, those that took the other circle for it 2.7 to 2.8.
"""
BLOOM_PX = 3.0
"""By how much blur can drive both edges apart, pixels at 1920 px width."""
LARGEST_FOCAL_SIGMA = 0.03
"""Relative standard deviation of the focal length up to which the limit of the shortest one follows it; a camera that
knows it less is not excused by that.
"""
LIKELY_RESIDUAL_PX = 1.4
"""Largest rms distance from the projected circle of one that needs a confirmation, pixels at 1920 px width."""
EXACT_RESIDUALS_PX, EXACT_ARCS_DEG = np.array([0.1, 0.2]), np.array([130.0, 180.0])
"""Largest rms distance from the projected circle (pixels at 1920 px width) and least arc (degrees) of one that needs no
other confirmation; of more of the circle less exactness is asked, since what is pieced together of other lines is
shorter. Worn circles that are seen for 190 to 325 degrees lie 0.11 to 0.16 off; of 200 rendered pictures without a
circle none comes so far.
"""
EXACT_WIDTHS = 0.015
"""The limit of exactness in widths of the circle's paint, where that is more."""
UNCONFIRMED_SIGMA = 0.75
"""Share of the usual uncertainty that is allowed where nothing else confirms it: nothing would contradict either."""
MEASURED_SHARE = 2.0 / 3.0
"""Share of a short arc in view that is measured, without what lies too near to the picture's border for a profile to
fit: of four rendered arcs of 71 to 91 degrees 47 to 59 are.
"""
WRONG_PX = 20.0
"""Mean error, pixels at 1920 px width, from which on another size of the field is another answer."""
SIZE_SIGMAS, MOST_BEYOND_RULES = 3.0, 3.0 / 68.0
"""Standard deviations, and widths of the usual field further, by which a field may be smaller or larger than the rules
of its sport allow: a picture that was turned upside down had a width of 33.2 +- 0.3 m, of 45 m at least; of 226 answers
to 13 real clips none lies beyond the rules at all. Of 17 right answers to rendered halls none does; of seven halls of
handball or futsal under the other's name one is 1.6 m too narrow, and one 2.1 m too long.
"""
HOLLOW_M = 0.02
"""Metres by which the ground may lie lower in the middle of the circle than at its rim: of 2,130 right answers to
rendered frames none lies lower by more than 0.005; of 225 rendered pictures that were turned upside down, mirrored or
put together, and that some camera explains, 68 lie lower by more than this.
"""
MINIMUM_WIDTH_M = 1e-3
"""Narrower markings are the zero-width lines of an annotation's model."""
MOST_NOISE_BESIDE_MARK = 2.0
"""By how much noise may have to grow for circle and halfway line where they contradict the centre mark and nothing else
is there to decide: of rendered frames in which a foot was taken for the mark 1.0, of pictures of other perspectives
that were put together, whose mark is one, 3.7.
"""


class VerdictConfig(BaseModel):
    """Options of the stage ``verdict``."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    max_sigma_px: float = Field(
        64.0,
        gt=0,
        description="Largest predicted error of the field around the circle, or around what is seen instead of it, "
        "pixels at 1920 px width; smaller where a refused frame is better than one that is known roughly. Frames "
        "that `circlecal track` answers may have as much, on all of the pitch that is in view.",
    )
    max_mean_sigma_px: float = Field(
        24.0,
        gt=0,
        description="Largest mean of the predicted error there, pixels at 1920 px width: of right answers to real "
        "frames at most 20.8, of a rendered one that is 36 px off 28. Frames that are tracked may have 8 or a third "
        "of it.",
    )
    max_other_size_share: float = Field(
        0.02,
        ge=0,
        le=1,
        description="How likely a field of another size, which moves what is in view by 20 px, may be. Real frames of "
        "usual fields that are good have 0.0196 at most; of 1,800 rendered ones of all sizes ten have 0.02 to 0.04, of "
        "which one is good, and seven are 22 to 58 px off.",
    )
    max_sigma_m: float = Field(3.0, gt=0, description="Largest predicted error on the ground there, metres.")
    max_circle_residual_px: float = Field(
        2.0,
        gt=0,
        description="Largest rms distance of the circle's points from the projected circle, pixels at 1920 px width.",
    )
    max_structured_residual_px: float = Field(
        1.5,
        gt=0,
        description="Largest part of it that repeats itself along the arc, pixels at 1920 px width.",
    )
    edge_gap_ratio: tuple[float, float] = Field(
        (0.5, 2.0), description="Accepted gap between outer and inner edge over the one that the camera predicts."
    )
    max_line_residual_px: float = Field(
        2.0,
        gt=0,
        description="Largest rms distance of the halfway line from its points, and of every line, arc and point where "
        "the circle is not seen, pixels at 1920 px width.",
    )
    max_rejected_share: float = Field(
        0.4,
        ge=0,
        lt=1,
        description="Largest share of contradicting observations where the circle is not seen.",
    )
    max_line_reach: float = Field(
        1.35,
        gt=1,
        description="How far the halfway line may be seen to run, in half widths of the field: where it goes further, "
        "the circle is another one.",
    )
    max_mark_distance_px: float = Field(
        12.0, gt=0, description="Largest distance of the seen from the predicted centre mark, pixels at 1920 px width."
    )
    height_m: tuple[float, float] = Field((1.5, 150.0), description="Plausible height of a camera, metres.")
    distance_radii: tuple[float, float] = Field(
        (1.1, 40.0), description="Plausible distance from the circle, or from what is seen instead, in its radii."
    )
    stands_m: float = Field(
        60.0,
        gt=0,
        description="No camera stands further away than the field's diagonal and this, metres: 185 m at a soccer "
        "pitch. The furthest of 40 real frames stood at 114 m.",
    )
    max_roll_deg: float = Field(20.0, gt=0, le=180, description="Largest plausible roll, degrees.")
    focal_widths: tuple[float, float] = Field(
        (0.3, 30.0), description="Plausible focal length, in widths of the picture."
    )


def judge(attempt: Attempt, template: FieldTemplate, circle: Circle, width: int, config: VerdictConfig) -> Verdict:
    """Check the calibration of a frame.

    Every check is recorded with its value and its limit; the first that fails is the reason of the refusal. A circle
    that the mask stage did not accept by itself needs the centre mark or a further marking at the place that the camera
    gives it, or much of it must lie exactly where the camera puts it, and less uncertainty is allowed then.

    Parameters
    ----------
    attempt : Attempt
        With ellipses and cues, and with a homography, a camera or both.
    template, circle : FieldTemplate, Circle
        The field and the circle.
    width : int
        Width of the picture, pixels.
    config : VerdictConfig
        Limits.
    """
    camera, homography = attempt.camera, attempt.homography
    ellipses, cues = attempt.ellipses or EllipseFits(None, None, None), attempt.cues or Cues(None, None)
    unit, is_tentative = width / 1920.0, attempt.mask is not None and attempt.mask.confidence is Confidence.TENTATIVE
    if camera is not None:
        checks = _camera_checks(camera, ellipses, cues, template, circle, unit, config, is_tentative)
    elif homography is not None:
        H = homography.H_image_field
        residual = _circle_residual(ellipses, H, template, circle)
        checks = _orientation_checks(H, circle)
        checks.append(Check.of("circle_residual_px", residual, config.max_circle_residual_px * unit))
    else:
        return Verdict("refused", "no_homography", REFUSALS["no_homography"].words, "verdict")
    if is_tentative and ellipses.all():
        if camera is not None:
            likely = max(LIKELY_RESIDUAL_PX * unit, RESIDUAL_WIDTHS * mean_paint_width(camera.view, circle, template))
            checks.append(Check.of("likely_residual_px", _worst_of(camera, circle), likely))
        exact = camera is not None and _is_exact(ellipses, camera, template, circle, unit)
        checks.append(Check.of("confirmations", float(_confirmations(cues, camera, circle, unit) + exact), 1.0))
    if camera is not None and ellipses.least_arc_deg > 0.0:
        checks += _short_arc_checks(attempt, camera, ellipses, cues, template, circle, unit)
    failed = next((c for c in checks if not c.passed), None)
    if failed is None:
        return Verdict("calibrated", None, None, None, tuple(checks))
    marking = str(_worst_marking(camera, unit, config)[0]) if camera is not None and camera.residuals_px else ""
    return Verdict.refusal_by(failed, tuple(checks), marking)


def _camera_checks(
    camera: CameraFit,
    ellipses: EllipseFits,
    cues: Cues,
    template: FieldTemplate,
    circle: Circle,
    unit: float,
    config: VerdictConfig,
    is_tentative: bool,
) -> list[Check]:
    """Checks of a camera: where it stands, how well it explains what was seen, how surely it is known."""
    if ellipses.all():
        checks = _orientation_checks(camera.H_image_field, circle)
        checks += _place_checks(camera, circle, camera.view.center_of(circle, template), template, config)
        width_px = mean_paint_width(camera.view, circle, template)
        checks += _residual_checks(camera, cues, circle, RESIDUAL_WIDTHS * width_px, unit, config)
        checks += reach_checks(camera, cues, template, config.max_line_reach)
        checks += chord_checks(camera, cues, template, circle)
    else:
        checks = _landmark_checks(camera, unit, config)
        checks += _place_checks(camera, circle, camera.reference_m, template, config)
    checks += _surface_checks(camera)
    alone = is_tentative and bool(ellipses.all()) and _confirmations(cues, camera, circle, unit) == 0
    limit_px = config.max_sigma_px * (UNCONFIRMED_SIGMA if alone else 1.0)
    checks.append(Check.of("sigma_px", camera.max_sigma_px, limit_px * unit))
    checks.append(Check.of("mean_sigma_px", camera.mean_sigma_px, config.max_mean_sigma_px * unit))
    checks.append(Check.of("sigma_m", camera.max_sigma_m, config.max_sigma_m))
    if camera.other_size is not None and camera.other_size.away_px > WRONG_PX * unit:
        checks.append(Check.of("other_size_share", camera.other_size.share, config.max_other_size_share))
    checks += _size_checks(camera, template)
    return [*checks, *_edge_checks(camera, ellipses, template, circle, config)]


def _size_checks(camera: CameraFit, template: FieldTemplate) -> list[Check]:
    """Whether the field has a size that the rules of its sport allow; nothing where no size was asked."""
    size = camera.field_size
    if size is None:
        return []
    estimates = (size.length_m, size.length_sd_m), (size.width_m, size.width_sd_m)
    beyond = [
        extent.beyond_rules(size_m) - SIZE_SIGMAS * sd_m
        for (size_m, sd_m), extent in zip(estimates, template.extents, strict=True)
        if extent.range_m is not None
    ]
    return [Check.of("beyond_rules_m", max(beyond, default=0.0), MOST_BEYOND_RULES * template.width_m)]


def renew_sigmas(verdict: Verdict, camera: CameraFit) -> Verdict:
    """The verdict on a camera whose uncertainty has changed since, refused where that is too large now."""
    values = {"sigma_px": camera.max_sigma_px, "mean_sigma_px": camera.mean_sigma_px, "sigma_m": camera.max_sigma_m}
    checks = tuple(
        Check.of(check.name, values[check.name], check.limit) if check.name in values else check
        for check in verdict.checks
    )
    failing = [check for check in checks if check.name in values and not check.passed]
    if verdict.status == "calibrated" and failing:
        return Verdict.refusal_by(failing[0], checks)
    return replace(verdict, checks=checks)


def _orientation_checks(H: Array, circle: Circle) -> list[Check]:
    rim = np.asarray(circle.center, dtype=np.float64) + circle.radius_m * _ring()
    return [
        Check.of("circle_in_front", 1.0 if projects_in_front(H, rim) else 0.0, 1.0),
        Check.of("not_mirrored", float(np.linalg.det(H)), 0.0),
    ]


def _worst_of(camera: CameraFit, circle: Circle) -> float:
    """Largest residual of the circle's edges or centreline, px, without what lies on players."""
    own = ((key, rms) for key, rms in camera.residuals_px.items() if key.name == circle.name)
    return max((camera.bulk_residuals_px.get(key, rms) for key, rms in own), default=0.0)


def _confirmations(cues: Cues, camera: CameraFit | None, circle: Circle, unit: float) -> int:
    """Markings besides circle and halfway line that lie where the camera puts them; arcs only beside both."""
    if camera is None:
        return 0
    halfway = None if cues.halfway is None else cues.halfway.name
    mark = cues.mark is not None and MarkingKey(cues.mark.name) not in camera.rejected
    residuals, largest = camera.residuals_px, LIKELY_RESIDUAL_PX * unit
    told = {line.name for line in cues.lines if line.name is not None and MarkingKey(line.name) in residuals}
    near = [name for name in {*camera.named_lines, *told} if residuals.get(MarkingKey(name), 0.0) <= largest]
    others = (key for key in residuals if key.edge is not None and key.name != circle.name and halfway is not None)
    arcs = sum(residuals[key] <= largest for key in others)
    return int(mark) + sum(name != halfway for name in near) + arcs


def _short_arc_checks(
    attempt: Attempt,
    camera: CameraFit,
    ellipses: EllipseFits,
    cues: Cues,
    template: FieldTemplate,
    circle: Circle,
    unit: float,
) -> list[Check]:
    """Checks of an arc of which the ellipse does not tell how long it is: as the camera puts it on the field it must be
    long enough, and other markings must confirm that camera.
    """
    seen = None if attempt.observations is None else attempt.observations.circle(circle.name, ellipses.primary.edge)
    points_px = ellipses.primary.points_px if seen is None else seen.points_px
    off_m = camera.view.to_field(points_px) - camera.view.center_of(circle, template)
    angle = np.sort(np.arctan2(off_m[:, 1], off_m[:, 0]))
    angle = angle[np.isfinite(angle)]
    gap = np.diff(angle, append=angle[:1] + 2 * np.pi)
    arc_deg = 360.0 - float(np.degrees(gap.max(initial=0.0))) if len(angle) else 0.0
    confirmations = float(_confirmations(cues, camera, circle, unit))
    return [
        Check.of("arc_deg", arc_deg, MEASURED_SHARE * ellipses.least_arc_deg),
        Check.of("confirmations", confirmations, 1.0),
    ]


def _is_exact(ellipses: EllipseFits, camera: CameraFit, template: FieldTemplate, circle: Circle, unit: float) -> bool:
    """Whether more of the circle than a penalty arc has lies where the camera puts it so exactly that nothing that was
    pieced together does.
    """
    exact = np.maximum(EXACT_RESIDUALS_PX * unit, EXACT_WIDTHS * mean_paint_width(camera.view, circle, template))
    worst = _worst_of(camera, circle)
    return worst > 0.0 and bool(((ellipses.primary.arc_deg >= EXACT_ARCS_DEG) & (worst <= exact)).any())


def _landmark_checks(camera: CameraFit, unit: float, config: VerdictConfig) -> list[Check]:
    """Of a frame without the circle: every line, arc and point must lie where the others put it."""
    checks = [Check.of("field_in_front", float(camera.camera.depth(camera.reference_m)), 0.0)]
    if camera.residuals_px:
        _, rms, limit = _worst_marking(camera, unit, config)
        checks.append(Check.of("marking_residual_px", rms, limit))
    share = len(camera.rejected) / max(len(camera.rejected) + len(camera.all_residuals_px), 1)
    return [*checks, Check.of("rejected_share", share, config.max_rejected_share)]


def _worst_marking(camera: CameraFit, unit: float, config: VerdictConfig) -> tuple[MarkingKey, float, float]:
    """Key, rms residual and limit of the line, arc or point that leaves most of what it is allowed."""
    least = config.max_line_residual_px * unit
    seen = camera.all_residuals_px.items()
    markings = ((key, rms, max(least, _largest_residual_px(camera, key))) for key, rms in seen)
    return max(markings, key=lambda marking: marking[1] / marking[2])


def _largest_residual_px(camera: CameraFit, key: MarkingKey) -> float:
    """Residual that an observation may have by its own noise and by painters' errors, pixels."""
    stated, painted = camera.stated_sigma_px.get(key, 0.0), camera.painted_sigma_px.get(key, 0.0)
    return NOISE_SIGMAS * float(np.hypot(stated, painted))


def _place_checks(
    camera: CameraFit, circle: Circle, reference_m: Array, template: FieldTemplate, config: VerdictConfig
) -> list[Check]:
    view = camera.camera
    furthest_m = float(np.hypot(template.length_m, template.width_m)) + config.stands_m
    furthest = min(config.distance_radii[1], furthest_m / circle.radius_m)
    distance = float(np.linalg.norm(view.position_m - np.r_[reference_m, 0.0])) / circle.radius_m
    # of a focal length that is known to a few per cent, what is by less below the limit is not
    sigma = min(float(np.sqrt(camera.covariance[LOG_FOCAL, LOG_FOCAL])), LARGEST_FOCAL_SIGMA)
    shortest = config.focal_widths[0] * float(np.exp(-NOISE_SIGMAS * sigma))
    return [
        Check.of("height_m", -float(view.position_m[2]), config.height_m[1]),
        Check.of("lowest_height_m", -float(view.position_m[2]), config.height_m[0]),
        Check.of("distance_radii", distance, furthest),
        Check.of("nearest_radii", distance, config.distance_radii[0]),
        Check.of("roll_deg", abs(float(np.degrees(view.angles_rad[2]))), config.max_roll_deg),
        Check.of("focal_widths", float(view.focal_px[0]) / view.width, config.focal_widths[1]),
        Check.of("shortest_focal_widths", float(view.focal_px[0]) / view.width, shortest),
    ]


def _surface_checks(camera: CameraFit) -> list[Check]:
    """Whether the ground is no bowl, where its crown was estimated; a dome that is seen upside down is one."""
    if not camera.covariance[CROWN, CROWN]:
        return []
    return [Check.of("crown_m", camera.surface.crown_m, -HOLLOW_M)]


def _residual_checks(
    camera: CameraFit, cues: Cues, circle: Circle, wander_px: float, unit: float, config: VerdictConfig
) -> list[Check]:
    """Residuals of the circle, whose paint may wander by so many pixels, of the halfway line and of the mark."""
    checks = []
    for key, rms in camera.residuals_px.items():
        # coarse observations (clicks, detections) may scatter by what they state themselves
        stated = NOISE_SIGMAS * camera.stated_sigma_px.get(key, 0.0)
        if key.name == circle.name:
            rms = camera.bulk_residuals_px.get(key, rms)
            painted = CIRCLE_SIGMAS * camera.painted_sigma_px.get(key, 0.0)
            limit = max(config.max_circle_residual_px * unit, stated, wander_px, painted)
            checks.append(Check.of("circle_residual_px", rms, limit))
            structured = rms * np.sqrt(1.0 - 1.0 / max(camera.residual_correlation, 1.0))
            limit = max(config.max_structured_residual_px * unit, stated, wander_px, painted)
            checks.append(Check.of("structured_residual_px", structured, limit))
        elif cues.halfway is not None and key.name == cues.halfway.name:
            checks.append(Check.of("line_residual_px", rms, max(config.max_line_residual_px * unit, stated)))
        elif key.edge is not None and cues.halfway is None and not camera.painted_sigma_px:
            # what turns the field in the place of the halfway line, where arcs are painted as the template has them
            limit = max(config.max_circle_residual_px * unit, stated, wander_px)
            checks.append(Check.of("arc_residual_px", camera.bulk_residuals_px.get(key, rms), limit))
    if not _confirmations(cues, camera, circle, unit):
        for key in _keys_of_ends(camera, cues, circle):
            painted = NOISE_SIGMAS * camera.painted_sigma_px.get(key, 0.0)
            limit = max(config.max_line_residual_px * unit, painted)
            checks.append(Check.of("end_residual_px", camera.all_residuals_px[key], limit))
    if cues.mark is not None and MarkingKey(cues.mark.name) not in camera.rejected:
        seen = camera.residuals_px.get(MarkingKey(cues.mark.name), 0.0)
        stated = NOISE_SIGMAS * camera.stated_sigma_px.get(MarkingKey(cues.mark.name), 0.0)
        checks.append(Check.of("mark_distance_px", seen, max(config.max_mark_distance_px * unit, stated)))
    if cues.mark is not None and MarkingKey(cues.mark.name) in camera.rejected and not camera.named_lines:
        checks.append(Check.of("noise_beside_mark", camera.noise_scale, MOST_NOISE_BESIDE_MARK))
        # one camera or the other: circle and line alone cannot tell that a picture was cut out of a larger one
        off_px = float(np.linalg.norm(camera.view.project(np.asarray(circle.center)) - cues.mark.point_px))
        checks.append(Check.of("mark_distance_px", off_px, config.max_mark_distance_px * unit))
    return checks


def _keys_of_ends(camera: CameraFit, cues: Cues, circle: Circle) -> list[MarkingKey]:
    """Markings on which the seen ends of the halfway line must lie: where nothing else says how large the field is, an
    end that does not fit is none.
    """
    own = () if cues.halfway is None or cues.halfway.name is None else (cues.halfway.name,)
    marks = () if cues.mark is None else (cues.mark.name,)
    known = {*own, *marks, circle.name, *camera.named_lines, *(line.name for line in cues.lines)}
    ends = cues.halfway is not None and cues.halfway.ends
    return [key for key in camera.all_residuals_px if key.name not in known] if ends else []


def _edge_checks(
    camera: CameraFit, ellipses: EllipseFits, template: FieldTemplate, circle: Circle, config: VerdictConfig
) -> list[Check]:
    """Inner against outer edge: where both were seen, their gap must be the marking's width as the camera puts it."""
    outer, inner = ellipses.outer, ellipses.inner
    if outer is None or inner is None or template.marking_width_m < MINIMUM_WIDTH_M:
        return []
    center = camera.view.center_of(circle, template)
    offset = camera.view.to_field(outer.points_px[outer.inliers]) - center
    outward = offset / np.linalg.norm(offset, axis=-1, keepdims=True)
    seen = np.abs(sampson_distance(inner.conic, outer.points_px[outer.inliers]))
    rims = [camera.view.project(center + template.radius(circle, edge) * outward) for edge in ("outer", "inner")]
    across = np.abs(sampson_distance(inner.conic, rims[0]) - sampson_distance(inner.conic, rims[1]))
    known = np.isfinite(seen) & np.isfinite(across)
    if not known.any():  # the camera shows the rims nowhere, as one that looks at the field from below
        return []
    gap, predicted = float(np.median(seen[known])), float(np.median(across[known]))
    bloom = BLOOM_PX * camera.camera.width / 1920.0
    return [
        Check.of("widest_edge_gap", gap / (predicted + bloom), config.edge_gap_ratio[1]),
        Check.of("narrowest_edge_gap", gap / predicted, config.edge_gap_ratio[0]),
    ]


def _circle_residual(ellipses: EllipseFits, H: Array, template: FieldTemplate, circle: Circle) -> float:
    fit = ellipses.primary
    conic = transform_conic(H, circle_conic(circle.center, template.radius(circle, fit.edge)))
    return float(np.sqrt(np.mean(sampson_distance(conic, fit.points_px[fit.inliers]) ** 2)))


def _ring(count: int = 72) -> Array:
    angle = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)

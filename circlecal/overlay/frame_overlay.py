"""The overlay: the calibrated field drawn over the frame, with what carried the calibration and the verdict."""

from __future__ import annotations

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.ellipses import ellipse_from_conic
from circlecal.geometry.projective import Array, dehomogenise, lift, normalise_line
from circlecal.observations import MarkingKey
from circlecal.overlay.canvas import Canvas, Picture, filter_legend, text_size, wrap
from circlecal.overlay.palette import ACCEPTED, CIRCLE, GREY, INLIER, POINT, REFUSED, TANGENT, TEMPLATE, WHITE, Color
from circlecal.overlay.quality import SCALE, USUAL_WIDTH, rate_sigma
from circlecal.overlay.template_lines import draw_template
from circlecal.refusals import explain
from circlecal.results import Attempt, Check, CircleCandidate, Correspondences, FrameCalibration, MarkingMask

READABLE_WIDTH = 1280
"""Overlays to look at are at least so wide, pixels: labels of smaller ones cannot be read."""


def draw_readable_overlay(image_bgr: Picture, calibration: FrameCalibration, template: FieldTemplate) -> Picture:
    """The overlay to look at: small pictures are enlarged first, and a strip below explains colours and sigma.

    Parameters
    ----------
    image_bgr, calibration, template : (H, W, 3) uint8, FrameCalibration, FieldTemplate
        As for :func:`draw_overlay`.

    Returns
    -------
    (h, w, 3) uint8
        At least 1280 px wide.
    """
    check_size(image_bgr, calibration)
    zoom = max(1, -(-READABLE_WIDTH // image_bgr.shape[1]))
    canvas = _draw_on(Canvas.of(image_bgr, zoom=zoom), calibration, template)
    camera = calibration.attempt.camera
    facts = [] if camera is None else [f"sigma, the largest predicted error of a marking, at 1920 px width: {SCALE}"]
    if calibration.status == "calibrated" and camera is not None:
        word = rate_sigma(camera.max_sigma_px, calibration.width)
        at_usual = camera.max_sigma_px * USUAL_WIDTH / calibration.width
        facts = [f"sigma {_short(at_usual)} px at 1920 px width is {word}: {SCALE}"]
    return canvas.footer(facts, legend_of(calibration, template))


def draw_overlay(image_bgr: Picture, calibration: FrameCalibration, template: FieldTemplate) -> Picture:
    """Draw the calibration over its frame.

    Parameters
    ----------
    image_bgr : (H, W, 3) uint8
        The frame.
    calibration : FrameCalibration
        Complete or not; of a refused frame whatever was reached is drawn.
    template : FieldTemplate
        The field that it was calibrated with.

    Returns
    -------
    (H, W, 3) uint8
        Template (the circle in yellow, the rest in light blue; dashed and vermilion where the estimate was refused),
        inliers (orange), derived points with labels (vermilion) and their tangents (purple), the imaged centre, and the
        verdict.

    Raises
    ------
    ValueError
        Where the picture has another size than the calibrated frame.
    """
    check_size(image_bgr, calibration)
    return _draw_on(Canvas.of(image_bgr), calibration, template).picture


def _draw_on(canvas: Canvas, calibration: FrameCalibration, template: FieldTemplate) -> Canvas:
    """Draw everything on a canvas with the frame."""
    accepted = calibration.status == "calibrated"
    view = calibration.view
    _draw_banner(canvas, calibration)
    _draw_inliers(canvas, calibration)
    if view is None:
        _draw_what_was_seen(canvas, calibration)
    else:
        draw_template(
            canvas, view, template, calibration.circle_name, TEMPLATE if accepted else REFUSED, dashed=not accepted
        )
    if calibration.attempt.correspondences is not None:
        draw_correspondences(canvas, calibration.attempt.correspondences)
    _draw_center(canvas, calibration, template, view)
    return canvas


def legend_of(calibration: FrameCalibration, template: FieldTemplate) -> list[tuple[str, Color]]:
    """Words and colours of what the overlay of a frame shows; nothing that it does not show."""
    attempt = calibration.attempt
    fits = [] if attempt.ellipses is None else attempt.ellipses.all()
    seen, found = attempt.observations, attempt.correspondences
    stands_in = not fits and attempt.ellipses is not None and seen is not None
    if calibration.view is None:
        field = _legend_without_homography(attempt)
    elif calibration.status == "calibrated":
        field = legend_of_template(calibration.view, template, calibration.circle_name)
    else:
        field = [("estimate that was refused (dashed)", REFUSED)]
    rest = [
        ("points that were used", INLIER, bool(fits) or stands_in),
        ("derived points (labelled)", POINT, found is not None and len(found.points) > 0),
        ("tangents", TANGENT, found is not None and len(found.tangents) > 0),
        ("seen, not used", GREY, stands_in),
    ]
    return field + filter_legend(rest)


def legend_of_template(view: FieldView, template: FieldTemplate, circle: str) -> list[tuple[str, Color]]:
    """Words and colours of the template's markings, where the picture shows a part of them."""
    drawn = {name for name, line in view.markings(template).items() if view.shows(view.project(line)).any()}
    others = "other markings" if circle in drawn else "markings"
    return filter_legend([("circle", CIRCLE, circle in drawn), (others, TEMPLATE, bool(drawn - {circle}))])


def _legend_without_homography(attempt: Attempt) -> list[tuple[str, Color]]:
    """Words and colours of what a frame without a homography shows."""
    mask, ellipses, cues = attempt.mask, attempt.ellipses, attempt.cues
    legend = []
    if ellipses is not None and ellipses.all():
        legend = [("ellipse", CIRCLE)]
    elif mask is not None and (mask.conic is not None or any(arc.gapless for arc in mask.arcs) or mask.candidates):
        legend = [("what looks most like the circle", CIRCLE)]
    if (cues is not None and cues.halfway is not None) or (mask is not None and mask.halfway is not None):
        legend.append(("halfway line", TEMPLATE))
    return legend


def check_size(image: Picture, calibration: FrameCalibration) -> None:
    """Raise ``ValueError`` where a picture is not of the calibrated frame's size, or not BGR."""
    expected = (calibration.height, calibration.width, 3)
    if image.shape != expected or image.dtype != np.uint8:
        raise ValueError(
            f"{calibration.id}: expected a uint8 picture of shape {expected}, not {image.dtype} of {image.shape}"
        )


MOST_POINTS = 3
"""Contradicting points that are named."""


def verdict_facts(calibration: FrameCalibration) -> list[str]:
    """What the verdict rests on, in a few words each."""
    attempt = calibration.attempt
    facts = [] if attempt.correspondences is None else [f"case {attempt.correspondences.case}"]
    if attempt.ellipses is not None and attempt.ellipses.all():
        fit = attempt.ellipses.primary
        facts.append(f"ellipse {fit.rms_px:.2f} px rms over {fit.arc_deg:.0f} deg")
    if attempt.camera is not None:
        fit_camera = attempt.camera
        if attempt.ellipses is not None and not attempt.ellipses.all():
            facts.append(f"without the circle, from {len(fit_camera.residuals_px)} lines, arcs and points")
        if fit_camera.left_out:
            facts.append(f"left out {', '.join(map(str, fit_camera.left_out))}")
        for key, number, off in fit_camera.contradicting_points[:MOST_POINTS]:
            facts.append(f"{key}: point {number} lies {off:.0f} px off")
        if fit_camera.field_size is not None and not fit_camera.field_size.is_usual:
            facts.append(f"field: {fit_camera.field_size}")
        word = rate_sigma(fit_camera.max_sigma_px, calibration.width)
        facts.append(f"sigma {_short(fit_camera.max_sigma_px)} px ({word}), {_short(fit_camera.max_sigma_m)} m")
    elif attempt.homography is not None and attempt.homography.residuals_px.size:
        facts.append(f"DLT residual {_short(float(np.max(np.abs(attempt.homography.residuals_px))))} px")
    return facts


def verdict_reasons(calibration: FrameCalibration) -> list[str]:
    """Why a frame is refused and what helps; nothing for a calibrated one."""
    verdict = calibration.verdict
    if verdict.status == "calibrated":
        return []
    reason = verdict.reason or verdict.code or "no reason was given"
    return [reason, *([] if verdict.code is None else [f"What helps: {explain(verdict.code, verdict.stage).help}"])]


def draw_correspondences(canvas: Canvas, found: Correspondences) -> None:
    """Draw derived points with labels, and each tangent around its point."""
    center = dehomogenise(found.imaged_center)
    reach = 0.35 * max((float(np.linalg.norm(p.image_px - center)) for p in found.points), default=0.0)
    by_label = {p.label: p for p in found.points}
    for tangent in found.tangents:
        if tangent.label in by_label:
            canvas.polyline(_piece(tangent.image_line, by_label[tangent.label].image_px, reach), TANGENT, 1.4)
    for point in found.points:
        canvas.disc(point.image_px, POINT, 8.0)
    for point in found.points:
        canvas.label(point.label.replace("_", " "), point.image_px, WHITE, toward=point.image_px - center, size=0.75)


def _piece(line: Array, point: Array, reach: float) -> Array:
    """Ends (2, 2) of the piece of a line within ``reach`` of a point."""
    a, b, _ = normalise_line(line)
    foot = point - float(lift(point) @ normalise_line(line)) * np.array([a, b])
    return np.stack([foot - reach * np.array([b, -a]), foot + reach * np.array([b, -a])])


def _draw_inliers(canvas: Canvas, calibration: FrameCalibration) -> None:
    ellipses = calibration.attempt.ellipses
    if ellipses is not None:
        for fit in ellipses.all():
            canvas.points(fit.points_px[fit.inliers], INLIER, 2.2)
        if not ellipses.all():
            _draw_landmarks(canvas, calibration)


def _draw_landmarks(canvas: Canvas, calibration: FrameCalibration) -> None:
    """Lines, arcs and points that stood for the circle, those left out in grey."""
    seen, camera = calibration.attempt.observations, calibration.attempt.camera
    left_out = set(() if camera is None else camera.left_out)
    if seen is None:
        return
    drawn: list[tuple[MarkingKey | None, Array]] = [(c.key, c.points_px) for c in seen.circles]
    names = {} if camera is None else camera.names_by_line
    named = {k: MarkingKey(name) for k, name in names.items()}
    drawn += [(line.key or named.get(k), line.points_px) for k, line in enumerate(seen.lines)]
    drawn += [(mark.key, mark.point_px[None]) for mark in seen.marks]
    drawn += [(point.key, point.point_px[None]) for point in seen.keypoints]
    for key, pixels in drawn:
        canvas.points(pixels, GREY if key is None or key in left_out else INLIER, 4.0)


def _draw_what_was_seen(canvas: Canvas, calibration: FrameCalibration) -> None:
    """Of a frame without a homography: the ellipse or its candidates, and the halfway line."""
    attempt = calibration.attempt
    mask, ellipses, cues = attempt.mask, attempt.ellipses, attempt.cues
    if ellipses is not None and ellipses.all():
        canvas.conic(ellipses.primary.conic, CIRCLE, 1.6)
    elif mask is not None:
        if mask.conic is not None:
            canvas.conic(mask.conic, CIRCLE, 1.6, dashed=True)
        elif any(arc.gapless for arc in mask.arcs):
            draw_arcs(canvas, mask)
        elif mask.candidates:
            canvas.conic(mask.candidates[0].conic, CIRCLE, 1.6, dashed=True)
            draw_candidate_label(canvas, mask.candidates[0])
    if cues is not None and cues.halfway is not None:
        canvas.line(cues.halfway.line, TEMPLATE, 1.6)
    elif mask is not None and mask.halfway is not None:
        canvas.polyline(np.stack([mask.halfway.start, mask.halfway.end]), TEMPLATE, 1.6)


def draw_arcs(canvas: Canvas, mask: MarkingMask) -> None:
    """Draw the parts of circles that were seen without a line through their middle."""
    for arc in (arc for arc in mask.arcs if arc.gapless):
        canvas.points(arc.points_px, CIRCLE, 3.0)
        canvas.label("part of a circle", arc.points_px[np.argmin(arc.points_px[:, 1])], CIRCLE, size=0.8)


def draw_candidate_label(canvas: Canvas, candidate: CircleCandidate) -> None:
    """Name the best ellipse that was not taken for the circle, with the gate that it did not pass."""
    ellipse = ellipse_from_conic(candidate.conic) if np.isfinite(candidate.conic).all() else None
    if ellipse is None:
        return
    failed = [
        f"{name_of(check)} {check.value:.2g}, limit {check.limit:.2g}" for check in candidate.checks if not check.passed
    ]
    text = f"best candidate, not taken: {'; '.join(failed)}" if failed else "best candidate, not taken"
    points = ellipse.points(np.linspace(0.0, 2.0 * np.pi, 72))
    seen = points[((points >= 0) & (points < [canvas.width / canvas.zoom, canvas.height / canvas.zoom])).all(axis=1)]
    if len(seen):
        canvas.label(text, seen[np.argmin(seen[:, 1])], WHITE, size=0.8)


def name_of(check: Check) -> str:
    """A check's name in words."""
    return check.name.replace("_", " ")


def _draw_center(
    canvas: Canvas, calibration: FrameCalibration, template: FieldTemplate, view: FieldView | None
) -> None:
    circle = template.circle_by_name.get(calibration.circle_name)
    if view is not None and circle is not None:
        center = view.project(view.center_of(circle, template))
    elif calibration.attempt.correspondences is not None:
        center = dehomogenise(calibration.attempt.correspondences.imaged_center)
    else:
        return
    canvas.cross(center, CIRCLE)
    canvas.label("imaged centre", center, CIRCLE, size=0.75)


def _draw_banner(canvas: Canvas, calibration: FrameCalibration) -> None:
    accepted = calibration.status == "calibrated"
    size = canvas.text_px
    status = "CALIBRATED" if accepted else "REFUSED"
    head = round(text_size(status, size)[0] + 1.6 * size)
    limit = max(canvas.width - head - 2.5 * size, 8 * size)
    reason = [line for text in verdict_reasons(calibration) for line in wrap(text, 0.8 * size, limit)]
    facts = wrap(" | ".join(verdict_facts(calibration)), 0.8 * size, limit)
    lines = [line for line in reason + facts if line]
    widest = max((text_size(line, 0.8 * size)[0] for line in lines), default=0)
    bottom = (1.0 + 1.7 * max(len(lines), 1)) * size
    canvas.shade(0, 0, head, bottom, ACCEPTED if accepted else REFUSED, 1.0)
    canvas.text(status, 0.8 * size, 0.85 * size, WHITE, size, halo=False)
    if lines:
        canvas.shade(head, 0, head + widest + 1.6 * size, bottom, share=0.72)
    for number, line in enumerate(lines):
        canvas.text(line, head + 0.8 * size, (0.95 + 1.7 * number) * size, WHITE, 0.8 * size, halo=False)


def _short(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "unbounded"

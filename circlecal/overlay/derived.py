"""Pictures of the stages that derive: correspondences, homography, camera and verdict."""

from __future__ import annotations

import cv2
import numpy as np

from circlecal.checks import words_of_limit
from circlecal.field import FieldTemplate
from circlecal.field.view import FieldView
from circlecal.geometry.camera import PlaneCamera
from circlecal.geometry.projective import Array, dehomogenise, normalise_line
from circlecal.overlay.canvas import Canvas, Picture, filter_legend, text_size
from circlecal.overlay.frame_overlay import (
    draw_correspondences,
    legend_of_template,
    name_of,
    verdict_facts,
    verdict_reasons,
)
from circlecal.overlay.palette import (
    ACCEPTED,
    CIRCLE,
    GREEN,
    GREY,
    INLIER,
    POINT,
    REFUSED,
    SKY,
    TANGENT,
    WHITE,
)
from circlecal.overlay.template_lines import count_sigma_from_seen, draw_template, sigma_over_picture
from circlecal.results import CameraFit, Check, Correspondences, FrameCalibration, HomographyFit

_DIM = 0.55


def correspondences_picture(image: Picture, found: Correspondences, zoom: int) -> Picture:
    """Derived points and tangents, the imaged centre, and the vanishing line where it is in view."""
    canvas = Canvas.of(image, _DIM, zoom)
    canvas.conic(found.conic, CIRCLE, 1.4)
    canvas.line(found.vanishing_line, GREEN, 2.0, dashed=True)
    canvas.segments(*_full_tangents(found), TANGENT, 1.0)
    draw_correspondences(canvas, found)
    center = dehomogenise(found.imaged_center)
    canvas.cross(center, CIRCLE, 30.0)
    canvas.label(f"imaged centre ({found.center_source.replace('_', ' ')})", center, CIRCLE, size=0.75)
    facts = [
        f"case {found.case}; imaged centre ({center[0]:.2f}, {center[1]:.2f}) from "
        f"{found.center_source.replace('_', ' ')}; {len(found.points)} points, {len(found.tangents)} tangents; "
        f"circle of {found.radius_m:.3f} m"
    ]
    corners = np.array([[0, 0, 1], [image.shape[1], 0, 1], [0, image.shape[0], 1], [image.shape[1], image.shape[0], 1]])
    sides = np.sign(corners @ found.vanishing_line)
    legend = [
        ("ellipse, centre", CIRCLE, True),
        ("points", POINT, len(found.points) > 0),
        ("tangents", TANGENT, len(found.tangents) > 0),
        ("vanishing line (dashed)", GREEN, bool(sides.min() < sides.max())),
    ]
    return canvas.header("6 correspondences", facts, filter_legend(legend))


def homography_picture(
    image: Picture, fit: HomographyFit, found: Correspondences | None, template: FieldTemplate, circle: str, zoom: int
) -> Picture:
    """Template through the homography, and the points and lines that it was computed from."""
    canvas = Canvas.of(image, _DIM, zoom)
    view = FieldView(PlaneCamera(image.shape[1], image.shape[0], fit.H_image_field))
    draw_template(canvas, view, template, circle)
    points = () if found is None else found.all_points
    for line in found.seen_lines if found is not None else ():
        canvas.line(line.image_line, INLIER, 1.0)
    for point in points:
        canvas.disc(point.image_px, POINT, 7.0)
    if points:
        canvas.points(view.project(np.stack([p.field_m for p in points])), WHITE, 3.0)
    worst = float(np.max(np.abs(fit.residuals_px))) if fit.residuals_px.size else float("nan")
    facts = [
        f"DLT on {len(fit.residuals_px)} points and {fit.lines} lines: largest residual {worst:.3g} px, "
        f"condition {fit.condition:.3g}, null ratio {fit.null_ratio:.2g}"
    ]
    legend = [
        ("derived and known points", POINT, bool(points)),
        ("these through H (white)", WHITE, bool(points)),
        ("named lines as seen", INLIER, found is not None and bool(found.seen_lines)),
    ]
    return canvas.header("7 homography", facts, legend_of_template(view, template, circle) + filter_legend(legend))


def camera_picture(
    image: Picture, fit: CameraFit, calibration: FrameCalibration, template: FieldTemplate, zoom: int
) -> Picture:
    """Template through the camera, over a heat map of the predicted standard deviation, with what was observed."""
    canvas = Canvas.of(image, _DIM, zoom)
    sigma = sigma_over_picture(count_sigma_from_seen(fit.view, fit.reference_by_growth), template)
    low_high = None if sigma is None else _draw_heat(canvas, sigma)
    seen = calibration.attempt.observations
    for circle in seen.circles if seen is not None else ():
        canvas.points(circle.points_px, INLIER, 2.2)
    unnamed = [] if seen is None else [k for k, line in enumerate(seen.lines) if line.line is None]
    unnamed = [k for k in unnamed if k not in fit.names_by_line]
    for k, line in enumerate(seen.lines) if seen is not None else ():
        canvas.points(line.points_px, GREY if k in unnamed else INLIER, 2.2)
    draw_template(canvas, fit.view, template, calibration.circle_name)
    for mark in seen.marks if seen is not None else ():
        canvas.cross(mark.point_px, INLIER, 26.0)
    if low_high is not None:
        _draw_scale(canvas, *low_high)
    rest = [("observations", INLIER, seen is not None), ("lines seen without a name", GREY, bool(unnamed))]
    legend = legend_of_template(fit.view, template, calibration.circle_name) + filter_legend(rest)
    return canvas.header("8 camera", _camera_facts(fit), legend)


def verdict_picture(image: Picture, calibration: FrameCalibration, template: FieldTemplate, zoom: int) -> Picture:
    """The checks with their values and limits, over the dimmed frame."""
    accepted = calibration.status == "calibrated"
    canvas = Canvas.of(image, 0.35, zoom)
    view = calibration.view
    if view is not None:
        draw_template(canvas, view, template, calibration.circle_name, dashed=not accepted)
    _draw_checks(canvas, calibration.verdict.checks)
    title = "9 verdict: " + ("CALIBRATED" if accepted else f"REFUSED ({calibration.verdict.code or 'no code'})")
    facts = verdict_reasons(calibration) + [text for text in ["; ".join(verdict_facts(calibration))] if text]
    timings = ", ".join(f"{stage} {value:.0f}" for stage, value in calibration.timings_ms.items())
    facts.append(f"timings in ms: {timings or 'none'}; seed {calibration.seed}")
    picture = canvas.header(title, facts)
    cv2.rectangle(
        picture, (0, 0), (max(4, round(0.4 * canvas.text_px)), picture.shape[0]), ACCEPTED if accepted else REFUSED, -1
    )
    return picture


def _full_tangents(found: Correspondences) -> tuple[Array, Array]:
    """Ends of the tangents, three times as long as the points are far from their middle."""
    if not found.tangents or not found.points:
        return np.zeros((0, 2)), np.zeros((0, 2))
    lines = normalise_line(np.stack([t.image_line for t in found.tangents]))
    points = np.stack([p.image_px for p in found.points])
    middle = points.mean(axis=0)
    reach = 1.5 * float(np.linalg.norm(points - middle, axis=1).max())
    foot = middle - (lines[:, :2] @ middle + lines[:, 2])[:, None] * lines[:, :2]
    along = reach * np.column_stack([lines[:, 1], -lines[:, 0]])
    return foot - along, foot + along


def _draw_heat(canvas: Canvas, sigma: Array) -> tuple[float, float] | None:
    known = np.isfinite(sigma)
    if not known.any():
        return None
    low, high = (float(v) for v in np.percentile(sigma[known], [2, 98]))
    span = max(high - low, 1e-9)
    level = np.round(255 * np.clip((np.where(known, sigma, low) - low) / span, 0.0, 1.0)).astype(np.uint8)
    size = (canvas.width, canvas.height)
    heat = cv2.applyColorMap(cv2.resize(level, size, interpolation=cv2.INTER_LINEAR), cv2.COLORMAP_VIRIDIS)
    share = 0.55 * cv2.resize(known.astype(np.float32), size, interpolation=cv2.INTER_LINEAR)[..., None]
    canvas.picture[:] = np.round((1.0 - share) * canvas.picture + share * heat).astype(np.uint8)
    return low, high


def _draw_scale(canvas: Canvas, low: float, high: float) -> None:
    """Colour bar of the heat map, in the corner below on the left."""
    size = 0.8 * canvas.text_px
    caption = "predicted sigma (px)"
    width, height = max(round(14 * size), text_size(caption, size)[0]), round(size)
    left, top = round(size), round(canvas.height - 4.6 * size)
    if width + 2 * left > canvas.width or top < 0:
        return
    canvas.shade(left - 0.5 * size, top - 2.0 * size, left + width + 0.5 * size, top + 3.6 * size, share=0.75)
    ramp = cv2.applyColorMap(np.tile(np.linspace(0, 255, width).astype(np.uint8), (height, 1)), cv2.COLORMAP_VIRIDIS)
    canvas.picture[top : top + height, left : left + width] = ramp[:, : canvas.width - left]
    canvas.text(caption, left, top - 1.5 * size, WHITE, size, halo=False)
    canvas.text(f"{low:.2g}", left, top + 1.5 * size, WHITE, size, halo=False)
    most = f"{high:.2g}"
    canvas.text(most, left + width - text_size(most, size)[0], top + 1.5 * size, WHITE, size, halo=False)


def _camera_facts(fit: CameraFit) -> list[str]:
    camera = fit.camera
    pan, tilt, roll = np.degrees(camera.angles_rad)
    x, y, z = camera.position_m
    facts = [
        f"focal length {camera.focal_px[0]:.0f} px; pan {pan:z.2f}, tilt {tilt:z.2f}, roll {roll:z.2f} deg; "
        f"position ({x:z.1f}, {y:z.1f}, {z:.1f}) m; kappa {camera.kappa[0]:+z.4f}; "
        f"crown {100 * fit.surface.crown_m:z.1f} cm ({fit.surface.shape})",
        f"largest sigma {fit.max_sigma_px:.3g} px, {fit.max_sigma_m:.3g} m; noise scale {fit.noise_scale:.2f}; "
        f"data share {100 * fit.data_share:.0f} %",
    ]
    if fit.residuals_px:
        facts.append("rms residuals: " + ", ".join(f"{name} {rms:.2f} px" for name, rms in fit.residuals_px.items()))
    named = [f"recognised {', '.join(fit.named_lines)}"] if fit.named_lines else []
    named += [f"left out {', '.join(map(str, fit.left_out))}"] if fit.left_out else []
    return [*facts, "; ".join(named)] if named else facts


def _draw_checks(canvas: Canvas, checks: tuple[Check, ...]) -> None:
    rows = [("check", "value", "limit", "", WHITE)]
    rows += [
        (
            name_of(c),
            f"{c.value:.4g}",
            words_of_limit(c.name, f"{c.limit:.4g}"),
            "pass" if c.passed else "FAIL",
            SKY if c.passed else REFUSED,
        )
        for c in checks
    ]
    if not checks:
        rows = [("no check was reached", "", "", "", WHITE)]
    size = min(canvas.text_px, canvas.height / (1.8 * (len(rows) + 2)), canvas.width / 40.0)
    stops = np.array([1.0, 18.0, 25.0, 36.0]) * size
    canvas.shade(0, 0, stops[-1] + 5 * size, (1.8 * len(rows) + 1.2) * size, share=0.75)
    for number, (*cells, color) in enumerate(rows):
        top = (0.9 + 1.8 * number) * size
        for cell, stop in zip(cells, stops, strict=True):
            canvas.text(cell, stop, top, color if cell in {"pass", "FAIL"} else WHITE, size, halo=False)

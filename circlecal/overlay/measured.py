"""Pictures of the stages that measure: mask, edges, rays, ellipse and cues."""

from __future__ import annotations

import cv2
import numpy as np

from circlecal.geometry.ellipses import orthogonal_distance
from circlecal.geometry.projective import Array
from circlecal.overlay.canvas import Canvas, Picture, filter_legend
from circlecal.overlay.frame_overlay import draw_arcs, draw_candidate_label
from circlecal.overlay.palette import (
    CLASS_COLORS,
    EDGE_COLORS,
    GREY,
    ORANGE,
    PURPLE,
    SKY,
    VERMILION,
    WHITE,
    YELLOW,
    Color,
)
from circlecal.results import Cues, EdgePoints, EllipseFit, EllipseFits, LineCue, MarkCue, MarkingMask, RayPoints

_DIM = 0.5
_CANDIDATES = 5
"""So many of the ellipses that may be the circle are drawn."""
_BINS = 72
_LEVELS = 12


def mask_picture(image: Picture, mask: MarkingMask, zoom: int) -> Picture:
    """Marking mask over the dimmed frame, with the field region, the rough circle and line, and the candidates."""
    canvas = Canvas.of(_shade_outside_field(image, mask), 0.7, zoom)
    classes = mask.classes
    _paint_classes(canvas, classes)
    others = [c for c in mask.candidates[:_CANDIDATES] if mask.conic is None or not np.array_equal(c.conic, mask.conic)]
    for candidate in others:
        canvas.conic(candidate.conic, WHITE, 1.2, dashed=True)
    if mask.conic is not None:
        canvas.conic(mask.conic, VERMILION, 1.0)
    else:
        draw_arcs(canvas, mask)
        if others:
            canvas.conic(others[0].conic, WHITE, 2.4, dashed=True)
            draw_candidate_label(canvas, others[0])
    for segment in ((mask.halfway,) if mask.halfway is not None else ()) + mask.lines:
        color = SKY if segment is mask.halfway else PURPLE
        canvas.polyline(np.stack([segment.start, segment.end]), color, 1.0)
        canvas.label(f"{100 * segment.support:.0f} % seen", 0.5 * (segment.start + segment.end), color, size=0.7)
    counts = [int(np.count_nonzero(classes == k)) for k in CLASS_COLORS]
    other = int(np.count_nonzero(classes)) - sum(counts)
    facts = [
        f"from the {mask.source}; marked pixels: circle {counts[0]}, halfway line {counts[1]}, "
        f"other lines {counts[2]}, other {other}"
    ]
    if mask.field_region is not None:
        facts[0] += f"; field region {100 * float(np.mean(mask.field_region)):.0f} % of the frame"
    has_lines = any(segment is not mask.halfway for segment in mask.lines)
    legend = [
        ("circle", YELLOW, counts[0] > 0 or (mask.conic is None and any(arc.gapless for arc in mask.arcs))),
        ("halfway line", SKY, counts[1] > 0 or mask.halfway is not None),
        ("other lines", PURPLE, counts[2] > 0 or has_lines),
        ("other classes", ORANGE, other > 0),
        ("rough circle", VERMILION, mask.conic is not None),
        ("candidates (dashed)", WHITE, bool(others)),
    ]
    if others:
        scores = ", ".join(f"{candidate.score:.2f}" for candidate in others)
        facts.append(f"candidates that were not taken for the circle, by score: {scores}")
    return canvas.header("1 mask", facts, filter_legend(legend))


def edges_picture(image: Picture, edges: EdgePoints, zoom: int) -> Picture:
    """Sub-pixel edge points coloured by their standard deviation."""
    canvas = Canvas.of(image, _DIM, zoom)
    facts = [
        f"{len(edges.points_px)} points; Canny thresholds {edges.thresholds[0]:.0f} and {edges.thresholds[1]:.0f}; "
        f"noise {edges.noise:.1f} grey levels; blur {edges.blur_px:.2f} px"
    ]
    legend: list[tuple[str, Color]] = []
    known = np.isfinite(edges.sigma_px)
    if known.any():
        low, high = (float(v) for v in np.percentile(edges.sigma_px[known], [2, 98]))
        share = np.clip((np.where(known, edges.sigma_px, high) - low) / max(high - low, 1e-9), 0.0, 1.0)
        level = np.round(share * (_LEVELS - 1)).astype(int)
        for step in range(_LEVELS):
            canvas.points(edges.points_px[level == step], _viridis(step / (_LEVELS - 1)), 2.6)
        facts.append(f"contrast {float(np.median(edges.contrast)):.0f} grey levels (median)")
        legend = [(f"sigma {low + part * (high - low):.3g} px", _viridis(part)) for part in (0.0, 0.5, 1.0)]
    return canvas.header("2 edges", facts, legend)


def rays_picture(image: Picture, rays: RayPoints, zoom: int) -> Picture:
    """What the rays met: both edges, band centres, and what was rejected."""
    canvas = Canvas.of(image, _DIM, zoom)
    canvas.points(rays.rejected_px, GREY, 3.0)
    canvas.points(rays.center_line_px, YELLOW, 2.6)
    canvas.points(rays.inner_px, EDGE_COLORS["inner"], 2.6)
    canvas.points(rays.outer_px, EDGE_COLORS["outer"], 2.6)
    canvas.cross(rays.center_px, WHITE, 30.0)
    canvas.label("centre of the rays", rays.center_px, WHITE, size=0.75)
    x, y = rays.center_px
    facts = [
        f"{rays.rays} rays from ({x:.1f}, {y:.1f}); {len(rays.outer_px)} crossed two edges, "
        f"{len(rays.center_line_px)} band centres, {rays.rejected} rejected"
    ]
    if len(rays.center_line_px):
        facts.append(f"median sigma of the band centres {float(np.median(rays.center_line_sigma_px)):.2f} px")
    legend = [
        ("inner edge", EDGE_COLORS["inner"]),
        ("outer edge", EDGE_COLORS["outer"]),
        ("centreline", YELLOW),
        ("rejected", GREY),
    ]
    return canvas.header("3 rays", facts, legend)


def ellipse_picture(image: Picture, fits: EllipseFits, zoom: int) -> Picture:
    """Fitted ellipses, their inliers and outliers, the arcs that have inliers, and the residuals along them."""
    canvas = Canvas.of(image, _DIM, zoom)
    facts = []
    for fit in fits.all():
        canvas.points(fit.points_px[~fit.inliers], GREY, 3.4)
        canvas.conic(fit.conic, EDGE_COLORS[fit.edge], 1.0)
        _draw_covered_arc(canvas, fit)
        a, b = fit.ellipse.semi_axes
        facts.append(
            f"{fit.edge}: {int(fit.inliers.sum())} of {len(fit.inliers)} points, rms {fit.rms_px:.2f} px, "
            f"arc {fit.arc_deg:.0f} deg, semi-axes {a:.1f} x {b:.1f} px, {fit.method}, {fit.hypotheses} hypotheses"
        )
    _draw_residuals(canvas, fits)
    legend = [
        (f"{'centreline' if f.edge == 'center' else f.edge + ' edge'} (thick: inliers)", EDGE_COLORS[f.edge])
        for f in fits.all()
    ]
    has_outliers = not all(fit.inliers.all() for fit in fits.all())
    return canvas.header("4 ellipse", facts, legend + filter_legend([("outliers", GREY, has_outliers)]))


def cues_picture(image: Picture, cues: Cues, zoom: int) -> Picture:
    """Halfway line, centre mark with an enlarged detail, and further straight lines."""
    canvas = Canvas.of(image, _DIM, zoom)
    for line in cues.lines:
        _draw_line_cue(canvas, line, PURPLE)
    if cues.halfway is not None:
        _draw_line_cue(canvas, cues.halfway, SKY)
    facts = _line_facts(cues)
    if cues.mark is not None:
        mark = cues.mark
        canvas.cross(mark.point_px, YELLOW, 30.0)
        canvas.circle(mark.point_px, mark.sigma_px, VERMILION, 1.0)
        canvas.label(f"{mark.name.replace('_', ' ')}, sigma {mark.sigma_px:.2f} px", mark.point_px, YELLOW, size=0.75)
        x, y = mark.point_px
        facts.append(f"{mark.name}: ({x:.2f}, {y:.2f}), sigma {mark.sigma_px:.2f} px, signal to noise {mark.snr:.1f}")
        _draw_detail(canvas, image, mark, cues)
    if not facts:
        facts = ["nothing was found that fixes the rotation or the imaged centre"]
    has_mark = cues.mark is not None
    legend = [
        ("halfway line", SKY, cues.halfway is not None),
        ("further lines", PURPLE, len(cues.lines) > 0),
        ("centre mark", YELLOW, has_mark),
        ("its sigma", VERMILION, has_mark),
    ]
    return canvas.header("5 cues", facts, filter_legend(legend))


def _shade_outside_field(image: Picture, mask: MarkingMask) -> Picture:
    if mask.field_region is None:
        return image
    size = image.shape[1], image.shape[0]
    region = np.asarray(cv2.resize(mask.field_region.view(np.uint8), size, interpolation=cv2.INTER_NEAREST), np.uint8)
    shaded = np.where(region[..., None] > 0, image, (0.45 * image).astype(np.uint8))
    outline, _ = cv2.findContours(region, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    picture = np.ascontiguousarray(shaded, dtype=np.uint8)
    cv2.drawContours(picture, outline, -1, WHITE, max(1, image.shape[1] // 960), cv2.LINE_AA)
    return picture


def _paint_classes(canvas: Canvas, ids: Picture) -> None:
    table = np.zeros((256, 3), dtype=np.uint8)
    table[1:] = ORANGE
    for identity, color in CLASS_COLORS.items():
        table[identity] = color
    classes = cv2.resize(ids, (canvas.width, canvas.height), interpolation=cv2.INTER_NEAREST)
    marked = classes > 0
    canvas.picture[marked] = (0.4 * canvas.picture[marked] + 0.6 * table[classes[marked]]).astype(np.uint8)


def _viridis(share: float) -> Color:
    # the dark end of the map would drown in the frame
    level = np.array([[round(255 * (0.25 + 0.75 * share))]], dtype=np.uint8)
    blue, green, red = cv2.applyColorMap(level, cv2.COLORMAP_VIRIDIS)[0, 0]
    return int(blue), int(green), int(red)


def _draw_covered_arc(canvas: Canvas, fit: EllipseFit) -> None:
    """Thick where the ellipse has inliers, in pieces of five degrees."""
    if not fit.inliers.any():
        return
    parameter = fit.ellipse.parameter(fit.points_px[fit.inliers])
    pieces = np.unique(np.floor(parameter / (2 * np.pi) * _BINS).astype(int) % _BINS)
    t = (pieces[:, None] + np.linspace(0.0, 1.0, 6)) * 2 * np.pi / _BINS
    points = fit.ellipse.points(t)
    canvas.segments(points[:, :-1].reshape(-1, 2), points[:, 1:].reshape(-1, 2), EDGE_COLORS[fit.edge], 2.6)


def _draw_residuals(canvas: Canvas, fits: EllipseFits) -> None:
    """Inset plot: signed distance from the ellipse over the angle along it, inliers only."""
    angles, distances = {}, {}
    for fit in fits.all():
        if fit.inliers.any():
            points = fit.points_px[fit.inliers]
            angles[fit.edge] = np.degrees(fit.ellipse.parameter(points))
            distances[fit.edge] = orthogonal_distance(fit.ellipse, points)
    if not angles:
        return
    limit = max(0.5, float(np.percentile(np.abs(np.concatenate(list(distances.values()))), 99.5)))
    size = 0.75 * canvas.text_px
    left, right = 0.62 * canvas.width, canvas.width - size
    top, bottom = canvas.height - 0.30 * canvas.height, canvas.height - size
    canvas.shade(left, top, right, bottom, share=0.8)
    x0, x1, y0, y1 = left + 6 * size, right - size, top + 2.6 * size, bottom - 2.4 * size
    canvas.text(
        "residual (px) along the ellipse (deg), outside positive",
        left + size,
        top + 0.6 * size,
        WHITE,
        size,
        halo=False,
    )
    plot = Canvas(canvas.picture)  # in drawn pixels
    for share, tick in ((0.0, limit), (0.5, 0.0), (1.0, -limit)):
        y = y0 + share * (y1 - y0)
        plot.polyline([[x0, y], [x1, y]], GREY, 1.0)
        plot.text(f"{tick:+.2f}" if tick else "0", left + size, y - 0.5 * size, WHITE, size, halo=False)
    for tick in (-180, -90, 0, 90, 180):
        x = x0 + (tick + 180) / 360 * (x1 - x0)
        plot.polyline([[x, y1], [x, y1 + 0.4 * size]], GREY, 1.0)
        plot.text(str(tick), x - 1.2 * size, y1 + 0.8 * size, WHITE, size, halo=False)
    for edge, distance in distances.items():
        along = x0 + (angles[edge] + 180.0) / 360.0 * (x1 - x0)
        across = 0.5 * (y0 + y1) - np.clip(distance / limit, -1.0, 1.0) * 0.5 * (y1 - y0)
        plot.points(np.column_stack([along, across]), EDGE_COLORS[edge], 2.4)


def _draw_line_cue(canvas: Canvas, cue: LineCue, color: Color) -> None:
    canvas.line(cue.line, color, 1.0, dashed=True)
    canvas.points(cue.points_px, color, 4.0)
    canvas.disc(cue.segment.start, color, 6.0)
    canvas.disc(cue.segment.end, color, 6.0)
    canvas.label(
        (cue.name or "unnamed").replace("_", " "), 0.5 * (cue.segment.start + cue.segment.end), color, size=0.75
    )


def _line_facts(cues: Cues) -> list[str]:
    """One line each for lines with a name, one together for those without."""
    named = [line for line in (cues.halfway, *cues.lines) if line is not None and line.name is not None]
    unnamed = [line for line in cues.lines if line.name is None]
    facts = [
        f"{line.name}: {len(line.points_px)} points, rms {line.rms_px:.2f} px, {100 * line.segment.support:.0f} % seen"
        for line in named
    ]
    if unnamed:
        worst = max(line.rms_px for line in unnamed)
        count = sum(len(line.points_px) for line in unnamed)
        facts.append(f"lines without a name: {len(unnamed)}, {count} points, largest rms {worst:.2f} px")
    return facts


def _draw_detail(canvas: Canvas, image: Picture, mark: MarkCue, cues: Cues) -> None:
    """Enlarged detail around the centre mark, in the corner below on the right."""
    half = max(8, round(image.shape[1] / 64))
    around = np.round(mark.point_px).astype(int) - half
    side = 2 * half + 1
    if not np.isfinite(mark.point_px).all() or (around < 0).any() or (around + side > image.shape[1::-1]).any():
        return
    zoom = max(1, round(0.32 * canvas.height / side))
    patch = image[around[1] : around[1] + side, around[0] : around[0] + side]
    detail = Canvas.of(patch, 1.0, zoom)
    local = _move(mark.point_px, around)
    if cues.halfway is not None:
        a, b, c = cues.halfway.line
        detail.line((a, b, c + a * around[0] + b * around[1]), SKY, 1.0)
    detail.cross(local, YELLOW, 0.25 * detail.width / max(detail.unit, 1e-9), 1.0)
    detail.circle(local, mark.sigma_px, VERMILION, 1.0)
    gap = round(canvas.text_px)
    bottom, right = canvas.height - gap, canvas.width - gap
    if detail.height > bottom or detail.width > right:
        return
    canvas.picture[bottom - detail.height : bottom, right - detail.width : right] = detail.picture
    cv2.rectangle(
        canvas.picture,
        (right - detail.width - 1, bottom - detail.height - 1),
        (right, bottom),
        WHITE,
        canvas.thickness(1.5),
    )


def _move(point: Array, origin: Array) -> Array:
    return np.asarray(point, dtype=np.float64) - origin

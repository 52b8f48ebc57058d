"""The layers of a frame's large view, from its record alone: field template, points and plan as SVG."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from circlecal.errors import CirclecalError
from circlecal.field import FieldTemplate, load_field
from circlecal.field.view import FieldView
from circlecal.geometry.projective import Array
from circlecal.overlay.canvas import Canvas
from circlecal.overlay.palette import CIRCLE, INLIER, POINT, PURPLE, REFUSED, TEMPLATE, Color
from circlecal.overlay.radar import radar_half
from circlecal.overlay.template_lines import pixels_near_picture
from circlecal.records.parts import Pair
from circlecal.records.record import ResultRecord

_TOLERANCE = 0.35
"""How far a drawn line may leave the exact curve, pixels at 1920 px width."""
_MOST_POINTS = 600
_PLAN_UNITS_PER_M = 10.0
_FOOTPRINT_PX_PER_M = 2.0
_LARGEST_ASPECT = 5.0
"""Of pixels, as of the option ``camera.aspect``; a record that says more is damaged."""


@dataclass(frozen=True, slots=True)
class Scene:
    """What the record of one frame lets draw.

    Attributes
    ----------
    width, height : int
        Size of the frame, pixels.
    accepted : bool
        Whether the verdict believed the estimate.
    template : FieldTemplate or None
        None where the record's template is not known here.
    view : FieldView or None
        Field to pixels, through the estimate, also one that was refused.
    circle : str
        The circle that carried the calibration.
    record : ResultRecord
        The record itself.
    """

    width: int
    height: int
    accepted: bool
    template: FieldTemplate | None
    view: FieldView | None
    circle: str
    record: ResultRecord

    @property
    def aspect(self) -> float:
        """Width of a pixel over its height; 1 where it is not known."""
        aspect = 1.0 if self.record.image is None else self.record.image.aspect
        return aspect if 1.0 / _LARGEST_ASPECT <= aspect <= _LARGEST_ASPECT else 1.0


def scene_of(record: ResultRecord) -> Scene | None:
    """What can be drawn of a record; None where it has no picture size."""
    if record.image is None:
        return None
    view, template, circle = record.estimated_view, None, ""
    if record.field is not None:
        try:
            template = load_field(record.field.template, record.field.sizes)
            circle = record.field.circle or ""
        except CirclecalError:  # of another version, or a file of somebody's own
            view = None
    return Scene(record.width, record.height, record.status == "calibrated", template, view, circle, record)


def template_layer(scene: Scene) -> str | None:
    """The projected field template as SVG in the frame's pixels.

    Dashed and in the refusal's colour where the estimate was refused; of a frame without one the ellipse that was
    found. None where there is nothing to draw.
    """
    paths: list[str] = []
    unit = scene.width / 1920.0
    if scene.view is not None and scene.template is not None:
        for name, polyline in scene.view.markings(scene.template).items():
            outline = _path(_runs(pixels_near_picture(scene.view, polyline) + 0.5), _TOLERANCE * unit)
            own = CIRCLE if name == scene.circle else TEMPLATE
            paths.append(_stroke(outline, own if scene.accepted else REFUSED, dashed=not scene.accepted))
    else:
        found = _ellipse_of_record(scene.record)
        if found is not None:
            paths.append(_stroke(_path([found + 0.5], _TOLERANCE * unit), CIRCLE, dashed=True))
    content = "".join(paths)
    return _picture_svg(content, scene) if content else None


def other_layer(scene: Scene) -> str | None:
    """The field template as another run's camera draws it, in one colour, dashed; None without a camera."""
    if scene.view is None or scene.template is None:
        return None
    lines = (
        _runs(pixels_near_picture(scene.view, line) + 0.5) for line in scene.view.markings(scene.template).values()
    )
    outline = "".join(_path(runs, _TOLERANCE * scene.width / 1920.0) for runs in lines)
    return _picture_svg(_stroke(outline, PURPLE, dashed=True), scene) if outline else None


def points_layer(scene: Scene) -> str | None:
    """The circle's points that took part, the derived points and the imaged centre as SVG in the frame's pixels."""
    record = scene.record
    parts = [_dots(_thin(_points(edge.points_px)), INLIER, 3.0) for edge in (record.inliers or {}).values()]
    derived = [point.image_px for point in record.correspondences.points] if record.correspondences else []
    parts.append(_dots(_points(derived), POINT, 8.0))
    center = _points([] if record.imaged_center is None else [record.imaged_center])
    if len(center):
        x, y = center[0] + 0.5
        arm = 14.0 * scene.width / 1920.0
        cross = f"M{x - arm:.1f} {y:.1f}H{x + arm:.1f}M{x:.1f} {y - arm:.1f}V{y + arm:.1f}"
        parts.append(_stroke(cross, CIRCLE))
    content = "".join(parts)
    return _picture_svg(content, scene) if content else None


def plan_layer(scene: Scene) -> str | None:
    """The field from above with the outline of what the frame shows, as SVG on the extent of the radar picture."""
    if scene.view is None or scene.template is None or not scene.accepted:
        return None
    half, scale = radar_half(scene.template, scene.view), _PLAN_UNITS_PER_M
    footprint = _path(_close(_footprint(scene, half)), 0.5, closed=True, scale=scale)
    parts = [f'<path d="{footprint}" fill="#fff" fill-opacity=".10" stroke="#fff" {_LINE} stroke-dasharray="5 4"/>']
    for name, polyline in scene.view.markings(scene.template).items():
        color = CIRCLE if name == scene.circle else TEMPLATE
        parts.append(_stroke(_path([polyline], 0.02, scale=scale), color))
    left, top = -half * scale
    return _svg("".join(parts), (left, top, -2 * left, -2 * top), -2 * left)


def draw_on_thumbnail(picture: Any, scene: Scene) -> Any:
    """Draw the template on a scaled-down copy (h, w, 3) of the frame."""
    canvas = Canvas.of(picture)
    if scene.view is None or scene.template is None:
        return canvas.picture
    scale = np.array([picture.shape[1] / scene.width, picture.shape[0] / scene.height])
    for name, polyline in scene.view.markings(scene.template).items():
        own = CIRCLE if name == scene.circle else TEMPLATE
        placed = (pixels_near_picture(scene.view, polyline) + 0.5) * scale - 0.5
        canvas.polyline(placed, own if scene.accepted else REFUSED, 1.0, dashed=not scene.accepted)
    return canvas.picture


def _footprint(scene: Scene, half: Array) -> list[Array]:
    """Outlines in metres of the part of the plan that the frame shows."""
    if scene.view is None:
        return []
    step = 1.0 / _FOOTPRINT_PX_PER_M
    x, y = np.meshgrid(np.arange(-half[0] + step / 2, half[0], step), np.arange(-half[1] + step / 2, half[1], step))
    seen = scene.view.shows(scene.view.project(np.stack([x, y], axis=-1)), margin_px=0.5)
    contours, _ = cv2.findContours(seen.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return [(contour[:, 0].astype(np.float64) + 0.5) * step - half for contour in contours if len(contour) > 2]


def _ellipse_of_record(record: ResultRecord) -> Array | None:
    """The fitted ellipse (N, 2) of a frame that got no further."""
    fit = None if record.ellipses is None else record.ellipses.found
    if fit is None:
        return None
    center, axes = (np.asarray(pair, dtype=np.float64) for pair in (fit.center_px, fit.semi_axes_px))
    turn = np.radians(np.float64(np.nan if fit.angle_degrees is None else fit.angle_degrees))
    t = np.linspace(0.0, 2 * np.pi, 181)
    along = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    points = center + (np.stack([np.cos(t), np.sin(t)], axis=1) * axes) @ along
    return points if np.isfinite(points).all() else None


def _points(pairs: Sequence[Pair]) -> Array:
    """Points (N, 2) without the ones that are not known."""
    points = np.asarray(pairs, dtype=np.float64).reshape(-1, 2)
    return points[np.isfinite(points).all(axis=1)]


def _thin(points: Array) -> Array:
    return points[:: max(1, math.ceil(len(points) / _MOST_POINTS))]


def _runs(points: Array) -> Iterator[Array]:
    """Pieces of a polyline between the points that are nan."""
    finite = np.isfinite(points[:, 0]) & np.isfinite(points[:, 1])
    for piece in np.split(np.arange(len(points)), np.flatnonzero(np.diff(finite.astype(np.int8))) + 1):
        if len(piece) > 1 and finite[piece[0]]:
            yield points[piece]


def _close(outlines: Iterable[Array]) -> list[Array]:
    return [np.concatenate([outline, outline[:1]]) for outline in outlines]


def _path(polylines: Iterable[Array], tolerance: float, *, closed: bool = False, scale: float = 1.0) -> str:
    """SVG path through polylines, thinned out (Douglas and Peucker 1973) within a tolerance."""
    drawn: list[str] = []
    for polyline in polylines:
        thin = cv2.approxPolyDP(polyline.astype(np.float32)[:, None], tolerance, closed=False)[:, 0] * scale
        pairs = [f"{x:.1f} {y:.1f}" for x, y in thin.tolist()]
        drawn.append(f"M{'L'.join(pairs)}{'Z' if closed else ''}")
    return "".join(drawn)


_LINE = 'stroke-width="1.6" vector-effect="non-scaling-stroke" stroke-linejoin="round" stroke-linecap="round"'
_HALO = 'fill="none" stroke="#000" stroke-opacity=".45" stroke-width="3.4" vector-effect="non-scaling-stroke"'


def _stroke(outline: str, color: Color, *, dashed: bool = False) -> str:
    if not outline:
        return ""
    dashes = ' stroke-dasharray="7 5"' if dashed else ""
    halo = f'<path d="{outline}" {_HALO}/>'
    return f'{"" if dashed else halo}<path d="{outline}" fill="none" stroke="{_css(color)}" {_LINE}{dashes}/>'


def _dots(points: Array, color: Color, diameter: float) -> str:
    if not len(points):
        return ""
    outline = "".join(f"M{x:.1f} {y:.1f}h0" for x, y in (points + 0.5).tolist())
    shared = 'fill="none" stroke-linecap="round" vector-effect="non-scaling-stroke"'
    rim = f'<path d="{outline}" {shared} stroke="#000" stroke-opacity=".6" stroke-width="{diameter + 1.5:g}"/>'
    return f'{rim}<path d="{outline}" {shared} stroke="{_css(color)}" stroke-width="{diameter:g}"/>'


def _picture_svg(content: str, scene: Scene) -> str:
    """A drawing in the pixels of a frame, as wide as the frame is shown."""
    return _svg(content, (0, 0, scene.width, scene.height), scene.width * scene.aspect)


def _svg(content: str, box: tuple[float, float, float, float], width: float) -> str:
    """A drawing in a box of left, top, width and height, stretched to a width where that is another one."""
    view = " ".join(f"{value:g}" for value in box)
    size = f'width="{width:g}" height="{box[3]:g}" preserveAspectRatio="none"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{view}" {size}>{content}</svg>'


def _css(color: Color) -> str:
    blue, green, red = color
    return f"#{red:02x}{green:02x}{blue:02x}"

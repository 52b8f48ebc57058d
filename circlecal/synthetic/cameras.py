"""Random broadcast cameras by batched rejection: placed, zoomed and aimed, kept when the view is as wanted.

Distances and heights are those of main broadcast cameras; bounds on ``focal_px`` hold for a frame 1920 pixels wide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from circlecal.field import Circle, FieldTemplate, load_field
from circlecal.geometry.camera import Camera, image_center
from circlecal.geometry.camera_parameters import (
    ANGLES,
    INDEX,
    PARAMETERS,
    POSITION,
    ProjectionModel,
    camera_of,
    project,
)
from circlecal.geometry.projective import Array
from circlecal.geometry.surface import FLAT, Surface
from circlecal.synthetic.views import CAMERA_PROFILES, VIEWS, CameraProfile, View

FULL_MARGIN_PX = 8.0
ARC_TOLERANCE_DEG = 12.0
_ROLL_CUT = 2.5
_BATCH = 512
_BATCHES_A_POSITION = 2
_POSITIONS = 400
_HALFWAY_POSITIONS = 40
_CIRCLE_SAMPLES = 180
_COARSE_STRIDE = 15
_DESIGN_WIDTH = 1920.0
_OTHERS_STEP_M = 0.5


@dataclass(frozen=True, slots=True)
class _Candidates:
    """N cameras at once, by their parameters ``theta`` (N, P)."""

    model: ProjectionModel
    theta: Array

    def select(self, chosen: NDArray[np.bool_]) -> _Candidates:
        """The chosen ones."""
        return replace(self, theta=self.theta[chosen])

    def project(self, points_m: Array) -> Array:
        """Pixels (N, M, 2) of field points (M, 2); nan where they are not seen."""
        seen = project(self.theta, points_m[None], self.model)
        return np.where(seen.visible[..., None], seen.pixels, np.nan)

    def inside(self, points_m: Array, margin_px: float = 0.0) -> NDArray[np.bool_]:
        """Which field points (M, 2) lie within the picture (N, M), so far from its border."""
        return inside_frame(self.project(points_m), self.model.width, self.model.height, margin_px)


@dataclass(frozen=True, slots=True)
class _FieldPoints:
    """Field points (N, 2) that the views are judged by."""

    rim: Array
    halfway: Array
    others: Array


@lru_cache(maxsize=1)
def soccer() -> FieldTemplate:
    """The soccer template that comes with the package."""
    return load_field("soccer")


def sample_camera(
    profile: CameraProfile,
    rng: np.random.Generator,
    width: int = 1920,
    height: int = 1080,
    template: FieldTemplate | None = None,
    *,
    arc_deg: float | None = None,
    offset_m: float | None = None,
    kappa: float = 0.0,
    surface: Surface = FLAT,
    like: Camera | None = None,
) -> Camera:
    """One random camera of a profile, on the near side of the field (y > 0) unless the profile says otherwise.

    Parameters
    ----------
    profile : str
        One of :data:`circlecal.synthetic.views.CAMERA_PROFILES`. ``"main"``: 45-90 m from the centre mark, 8-25 m
        high, within 12 m of the halfway line, roll sd 1 degree cut at 2.5 sd; the whole circle inside the frame with
        8 px to spare and no marking but circle and halfway line in view. ``"wide"``: the same within 25 m.
        ``"high"``: the same, 25-40 m high. ``"partial"``: 40-80 % of the circle. ``"arc"``: one arc of ``arc_deg`` +-
        12 degrees, with the halfway line where that can be had. ``"hard"``: low (6-10 m) or near (38-45 m), roll sd 3
        degrees, at least 45 % of the circle, other markings allowed. ``"broadcast"``: the whole circle and more of
        the field, focal length 1500-4000 px at a width of 1920. The others are told by their numbers in
        :mod:`circlecal.synthetic.views`.
    rng : Generator
        Randomness.
    width, height : int
        Picture size, pixels.
    template : FieldTemplate, optional
        Field; soccer if not given.
    arc_deg : float, optional
        Length of the visible arc in degrees of the circle; needed by, and only by, ``"arc"``.
    offset_m : float, optional
        Another bound on ``|x|`` than the profile's, metres.
    kappa : float
        Radial distortion, half-widths.
    surface : Surface
        Shape of the ground.
    like : Camera, optional
        Another view of the same camera: its position and roll are kept.

    Raises
    ------
    ValueError
        Unknown profile, or no camera with such a view was found.
    """
    if profile not in CAMERA_PROFILES:
        raise ValueError(f"unknown camera profile {profile!r}; known: {', '.join(CAMERA_PROFILES)}")
    if (arc_deg is not None) != (profile == "arc"):
        raise ValueError("arc_deg is needed by the profile 'arc', and only by it")
    view = VIEWS[("low" if rng.random() < 0.5 else "near") if profile == "hard" else profile]
    if offset_m is not None:
        view = replace(view, offset_m=offset_m)
    field = template or soccer()
    circle = field.circle_by_name[field.default_circle]
    points = _field_points(field)
    for attempt in range(_POSITIONS * _BATCHES_A_POSITION):
        if attempt % _BATCHES_A_POSITION == 0:
            position = _draw_position(view, rng)
            if like is not None:
                position = like.position_m - np.array([*circle.center, 0.0])
        if arc_deg is not None and attempt == _HALFWAY_POSITIONS * _BATCHES_A_POSITION:
            view = replace(view, halfway_px=0.0)
        candidates = _aim(position, view, circle, rng, (width, height), kappa, surface)
        if like is not None:
            candidates.theta[:, INDEX["roll"]] = like.angles_rad[2]
        candidates = _select_circle_as_wanted(candidates, view, points, arc_deg)
        if view.only_circle:
            candidates = _without_others(candidates, points)
        candidates = _select_with_halfway_line(candidates, view, points)
        candidates = _select_with_other_markings(candidates, view, points)
        candidates = _select_with_little_foreground(candidates, view, field)
        if len(candidates.theta):
            return camera_of(candidates.theta[0], candidates.model)
    raise ValueError(
        f"no camera found for profile {profile!r}"
        + (f" with an arc of {arc_deg:g} degrees" if arc_deg is not None else "")
    )


def aim_camera(
    position_m: Array, target_m: Array, focal_px: float, roll_rad: float, width: int, height: int, kappa: float = 0.0
) -> Camera:
    """Camera at a position (3,) with a target (3,) in the middle of its picture; z of both points down, metres."""
    dx, dy, dz = np.asarray(target_m, dtype=np.float64) - np.asarray(position_m, dtype=np.float64)
    return Camera(
        width=width,
        height=height,
        focal_px=np.full(2, float(focal_px)),
        principal_point_px=image_center(width, height),
        angles_rad=np.array([np.arctan2(dx, -dy), np.arctan2(np.hypot(dx, dy), dz), roll_rad]),
        position_m=np.asarray(position_m, dtype=np.float64),
        kappa=np.array([kappa, 0.0]),
    )


def visible_circle_deg(
    camera: Camera, template: FieldTemplate, surface: Surface = FLAT, margin_px: float = 0.0
) -> float:
    """Degrees (0-360) of the outer edge of the default circle that lie inside the frame."""
    angles = np.arange(1440) / 1440 * 2 * np.pi
    pixels = camera.project(surface.lift(_rim(template, angles)))
    return float(np.mean(inside_frame(pixels, camera.width, camera.height, margin_px)) * 360.0)


def halfway_length_px(camera: Camera, template: FieldTemplate, surface: Surface = FLAT) -> float:
    """Length in pixels of the halfway line inside the frame."""
    pixels = camera.project(surface.lift(_halfway_points(template)))
    return float(_visible_length(pixels, camera.width, camera.height))


def other_lengths_px(camera: Camera, template: FieldTemplate, surface: Surface = FLAT) -> tuple[float, ...]:
    """Lengths in pixels, longest first, of the lines and arcs inside the frame other than the default circle and the
    halfway line.
    """
    own = {template.default_circle, template.halfway_line}
    drawn = [points for name, points in template.polylines(_OTHERS_STEP_M).items() if name not in own]
    pixels = (camera.project(surface.lift(points)) for points in drawn)
    lengths = [float(_visible_length(seen, camera.width, camera.height)) for seen in pixels]
    return tuple(sorted((length for length in lengths if length > 0.0), reverse=True))


def inside_frame(pixels: Array, width: int, height: int, margin_px: float = 0.0) -> NDArray[np.bool_]:
    """Which pixels (..., 2) lie on the picture, at least ``margin_px`` from its outermost pixel centres."""
    with np.errstate(invalid="ignore"):
        low = (pixels >= margin_px).all(axis=-1)
        return np.asarray(low & (pixels[..., 0] <= width - 1 - margin_px) & (pixels[..., 1] <= height - 1 - margin_px))


def _draw_position(view: View, rng: np.random.Generator) -> Array:
    """Camera position (3,) relative to the middle of the circle."""
    distance, elevation = rng.uniform(*view.distance_m), rng.uniform(*view.height_m)
    x = rng.uniform(-view.offset_m, view.offset_m)
    y = np.sqrt(max(distance**2 - elevation**2 - x**2, 1.0))
    if not view.azimuth_deg:
        return np.array([x, y, -elevation])
    lowest, highest = view.azimuth_deg[rng.integers(len(view.azimuth_deg))]
    turn = np.radians(rng.uniform(lowest, highest))
    return np.array([x * np.cos(turn) + y * np.sin(turn), y * np.cos(turn) - x * np.sin(turn), -elevation])


def _aim(
    position: Array,
    view: View,
    circle: Circle,
    rng: np.random.Generator,
    size: tuple[int, int],
    kappa: float,
    surface: Surface,
) -> _Candidates:
    """Zooms, aims and rolls of a camera at a position relative to the middle of the circle."""
    width, height = size
    x, y, z = position
    distance = float(np.linalg.norm(position))
    half_axis = rng.uniform(*view.circle_half_widths, _BATCH) * (width / 2.0)
    focal = half_axis * distance / circle.radius_m
    if view.aim_share is None:
        reach = np.stack([width / 2.0 - half_axis, height / 2.0 + half_axis * z / distance])
    else:
        reach = np.broadcast_to(np.array([[view.aim_share[0] * width], [view.aim_share[1] * height]]), (2, _BATCH))
    # the centre mark appears this many pixels away from the middle of the picture
    aside, below = rng.uniform(-1.0, 1.0, (2, _BATCH)) * np.maximum(reach, 0.0)
    pan = np.arctan2(-x, y) - np.arctan2(aside, focal)
    tilt = np.arctan2(np.hypot(x, y), -z) + np.arctan2(below, focal)
    roll = np.radians(view.roll_sd_deg) * _draw_cut_normal(rng)
    theta = np.zeros((_BATCH, len(PARAMETERS)))
    theta[:, INDEX["log_focal"]] = np.log(focal)
    theta[:, ANGLES] = np.stack([pan, tilt, roll], axis=-1)
    theta[:, POSITION] = position + np.array([*circle.center, 0.0])
    theta[:, INDEX["kappa_1"]] = kappa
    theta[:, INDEX["crown"]] = surface.crown_m
    drawn = _Candidates(ProjectionModel(width, height, replace(surface, crown_m=1.0)), theta)
    bounds = np.asarray(view.focal_px) * width / _DESIGN_WIDTH
    return drawn.select((focal >= bounds[0]) & (focal <= bounds[1]))


def _draw_cut_normal(rng: np.random.Generator) -> Array:
    # standard normal cut at _ROLL_CUT: enough spares are drawn that the first _BATCH survivors exist in practice
    values = rng.standard_normal(2 * _BATCH)
    return values[np.argsort(np.abs(values) > _ROLL_CUT, kind="stable")[:_BATCH]]


def _rim(template: FieldTemplate, angles: Array) -> Array:
    circle = template.circle_by_name[template.default_circle]
    return template.curve_points(circle, "outer", angles)


def _field_points(template: FieldTemplate) -> _FieldPoints:
    angles = np.arange(_CIRCLE_SAMPLES) / _CIRCLE_SAMPLES * 2 * np.pi
    return _FieldPoints(_rim(template, angles), _halfway_points(template), other_markings(template))


def _select_circle_as_wanted(
    candidates: _Candidates, view: View, points: _FieldPoints, arc_deg: float | None
) -> _Candidates:
    """Candidates that show as much of the circle as asked for: a coarse look at all, a fine one at what is left."""
    lowest, highest = view.visible_share
    if arc_deg is not None:
        # half a sample of slack on each side, so that the exact length keeps the tolerance
        slack = ARC_TOLERANCE_DEG - 360.0 / _CIRCLE_SAMPLES
        lowest, highest = (arc_deg - slack) / 360.0, (arc_deg + slack) / 360.0
    margin = FULL_MARGIN_PX if lowest >= 1.0 else 0.0
    for stride in (_COARSE_STRIDE, 1):
        inside = candidates.inside(points.rim[::stride], margin)
        share = inside.mean(axis=1)
        runs = np.sum(inside & ~np.roll(inside, 1, axis=1), axis=1)
        # an arc end may lie anywhere between two samples
        spare = 2.0 * stride / _CIRCLE_SAMPLES if stride > 1 and lowest < 1.0 else 0.0
        wanted = (share >= lowest - spare) & (share <= highest + spare)
        contiguous = (runs == 1) | (arc_deg is None) | (stride > 1)
        candidates = candidates.select(np.asarray(wanted & contiguous))
    return candidates


def _halfway_points(template: FieldTemplate) -> Array:
    if template.halfway_line is None:
        return np.zeros((0, 2))
    start, end = template.line_ends(template.line_by_name[template.halfway_line])
    return np.asarray(np.linspace(start, end, 273))


def _visible_length(pixels: Array, width: int, height: int) -> Array:
    inside = inside_frame(pixels, width, height)
    step = np.linalg.norm(np.diff(pixels, axis=-2), axis=-1)
    return np.asarray(np.sum(np.where(inside[..., 1:] & inside[..., :-1], step, 0.0), axis=-1))


def _select_with_halfway_line(candidates: _Candidates, view: View, points: _FieldPoints) -> _Candidates:
    lowest, highest = view.halfway_px, view.halfway_most_px
    if lowest <= 0.0 and np.isinf(highest):
        return candidates
    length = _visible_length(candidates.project(points.halfway), candidates.model.width, candidates.model.height)
    unit = candidates.model.width / _DESIGN_WIDTH
    return candidates.select((length >= lowest * unit) & (length <= highest * unit))


def _select_with_other_markings(candidates: _Candidates, view: View, points: _FieldPoints) -> _Candidates:
    if view.others_m <= 0.0:
        return candidates
    seen = candidates.inside(points.others).sum(axis=1)
    return candidates.select(np.asarray(seen * _OTHERS_STEP_M >= view.others_m))


def _select_with_little_foreground(candidates: _Candidates, view: View, template: FieldTemplate) -> _Candidates:
    if not np.isfinite(view.foreground_m):
        return candidates
    x, y = template.length_m / 6, template.width_m / 2 + view.foreground_m
    below = candidates.project(np.array([[-x, y], [0.0, y], [x, y]]))[..., 1]
    return candidates.select(np.asarray(~np.any(below < candidates.model.height, axis=1)))


def _without_others(candidates: _Candidates, points: _FieldPoints) -> _Candidates:
    for stride in (_COARSE_STRIDE, 1):
        seen = candidates.inside(points.others[::stride], -FULL_MARGIN_PX)
        candidates = candidates.select(np.asarray(~seen.any(axis=1)))
    return candidates


def other_markings(template: FieldTemplate) -> Array:
    """Points (N, 2) in metres, every 0.5 m, of all markings but default circle, halfway line and the mark on them."""
    own = {template.default_circle, template.halfway_line}
    center = np.asarray(template.circle_by_name[template.default_circle].center)
    drawn = [points for name, points in template.polylines(_OTHERS_STEP_M).items() if name not in own]
    marks = [np.array([m.position]) for m in template.marks if np.linalg.norm(np.asarray(m.position) - center) > 1e-6]
    return np.concatenate([np.zeros((0, 2)), *drawn, *marks])

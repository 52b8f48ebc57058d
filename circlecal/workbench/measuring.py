"""What a picture shows before anybody names it, and where a click or a drag meets paint: measured once, then kept.

Everything is measured by the instrument of :mod:`circlecal.paint`; the detector is not run again while a person works.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from circlecal.api.calls import calibrate_picture
from circlecal.config import Config
from circlecal.formats.annotation import AnnotatedMarking, Annotation, markings_of
from circlecal.geometry.conic_fits import fit_conic
from circlecal.geometry.ellipses import Ellipse, ellipse_from_conic, orthogonal_distance
from circlecal.geometry.projective import Array
from circlecal.observations import LinePoints, MarkingKey, Observations
from circlecal.paint.bands import measure_bands, rise_above_noise
from circlecal.paint.lines import ONE_ROUND, TWO_ROUNDS, measure_lines
from circlecal.paint.profiles import estimate_noise, sample_profiles, smooth_along, to_gray
from circlecal.pictures.files import PictureFile
from circlecal.pipeline import field_of
from circlecal.pipeline.setting import lighten_markings
from circlecal.results import FrameCalibration, Segment

SNAP_PX = 12.0
"""A click snaps to paint at most this far away, pixels at 1920 px width: about a fingertip on a screen."""
DIRECTIONS, STRIP_PX, STRIP_PROFILES = 24, 18.0, 7
"""Directions in which a marking may run through a click, and the length (pixels at 1920 px width) and number of
profiles of the strip on which each is judged: shorter strips mistake a player's sock for paint, longer ones leave arcs.
"""
FOLLOW_PX, SPACING_PX = 8.0, 3.0
"""How far to both sides of a dragged path paint is looked for, and how far apart, pixels at 1920 px width."""
FEWEST, SEEN_SHARE = 5, 0.25
"""So many points, and such a share of the places that were looked at, are a marking."""
ARC_GAP_PX = 30.0
"""Of an arc that was seen, points so near to its drawn part are taken, pixels at 1920 px width: players hide as much of
a line, and the ellipse goes on over other markings.
"""
OFFERED, APART_PX = 3, 8.0
"""How many ellipses of a picture without a circle are offered, and how far apart they lie, pixels at 1920 px width."""
CONIC_POINTS = 5
"""Points that determine an ellipse."""
CLICKED_SIGMA_PX = 1.5
"""Standard deviation of a click that met no paint, pixels at 1920 px width; as for annotation files."""


@dataclass(frozen=True, slots=True)
class MeasuredPicture:
    """A picture with what the chain made of it.

    Attributes
    ----------
    picture : (H, W, 3) uint8
        BGR.
    light : (H, W) uint8
        Its brightness, with the markings lighter than the surface.
    noise : float
        Grey-level noise.
    found : FrameCalibration
        The chain's own answer.
    """

    picture: NDArray[np.uint8]
    light: NDArray[np.uint8]
    noise: float
    found: FrameCalibration

    @property
    def unit(self) -> float:
        """Pixels per pixel at 1920 px width."""
        return self.picture.shape[1] / 1920.0

    def shows(self, points: Array) -> NDArray[np.bool_]:
        """Which of the points (N, 2) lie in the picture."""
        last = np.array(self.picture.shape[1::-1]) - 1
        return np.asarray(((points >= 0) & (points <= last)).all(axis=1), np.bool_)


@dataclass(frozen=True, slots=True)
class Snapped:
    """Points (N, 2) on the middle of paint with their standard deviations (N,), and whether they met any."""

    points: Array
    sigma: Array
    on_paint: bool


def measure_picture(picture: NDArray[np.uint8], config: Config, frame: PictureFile) -> MeasuredPicture:
    """Calibrate a picture by the chain and keep what a person may go on from.

    Parameters
    ----------
    picture : (H, W, 3) uint8
        BGR.
    config : Config
        Options of every stage.
    frame : PictureFile
        Its name, file and aspect.

    Raises
    ------
    ConfigError
        The configuration's field template or a network is unusable.
    """
    found = calibrate_picture(picture, config, aspect=frame.aspect, frame_id=frame.id, source=frame.source)
    gray, circle = to_gray(picture), field_of(config)[1]
    mask, edges = found.attempt.mask, found.attempt.edges
    light = gray if mask is None else lighten_markings(gray, mask, circle)
    noise = estimate_noise(light) if edges is None else edges.noise
    return MeasuredPicture(picture, light, noise, found)


def begin_annotation(measured: MeasuredPicture, config: Config, frame: PictureFile) -> Annotation:
    """An annotation that holds what was measured, with the names that an accepted calibration gave; what it left out
    since it contradicts the rest is not used, as it was not there.

    Where no circle was believed, ellipses that may be one are offered and not used.
    """
    found = measured.found
    seen, camera = found.attempt.observations, found.attempt.camera
    if seen is None:
        markings = [*_lines_of_mask(measured, config), *_find_curves(measured)]
    else:
        accepted = camera if found.status == "calibrated" else None
        names = {} if accepted is None else accepted.names_by_line
        left_out = () if accepted is None else accepted.rejected
        lines = tuple(replace(line, line=line.line or names.get(k)) for k, line in enumerate(seen.lines))
        markings = [
            marking.model_copy(update={"used": _key_of(marking) not in left_out})
            for marking in markings_of(replace(seen, lines=lines), "measured")
        ]
    template, circle = field_of(config)
    return Annotation(
        id=frame.id,
        source=frame.source,
        time_s=frame.time_s,
        width=found.width,
        height=found.height,
        pixel_aspect=found.aspect,
        field=config.field.template if config.field.template.endswith((".yaml", ".yml")) else template.name,
        circle=found.circle_name if found.circle_name != circle.name else None,
        placed=found.attempt.is_placed,
        markings=markings,
    )


def _key_of(marking: AnnotatedMarking) -> MarkingKey:
    return MarkingKey(marking.name or "", marking.edge if marking.kind == "curve" else None)


def _lines_of_mask(measured: MeasuredPicture, config: Config) -> list[AnnotatedMarking]:
    mask = measured.found.attempt.mask
    rough = () if mask is None else (*mask.lines, *((mask.halfway,) if mask.halfway is not None else ()))
    cues = config.cues
    seen = measure_lines(measured.light, rough, measured.noise, cues.search_px, cues.spacing_px, ONE_ROUND)
    lines = tuple(LinePoints(None, line.points_px, line.sigma_px) for line in seen if line is not None)
    return markings_of(Observations(measured.found.width, measured.found.height, lines=lines), "measured")


def _find_curves(measured: MeasuredPicture) -> Iterator[AnnotatedMarking]:
    mask = measured.found.attempt.mask
    drawn: list[tuple[Array, Array | None]] = [] if mask is None else [(arc.conic, arc.points_px) for arc in mask.arcs]
    drawn += [] if mask is None else [(candidate.conic, None) for candidate in mask.candidates]
    kept: list[Ellipse] = []
    for conic, part in drawn:
        ellipse = ellipse_from_conic(conic)
        if ellipse is None or len(kept) >= OFFERED or any(_are_alike(ellipse, other, measured.unit) for other in kept):
            continue
        seen = measure_ellipse(measured, ellipse)
        if seen is not None and part is not None and len(part):  # beside an arc its ellipse meets other markings
            apart = np.linalg.norm(seen.points[:, None] - part[None], axis=2).min(axis=1)
            near = apart < ARC_GAP_PX * measured.unit
            seen = Snapped(seen.points[near], seen.sigma[near], True) if near.sum() >= FEWEST else None
        if seen is not None:
            kept.append(ellipse)
            yield _as_marking(seen, "curve", None, used=False)


def _are_alike(ellipse: Ellipse, other: Ellipse, unit: float) -> bool:
    around = ellipse.points(np.linspace(0.0, 2 * np.pi, 24, endpoint=False))
    return bool(np.median(np.abs(orthogonal_distance(other, around))) < APART_PX * unit)


def _as_marking(seen: Snapped, kind: str, name: str | None, *, used: bool) -> AnnotatedMarking:
    return AnnotatedMarking.model_validate(
        {
            "name": name,
            "kind": kind,
            "points_px": np.round(seen.points, 3).tolist(),
            "sigma_px": np.round(seen.sigma, 4).tolist(),
            "source": "measured",
            "used": used,
        }
    )


def measure_ellipse(measured: MeasuredPicture, ellipse: Ellipse) -> Snapped | None:
    """Points of a marking along a rough ellipse; None where there is hardly any."""
    count = int(np.clip(2 * np.pi * ellipse.semi_axes[0] / (SPACING_PX * measured.unit), 60, 1500))
    angles = np.linspace(0.0, 2 * np.pi, count, endpoint=False)
    points, normals = ellipse.points_and_normals(angles)
    inside = measured.shows(points)
    return _measure_along(measured, points[inside], normals[inside])


def _measure_along(measured: MeasuredPicture, points: Array, normals: Array) -> Snapped | None:
    """Middle of the paint across places (N, 2) with unit normals."""
    if len(points) < FEWEST:
        return None
    reach = max(FOLLOW_PX * measured.unit, 4.0)
    offsets = np.arange(-2.0 * reach, 2.0 * reach + 0.25, 0.5)
    bands = measure_bands(smooth_along(sample_profiles(measured.light, points, normals, offsets), 1.0), offsets, reach)
    on = rise_above_noise(bands, measured.noise)
    if np.count_nonzero(on) < max(FEWEST, SEEN_SHARE * len(points)):
        return None
    middles = points[on] + bands.center[on, None] * normals[on]
    return Snapped(middles, bands.sigma(measured.noise)[on], True)


def snap_click(measured: MeasuredPicture, click: Array) -> Snapped:
    """The middle of the paint next to a click (2,): in every direction a strip of profiles is averaged, and the one in
    which a thin light band stands out most tells how the marking runs there.
    """
    unit = max(measured.unit, 0.5)
    reach = SNAP_PX * unit
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    along = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    normals = np.stack([-along[:, 1], along[:, 0]], axis=-1)
    steps = np.linspace(-0.5, 0.5, STRIP_PROFILES) * STRIP_PX * unit
    places = (click + steps[:, None] * along[:, None]).reshape(-1, 2)
    offsets = np.arange(-2.0 * reach, 2.0 * reach + 0.25, 0.5)
    profiles = sample_profiles(measured.light, places, np.repeat(normals, len(steps), axis=0), offsets)
    strips = profiles.reshape(DIRECTIONS, len(steps), len(offsets)).mean(axis=1)
    bands = measure_bands(np.asfortranarray(strips.astype(np.float32)), offsets, reach)
    noise = measured.noise / np.sqrt(len(steps))
    seen = rise_above_noise(bands, noise)
    # sharp and near: of two markings the one that was meant
    nearness = 1.0 - 0.5 * np.abs(bands.center) / reach
    score = np.where(seen, nearness * bands.contrast / np.sqrt(np.maximum(bands.width, 1.0)), -np.inf)
    best = int(np.argmax(score))
    if not np.isfinite(score[best]):
        return exact_clicks(measured, click[None])
    point = click + bands.center[best] * normals[best]
    return Snapped(point[None], bands.sigma(noise)[[best]], True)


def exact_clicks(measured: MeasuredPicture, points: Array) -> Snapped:
    """Points (N, 2) exactly where they were clicked."""
    return Snapped(points, np.full(len(points), CLICKED_SIGMA_PX * max(measured.unit, 0.1)), False)


def follow_path(measured: MeasuredPicture, path: Array) -> Snapped:
    """Points on the paint along a dragged path (N, 2), or along the straight line between two clicks."""
    if len(path) == 2:
        lines = measure_lines(measured.light, [Segment(*path)], measured.noise, FOLLOW_PX, SPACING_PX, TWO_ROUNDS)
        line = lines[0]
        return exact_clicks(measured, path) if line is None else Snapped(line.points_px, line.sigma_px, True)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    spacing = SPACING_PX * max(measured.unit, 0.5)
    at = np.arange(0.0, length[-1], spacing)
    if len(at) < FEWEST:
        return snap_click(measured, path[len(path) // 2])
    points = np.stack([np.interp(at, length, path[:, k]) for k in (0, 1)], axis=-1)
    # hands tremble: the direction is that of some neighbours together
    half = max(1, min(8, len(points) // 6))
    around = np.clip(np.arange(len(points))[:, None] + (-half, half), 0, len(points) - 1)
    span = points[around[:, 1]] - points[around[:, 0]]
    normals = np.stack([-span[:, 1], span[:, 0]], axis=-1) / np.maximum(np.hypot(*span.T), 1e-9)[:, None]
    inside = measured.shows(points)
    return _measure_along(measured, points[inside], normals[inside]) or exact_clicks(measured, path[[0, -1]])


def complete_circle(measured: MeasuredPicture, clicks: Array) -> Snapped | None:
    """The marking of the ellipse that was meant by clicks (N, 2) on its paint: two choose one that was seen in the
    picture, five determine any; None where there is none.
    """
    mask = measured.found.attempt.mask
    conics = [] if mask is None else [*(c.conic for c in mask.candidates), *(arc.conic for arc in mask.arcs)]
    ellipses = [ellipse for conic in conics if (ellipse := ellipse_from_conic(conic)) is not None]
    near = [
        (float(np.abs(orthogonal_distance(ellipse, clicks)).max()), k)
        for k, ellipse in enumerate(ellipses)
        if len(clicks) >= 2
    ]
    if near and min(near)[0] < FOLLOW_PX * max(measured.unit, 0.5):
        return measure_ellipse(measured, ellipses[min(near)[1]])
    if len(clicks) < CONIC_POINTS:
        return None
    conic = fit_conic(clicks, "direct")
    ellipse = None if conic is None else ellipse_from_conic(conic)
    return None if ellipse is None else measure_ellipse(measured, ellipse)

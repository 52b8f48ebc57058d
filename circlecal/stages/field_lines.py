"""Straight markings where no circle carries the frame: measured, named together, and the arcs that go with them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import ProjectionModel, project
from circlecal.geometry.projective import Array, line_distance
from circlecal.line_naming.two_directions import FieldHypothesis, find_arc, propose_cameras
from circlecal.observations import CirclePoints, LinePoints, Observations
from circlecal.paint.lines import ONE_ROUND, measure_lines
from circlecal.paint.predicted_width import predict_line_widths
from circlecal.paint.profiles import GrayPicture
from circlecal.results import CameraFit, LineCue, MarkingMask

__all__ = ["carriers", "observe_field_lines", "without_worst_marking"]

MOST_HYPOTHESES = 3
"""How many namings of the lines are fitted, at most."""
RIVAL_SHARE = 0.7
"""Of the best one's score: namings with less are not fitted (of 33 real frames of penalty areas the right one had the
best score in all that had any, and the next one with other names more than this share in two).
"""
ONE_LINE_PX = 4.0
"""Pixels at 1920 px width from the longest piece of a marking within which others are pieces of it: lens and crown bend
a touchline by so much, the edge of a board runs further off.
"""
ARC_SIGMA_PX = 0.5
"""Of the points of curves that the detector traced, pixels at 1920 px width."""

WIDEST = 2.0
"""Times the width that the rough camera predicts, or the median of the lines' own where that is more, from which on a
line is no marking but a part of a board: right names of 6 real and rendered frames have at most 1.4, two pieces of
advertising boards taken for the far touchline 3.8 and 4.3.
"""


def observe_field_lines(
    picture: GrayPicture,
    mask: MarkingMask,
    noise: float,
    template: FieldTemplate,
    search_px: float,
    spacing_px: float,
    side: str,
) -> list[tuple[Observations, Array]]:
    """Observations with names for the straight markings and arcs of a picture, by the most plausible naming first, each
    with the rough camera (P,) that its names imply, without lens or crown.

    Parameters
    ----------
    picture : (H, W) uint8 or float32
        Brightness, with the markings lighter than the field.
    mask : MarkingMask
        Gives the rough lines and arcs.
    noise : float
        Grey-level noise of the picture.
    template : FieldTemplate
        The field.
    search_px, spacing_px : float
        How lines are measured, as of :func:`circlecal.paint.lines.measure_lines`.
    side : str
        Side of the field on which the camera stands.
    """
    height, width = picture.shape
    model = ProjectionModel(width, height)
    measured = measure_lines(picture, mask.lines, noise, search_px, spacing_px, ONE_ROUND)
    lines = [line for line in measured if line is not None]
    segments = np.array([(line.segment.start, line.segment.end) for line in lines]).reshape(-1, 2, 2)
    curves = [arc.points_px for arc in mask.arcs]
    found = propose_cameras(segments, curves, template, model, side, MOST_HYPOTHESES)
    return [
        (_observations(naming, lines, mask, template, model), naming.theta)
        for naming in found
        if naming.score > 0 and naming.score >= RIVAL_SHARE * found[0].score
    ]


def carriers(observations: Observations, fit: CameraFit) -> frozenset[str]:
    """Names of the lines and arcs that a camera was fitted to."""
    names = {line.line for line in observations.lines} | {seen.circle for seen in observations.circles}
    rejected = {key.name for key in fit.rejected}
    return frozenset(name for name in (*names, *fit.named_lines) if name is not None and name not in rejected)


def without_worst_marking(observations: Observations, fit: CameraFit) -> Observations:
    """The observations where the line that a camera explains worst has lost its name, or without the arc of which that
    is true.
    """
    lines_named = [line.key for line in observations.lines if line.key is not None]
    named = [*lines_named, *(seen.key for seen in observations.circles)]
    worst = max(named, key=lambda key: fit.residuals_px.get(key, 0.0), default=None)
    lines = tuple(replace(line, line=None) if worst and line.key == worst else line for line in observations.lines)
    circles = tuple(seen for seen in observations.circles if seen.key != worst)
    return replace(observations, lines=lines, circles=circles)


def _observations(
    naming: FieldHypothesis,
    lines: Sequence[LineCue],
    mask: MarkingMask,
    template: FieldTemplate,
    model: ProjectionModel,
) -> Observations:
    """The lines with their names, and the curves that are a circle or an arc under the naming's camera.

    A line that was named and is far too wide is none, so that nothing names it later.
    """
    unit = model.width / 1920.0
    names = _names_of_paint(naming, lines, template, model)
    longest: dict[str, LineCue] = {}
    for k, name in names.items():
        if name not in longest or len(lines[k].points_px) > len(longest[name].points_px):
            longest[name] = lines[k]
    seen = []
    for k, line in enumerate(lines):
        own = names.get(k)
        if own is None and k in naming.names:
            continue
        if own is not None and line is not longest[own]:
            off = np.median(np.abs(line_distance(longest[own].line, line.points_px)))
            own = own if off < ONE_LINE_PX * unit else None
        seen.append(LinePoints(own, line.points_px, line.sigma_px, line.ends))
    arcs = []
    for arc in mask.arcs:
        sigma = np.full(len(arc.points_px), ARC_SIGMA_PX * unit)
        drawn = find_arc(arc.points_px, naming.theta, template, model)
        arcs += [] if drawn is None else [CirclePoints(drawn, "center", arc.points_px, sigma)]
    return Observations(model.width, model.height, tuple(arcs), tuple(seen))


def _names_of_paint(
    naming: FieldHypothesis, lines: Sequence[LineCue], template: FieldTemplate, model: ProjectionModel
) -> dict[int, str]:
    """The names of a naming without those of lines that are far wider than the paint that they would be."""
    if not naming.names:
        return {}
    measured = np.array([lines[k].width_px for k in naming.names])
    usual = np.maximum(_predict_widths(naming, lines, template, model), np.median(measured))
    is_paint = measured <= WIDEST * usual
    return {k: name for (k, name), is_kept in zip(naming.names.items(), is_paint.tolist(), strict=True) if is_kept}


def _predict_widths(
    naming: FieldHypothesis, lines: Sequence[LineCue], template: FieldTemplate, model: ProjectionModel
) -> Array:
    """Width (K,), pixels, of the paint of each named marking under the naming's camera, where its line is seen."""
    seen = np.array([0.5 * (lines[k].segment.start + lines[k].segment.end) for k in naming.names])

    def project_visible(places: Array) -> Array:
        projected = project(naming.theta[None], places[None], model)
        return np.where(projected.visible[0][:, None], projected.pixels[0], np.nan)

    return predict_line_widths(project_visible, list(naming.names.values()), seen, template)

"""What a named picture should show and does not, and what it shows where no marking is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from circlecal.camera.residuals import ground_feet, line_curve
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import ProjectionModel, project
from circlecal.geometry.projective import Array

FARTHEST_WIDTHS = 4.0
"""How far from the picture's corner the field counts as seen, in picture widths."""
SAMPLES = 48
"""Places along each line of the template, and along each seen one."""
EXPECTED_WIDTHS = 0.15
"""A line of the template is expected to be seen where so much of it lies in the picture, in picture widths."""
NARROWEST_PX, USUAL_WIDTH_M = 0.5, 0.1
"""Paint that is narrower in the picture is not expected to be seen; its width where the template's has none."""
SEEN_SHARE = 0.25
"""A line of the template counts as seen where lines of its name cover this share of what lies in the picture."""
END_SLACK_M = 2.0
"""How far a line may be seen beyond the end of its marking before it overhangs, metres."""


@dataclass(frozen=True, slots=True)
class PredictedMarkings:
    """N places along each of K markings before a camera.

    Attributes
    ----------
    pixels, normals : (K, N, 2) arrays
        Where they are in the picture, and the unit vectors across the marking there.
    by_theta, by_field : (P, K, N), (2, K, N) arrays
        Derivatives of the pixels along the normals by the camera's parameters and by the place on the field.
    length_px : (K, N - 1) array
        Of the pieces between neighbouring places that the picture may show, 0 for the others.
    """

    pixels: Array
    normals: Array
    by_theta: Array
    by_field: Array
    length_px: Array

    @property
    def across(self) -> Array:
        """Pixels across the marking (K, N) per metre of ground: of the width of its paint."""
        return np.asarray(np.hypot(*self.by_field))


def predict_markings(theta: Array, places_m: Array, model: ProjectionModel) -> PredictedMarkings:
    """Markings, by places (K, N, 2) along them on the field, as a camera (P,) shows them."""
    shape = places_m.shape[:2]
    seen = project(theta[None], places_m.reshape(1, -1, 2), model)
    pixels = seen.pixels[0].reshape(*shape, 2)
    tangent = np.gradient(pixels, axis=1)
    tangent /= np.maximum(np.hypot(tangent[..., :1], tangent[..., 1:]), 1e-9)
    normals = np.stack([-tangent[..., 1], tangent[..., 0]], axis=-1)
    by_theta, by_field = (rows[0] for rows in seen.gradient(normals.reshape(1, -1, 2).swapaxes(1, 2)))
    ahead = seen.visible[0].reshape(shape)
    ahead &= (np.abs(pixels) < FARTHEST_WIDTHS * model.width).all(axis=-1)
    first, last = pixels[:, :-1], pixels[:, 1:]
    met = (np.maximum(first, last) > 0) & (np.minimum(first, last) < (model.width, model.height))
    shown = ahead[:, 1:] & ahead[:, :-1] & met.all(axis=-1)
    length = np.where(shown, np.hypot(*np.moveaxis(last - first, -1, 0)), 0.0)
    return PredictedMarkings(pixels, normals, by_theta.reshape(-1, *shape), by_field.reshape(-1, *shape), length)


def missing_px(
    names: dict[int, str], segments: Array, theta: Array, template: FieldTemplate, model: ProjectionModel
) -> float:
    """Length in pixels of the lines that a camera (P,) expects in the picture and that are not seen there.

    Parameters
    ----------
    names : dict
        Template names by index of the seen line.
    segments : (S, 2, 2) array
        Ends of the seen lines.
    theta, template, model : (P,) array, FieldTemplate, ProjectionModel
        Camera, field and picture.
    """
    ends = template.drawn_lines[0]
    share = np.linspace(0.0, 1.0, SAMPLES)
    drawn = predict_markings(theta, ends[:, :1] + share[:, None] * (ends[:, 1:] - ends[:, :1]), model)
    wide = drawn.across * max(template.marking_width_m, USUAL_WIDTH_M) > NARROWEST_PX
    length = drawn.length_px * (wide[:, 1:] & wide[:, :-1])
    expected = length.sum(axis=1)
    total = 0.0
    for k in np.flatnonzero(expected > EXPECTED_WIDTHS * model.width).tolist():
        found = [segments[s] for s, name in names.items() if name == template.lines[k].name]
        covered = np.zeros(SAMPLES, dtype=np.bool_)
        metres = share * np.linalg.norm(ends[k, 1] - ends[k, 0])
        for segment in found:
            low, high = np.sort(_position_along(segment, k, theta, template, model))
            covered |= (metres >= low) & (metres <= high)
        if length[k][covered[1:] | covered[:-1]].sum() < SEEN_SHARE * expected[k]:
            total += float(expected[k])
    return total


def overhang_px(
    names: dict[int, str], segments: Array, theta: Array, template: FieldTemplate, model: ProjectionModel
) -> float:
    """Length in pixels of the seen lines that lies beyond the ends of their markings."""
    total = 0.0
    for s, name in names.items():
        k = next(k for k, line in enumerate(template.lines) if line.name == name)
        points = segments[s, 0] + np.linspace(0.0, 1.0, SAMPLES)[:, None] * (segments[s, 1] - segments[s, 0])
        along = _position_along(points, k, theta, template, model)
        length = float(np.linalg.norm(template.drawn_lines[0][k, 1] - template.drawn_lines[0][k, 0]))
        beyond = (along < -END_SLACK_M) | (along > length + END_SLACK_M)
        total += float(beyond.mean() * np.linalg.norm(segments[s, 1] - segments[s, 0]))
    return total


def _position_along(points: Array, k: int, theta: Array, template: FieldTemplate, model: ProjectionModel) -> Array:
    """Metres (N,) along a line of the template at which pixels (N, 2) lie."""
    line = template.lines[k]
    curve = line_curve(line.name, points, np.ones(len(points)), template.drawn_lines[0][k], template.drawn_lines[1][k])
    return np.asarray(ground_feet(curve, theta[None], model)[0])

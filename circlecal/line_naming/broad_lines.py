"""Lines that are far broader than paint would be where they lie: kerbs, edges of boards, the border of a track."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.problem import Problem, State
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import ProjectionModel, level_points, project
from circlecal.geometry.projective import Array
from circlecal.line_naming.line_ends import FEWEST_POINTS, segment_ends
from circlecal.observations import Observations
from circlecal.paint.predicted_width import blur_widths

__all__ = ["hide_broad_lines", "predict_widths_along"]

BROADEST = 3.0
"""Times the width of blurred paint there from which on a line without a name is no marking, where the camera knows no
more than the circle and its line. Of 663 lines on markings in 340 rendered frames 99 % have at most 1.8, and one, of
115 px, has more than 3; of 106 other lines 26 have, kerbs mostly.
"""


def hide_broad_lines(
    observations: Observations, problem: Problem, state: State, template: FieldTemplate
) -> Observations:
    """The observations, where nameless lines that are too broad for paint before the best camera of a state have no
    points; their numbers stay.
    """
    asked = [
        k
        for k, line in enumerate(observations.lines)
        if line.line is None and line.width_px > 0.0 and len(line.points_px) >= FEWEST_POINTS
    ]
    if not asked:
        return observations
    lines = list(observations.lines)
    segments = np.array([segment_ends(lines[k].points_px) for k in asked])
    painted_px = predict_widths_along(state.best().theta[0], segments, template.marking_width_m, problem.model)
    for k, own_px in zip(asked, painted_px.tolist(), strict=True):
        line = lines[k]
        if line.width_px > BROADEST * float(blur_widths(own_px, line.blur_px)):
            lines[k] = replace(line, points_px=line.points_px[:0], sigma_px=line.sigma_px[:0], ends=())
    return replace(observations, lines=tuple(lines))


def predict_widths_along(theta: Array, segments: Array, width_m: float, model: ProjectionModel) -> Array:
    """Widths (S,) in pixels of paint of a width in metres along segments (S, 2, 2) of the picture, for a camera (P,);
    not finite where it shows no ground.
    """
    ends = level_points(theta[None], segments.reshape(-1, 2), model)[0].reshape(segments.shape)
    span = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(span, axis=-1, keepdims=True), 1e-9)
    across = 0.5 * width_m * np.stack([-span[:, 1], span[:, 0]], axis=-1) / length
    middle = ends.mean(axis=1)
    rims = project(theta[None], np.concatenate([middle - across, middle + across])[None], model).pixels[0]
    step = segments[:, 1] - segments[:, 0]
    normal = np.stack([-step[:, 1], step[:, 0]], axis=-1) / np.linalg.norm(step, axis=-1, keepdims=True)
    count = len(segments)
    return np.asarray(np.abs(((rims[count:] - rims[:count]) * normal).sum(axis=-1)))

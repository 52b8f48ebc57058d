"""What a named picture should show and does not, and what it shows where no marking is."""

from __future__ import annotations

import numpy as np

from circlecal.camera_fit.curves import ground_hidden, line_curve
from circlecal.camera_fit.model import Frame, View, view
from circlecal.field import FieldTemplate
from circlecal.geometry.homogeneous import Array

SAMPLES = 48
"""Along each line of the template, and along each seen one."""
EXPECTED_WIDTHS = 0.15
"""A line of the template is expected to be seen where so much of it lies in the picture, in picture widths."""
NARROWEST_PX, USUAL_WIDTH_M = 0.5, 0.1
"""Paint that is narrower in the picture is not expected to be seen; its width where the template's has none."""
SEEN_SHARE = 0.25
"""It is, where so much of that is."""
END_SLACK_M = 2.0
"""How far a line may be seen beyond the end of its marking."""


def unseen_px(names: dict[int, str], segments: Array, theta: Array, template: FieldTemplate, frame: Frame) -> float:
    """Length in pixels of the lines that a camera (P,) expects in the picture and that are not seen there.

    Parameters
    ----------
    names : dict
        Template names by index of the seen line.
    segments : (S, 2, 2) array
        Ends of the seen lines.
    theta, template, frame : (P,) array, FieldTemplate, Frame
        Camera, field and picture.
    """
    ends = template.drawn_lines[0]
    share = np.linspace(0.0, 1.0, SAMPLES)
    field = ends[:, :1] + share[:, None] * (ends[:, 1:] - ends[:, :1])
    seen = view(theta[None], field[None, ..., 0].reshape(1, -1), field[None, ..., 1].reshape(1, -1), frame)
    x, y = seen.pixels[0].reshape(2, len(ends), SAMPLES)
    ahead = (seen.depth[0] > 0.1) & seen.unfolded[0]
    inside = ahead.reshape(len(ends), SAMPLES) & (x >= 0) & (x <= frame.width - 1)
    inside &= (y >= 0) & (y <= frame.height - 1)
    inside &= _across_px(seen, ends, template) > NARROWEST_PX
    step = np.hypot(np.diff(x), np.diff(y)) * (inside[:, 1:] & inside[:, :-1])
    expected = step.sum(axis=1)
    total = 0.0
    for k in np.flatnonzero(expected > EXPECTED_WIDTHS * frame.width).tolist():
        line = template.lines[k]
        found = [segments[s] for s, name in names.items() if name == line.name]
        covered = np.zeros(SAMPLES, dtype=np.bool_)
        metres = share * np.linalg.norm(ends[k, 1] - ends[k, 0])
        for segment in found:
            low, high = np.sort(_along(segment, k, theta, template, frame))
            covered |= (metres >= low) & (metres <= high)
        if step[k][covered[1:] | covered[:-1]].sum() < SEEN_SHARE * expected[k]:
            total += float(expected[k])
    return total


def _across_px(seen: View, ends: Array, template: FieldTemplate) -> Array:
    """Width of the paint in the picture (K, N), pixels, at the samples of lines with the ends (K, 2, 2)."""
    along = (ends[:, 1] - ends[:, 0]) / np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1, keepdims=True)
    x, y = np.repeat(along, SAMPLES, axis=0).T
    tangent, across = seen.along(x[None], y[None])[0], seen.along(-y[None], x[None])[0]
    area = np.abs(tangent[0] * across[1] - tangent[1] * across[0])
    width = max(template.marking_width_m, USUAL_WIDTH_M) * area / np.maximum(np.hypot(*tangent), 1e-9)
    return np.asarray(width.reshape(len(ends), SAMPLES))


def overhanging_px(
    names: dict[int, str], segments: Array, theta: Array, template: FieldTemplate, frame: Frame
) -> float:
    """Length in pixels of the seen lines that lies beyond the ends of their markings."""
    total = 0.0
    for s, name in names.items():
        k = next(k for k, line in enumerate(template.lines) if line.name == name)
        points = segments[s, 0] + np.linspace(0.0, 1.0, SAMPLES)[:, None] * (segments[s, 1] - segments[s, 0])
        along = _along(points, k, theta, template, frame)
        length = float(np.linalg.norm(template.drawn_lines[0][k, 1] - template.drawn_lines[0][k, 0]))
        beyond = (along < -END_SLACK_M) | (along > length + END_SLACK_M)
        total += float(beyond.mean() * np.linalg.norm(segments[s, 1] - segments[s, 0]))
    return total


def _along(points: Array, k: int, theta: Array, template: FieldTemplate, frame: Frame) -> Array:
    """Metres (N,) along a line of the template at which pixels (N, 2) lie."""
    line = template.lines[k]
    curve = line_curve(line.name, points, np.ones(len(points)), template.drawn_lines[0][k], template.drawn_lines[1][k])
    return np.asarray(ground_hidden(curve, theta[None], frame)[0])

"""Where an annotated halfway line ends.

SoccerNet's annotators mark the extremities of a straight line. Those of the halfway line that lie well inside the
picture are its ends on the touchlines, unless something hides the rest of it; they say how far away the touchline is,
which a circle alone says badly.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.field import FieldTemplate
from circlecal.observations import Keypoint, Observations

MARGIN_WIDTHS = 0.005
"""An end nearer to the border than this is where the picture cuts the line."""
SIGMA_FACTOR = 2.0
"""The corner of two bands of paint is found less well than a point across one of them."""


def with_halfway_ends(observations: Observations, template: FieldTemplate) -> Observations:
    """Add the halfway line's ends inside the picture as keypoints, seen from the main camera's side of the field."""
    name = template.halfway_line
    line = None if name is None else observations.line(name)
    if name is None or line is None or len(line.points_px) < 2:
        return observations
    ends_m = template.line_ends(template.line_by_name[name])
    upper, lower = (ends_m[int(k)] for k in (ends_m[:, 1].argmin(), ends_m[:, 1].argmax()))
    order = np.argsort(line.points_px[:, 1], kind="stable")
    margin = MARGIN_WIDTHS * observations.width
    inner = np.array([observations.width, observations.height]) - 1 - margin
    found = [
        Keypoint(f"{name} end {side}", field_m, line.points_px[k], SIGMA_FACTOR * float(line.sigma_px[k]))
        for side, field_m, k in (("top", upper, order[0]), ("bottom", lower, order[-1]))
        if (line.points_px[k] > margin).all() and (line.points_px[k] < inner).all()
    ]
    return replace(observations, keypoints=(*observations.keypoints, *found))

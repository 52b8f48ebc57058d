"""How far straight markings run before a camera: the halfway line to the ends of the field, and none through a circle
of which no halfway line is seen.
"""

from __future__ import annotations

import numpy as np

from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.medians import median_of_rows
from circlecal.geometry.projective import Array, Mask
from circlecal.line_naming.line_ends import FEWEST_POINTS, find_line_through
from circlecal.observations import MarkingKey, Observations
from circlecal.results import CameraFit, Check, Cues

REACH_SHARE = 0.95
"""Share of the halfway line's points that lie within its reach; a few may lie on something behind its end."""
STRAY_MEDIANS, LEAST_STRAY_PX = 5.0, 0.5
"""In medians of all distances from the camera's line, and pixels at 1920 px width, from where on a point of the halfway
line lies on something else: of 14 points on a player behind its end, on a rendered field, seven lie farther.
"""
REACH_WITH_END = 1.05
"""Half widths of the field that the halfway line may run where the camera was fitted to one of its ends: not past the
other one.
"""
CROSSED_BEYOND = 0.1
"""Half widths of the field by which the halfway line may cross another line beyond its end, where the camera was fitted
to a marking at that end: 27 such crossings of 45 real frames lie up to 0.003 beyond and 0.04 before it, that of a
rendered hall in which a streak of gloss was taken for the touchline 0.21 beyond.
"""
SURE_LINES = 4
"""So many further lines at their places leave no doubt about the size of the field."""
CLEAR_OF_RIM, LONGEST_CHORD = 0.85, 0.5
"""Inside this share of a circle's radius a straight marking is no piece of the circle, and the length there, in radii,
from which on it is a line that the circle does not have: a penalty arc that was taken for the circle in a rendered
frame has the penalty area's line through it for 1.1.
"""


def reach_checks(camera: CameraFit, cues: Cues, template: FieldTemplate, most: float) -> list[Check]:
    """The halfway line ends with the field: of a smaller circle on the same floor the field would be too small, and few
    of its lines would be there. Its points are taken to the surface, and the field is as broad, as the camera was
    fitted to them.

    Parameters
    ----------
    camera, cues, template : CameraFit, Cues, FieldTemplate
        What was fitted, to what, and the field.
    most : float
        How far the halfway line may be seen to run, in half widths of the field.
    """
    line = None if cues.halfway is None else template.line_by_name.get(cues.halfway.name or "")
    if cues.halfway is None or line is None or len(camera.named_lines) >= SURE_LINES:
        return []
    start, end = camera.view.grow(np.array([line.start, line.end]), template)
    middle, half = 0.5 * (start + end), 0.5 * (end - start)
    crossed_px = np.array([seen.point_px for seen in cues.halfway.ends if seen.crossed]).reshape(-1, 2)
    along, crossed = (
        (camera.view.to_field(points_px) - middle) @ half / (half @ half)
        for points_px in (cues.halfway.points_px, crossed_px)
    )
    along = along[_lie_on_line(camera, cues.halfway.points_px, middle, half, along)]
    checks = [_reach_check("line_reach", np.abs(along), most)]
    for seen_end, side in ((line.start, -1.0), (line.end, 1.0)):
        other = find_line_through(np.asarray(seen_end), line, template)
        if other is not None and MarkingKey(other.name) in camera.residuals_px:
            limit = min(REACH_WITH_END, most)
            checks.append(_reach_check("other_end_reach", -side * along, limit))
            reaches = (value for value in (side * crossed).tolist() if value > 0.0)
            checks += [Check.of("crossed_end_beyond", max(reach - 1.0, 0.0), CROSSED_BEYOND) for reach in reaches]
    return checks


def measure_beyond_ends(camera: CameraFit, observations: Observations, template: FieldTemplate) -> float:
    """Length over which one of the lines that carry a camera is seen beyond one of its ends, the most of all, picture
    widths, without gaps.
    """
    longest = 0.0
    for seen in observations.lines:
        line = template.line_by_name.get(seen.line or "")
        if line is None or MarkingKey(line.name) not in camera.residuals_px or len(seen.points_px) < FEWEST_POINTS:
            continue
        start, end = camera.view.grow(np.array([line.start, line.end]), template)
        along = (camera.view.to_field(seen.points_px) - start) @ (end - start) / ((end - start) @ (end - start))
        count = max(np.count_nonzero(along < 0.0), np.count_nonzero(along > 1.0))
        longest = max(longest, count * usual_step_px(seen.points_px) / camera.camera.width)
    return longest


def usual_step_px(points_px: Array) -> float:
    """Distance of neighbours among a line's points (N, 2) in order, pixels: times their number the length over which
    the line is seen, without its gaps.
    """
    return float(median_of_rows(np.linalg.norm(np.diff(points_px, axis=0), axis=1)))


def chord_checks(camera: CameraFit, cues: Cues, template: FieldTemplate, circle: Circle) -> list[Check]:
    """A circle of which no halfway line is seen has no other straight marking through it: what has one is an arc of a
    penalty area. A field with several circles is laid over the picture as a whole.
    """
    if cues.halfway is not None or template.halfway_line is None or len(template.circles) > 1:
        return []
    nameless = (
        camera.view.to_field(line.points_px) - np.asarray(circle.center)
        for k, line in enumerate(cues.lines)
        if line.name is None and k not in camera.names_by_line
    )
    inside = (off_m[np.hypot(*off_m.T) < CLEAR_OF_RIM * circle.radius_m] for off_m in nameless)
    lengths_m = [float(np.linalg.norm(np.ptp(off_m, axis=0))) for off_m in inside if len(off_m)]
    return [Check.of("chord_radii", max(lengths_m) / circle.radius_m, LONGEST_CHORD)] if lengths_m else []


def _lie_on_line(camera: CameraFit, points_px: Array, middle: Array, half: Array, along: Array) -> Mask:
    """Which points (N, 2) lie as near to the camera's line as most of them do: a player who stands behind its end hides
    it, and edges of his are followed in its place.
    """
    off_px = np.linalg.norm(camera.view.project(middle + along[:, None] * half) - points_px, axis=1)
    off_px = np.nan_to_num(off_px, nan=np.inf)
    return np.asarray(
        off_px <= max(STRAY_MEDIANS * float(np.median(off_px)), LEAST_STRAY_PX * camera.camera.width / 1920)
    )


def _reach_check(name: str, along: Array, limit: float) -> Check:
    """How far a line runs, by its points along it in half widths of the field."""
    reach = np.sort(np.nan_to_num(along, nan=np.inf))
    return Check.of(name, float(reach[int(REACH_SHARE * (len(reach) - 1))]), limit)

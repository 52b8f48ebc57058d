"""Where the search for a camera begins: at an earlier one, the circle, the lines around it, or other landmarks."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from circlecal.camera.multistart import Starts
from circlecal.camera.options import has_position
from circlecal.camera.problem import Problem
from circlecal.camera.starts_circle import MINIMUM_CIRCLE_POINTS, arc_starts, circle_starts, select_ellipse
from circlecal.camera.starts_landmarks import Landmarks, collect_landmarks, landmark_starts
from circlecal.estimation.task import Sight, Task
from circlecal.geometry.projective import Array
from circlecal.line_naming.around_circle import name_lines_around_circle
from circlecal.refusals import refuse

ENOUGH, ENOUGH_WITH_POSITION = 7, 4
"""Constraints that determine a camera without a circle: its unknowns with square pixels and a known principal point. A
point or a line brings two, a position three.
"""


def choose_sight(task: Task) -> Sight:
    """The circle's ellipse to start from, or landmarks where it shows none.

    Raises
    ------
    EstimationError
        ``no_circle``, ``no_ellipse`` where points, lines and arcs do not determine a camera either.
    """
    problem = task.problem()
    ellipse = select_ellipse(task.observations, task.circle, problem)
    if ellipse is not None:
        return Sight(problem, ellipse, None)
    landmarks = collect_landmarks(task.observations, task.template, problem.points, problem.usual_lens)
    _require_landmarks(task, landmarks)
    middle_m, by_growth = landmarks.middle_m(problem.model), problem.curves.common_shift
    priors = replace(problem.priors, center_m=middle_m, center_by_growth=by_growth)
    return Sight(replace(problem, priors=priors), None, landmarks)


def begin(task: Task, sight: Sight) -> Beginning:
    """The task with the names that starts need, its problem, and the starts of the first kind that applies.

    Raises
    ------
    EstimationError
        ``rotation_free`` where nothing says how the field is turned about the circle.
    """
    return next(found for of_kind in _BEGINNINGS if (found := of_kind(task, sight)) is not None)


Beginning = tuple[Task, Problem, Starts]


def _begin_earlier(task: Task, sight: Sight) -> Beginning | None:
    """From a camera of about the same observations."""
    return None if task.earlier is None else _begin_named(task, sight, task.earlier.theta, task.earlier.names_by_line)


def _begin_around_circle(task: Task, sight: Sight) -> Beginning | None:
    """From the circle and the nameless lines around it, where nothing else fixes how the field is turned."""
    if sight.ellipse is None or not _is_rotation_free(task):
        return None
    found = None
    if task.config.name_lines:
        ellipse, noise = sight.ellipse.ellipse, task.coarse_noise
        found = name_lines_around_circle(sight.problem, ellipse, task.observations, task.template, noise, task.side)
    if found is None:
        raise refuse("camera", "rotation_free")
    return _begin_named(task, sight, found.theta, found.names, found.arcs)


def _begin_named(
    task: Task, sight: Sight, theta: Array, lines: dict[int, str], arcs: dict[int, str] | None = None
) -> Beginning:
    """From one camera (P,) and the names that it gave to lines and arcs."""
    task = task.with_names(lines, arcs)
    follow_grid = sight.ellipse is not None and sight.ellipse.follows_grid(sight.problem)
    starts = Starts(theta[None], theta[None][:0], follow_grid)
    return task, replace(sight.problem, curves=task.curves()), starts


def _begin_circle(task: Task, sight: Sight) -> Beginning | None:
    """From the circle and what is known beside it."""
    if sight.ellipse is None:
        return None
    starts = circle_starts(sight.problem, task.observations, task.template, task.circle, sight.ellipse, task.side)
    return task, sight.problem, starts


def _begin_landmarks(task: Task, sight: Sight) -> Beginning | None:
    """From points, lines and other arcs."""
    if sight.landmarks is None:
        return None
    arcs = arc_starts(sight.problem, task.observations, task.template, task.side)
    return task, sight.problem, landmark_starts(sight.problem, sight.landmarks, arcs, task.side)


_BEGINNINGS: tuple[Callable[[Task, Sight], Beginning | None], ...] = (
    _begin_earlier, _begin_around_circle, _begin_circle, _begin_landmarks,
)  # fmt: skip
"""Where starts come from: the first that applies."""


def _is_rotation_free(task: Task) -> bool:
    """Whether nothing beside the circle says how the field is turned about it."""
    given, center = task.observations, np.asarray(task.circle.center)
    others = any(c.circle != task.circle.name for c in given.circles) or any(s.line is not None for s in given.lines)
    others = others or any(np.linalg.norm(k.field_m - center) > 1e-6 for k in given.keypoints)
    return not others and not has_position(task.config)


def _require_landmarks(task: Task, landmarks: Landmarks) -> None:
    """Refuse where points, lines and arcs determine no camera without the circle's ellipse."""
    circles, name = task.observations.circles, task.circle.name
    on_arcs = sum(min(5, len(c.points_px)) for c in circles)
    enough = ENOUGH_WITH_POSITION if has_position(task.config) else ENOUGH
    if len(landmarks) and 2 * len(landmarks) + on_arcs >= enough:
        return
    seen = max((len(c.points_px) for c in circles if c.circle == name), default=0)
    code, words = ("no_ellipse", f"{seen} points of") if seen else ("no_circle", "no points of")
    others = len(landmarks) + len({c.circle for c in circles if c.circle != name})
    raise refuse(
        "camera",
        code,
        f"{words} the circle {name!r} and {others} other marking{'' if others == 1 else 's'} were seen; "
        f"{-(-enough // 2)} lines and points are enough, or {MINIMUM_CIRCLE_POINTS} points of the circle",
    )

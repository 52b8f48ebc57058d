"""Stage ``camera``: the pinhole camera that explains everything that was seen, with priors and its covariance.

One ellipse brings five constraints and the halfway line two; a camera with square pixels and a known principal point
has seven unknowns. So neither the imaged
centre nor the second edge of the marking is needed; lens, principal point, crown and marking width enter with priors,
and so does their uncertainty.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.all_starts import (
    MINIMUM_CIRCLE_POINTS,
    SeenEllipse,
    circle_starts,
    landmark_starts,
    seen_ellipse,
    usual_lens,
)
from circlecal.camera.crown import on_parabola
from circlecal.camera.multistart import COARSE_POINTS, best_fit
from circlecal.camera.noise import as_measured, inflated
from circlecal.camera.observed import observed_curves, observed_points, stated_sigmas
from circlecal.camera.optimise import (
    COARSE,
    FINAL,
    Problem,
    State,
    best_of,
    continued,
    foreseen,
    minimise,
    reweighted,
)
from circlecal.camera.options import CameraConfig, position_known, priors_of, realism_of
from circlecal.camera.report import camera_fit
from circlecal.camera.residuals import CurvePoints, FixedPoints, ground_hidden, joined_curves
from circlecal.camera.starts_landmarks import Landmarks, seen_landmarks
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel
from circlecal.geometry.projective import Array, Mask
from circlecal.geometry.surface import Surface
from circlecal.line_naming.around_circle import names_around
from circlecal.line_naming.hypotheses import Naming, name_lines
from circlecal.line_naming.line_ends import same_markings, with_crossings
from circlecal.observations import CirclePoints, Observations
from circlecal.refusals import refuse
from circlecal.results import CameraFit

DENSE_POINTS = 60
"""Of a marking: so many tell their noise, and which of them lie on something else."""
OVERRULING_LINES = 3
"""So many different lines that get a name only without the seen ends of others show that those are none."""
SHORT_ARC_DEG = 200.0
"""Shorter arcs have local minima: the whole grid of starts is followed."""
ARC_SIGMA_PX = 0.5
"""Of the points of curves that were seen without a name, at 1920 px width."""
ENOUGH, ENOUGH_WITH_POSITION = 7, 4
"""Constraints that determine a camera without a circle; a point or a line brings two."""
WRONG_SIGMAS, WRONG_PX = 10.0, 10.0
"""A named line or arc whose points mostly lie further off, in both measures (pixels at 1920 px width), is not that."""
LENS_DOUBT, LENS_WIDER, LENS_EVIDENCE = 1.5, 4.0, 6.0
"""A radial distortion that lies so many standard deviations from what is usual is fitted with a prior so many times as
wide, and believed where that explains the frame so much better (chi-square): what the wider prior costs, and as much.
"""
CROWN_EVIDENCE = 3.0
"""By how much (half a chi-square) a parabolic pitch must explain a frame better than a roof to be believed."""


def estimate_camera(
    observations: Observations,
    template: FieldTemplate,
    circle: Circle,
    config: CameraConfig,
    camera_side: str = "main",
    earlier: CameraFit | None = None,
) -> CameraFit:
    """Maximum a posteriori camera.

    Parameters
    ----------
    observations : Observations
        Everything that was seen, with sigmas.
    template : FieldTemplate
        The field.
    circle : Circle
        The circle from which the starts are taken; where it is not seen, points, lines and other arcs stand for it.
    config : CameraConfig
        Model and priors.
    camera_side : str
        Which of the two solutions of the turned field is returned.
    earlier : CameraFit, optional
        Of about the same observations: the only start, and its names of the same lines hold.

    Raises
    ------
    EstimationError
        ``no_circle`` where nothing else determines a camera, ``no_ellipse``, ``rotation_free``, ``no_camera`` where no
        start leads to a camera above the ground.
    """
    model = ProjectionModel(
        observations.width, observations.height, Surface(config.usual_crown, max(circle.radius_m, 1e-3))
    )
    curves = observed_curves(observations, template, realism_of(config, observations.width))
    points = observed_points(observations, template)
    priors = priors_of(config, template, circle, model)
    problem = Problem(curves, points, priors, model)
    ellipse = seen_ellipse(observations, circle, problem)
    carrying = circle if ellipse is not None else None
    named: dict[int, str] = {}
    if ellipse is None:
        landmarks = seen_landmarks(observations, template, points, usual_lens(problem))
        _require_landmarks(observations, circle, landmarks, config)
        problem = replace(problem, priors=replace(priors, center_m=landmarks.middle_m(model)))
        closed, grid = landmark_starts(problem, observations, template, landmarks, camera_side)
    turning = earlier is None and ellipse is not None and _rotation_free(observations, circle, config)
    if earlier is not None:
        named, closed = earlier.names_by_line, earlier.theta[None]
    elif ellipse is not None and turning:
        around = _around(problem, ellipse, observations, template, config, camera_side)
        named, closed = around.names, around.theta[None]
        observations = _with_arcs(observations, around.arcs)
    elif ellipse is not None:
        closed, grid = circle_starts(problem, observations, template, circle, ellipse, camera_side)
    if turning or earlier is not None:
        grid, observations = closed[:0], _with_names(observations, named)
        curves = observed_curves(observations, template, realism_of(config, observations.width))
        problem = replace(problem, curves=curves)
    short = ellipse is not None and ellipse.arc_deg < SHORT_ARC_DEG and problem.priors.standing_m is None
    state = best_fit(problem, closed, grid, short, config, camera_side)
    rejected: tuple[str, ...] = ()
    contradicting = _contradicting(state, points)
    off = _contradicting_markings(problem, state, template, carrying)
    if contradicting.any() or off:
        rejected = (*(str(name) for name in np.array(points.names)[contradicting]), *sorted(off))
        keep = ~contradicting
        kept_names = tuple(str(name) for name in np.array(points.names)[keep])
        points = FixedPoints(points.field_m[keep], points.points_px[keep], points.sigma_px[keep], kept_names)
        observations = _without(observations, off)
        curves = observed_curves(observations, template, realism_of(config, observations.width))
        problem = replace(problem, points=points, curves=curves)
        state = best_fit(problem, np.concatenate([state.theta[:2], closed]), grid, short, config, camera_side)
    problem, state, scale = _settled(problem, state, config, COARSE)
    close = None
    more = _recognised(problem, state, curves, observations, template, config) if config.name_lines else None
    if more is None:
        close = None if named else _close_curves(curves, observations, template, config)
        if close is not None:
            problem, state, scale, close = as_measured(problem, state, close, config.loss_scale)
        state = continued(problem, state, config.loss_scale, config.iterations)
    else:
        problem, start, further = more
        named = named | further
        hidden = ground_hidden(problem.curves, start, model)
        state = minimise(problem, start, config.loss_scale, config.iterations, hidden, COARSE)
        problem, state, scale = _settled(problem, state, config, FINAL)
    if config.crown_shape == "auto" and config.shared is None:
        problem, state, scale = _clearly_curved(problem, state, scale, close, config)
    problem, state = _unusual_lens(problem, state, config)
    return camera_fit(
        problem,
        state,
        scale,
        rejected,
        named,
        circle,
        template,
        stated_sigmas(observations),
    )


def _dense(curves: CurvePoints) -> bool:
    return bool(np.bincount(curves.group, minlength=1).max() >= DENSE_POINTS)


def _close_curves(
    curves: CurvePoints, observations: Observations, template: FieldTemplate, config: CameraConfig
) -> CurvePoints | None:
    """The points of ``curves`` with the sigmas of a frame that shows nothing far from the circle; None where the points
    are too few to tell their noise.
    """
    if not config.noise_from_residuals or not _dense(curves):
        return None
    realism = realism_of(config, observations.width)
    close_px = config.close_sigma_px * observations.width / 1920.0
    return observed_curves(
        observations, template, replace(realism, model_sigma_px=min(realism.model_sigma_px, close_px))
    )


def _unusual_lens(problem: Problem, state: State, config: CameraConfig) -> tuple[Problem, State]:
    """The fit with little said of the radial distortion before, where what is usual clearly holds it back, else the one
    given. A few clicked points cannot say so.
    """
    sd = problem.priors.sd[INDEX["kappa_1"]]
    off = abs(float(state.theta[0, INDEX["kappa_1"]]) - problem.priors.mean[INDEX["kappa_1"]])
    if not 0 < sd < off / LENS_DOUBT or not _dense(problem.curves):
        return problem, state
    wider = problem.priors.sd.copy()
    wider[INDEX["kappa_1"]] *= LENS_WIDER
    free = replace(problem, priors=replace(problem.priors, sd=wider))
    found = minimise(free, state.theta[:1], config.loss_scale, config.iterations, state.hidden[:1])
    return (free, found) if found.cost[0] < state.cost[0] - LENS_EVIDENCE else (problem, state)


def _clearly_curved(
    problem: Problem, state: State, scale: float, close: CurvePoints | None, config: CameraConfig
) -> tuple[Problem, State, float]:
    """The fit with a parabolic pitch where it explains what was seen clearly better, else the one given."""
    curved, start = on_parabola(problem, best_of(state), config.loss_scale)
    start = foreseen(curved, start, config.loss_scale)
    if start.cost[0] > state.cost[0]:  # far from enough: the linear model knows it to a fraction of the evidence
        return problem, state, scale
    bar = float(state.cost[0]) - CROWN_EVIDENCE
    found = minimise(curved, start.theta, config.loss_scale, config.iterations, start.hidden, bar=bar)
    if found.cost[0] > bar:
        return problem, state, scale
    if close is not None:
        # what the roof left of the residuals was no noise
        curved, found, scale, _ = as_measured(curved, found, close, config.loss_scale)
        return curved, continued(curved, found, config.loss_scale, config.iterations), scale
    return _settled(curved, found, config, FINAL)


def _recognised(
    problem: Problem,
    state: State,
    curves: CurvePoints,
    observations: Observations,
    template: FieldTemplate,
    config: CameraConfig,
) -> tuple[Problem, Array, dict[int, str]] | None:
    """The problem with the straight markings that can be named and the ends of lines beside the markings ``curves``
    with their first sigmas, a start (1, P) for it, and the names by index of the seen line; None where there is nothing
    more.
    """
    realism = realism_of(config, observations.width)
    coarse = replace(realism, maximum_points=COARSE_POINTS)
    fuller, with_ends, met = with_crossings(problem, state, observations, template, config.loss_scale)
    found = name_lines(fuller, with_ends, observations, template, coarse, config.loss_scale, met)
    if met and not found.names:
        # an end may be a cover's edge: only a whole structure of lines says so
        others = name_lines(problem, state, observations, template, coarse, config.loss_scale)
        # and a line that passes through the end tells better where it runs
        if len(set(others.names.values())) >= OVERRULING_LINES or same_markings(others.names, met, observations):
            met, found = (), others
    if not met and not found.names:
        return None
    lines = (*met, *(replace(observations.lines[k], line=name) for k, name in sorted(found.names.items())))
    further = observed_curves(replace(observations, circles=(), lines=lines), template, realism)
    return replace(problem, curves=joined_curves(curves, further)), found.theta[None], found.names


def _settled(problem: Problem, state: State, config: CameraConfig, tolerance: float) -> tuple[Problem, State, float]:
    """Optimise once more with the sigmas that the residuals ask for."""
    best = best_of(state)
    scale = 1.0
    if config.noise_from_residuals:
        curves, scale = inflated(problem, best)
        problem, best = reweighted(problem, best, curves.sigma_px, config.loss_scale)
    return problem, continued(problem, best, config.loss_scale, config.iterations, tolerance), scale


def _around(
    problem: Problem,
    seen: SeenEllipse,
    observations: Observations,
    template: FieldTemplate,
    config: CameraConfig,
    side: str,
) -> Naming:
    """Names of nameless straight lines that fix the rotation about the circle."""
    coarse = replace(realism_of(config, observations.width), maximum_points=COARSE_POINTS)
    found = None
    if config.name_lines:
        found = names_around(problem, seen.ellipse, observations, template, coarse, config.loss_scale, side)
    if found is None:
        raise refuse("camera", "rotation_free")
    return found


def _with_names(observations: Observations, names: dict[int, str]) -> Observations:
    lines = tuple(replace(line, line=names.get(k, line.line)) for k, line in enumerate(observations.lines))
    return replace(observations, lines=lines)


def _with_arcs(observations: Observations, names: dict[int, str]) -> Observations:
    sigma_px = ARC_SIGMA_PX * observations.width / 1920.0
    arcs = (
        CirclePoints(name, "center", points, np.full(len(points), sigma_px))
        for points, name in ((observations.curves[k], name) for k, name in names.items())
    )
    return replace(observations, circles=(*observations.circles, *arcs))


def _rotation_free(observations: Observations, circle: Circle, config: CameraConfig) -> bool:
    center = np.asarray(circle.center)
    others = any(c.circle != circle.name for c in observations.circles) or any(
        s.line is not None for s in observations.lines
    )
    others = others or any(np.linalg.norm(k.field_m - center) > 1e-6 for k in observations.keypoints)
    return not others and not position_known(config)


def _require_landmarks(observations: Observations, circle: Circle, landmarks: Landmarks, config: CameraConfig) -> None:
    """Whether points, lines and arcs determine a camera where the circle shows no ellipse."""
    on_arcs = sum(min(5, len(c.points_px)) for c in observations.circles)
    enough = ENOUGH_WITH_POSITION if position_known(config) else ENOUGH
    if len(landmarks) and 2 * len(landmarks) + on_arcs >= enough:
        return
    seen = max((len(c.points_px) for c in observations.circles if c.circle == circle.name), default=0)
    code, words = ("no_ellipse", f"{seen} points of") if seen else ("no_circle", "no points of")
    raise refuse(
        "camera",
        code,
        f"{words} the circle {circle.name!r} were seen, and the {len(landmarks)} points and named lines beside it "
        f"do not determine a camera: show {-(-enough // 2)} of them, or {MINIMUM_CIRCLE_POINTS} points of the circle",
    )


def _contradicting(state: State, points: FixedPoints) -> Mask:
    """Marks and keypoints (M,) that lie further from where the camera puts them than their sigma can explain."""
    values = state.point_values[0].reshape(len(points.names), 2) if points.names else np.zeros((0, 2))
    return np.asarray(np.linalg.norm(values, axis=-1) > 5.0, dtype=bool)


def _contradicting_markings(problem: Problem, state: State, template: FieldTemplate, circle: Circle | None) -> set[str]:
    """Named lines and arcs that lie far from where the camera puts them; never the circle and the halfway line beside
    it, which the verdict judges.
    """
    sigma, values = problem.curves.sigma_px, np.abs(state.residuals[0])
    least = WRONG_PX * problem.model.width / 1920.0
    found = set()
    for group, name in enumerate(problem.curves.names):
        own = problem.curves.group == group
        carrying = circle is not None and (name == template.halfway_line or name.startswith(f"{circle.name} "))
        if not carrying and np.median(values[own]) > WRONG_SIGMAS and np.median((values * sigma)[own]) > least:
            found.add(name)
    return found


def _without(observations: Observations, names: set[str]) -> Observations:
    return replace(
        observations,
        circles=tuple(c for c in observations.circles if f"{c.circle} {c.edge}" not in names),
        lines=tuple(line for line in observations.lines if line.line not in names),
    )

"""A circle without a line through its middle: which markings the other straight lines are, and so how it is turned.

A circle leaves a camera free to go round it, and focal length, distance and tilt vague. What a straight line is seen
to be, as the paint on the ground, is then known up to that turn: a line at some distance from the circle's centre. So
each long line is taken for every marking of the field in turn, which fixes the turn; circle and line together have
the seven constraints of a pinhole camera. The other lines must then fall on markings too; a long touchline is enough by
itself where nothing else that it would have to show is missing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from circlecal.camera.observed import NoiseModel
from circlecal.camera.priors import Priors
from circlecal.camera.problem import COARSE, FAR_LOSS, Problem, State, minimise
from circlecal.camera.residuals import circle_curve, curve_residuals, ground_feet, join_curves
from circlecal.camera.viewing_coordinates import VIEWING, from_viewing, to_viewing
from circlecal.field import Arc, FieldTemplate
from circlecal.geometry.camera_parameters import camera_of
from circlecal.geometry.ellipses import Ellipse
from circlecal.geometry.homography import SIDES
from circlecal.geometry.projective import Array, Mask, lift
from circlecal.line_naming.association import Association
from circlecal.line_naming.hypotheses import (
    FIT_ITERATIONS,
    Naming,
    NamingScene,
    Trial,
    find_nameless_lines,
    make_naming_scene,
    match_further_lines,
    select_trial,
    try_names,
)
from circlecal.line_naming.predicted_markings import missing_px, overhang_px
from circlecal.observations import MarkingKey, Observations

Arcs = dict[int, str]
"""Names of arcs by number of the curve."""
DISTANCES, TILT_FACTORS = (4.0, 6.0, 9.0, 13.0), (0.7, 1.0, 1.4)
"""Cameras from which hypotheses start: distances in radii of the circle, and the axis ratio of the ellipse that they
see over that which is seen.
"""
CIRCLE_POINTS, WORST_START = 48, 100.0
"""Points of the circle that cameras are fitted to before hypotheses start from them, and by how much such a camera may
fit worse than the best (chi-square).
"""
LONGEST = 5
"""So many lines are taken for every marking."""
OFFSET_RATIO = (0.5, 2.0)
"""How much nearer or further than its marking a line may lie under a camera of which only the turn is known."""
SLACK = 0.35
"""How far a line may then reach beyond its marking, in lengths of it."""
FOLLOWED = 10
"""How many hypotheses are completed with the other lines."""
FEWEST_NAMES, TOUCH_M = 2, 0.3
"""One line beside a circle can be several markings: so many different ones must be recognised, or one and the arc that
ends on it, this near.
"""
LONG_WIDTHS = 0.45
"""One touchline is enough where so much of it is seen, picture widths: other markings are a sixth as long, and what
they would have to show beside them is missing.
"""
CURVE_POINTS, CURVE_SIGMA_PX, CURVE_PX, CURVE_SHARE, ARC_SLACK = 40, 0.5, 3.0, 0.5, 0.15
"""A curve is an arc of the field where this share of its points lies so near to it (pixels at 1920 px width), and
hardly beyond its ends (radians).
"""
OVERHANG_COST = 2.0
"""Pixels of explained line that one pixel of overhang beyond the end of a marking outweighs."""
EXPLAINED_SHARE = 0.5
"""Length of what is recognised, arcs among it, as a share of that of all straight lines: the least."""


def name_lines_around_circle(
    problem: Problem,
    ellipse: Ellipse,
    observations: Observations,
    template: FieldTemplate,
    noise: NoiseModel,
    side: str,
) -> Naming | None:
    """Names of straight markings beside a circle whose rotation nothing else fixes.

    Parameters
    ----------
    problem : Problem
        The circle and the priors.
    ellipse : Ellipse
        The circle as it is seen, in undistorted pixels.
    observations, template : Observations, FieldTemplate
        With the nameless lines, and the field.
    noise : NoiseModel
        How points are thinned and trusted while hypotheses are compared.
    side : str
        Side of the field from which the camera looks: of a field and the same turned by 180 degrees one is wanted.

    Returns
    -------
    Naming or None
        None where fewer than two markings are recognised, or other names explain about as much.
    """
    unnamed = find_nameless_lines(observations)
    if not unnamed:
        return None
    reach = max(float(np.linalg.norm(np.ptp(observations.lines[k].points_px, axis=0))) for k in unnamed)
    is_long = reach > LONG_WIDTHS * observations.width
    if len(unnamed) + len(observations.curves) < FEWEST_NAMES and not is_long:
        return None
    cameras = _fit_cameras_around_circle(problem, ellipse)
    fitted = minimise(problem, cameras.theta[:1], COARSE)
    scene = make_naming_scene(unnamed, problem, fitted, observations, template, noise)
    if template.halfway_line is not None:
        scene = replace(scene, known=(*scene.known, template.halfway_line))
    hypotheses, turned = _match_directions(scene, cameras.theta, side)
    if not hypotheses:
        return None
    likely = _select_best_of_each(try_names(_stiffen(scene), hypotheses, turned))
    trials = try_names(scene, [trial.association for trial in likely], np.array([trial.theta for trial in likely]))
    trials = match_further_lines(scene, trials, len(trials))
    trials = [_subtract_contradictions(scene, trial) for trial in trials]
    trials, arcs = _add_curves(scene, trials, observations.curves)
    best = select_trial(trials, observations.width)
    if best is None:
        return None
    named = next(found for trial, found in zip(trials, arcs, strict=True) if trial is best)
    names = set(best.association.names.values())
    is_alone = len(names) < FEWEST_NAMES and not any(_is_ending_on(template, arc, names) for arc in named.values())
    if is_alone and not (best.explained_px > LONG_WIDTHS * observations.width and _is_bounding(template, names)):
        return None
    lengths = np.linalg.norm(scene.segments[:, 1] - scene.segments[:, 0], axis=-1)
    if best.explained_px < EXPLAINED_SHARE * lengths.sum():
        return None
    return Naming({unnamed[k]: name for k, name in best.association.names.items()}, best.theta, named)


def _fit_cameras_around_circle(problem: Problem, ellipse: Ellipse) -> State:
    """Cameras at several distances and heights that see the circle about as it is seen, the best first.

    Without priors of their place they stay about where they start from along what the circle leaves open.
    """
    curves, center = problem.curves, problem.priors.center_m
    few = curves.select(np.arange(0, len(curves.points_px), max(1, len(curves.points_px) // CIRCLE_POINTS)))
    priors = replace(problem.priors, distance_log_sd=np.inf, elevation_sd_rad=np.inf, shared=None)
    distance, factor = (g.ravel() for g in np.meshgrid(DISTANCES, TILT_FACTORS))
    radius = float(curves.radius[0])
    viewing = np.zeros((len(distance), VIEWING))
    viewing[:, 0] = np.log(ellipse.semi_axes[0] * distance)
    viewing[:, 1:3] = ellipse.center - problem.model.center
    viewing[:, 4] = np.log(radius * distance)
    viewing[:, 6] = np.arcsin(np.clip(ellipse.axis_ratio * factor, 0.03, 0.97))
    starts = np.tile(np.where(np.isfinite(priors.mean), priors.mean, 0.0), (len(viewing), 1))
    starts[:, :VIEWING] = from_viewing(viewing, center)
    far = replace(problem, curves=few, priors=priors, loss_scale=FAR_LOSS * problem.loss_scale)
    found = minimise(far, starts, replace(COARSE, iterations=FIT_ITERATIONS))
    return found.best(int((found.cost < found.cost.min() + WORST_START).sum()))


def _fix_lens(priors: Priors) -> Priors:
    """Priors that leave pose and focal length free and fix everything else at what is expected."""
    sd = priors.sd.copy()
    sd[VIEWING:] = 0.0
    return replace(priors, sd=sd, mean=np.where(np.isfinite(priors.mean), priors.mean, 0.0))


def _match_directions(scene: NamingScene, cameras: Array, side: str) -> tuple[list[Association], Array]:
    """Each long line as each marking that it may be, and cameras (B, P) turned so that both are parallel."""
    model, template = scene.problem.model, scene.template
    center = scene.problem.priors.center_m
    lengths = np.linalg.norm(scene.segments[:, 1] - scene.segments[:, 0], axis=-1)
    longest = np.argsort(-lengths, kind="stable")[:LONGEST]
    drawn = [k for k, line in enumerate(template.lines) if line.name not in scene.known]
    ends = template.drawn_lines[0][drawn] - center
    normal, offset = _normals(ends)
    hypotheses: list[Association] = []
    found = []
    for theta in cameras:
        seen = camera_of(theta, model).back_project(scene.segments[longest]) - center
        seen_normal, seen_offset = _normals(seen)
        turn = np.arctan2(normal[:, 1], normal[:, 0]) - np.arctan2(seen_normal[:, 1], seen_normal[:, 0])[:, None]
        around = np.repeat(to_viewing(theta[None], center), turn.size, axis=0)
        around[:, 5] -= turn.ravel()
        turned = np.repeat(theta[None], turn.size, axis=0)
        turned[:, :7] = from_viewing(around, center)
        with np.errstate(invalid="ignore", divide="ignore"):
            ratio = seen_offset[:, None] / offset
            possible = (ratio > OFFSET_RATIO[0]) & (ratio < OFFSET_RATIO[1]) & _lie_beside(seen, turn, ends)
        possible &= ((turned[:, 4:6] - center) @ np.array(SIDES[side]) >= 0).reshape(turn.shape)
        hypotheses += [
            Association({int(longest[k]): template.lines[drawn[t]].name}, float(lengths[longest[k]]), 0.0)
            for k, t in np.argwhere(possible)
        ]
        found.append(turned[possible.ravel()])
    return hypotheses, np.concatenate(found)


def _lie_beside(seen: Array, turn: Array, ends: Array) -> Mask:
    """Whether lines with the ends (S, 2, 2), turned by (S, T), lie beside markings with the ends (T, 2, 2), not beyond
    them.
    """
    c, s = np.cos(turn)[..., None], np.sin(turn)[..., None]
    x, y = seen[:, None, :, 0], seen[:, None, :, 1]
    turned = np.stack([c * x - s * y, s * x + c * y], axis=-1)
    span = ends[:, 1] - ends[:, 0]
    share = ((turned - ends[None, :, :1]) * span[:, None]).sum(axis=-1) / (span**2).sum(axis=-1)[:, None]
    return np.asarray(((share > -SLACK) & (share < 1.0 + SLACK)).all(axis=-1))


def _stiffen(scene: NamingScene) -> NamingScene:
    """The scene with everything but pose and focal length fixed, which far starts would bend, and with a loss that
    pulls from far.
    """
    problem = scene.problem
    stiff = replace(problem, priors=_fix_lens(problem.priors), loss_scale=FAR_LOSS * problem.loss_scale)
    return replace(scene, problem=stiff)


def _normals(ends: Array) -> tuple[Array, Array]:
    """Unit normals (K, 2) of lines through ends (K, 2, 2), away from the origin, and their distances (K,)."""
    span = ends[:, 1] - ends[:, 0]
    normal = np.stack([-span[:, 1], span[:, 0]], axis=-1) / np.linalg.norm(span, axis=-1, keepdims=True)
    offset = (normal * ends[:, 0]).sum(axis=-1)
    sign = np.where(offset < 0, -1.0, 1.0)
    return normal * sign[:, None], offset * sign


def _subtract_contradictions(scene: NamingScene, trial: Trial) -> Trial:
    """The trial with what the picture should show under it and does not, and the other way round, in its score."""
    names, model, template = trial.association.names, scene.problem.model, scene.template
    missing = missing_px(names, scene.segments, trial.theta, template, model)
    overhang = overhang_px(names, scene.segments, trial.theta, template, model)
    return replace(trial, score=trial.score - missing - OVERHANG_COST * overhang)


def _add_curves(scene: NamingScene, trials: list[Trial], curves: tuple[Array, ...]) -> tuple[list[Trial], list[Arcs]]:
    """The trials with what a nameless curve adds where it is an arc of the field, fitted together with it; and which
    curve is which arc.
    """
    arcs: list[Arcs] = [{} for _ in trials]
    for number, points in enumerate(curves):
        length = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
        for arc in scene.template.arcs:
            fitted, share = _fit_with_arc(scene, trials, points[:: max(1, len(points) // CURVE_POINTS)], arc)
            for k, trial in enumerate(fitted):
                gain = share[k] * length if share[k] >= CURVE_SHARE else 0.0
                if gain > 0.0 and number not in arcs[k] and trial.score + gain > trials[k].score:
                    trials[k] = replace(trial, score=trial.score + gain, explained_px=trial.explained_px + gain)
                    arcs[k] = arcs[k] | {number: arc.name}
    return trials, arcs


def _fit_with_arc(scene: NamingScene, trials: list[Trial], points: Array, arc: Arc) -> tuple[list[Trial], Array]:
    """The trials fitted once more with points (N, 2) on an arc, and the share (B,) of these that then lie on it."""
    model, template, unit = scene.problem.model, scene.template, scene.unit
    radius = template.radius(arc, "center")
    sigma, shift = np.full(len(points), CURVE_SIGMA_PX * unit), template.place_shift(arc.center)
    drawn = circle_curve(MarkingKey(arc.name), points, sigma, np.array(arc.center), radius, 0, 0, shift)
    fuller = replace(
        scene,
        problem=replace(scene.problem, curves=join_curves(scene.problem.curves, drawn)),
        before_px=np.append(scene.before_px, np.inf),
        allowed_px=np.append(scene.allowed_px, 0.0),
        painted_px=np.append(scene.painted_px, 0.0),
    )
    fitted = try_names(fuller, [trial.association for trial in trials], np.array([trial.theta for trial in trials]))
    cameras = np.array([trial.theta for trial in fitted])
    near = curve_residuals(drawn, cameras, ground_feet(drawn, cameras, model), model)
    middle, half = np.radians((arc.start_deg + arc.end_deg) / 2), np.radians((arc.end_deg - arc.start_deg) / 2)
    aside = np.abs((near.feet - middle + np.pi) % (2 * np.pi) - np.pi)
    on = (np.abs(near.values) * CURVE_SIGMA_PX < CURVE_PX) & (aside < half + ARC_SLACK) & ~near.behind
    return fitted, on.mean(axis=1)


def _is_bounding(template: FieldTemplate, lines: set[str]) -> bool:
    """Whether lines run along a whole side of the field, as no other marking does."""
    ends = np.array([template.line_ends(template.line_by_name[name]) for name in lines])
    return bool((np.ptp(ends[..., 0], axis=1) > template.length_m - 2.0 * template.marking_width_m).all())


def _is_ending_on(template: FieldTemplate, arc: str, lines: set[str]) -> bool:
    """Whether an arc ends on one of the lines."""
    drawn = template.polylines()[arc][[0, -1]]
    coordinates = np.array([template.line_coordinates(template.line_by_name[name]) for name in lines])
    return bool((np.abs(lift(drawn) @ coordinates.T) < TOUCH_M).all(axis=0).any())


def _select_best_of_each(trials: list[Trial]) -> list[Trial]:
    """The best trial of each pair of a line and a name, the best of these."""
    best: dict[tuple[tuple[int, str], ...], Trial] = {}
    for trial in trials:
        key = tuple(trial.association.names.items())
        if key not in best or trial.score > best[key].score:
            best[key] = trial
    return sorted(best.values(), key=lambda t: -t.score)[:FOLLOWED]

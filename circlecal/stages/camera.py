"""Stage ``camera``: the pinhole camera that explains everything that was seen, with priors and its covariance.

One ellipse brings five constraints and the halfway line two; a camera with square pixels and a known principal point
has seven unknowns. So neither the imaged centre nor the second edge of the marking is needed; lens, principal point,
crown and marking width enter with priors, and so does their uncertainty.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field, replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.multistart import COARSE_POINTS, Starts, find_optima
from circlecal.camera.noise import noise_of_misfit, rescale_and_reject, rescale_sigmas
from circlecal.camera.observed import NoiseModel, curves_from_observations, median_sigmas, points_from_observations
from circlecal.camera.options import CameraConfig, has_position, noise_model, priors_of
from circlecal.camera.priors import Priors
from circlecal.camera.problem import (
    COARSE,
    FINAL,
    Problem,
    State,
    bend_surface,
    evaluate,
    minimise,
    predict_step,
    resume,
    reweight,
    with_priors,
)
from circlecal.camera.report import camera_fit
from circlecal.camera.residuals import CurvePoints, ground_feet, join_curves
from circlecal.camera.spike_and_slab import (
    UNLIKELY_SHARE,
    USUAL,
    Answer,
    Posterior,
    World,
    answers_in,
    depends_on_size,
    log_evidence,
    mix,
    possible_worlds,
    posterior_shares,
    share_noise,
)
from circlecal.camera.starts_circle import (
    MINIMUM_CIRCLE_POINTS,
    SeenEllipse,
    arc_starts,
    circle_starts,
    select_ellipse,
)
from circlecal.camera.starts_landmarks import Landmarks, collect_landmarks, landmark_starts
from circlecal.field import Circle, FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, ProjectionModel
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array, Mask
from circlecal.geometry.surface import Surface
from circlecal.line_naming.around_circle import name_lines_around_circle
from circlecal.line_naming.hypotheses import name_lines
from circlecal.line_naming.line_ends import add_line_ends, agree_with_ends
from circlecal.observations import CirclePoints, MarkingKey, Observations
from circlecal.refusals import refuse
from circlecal.results import CameraFit

DENSE_POINTS = 60
"""Of a marking: so many tell their noise, and which of them lie on something else; clicked ones are fewer."""
OVERRULING_LINES = 3
"""So many different lines that get a name only without the seen ends of others show that those are none."""
ARC_SIGMA_PX = 0.5
"""Of the points of curves that were seen without a name, at 1920 px width."""
ENOUGH, ENOUGH_WITH_POSITION = 7, 4
"""Constraints that determine a camera without a circle: its unknowns with square pixels and a known principal point. A
point or a line brings two, a position three.
"""
OFF_SIGMAS = 5.0
"""A mark or keypoint further from where the camera puts it is wrong: normal errors go so far once in 270,000."""
WORTH_LEAVING_OUT, LONE_SIGMAS = 4.0, 4.5
"""By how much chi-square must fall without a mark that nothing else checks for it to be left out in earnest, and how
many standard deviations from where the others put it it is something else then. Centre marks of 45 real frames lie 3.4
off at most; a foot that was taken for one in a rendered frame 8.0, marks of pictures that no camera took mostly 6.9 to
7.4.
"""
WRONG_SIGMAS, WRONG_PX = 10.0, 10.0
"""A named line or arc whose points mostly lie further off, in both measures (pixels at 1920 px width), is not that."""
LENS_DOUBT, LENS_WIDER, LENS_EVIDENCE = 1.5, 4.0, 6.0
"""A radial distortion that lies so many standard deviations from what is usual is fitted with a prior so many times as
wide, and believed where that explains the frame so much better (chi-square): what the wider prior costs, and as much.
"""
DOUBTED_SHARE = 0.1
"""Posterior probability of another size from which on the lines are named anew for such a field: below it the second
naming costs more time than it mends. Chosen without a measurement of its own.
"""
SEVERAL_LINES = 2
"""So many further markings at their places on a usual field leave little doubt about its size."""
MISFIT_SCALE, SIZE_EVIDENCE = 2.0, 3.0
"""Where noise had to grow so many times for a field of the usual size, it may be the size that does not fit; by how
much (logarithm of the evidence) a field of any size must then be likelier to be believed. Of 30 real frames of fields
of the usual size it reaches 0.3 in one, -2.6 in another and less in all others, whose misfit comes from the lens; of
two frames of a field of another size 2.9 and 4.1; of a rendered part of a circle beside a touchline 78.9 m apart from
the other one, 8.7.
"""
ALIKE_COST, DISTINCT_COST = 6.0, 30.0
"""Two optima are both followed where their chi-square differs by less than the first, and would differ by more than the
second if they lay in one valley: odds of 20 : 1, and five standard deviations. In a rendered hall cameras 12 m and 29 m
from the circle differ by 0.2.
"""
FEWEST_POINTS, NAMELESS_WIDTHS = 8, 0.2
"""Points of a line that is worth a name, and length in picture widths of one that needs one."""
CROWN_EVIDENCE = 3.0
"""By how much (half a chi-square) a parabolic pitch must explain a frame better than a roof to be believed."""


@dataclass(frozen=True, slots=True)
class _Task:
    """What a camera is estimated from, and with; the names of lines, by index, were given to them here."""

    observations: Observations
    template: FieldTemplate
    circle: Circle
    config: CameraConfig
    side: str
    earlier: CameraFit | None
    names: dict[int, str] = field(default_factory=dict)

    @property
    def noise(self) -> NoiseModel:
        """How far points are trusted."""
        return noise_model(self.config, self.observations.width)

    @property
    def coarse_noise(self) -> NoiseModel:
        """How far, and how many, while hypotheses are only compared."""
        return replace(self.noise, maximum_points=COARSE_POINTS)

    def curves(self) -> CurvePoints:
        """All named circles, arcs and lines."""
        return curves_from_observations(self.observations, self.template, self.noise)

    def problem(self) -> Problem:
        """All that is seen, and the priors."""
        reference_m = max(self.circle.radius_m, 1e-3)
        surface = Surface(self.config.usual_crown, reference_m)
        model = ProjectionModel(self.observations.width, self.observations.height, surface)
        priors = priors_of(self.config, self.template, self.circle, model)
        points = points_from_observations(self.observations, self.template)
        return Problem(self.curves(), points, priors, model, self.config.loss_scale)

    def rule(self, rule: StoppingRule, bar: float = np.inf) -> StoppingRule:
        """A stopping rule with the limit of iterations that the options set."""
        return replace(rule, iterations=self.config.iterations, bar=bar)

    def with_names(self, lines: dict[int, str], arcs: dict[int, str] | None = None) -> _Task:
        """The task with names of seen lines and curves, by their index."""
        given = self.observations
        named = tuple(replace(line, line=lines.get(k, line.line)) for k, line in enumerate(given.lines))
        sigma_px = ARC_SIGMA_PX * given.width / 1920.0
        found = ((name, given.curves[k]) for k, name in (arcs or {}).items())
        circles = (CirclePoints(name, "center", points, np.full(len(points), sigma_px)) for name, points in found)
        observations = replace(given, lines=named, circles=(*given.circles, *circles))
        return replace(self, observations=observations, names=lines)

    def without(self, keys: Collection[MarkingKey]) -> _Task:
        """The task without some of its markings."""
        given = self.observations
        circles = tuple(circle for circle in given.circles if circle.key not in keys)
        lines = tuple(line for line in given.lines if line.key not in keys)
        return replace(self, observations=replace(given, circles=circles, lines=lines))


@dataclass(frozen=True, slots=True)
class _Sight:
    """A task as a problem, with what starts can come from: the circle's ellipse, or where it shows none, landmarks."""

    problem: Problem
    ellipse: SeenEllipse | None
    landmarks: Landmarks | None


@dataclass(frozen=True, slots=True)
class _Fit:
    """Where the estimate stands.

    Attributes
    ----------
    problem, state : Problem, State
        With the standard deviations of the moment.
    scale : float
        By how much these have grown.
    least : CurvePoints or None
        Points with the least standard deviations that they can have, where the residuals have told the noise.
    posterior : Posterior or None
        What is assumed of the field, and what else it may be like; None where there is no choice.
    given_px : (N,) array or None
        Standard deviations of the points before their residuals told more; None where they did not.
    """

    problem: Problem
    state: State
    scale: float = 1.0
    least: CurvePoints | None = None
    posterior: Posterior | None = None
    given_px: Array | None = None


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
    task = _Task(observations, template, circle, config, camera_side, earlier)
    sight = _choose_sight(task)
    task, problem, starts = next(found for begin in _BEGINNINGS if (found := begin(task, sight)) is not None)
    state = find_optima(problem, starts, config, camera_side)
    wrong_points = _find_contradicting_points(problem, state) | _find_lone_contradiction(task, problem, state)
    wrong_markings = _find_contradicting_markings(task, problem, state, sight)
    rejected = (*problem.points.select(wrong_points).keys, *wrong_markings)
    if rejected:
        task = task.without(wrong_markings)
        problem = replace(problem, points=problem.points.select(~wrong_points), curves=task.curves())
        state = find_optima(problem, starts.continue_from(state), config, camera_side)
    finished = [
        _choose_world(task, problem.curves, fit, _complete(task, problem.curves, fit))
        for fit in (_settle(task, problem, start, COARSE) for start in _distinct_optima(problem, state))
    ]
    task, fit = _choose_optimum(finished, len(problem.curves.keys)) if len(finished) > 1 else finished[0]
    stated = median_sigmas(task.observations)
    return camera_fit(fit.problem, fit.state, fit.scale, rejected, task.names, circle, template, stated, fit.posterior)


def _distinct_optima(problem: Problem, state: State) -> list[State]:
    """The best optimum, and one that explains what was seen as well with quite another camera: a circle that is seen
    nearly edge-on has two. The camera of the turned field does not count.
    """
    best = state.best()
    away, place = state.theta - best.theta, state.theta[:, 4:6] - problem.priors.center_m
    own = best.theta[:, 4:6] - problem.priors.center_m
    is_turned = np.linalg.norm(place + own, axis=1) < np.linalg.norm(place - own, axis=1)
    is_distinct = ((away @ best.normal[0]) * away).sum(axis=1) > DISTINCT_COST
    rivals = np.flatnonzero(is_distinct & ~is_turned & (state.cost < best.cost + ALIKE_COST))
    return [best, state.select(rivals).best()] if len(rivals) else [best]


def _choose_optimum(finished: list[tuple[_Task, _Fit]], known: int) -> tuple[_Task, _Fit]:
    """The likelier of two cameras, each with the lines that it names, widened by the other."""
    alike = share_noise([(fit.problem, fit.state) for _, fit in finished])
    worlds = [USUAL if fit.posterior is None else fit.posterior.world for _, fit in finished]
    evidence = [log_evidence(world, *own, known) for world, own in zip(worlds, alike, strict=True)]
    (task, fit), (_, other) = (finished[k] for k in np.argsort(evidence)[::-1])
    share = 1.0 / (1.0 + float(np.exp(-abs(evidence[0] - evidence[1]))))
    if share > 1.0 - UNLIKELY_SHARE:
        return task, fit
    mine, its = (f.posterior or Posterior(USUAL, 1.0, np.zeros_like(f.state.normal[0]), 1.0) for f in (fit, other))
    away = other.state.theta[0] - fit.state.theta[0]
    covariance = its.widen(posterior_covariance(other.state.normal[0], other.problem.priors.sd))
    others = share * mine.others + (1.0 - share) * (covariance + np.outer(away, away))
    usual = share * mine.usual_share + (1.0 - share) * its.usual_share
    return task, replace(fit, posterior=Posterior(mine.world, share * mine.share, others, usual))


def _complete(task: _Task, stated: CurvePoints, fit: _Fit) -> tuple[_Task, _Fit]:
    """The fit with all that can be named, the lens and the shape of the pitch that it shows; ``stated`` are the curves
    with their first sigmas.
    """
    task, fit = _name_more_lines(task, stated, fit)
    return task, _allow_wider_lens(task, _allow_parabola(task, fit))


def _choose_world(task: _Task, stated: CurvePoints, first: _Fit, usual: tuple[_Task, _Fit]) -> tuple[_Task, _Fit]:
    """The best of the answers in all worlds, widened by the others.

    Parameters
    ----------
    task, stated, first : _Task, CurvePoints, _Fit
        Before further lines were named.
    usual : tuple of _Task, _Fit
        With the lines that a field of the usual size has.
    """
    config, template = task.config, task.template
    priors = first.problem.priors
    worlds = possible_worlds(template, priors, config.usual_size_share, config.flat_share)
    if len(worlds) == 1:
        return usual
    cases, known = [usual], len(stated.keys)

    def compare(noise: Callable[[_Fit], tuple[Problem, State]]) -> list[tuple[Answer, _Case]]:
        return _compare_worlds(worlds, cases, noise, priors, template, known)

    found = compare(_with_reported_noise)
    any_size = next((world for world in worlds if not world.is_usual_size and not world.is_flat), None)
    if any_size is not None and config.name_lines and _may_be_of_any_size(task, usual, [a for a, _ in found]):
        wide, state = with_priors(first.problem, first.state.best(), any_size.priors(priors, priors, template))
        start = replace(first, problem=wide, state=resume(wide, state, task.rule(COARSE)))
        other = _complete(task, stated, start)
        if depends_on_size(other[1].problem.curves) and other[0].names != usual[0].names:
            cases.append(other)
            found = compare(_with_reported_noise)
    if any_size is not None and _may_hide_misfit(usual[1], [a for a, _ in found]):
        named, own = usual
        cases.append((named, _fit_anew(named, own, any_size.priors(own.problem.priors, priors, template))))
        told = compare(_with_noise_of_misfit)
        if _prefers_any_size(told):
            found = told
    best, (chosen, fit) = max(found, key=lambda pair: pair[0].evidence)
    problem, state = reweight(best.problem, best.state, fit.problem.curves.sigma_px)
    state = resume(problem, state, task.rule(FINAL))
    posterior = mix([answer for answer, _ in found], best, state.theta[0])
    return chosen, replace(fit, problem=problem, state=state, posterior=posterior)


_Case = tuple[_Task, _Fit]


def _compare_worlds(
    worlds: tuple[World, ...], cases: list[_Case], noise: Callable[[_Fit], tuple[Problem, State]], usual: Priors,
    template: FieldTemplate, known: int,
) -> list[tuple[Answer, _Case]]:  # fmt: skip
    """The best answer in each world under each naming of the lines, and the case that it comes from.

    All are compared with the least noise that any of the cases leaves.
    """
    found: dict[tuple[World, frozenset[tuple[int, str]]], tuple[Answer, _Case]] = {}
    for case, alike in zip(cases, share_noise([noise(fit) for _, fit in cases]), strict=True):
        names = frozenset(case[0].names.items())
        for answer in answers_in(worlds, alike, usual, template, known, case[0].rule(COARSE)):
            key = answer.world, names
            if key not in found or answer.evidence > found[key][0].evidence:
                found[key] = answer, case
    return list(found.values())


def _with_reported_noise(fit: _Fit) -> tuple[Problem, State]:
    return fit.problem, fit.state.best()


def _with_noise_of_misfit(fit: _Fit) -> tuple[Problem, State]:
    problem, state = _with_reported_noise(fit)
    return (problem, state) if fit.given_px is None else noise_of_misfit(problem, state, fit.given_px)


def _may_hide_misfit(fit: _Fit, answers: list[Answer]) -> bool:
    """Whether noise was taken to have grown where it may be the size of the field that does not fit."""
    has_grown = fit.given_px is not None and fit.scale > MISFIT_SCALE
    return has_grown and depends_on_size(fit.problem.curves) and _doubt(answers) > UNLIKELY_SHARE


def _doubt(answers: list[Answer]) -> float:
    """Posterior probability that the field is not of the usual size."""
    shares = posterior_shares(answers)
    return float(sum(q for a, q in zip(answers, shares, strict=True) if not a.world.is_usual_size))


def _prefers_any_size(found: list[tuple[Answer, _Case]]) -> bool:
    """Whether the best answer is one of a field of any size, and clearly."""
    evidence = [max((a.evidence for a, _ in found if a.world.is_usual_size == usual)) for usual in (True, False)]
    return evidence[1] - evidence[0] > SIZE_EVIDENCE


def _fit_anew(task: _Task, fit: _Fit, priors: Priors) -> _Fit:
    """The fit to the same markings with other priors, and with the noise that it then leaves."""
    problem, state = with_priors(fit.problem, fit.state.best(), priors)
    if fit.given_px is not None:
        problem, state = reweight(problem, state, fit.given_px)
    return _settle(task, problem, resume(problem, state, task.rule(FINAL)), FINAL)


def _may_be_of_any_size(task: _Task, usual: tuple[_Task, _Fit], answers: list[Answer]) -> bool:
    """Whether lines are worth a name on a field of another size: those named on the usual one fit such a field as well,
    or long ones have no name there.
    """
    named, fit = usual
    if depends_on_size(fit.problem.curves) and _doubt(answers) > DOUBTED_SHARE:
        return True
    if len(set(named.names.values())) >= SEVERAL_LINES:
        return False
    least = NAMELESS_WIDTHS * task.observations.width
    return any(
        line.line is None
        and k not in named.names
        and len(line.points_px) >= FEWEST_POINTS
        and np.linalg.norm(np.ptp(line.points_px, axis=0)) > least
        for k, line in enumerate(task.observations.lines)
    )


def _choose_sight(task: _Task) -> _Sight:
    problem = task.problem()
    ellipse = select_ellipse(task.observations, task.circle, problem)
    if ellipse is not None:
        return _Sight(problem, ellipse, None)
    landmarks = collect_landmarks(task.observations, task.template, problem.points, problem.usual_lens)
    _require_landmarks(task, landmarks)
    middle_m = landmarks.middle_m(problem.model)
    return _Sight(replace(problem, priors=replace(problem.priors, center_m=middle_m)), None, landmarks)


_Begun = tuple[_Task, Problem, Starts]


def _begin_earlier(task: _Task, sight: _Sight) -> _Begun | None:
    """From a camera of about the same observations."""
    return None if task.earlier is None else _begin_named(task, sight, task.earlier.theta, task.earlier.names_by_line)


def _begin_around_circle(task: _Task, sight: _Sight) -> _Begun | None:
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
    task: _Task, sight: _Sight, theta: Array, lines: dict[int, str], arcs: dict[int, str] | None = None
) -> _Begun:
    """From one camera (P,) and the names that it gave to lines and arcs."""
    task = task.with_names(lines, arcs)
    follow_grid = sight.ellipse is not None and sight.ellipse.follows_grid(sight.problem)
    starts = Starts(theta[None], theta[None][:0], follow_grid)
    return task, replace(sight.problem, curves=task.curves()), starts


def _begin_circle(task: _Task, sight: _Sight) -> _Begun | None:
    """From the circle and what is known beside it."""
    if sight.ellipse is None:
        return None
    starts = circle_starts(sight.problem, task.observations, task.template, task.circle, sight.ellipse, task.side)
    return task, sight.problem, starts


def _begin_landmarks(task: _Task, sight: _Sight) -> _Begun | None:
    """From points, lines and other arcs."""
    if sight.landmarks is None:
        return None
    arcs = arc_starts(sight.problem, task.observations, task.template, task.side)
    return task, sight.problem, landmark_starts(sight.problem, sight.landmarks, arcs, task.side)


_BEGINNINGS: tuple[Callable[[_Task, _Sight], _Begun | None], ...] = (
    _begin_earlier, _begin_around_circle, _begin_circle, _begin_landmarks,
)  # fmt: skip
"""Where starts come from: the first that applies."""


def _settle(task: _Task, problem: Problem, state: State, rule: StoppingRule) -> _Fit:
    """Optimise once more with the sigmas that the residuals ask for."""
    best, scale, given_px = state.best(), 1.0, problem.curves.sigma_px
    if task.config.noise_from_residuals:
        problem, best, scale = rescale_sigmas(problem, best)
    return _Fit(problem, resume(problem, best, task.rule(rule)), scale, given_px=given_px)


def _name_more_lines(task: _Task, stated: CurvePoints, fit: _Fit) -> tuple[_Task, _Fit]:
    """The fit with the straight markings that can be named and the ends of lines; without any, with the noise that the
    points around the circle show. ``stated`` are the curves with their first sigmas.
    """
    more = _recognise(task, stated, fit) if task.config.name_lines else None
    if more is not None:
        problem, start, names = more
        state = minimise(problem, start, task.rule(COARSE), ground_feet(problem.curves, start, problem.model))
        return replace(task, names=task.names | names), _settle(task, problem, state, FINAL)
    problem, state, scale = fit.problem, fit.state, fit.scale
    least = None if task.names else _least_sigmas(task, stated)
    if least is not None:
        problem, state, scale, least = rescale_and_reject(problem, state, least)
    return task, _Fit(problem, resume(problem, state, task.rule(FINAL)), scale, least)


def _recognise(task: _Task, stated: CurvePoints, fit: _Fit) -> tuple[Problem, Array, dict[int, str]] | None:
    """The problem with the straight markings that can be named and the ends of lines beside the markings ``stated``, a
    start (1, P) for it, and the names by index of the seen line; None where there is nothing more.
    """
    observations, template, noise = task.observations, task.template, task.coarse_noise
    fuller, with_ends, ends = add_line_ends(fit.problem, fit.state, observations, template)
    found = name_lines(fuller, with_ends, observations, template, noise, ends)
    if ends and not found.names:
        # an end may be a cover's edge: only a whole structure of lines says so
        others = name_lines(fit.problem, fit.state, observations, template, noise)
        # and a line that passes through the end tells better where it runs
        if len(set(others.names.values())) >= OVERRULING_LINES or agree_with_ends(others.names, ends, observations):
            ends, found = (), others
    if not ends and not found.names:
        return None
    lines = (*ends, *(replace(observations.lines[k], line=name) for k, name in sorted(found.names.items())))
    further = curves_from_observations(replace(observations, circles=(), lines=lines), template, task.noise)
    return replace(fit.problem, curves=join_curves(stated, further)), found.theta[None], found.names


def _least_sigmas(task: _Task, curves: CurvePoints) -> CurvePoints | None:
    """The points with the sigmas of a frame that shows nothing far from the circle; None where they are too few to tell
    their noise.
    """
    if not task.config.noise_from_residuals or not _is_dense(curves):
        return None
    close_px = task.config.close_sigma_px * task.observations.width / 1920.0
    noise = replace(task.noise, model_sigma_px=min(task.noise.model_sigma_px, close_px))
    return curves_from_observations(task.observations, task.template, noise)


def _allow_parabola(task: _Task, fit: _Fit) -> _Fit:
    """The fit with a parabolic pitch where it explains what was seen clearly better, else the one given."""
    if task.config.crown_shape != "auto" or task.config.shared is not None:
        return fit
    curved, start = bend_surface(fit.problem, fit.state.best())
    start = predict_step(curved, start)
    if start.cost[0] > fit.state.cost[0]:  # far from enough: the linear model knows it to a fraction of the evidence
        return fit
    bar = float(fit.state.cost[0]) - CROWN_EVIDENCE
    found = minimise(curved, start.theta, task.rule(FINAL, bar), start.feet)
    if found.cost[0] > bar:
        return fit
    if fit.least is None:
        return replace(_settle(task, curved, found, FINAL), given_px=fit.given_px)
    # what the roof left of the residuals was no noise
    curved, found, scale, least = rescale_and_reject(curved, found, fit.least)
    return _Fit(curved, resume(curved, found, task.rule(FINAL)), scale, least)


def _allow_wider_lens(task: _Task, fit: _Fit) -> _Fit:
    """The fit with little said of the radial distortion before, where what is usual clearly holds it back, else the one
    given. A few clicked points cannot say so.
    """
    priors, kappa = fit.problem.priors, INDEX["kappa_1"]
    off = abs(float(fit.state.theta[0, kappa]) - priors.mean[kappa])
    if not 0 < priors.sd[kappa] < off / LENS_DOUBT or not _is_dense(fit.problem.curves):
        return fit
    free = replace(fit.problem, priors=_widen_lens(priors))
    found = minimise(free, fit.state.theta[:1], task.rule(FINAL), fit.state.feet[:1])
    is_clear = found.cost[0] < fit.state.cost[0] - LENS_EVIDENCE
    return replace(fit, problem=free, state=found) if is_clear else fit


def _widen_lens(priors: Priors) -> Priors:
    wider = priors.sd.copy()
    wider[INDEX["kappa_1"]] *= LENS_WIDER
    return replace(priors, sd=wider)


def _is_dense(curves: CurvePoints) -> bool:
    return bool(np.bincount(curves.group, minlength=1).max() >= DENSE_POINTS)


def _is_rotation_free(task: _Task) -> bool:
    """Whether nothing beside the circle says how the field is turned about it."""
    given, center = task.observations, np.asarray(task.circle.center)
    others = any(c.circle != task.circle.name for c in given.circles) or any(s.line is not None for s in given.lines)
    others = others or any(np.linalg.norm(k.field_m - center) > 1e-6 for k in given.keypoints)
    return not others and not has_position(task.config)


def _require_landmarks(task: _Task, landmarks: Landmarks) -> None:
    """Refuse where points, lines and arcs determine no camera without the circle's ellipse."""
    circles, name = task.observations.circles, task.circle.name
    on_arcs = sum(min(5, len(c.points_px)) for c in circles)
    enough = ENOUGH_WITH_POSITION if has_position(task.config) else ENOUGH
    if len(landmarks) and 2 * len(landmarks) + on_arcs >= enough:
        return
    seen = max((len(c.points_px) for c in circles if c.circle == name), default=0)
    code, words = ("no_ellipse", f"{seen} points of") if seen else ("no_circle", "no points of")
    raise refuse(
        "camera",
        code,
        f"{words} the circle {name!r} were seen, and the {len(landmarks)} points and named lines beside it "
        f"do not determine a camera: show {-(-enough // 2)} of them, or {MINIMUM_CIRCLE_POINTS} points of the circle",
    )


def _find_contradicting_points(problem: Problem, state: State) -> Mask:
    """Marks and keypoints (M,) that lie further from where the camera puts them than their sigma can explain."""
    off = state.point_values[0].reshape(len(problem.points.keys), 2)
    return np.asarray(np.linalg.norm(off, axis=-1) > OFF_SIGMAS, dtype=np.bool_)


def _find_lone_contradiction(task: _Task, problem: Problem, state: State) -> Mask:
    """The one mark or keypoint (M,) that lies elsewhere than where everything else puts it.

    A point that nothing checks bends the camera to itself and leaves no residual. With the noise that all else shows
    when the point is left out, chi-square rises by the square of the distance, in standard deviations, from where the
    others put it, when it is fitted too. The lens may be an unusual one, and the pitch a parabola.
    """
    nothing = np.zeros(len(problem.points.keys), dtype=np.bool_)
    if len(nothing) != 1 or not _is_dense(problem.curves):
        return nothing
    best, rule = state.best(), task.rule(COARSE)
    without = replace(problem, points=problem.points.select(nothing))
    start = evaluate(without, best.theta, best.feet)
    if predict_step(without, start).cost[0] > best.cost[0] - WORTH_LEAVING_OUT:
        return nothing
    least = _least_sigmas(task, problem.curves) or problem.curves
    lens = _widen_lens(problem.priors)
    without, start = reweight(*with_priors(without, start, lens), least.sigma_px)
    without, alone = noise_of_misfit(without, resume(without, start, rule), least.sigma_px)
    together = replace(without, points=problem.points)
    cases = [(without, alone), (together, evaluate(together, best.theta, best.feet))]
    if task.config.crown_shape == "auto":
        cases += [bend_surface(*case) for case in cases]
    cost = [float(resume(*case, rule).cost[0]) for case in cases]
    rise = min(cost[1::2]) - min(cost[::2])
    return ~nothing if rise > LONE_SIGMAS**2 else nothing


def _find_contradicting_markings(task: _Task, problem: Problem, state: State, sight: _Sight) -> list[MarkingKey]:
    """Named lines and arcs that lie far from where the camera puts them; never the circle that starts came from and the
    halfway line beside it, which the verdict judges.
    """
    curves, off = problem.curves, np.abs(state.residuals[0])
    least_px = WRONG_PX * problem.model.width / 1920.0
    found = set()
    for group, key in enumerate(curves.keys):
        own = curves.group == group
        carrying = key.name in (task.template.halfway_line, task.circle.name)
        far = np.median(off[own]) > WRONG_SIGMAS and np.median((off * curves.sigma_px)[own]) > least_px
        if far and not (carrying and sight.ellipse is not None):
            found.add(key)
    return sorted(found, key=str)

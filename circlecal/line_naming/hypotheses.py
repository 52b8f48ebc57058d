"""Which straight markings were seen: hypotheses from the predicted picture, tried together by one fit each."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from circlecal.camera.covariance import posterior_covariance
from circlecal.camera.observed import NoiseModel, thin_curves, thin_line
from circlecal.camera.painters import follow_errors, measure_displacements, weigh_errors
from circlecal.camera.problem import COARSE, WIDE_LOSS, Problem, State, minimise
from circlecal.camera.residuals import CurvePoints, ground_feet, join_curves, line_curve, stack_curves
from circlecal.field import FieldTemplate
from circlecal.geometry.projective import Array, Indices, Mask
from circlecal.line_naming.association import (
    EXTENTS,
    Association,
    associate_lines,
    has_allowed_size,
    lie_on_extent,
)
from circlecal.line_naming.line_ends import FEWEST_POINTS, find_passed_lines, passes_end, segment_ends
from circlecal.observations import LinePoints, MarkingKey, Observations

HYPOTHESES, GROWING, MOST_GROWING = 6, 2, 4
"""How many hypotheses are fitted, and of how many the lines are matched anew: of those that explain about as much as
the best one of more, since they leave nothing named until one of them explains what the others do not.
"""
RIVALS = 6
"""So many of the longest lines are also tried alone where markings may be painted beside their places: more lines come
near one then than hypotheses hold, and each may be it.
"""
FIT_ITERATIONS = 20
"""Most steps of a fit that is only compared."""
ROUNDS = 3
"""Fits of one hypothesis; after each the lines are matched anew."""
MARGIN_WIDTHS = 0.12
"""A hypothesis must explain this many picture widths of line more than any that contradicts it."""
UNUSED_SIGMA_PX = 1e5
"""Standard deviation of lines that a hypothesis leaves without a name: they count for nothing in its fit."""
LINE_SIGMA_PX = 1.5
"""Standard deviation of the ends of a seen line about the straight marking: lens and measuring, pixels at 1920 px
width.
"""
ALLOWED_PX = 0.3
"""By how much the root mean square residual of a known marking may grow under a hypothesis, pixels at 1920 px width."""
PASSED_PX = 2.5
"""Largest root mean square residual of a line that a fit passes through, pixels at 1920 px width."""
PX_PER_MISSED_PX, PX_PER_RESIDUAL_PX, PX_PER_PRIOR = 2.0, 400.0, 15.0
"""What outweighs one pixel of explained line, pixels at 1920 px width: each pixel of a named line that the fit misses,
each pixel by which known markings fit worse than allowed, each unit of chi-square that the priors give: what is known
is not given up for a name.
"""
LEAST_PAINTED_PX = 1e-6
"""Smaller painters' errors, pixels, are none."""
TOLD_SHARE, SIZES_APART_M = 0.5, 3.0
"""Share of its prior deviation below which a size of the field is told by what was named, and metres by which two sizes
differ clearly: a red line named as goal line made a rendered field 91.5 m long, the front of its penalty area 119.9 m.
"""
LEAST_EXPLAINED_WIDTHS, LEAST_SCORE_WIDTHS = 0.15, 0.1
"""Least length of named line, and least score, of a hypothesis that is believed, in picture widths."""


@dataclass(frozen=True, slots=True)
class Naming:
    """Template names by index of the seen line, the camera (P,) that they imply, and names of arcs by index of the
    nameless curve.
    """

    names: dict[int, str]
    theta: Array
    arcs: dict[int, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class NamingScene:
    """What all hypotheses share.

    Attributes
    ----------
    problem : Problem
        With the markings whose names are known, thinned.
    before_px, allowed_px, painted_px : (G,) arrays
        Root mean square residual of each of them before any line gets a name, by how much it may grow, and by how much
        a painter's error of one standard deviation lets it.
    points_px, sigma_px, line : (N, 2), (N,), (N,) arrays
        Thinned points of the nameless lines, and which line each belongs to.
    segments : (S, 2, 2) array
        Ends of the nameless lines.
    template : FieldTemplate
        The field.
    known : tuple of str
        Names that are given.
    elsewhere : frozenset of (int, str)
        Names that a nameless line cannot have, since another line is seen to end on that marking somewhere else, or to
        run on beyond this one.
    painters_covariance : (P, P) array
        What painters' errors of the known markings add to the covariance of the camera.
    """

    problem: Problem
    before_px: Array
    allowed_px: Array
    painted_px: Array
    points_px: Array
    sigma_px: Array
    line: Indices
    segments: Array
    template: FieldTemplate
    known: tuple[str, ...]
    elsewhere: frozenset[tuple[int, str]]
    painters_covariance: Array

    @property
    def unit(self) -> float:
        """Pixels per pixel at 1920 px width."""
        return self.problem.model.width / 1920.0

    @property
    def lengths_px(self) -> Array:
        """Lengths (S,) of the nameless lines."""
        return np.asarray(np.linalg.norm(self.segments[:, 1] - self.segments[:, 0], axis=-1))

    def leaves_longest(self, association: Association) -> bool:
        """Whether one line that gets no name is longer than all that get one."""
        named = list(association.names)
        return bool(np.delete(self.lengths_px, named).max(initial=0.0) > self.lengths_px[named].sum())

    def hypotheses(
        self, thetas: Array, normals: Array, count: int, asked: Mask | None = None
    ) -> list[list[Association]]:
        """The most plausible names under each camera (C, P) with its Gauss-Newton matrix; none where no line of those
        that are asked for (C, S) comes near a marking.
        """
        sd = self.problem.priors.sd
        covariances = posterior_covariance(normals, sd) + self.painters_covariance
        cameras, sigma_px = (thetas, covariances, self.problem.model), LINE_SIGMA_PX * self.unit
        options = cameras, sigma_px, count, self.elsewhere, asked
        return associate_lines(self.segments, self.template, self.known, *options)


@dataclass(frozen=True, slots=True)
class Trial:
    """A fitted hypothesis: its names, which lines (S,) it passes through, the length of these, its score, its camera
    (P,) and Gauss-Newton matrix (P, P).
    """

    association: Association
    passed: Mask
    explained_px: float
    score: float
    theta: Array
    normal: Array

    @property
    def left(self) -> Mask | None:
        """The lines (S,) that get no name, where the fit passes through all that get one; None where it does not, and
        others may be better names for these.
        """
        left = np.ones(len(self.passed), dtype=np.bool_)
        left[list(self.association.names)] = False
        return left if (left | self.passed).all() else None


def name_lines(
    problem: Problem,
    state: State,
    observations: Observations,
    template: FieldTemplate,
    noise: NoiseModel,
    ends: tuple[LinePoints, ...] = (),
) -> Naming:
    """Names for straight markings that were seen without one.

    Parameters
    ----------
    problem, state : Problem, State
        The fit without them.
    observations : Observations
        Everything that was seen.
    ends : tuple of LinePoints
        Points of markings, from :func:`circlecal.line_naming.line_ends.add_line_ends`, that ``problem`` holds already.
    template : FieldTemplate
        The field.
    noise : NoiseModel
        How points are thinned and trusted while hypotheses are compared.

    Returns
    -------
    Naming
        Without names where nothing is certain.
    """
    nothing = Naming({}, state.theta[0])
    unnamed = find_nameless_lines(observations)
    if not unnamed:
        return nothing
    scene = make_naming_scene(unnamed, problem, state, observations, template, noise, ends)
    (first,) = scene.hypotheses(state.theta[:1], state.normal[:1], HYPOTHESES)
    if not first:
        return nothing
    trials = match_further_lines(
        scene, try_names(scene, first, np.repeat(state.theta[:1], len(first), axis=0)), GROWING
    )
    if scene.painted_px.any():
        trials += _try_alone(scene, first, state.theta[:1])
    size_sd_m = problem.priors.sd[EXTENTS]
    best = select_trial(trials, observations.width, size_sd_m)
    if best is None or scene.leaves_longest(best.association):
        trials += _try_longest(scene, first, state.theta[:1])
        best = select_trial(trials, observations.width, size_sd_m)
    if best is not None and scene.painted_px.any():
        best = select_trial(_weigh_rivals(scene, trials, best), observations.width, size_sd_m)
    if best is None:
        return nothing
    return Naming({unnamed[k]: name for k, name in best.association.names.items() if best.passed[k]}, best.theta)


def find_nameless_lines(observations: Observations) -> list[int]:
    """Numbers of the straight lines without a name that have the points for one."""
    return [
        k for k, line in enumerate(observations.lines) if line.line is None and len(line.points_px) >= FEWEST_POINTS
    ]


def match_further_lines(scene: NamingScene, trials: list[Trial], count: int) -> list[Trial]:
    """The hypotheses, the ``count`` best of them with the further lines that their cameras lead to, and more of them
    where they come near the best one.
    """
    trials = list(trials)
    ranked = sorted(range(len(trials)), key=lambda k: -trials[k].score)
    near_px = _least_near(scene, trials[ranked[0]])
    growing = [k for i, k in enumerate(ranked[: max(count, MOST_GROWING)]) if i < count or trials[k].score > near_px]
    for _ in range(ROUNDS - 1):
        growing = [k for k in growing if len(trials[k].association.names) < len(scene.segments)]
        grown = [trials[k] for k in growing]
        further = _find_further(scene, grown) if grown else []
        more = {
            k: again[0]
            for k, trial, again in zip(growing, grown, further, strict=True)
            if again and _is_extension(again[0], trial.association)
        }
        if not more:
            break
        growing = list(more)
        starts = np.array([trials[k].theta for k in growing])
        for k, trial in zip(growing, try_names(scene, list(more.values()), starts), strict=True):
            trials[k] = trial
    return trials


def _find_further(scene: NamingScene, trials: list[Trial]) -> list[list[Association]]:
    """The best names, if any, under the camera of each hypothesis, where a line may get one that has none or should
    have another.
    """
    anything = np.ones(len(scene.segments), dtype=np.bool_)
    asked = [anything if trial.left is None else trial.left for trial in trials]
    thetas, normals = (np.array(values) for values in zip(*((t.theta, t.normal) for t in trials), strict=True))
    return scene.hypotheses(thetas, normals, 1, np.array(asked))


def _least_near(scene: NamingScene, best: Trial) -> float:
    """Score, pixels, from which on another hypothesis comes near the best one."""
    return best.score - MARGIN_WIDTHS * scene.problem.model.width


def _try_longest(scene: NamingScene, hypotheses: list[Association], start: Array) -> list[Trial]:
    """The longest line under each of its names, with nothing else named: the others may be edges of boards."""
    longest = int(np.argmax(scene.lengths_px))
    names = {h.names[longest] for h in hypotheses if longest in h.names}
    single = [Association({longest: name}, float(scene.lengths_px[longest]), 0.0) for name in sorted(names)]
    return try_names(scene, single, np.repeat(start, len(single), axis=0)) if single else []


def _try_alone(scene: NamingScene, hypotheses: list[Association], start: Array) -> list[Trial]:
    """Each of the longest lines alone under every name that a hypothesis gives."""
    names = sorted({name for hypothesis in hypotheses for name in hypothesis.names.values()})
    longest = np.argsort(-scene.lengths_px, kind="stable")[:RIVALS].tolist()
    pairs = [(k, name) for k in longest for name in names if (k, name) not in scene.elsewhere]
    single = [Association({k: name}, float(scene.lengths_px[k]), 0.0) for k, name in pairs]
    return try_names(scene, single, np.repeat(start, len(single), axis=0)) if single else []


def _is_extension(again: Association, before: Association) -> bool:
    return again.names != before.names and again.length_px >= before.length_px


def make_naming_scene(
    unnamed: list[int],
    problem: Problem,
    state: State,
    observations: Observations,
    template: FieldTemplate,
    noise: NoiseModel,
    ends: tuple[LinePoints, ...] = (),
) -> NamingScene:
    """The nameless lines (by index) before a fit without them, as :func:`name_lines` takes it."""
    lines = [observations.lines[k] for k in unnamed]
    curves = thin_curves(problem.curves, state.feet[0], noise.maximum_points, noise.model_sigma_px)
    thinned = [thin_line(line, noise) for line in lines]
    segments = np.array([segment_ends(line.points_px) for line in lines])
    unit = observations.width / 1920.0
    residuals, group = state.residuals[0] * problem.curves.sigma_px, problem.curves.group
    stated = np.bincount(group, problem.curves.sigma_px) / np.bincount(group)
    covariance = posterior_covariance(state.normal[0], problem.priors.sd)
    painters = follow_errors(problem, state, covariance, template)
    return NamingScene(
        problem=replace(problem, curves=curves),
        allowed_px=np.where(np.bincount(group) == 1, stated, ALLOWED_PX * unit),
        painted_px=measure_displacements(problem, state, template),
        painters_covariance=np.zeros_like(covariance) if painters is None else painters.covariance,
        before_px=np.sqrt(np.bincount(group, residuals**2) / np.bincount(group)),
        points_px=np.concatenate([points for points, _ in thinned]),
        sigma_px=np.concatenate([sigma for _, sigma in thinned]),
        line=np.repeat(np.arange(len(lines)), [len(points) for points, _ in thinned]),
        segments=segments,
        template=template,
        known=tuple(line.line for line in observations.lines if line.line is not None),
        elsewhere=frozenset(
            (k, str(point.line))
            for k, line in enumerate(lines)
            for point in ends
            if not passes_end(line.points_px, point, unit)
        )
        | find_passed_lines(observations, unnamed, template),
    )


def try_names(scene: NamingScene, associations: list[Association], starts: Array) -> list[Trial]:
    """Fit every hypothesis, all at once, from its own start (B, P)."""
    assumed = _assume(scene, associations)
    problem = replace(scene.problem, curves=assumed.curves, loss_scale=WIDE_LOSS * scene.problem.loss_scale)
    feet = ground_feet(problem.curves, starts, problem.model)
    state = minimise(problem, starts, replace(COARSE, iterations=FIT_ITERATIONS), feet)
    passed, explained, score = _score(scene, associations, state, problem, assumed)
    return [
        Trial(association, passed[k], float(explained[k]), float(score[k]), state.theta[k], state.normal[k])
        for k, association in enumerate(associations)
    ]


@dataclass(frozen=True, slots=True)
class _Assumed:
    """What B hypotheses assume: the known markings, and after them the points of those lines that each one names.

    Attributes
    ----------
    curves : CurvePoints
        With points of its own for every hypothesis; where one has fewer than another, its last point is repeated at
        the end and counts for nothing.
    of_line : (B, M, S) bool
        Which nameless line each of the M further points belongs to; none where it is such a repetition.
    """

    curves: CurvePoints
    of_line: Mask


def _assume(scene: NamingScene, associations: list[Association]) -> _Assumed:
    """The known markings, and the nameless lines that each hypothesis names as what it takes them for."""
    base, template = scene.problem.curves, scene.template
    shape = (len(associations), len(scene.segments))
    origin, direction, shift = np.zeros((*shape, 2)), np.zeros((*shape, 2)), np.zeros((*shape, 3, 2))
    used = np.zeros(shape, dtype=bool)
    for b, association in enumerate(associations):
        for s, name in association.names.items():
            drawn = template.line_by_name[name]
            ends = template.line_ends(drawn)
            origin[b, s], direction[b, s] = ends[0], (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
            shift[b, s], used[b, s] = template.line_shift(drawn), True
    is_own = used[:, scene.line]
    count = is_own.sum(axis=1)[:, None]
    number, row = np.arange(count.max()), np.arange(shape[0])[:, None]
    own = np.argsort(~is_own, axis=1, kind="stable")[row, np.minimum(number, count - 1)]
    line, counts = scene.line[own], number < count

    def join_points(known: Array, further: Array) -> Array:
        """Behind each other along the points, for every hypothesis."""
        return np.concatenate([np.broadcast_to(known, (shape[0], *known.shape)), further], axis=1)

    still = np.zeros(len(number))
    curves = CurvePoints(
        points_px=join_points(base.points_px, scene.points_px[own]),
        sigma_px=join_points(base.sigma_px, np.where(counts, scene.sigma_px[own], UNUSED_SIGMA_PX)),
        origin=join_points(base.origin, origin[row, line]),
        radius=np.concatenate([base.radius, still]),
        radius_by_width=np.concatenate([base.radius_by_width, still]),
        bloom_sign=np.concatenate([base.bloom_sign, still]),
        direction=join_points(base.direction, direction[row, line]),
        shift=join_points(base.shift, shift[row, line]),
        group=np.concatenate([base.group, np.full(len(number), len(base.keys))]),
        keys=(*base.keys, MarkingKey("nameless lines")),
    )
    return _Assumed(curves, counts[..., None] & (line[..., None] == np.arange(shape[1])))


def _score(
    scene: NamingScene, associations: list[Association], state: State, problem: Problem, assumed: _Assumed
) -> tuple[Mask, Array, Array]:
    """The lines (B, S) that each fit really passes through, their length (B,), and its score: less what circle, line
    and priors had to give for it. A field of a size that the rules do not allow passes through none.
    """
    lengths, known = scene.lengths_px, scene.problem.curves
    named = np.array([[k in association.names for k in range(len(lengths))] for association in associations])
    squares = (state.residuals * problem.curves.sigma_px) ** 2
    of_known, of_lines = squares[:, : len(known.group)], squares[:, None, len(known.group) :]
    member = (known.group[:, None] == np.arange(len(known.keys))).astype(np.float64)
    known_rms = np.sqrt(of_known @ member / member.sum(axis=0))
    rms = np.sqrt((of_lines @ assumed.of_line)[:, 0] / np.maximum(assumed.of_line.sum(axis=1), 1))
    is_allowed = has_allowed_size(state.theta, scene.template)
    passed = named & (rms < PASSED_PX * scene.unit) & is_allowed[:, None]
    passed &= _lie_on_extents(scene, associations, state, assumed)
    explained = (lengths * passed).sum(axis=1)
    missed = (lengths * named).sum(axis=1) - explained
    worse = np.maximum(0.0, known_rms - scene.before_px - scene.allowed_px)
    # a marking that is painted elsewhere is as likely as its painter's error
    painted = PX_PER_PRIOR * (worse / np.maximum(scene.painted_px, LEAST_PAINTED_PX)) ** 2
    strain = np.minimum(PX_PER_RESIDUAL_PX * worse / scene.unit, painted).sum(axis=1)
    prior = (problem.priors.residuals(state.theta)[0] ** 2).sum(axis=1)
    against = PX_PER_MISSED_PX * missed + scene.unit * (strain + PX_PER_PRIOR * prior)
    return passed, explained, explained - against


def _lie_on_extents(scene: NamingScene, associations: list[Association], state: State, assumed: _Assumed) -> Mask:
    """Which of the lines (B, S) that hypotheses name lie on the extents of the markings that they are taken for, under
    the cameras of the fits.
    """
    feet = state.feet[:, -assumed.of_line.shape[1] :, None]
    first = np.where(assumed.of_line, feet, np.inf).min(axis=1)
    last = np.where(assumed.of_line, feet, -np.inf).max(axis=1)
    lengths = np.zeros(first.shape)
    for b, association in enumerate(associations):
        for s, name in association.names.items():
            start, end = scene.template.line_ends(scene.template.line_by_name[name])
            lengths[b, s] = np.linalg.norm(end - start)
    return lie_on_extent(np.stack([first, last], axis=-1), lengths[..., None])


def _weigh_rivals(scene: NamingScene, trials: list[Trial], best: Trial) -> list[Trial]:
    """The trials, the best one and those that contradict it and may come near it with scores by what is left of the
    known markings' misfit when painters' errors explain what they can.

    Painted three centimetres beside the halfway line a circle left the true touchline of a rendered hall 78 units of
    chi-square, and 15 with painters' errors, where a streak of light beside it had 11 and 6.
    """
    near_px = _least_near(scene, best)
    close = {
        k
        for k, trial in enumerate(trials)
        if trial is best or (trial.association.contradicts(best.association) and trial.explained_px > near_px)
    }
    if len(close) < 2:
        return trials
    alone = _cost_with_errors(scene, Association({}, 0.0, 0.0), best.theta)
    return [_weigh_trial(scene, trial, alone) if k in close else trial for k, trial in enumerate(trials)]


def _weigh_trial(scene: NamingScene, trial: Trial, alone: float) -> Trial:
    """The trial with the score that painters' errors leave it, beside the cost of the known markings ``alone``."""
    named = list(trial.association.names)
    missed_px = float(scene.lengths_px[named].sum()) - trial.explained_px
    passed = Association({k: trial.association.names[k] for k in named if trial.passed[k]}, trial.explained_px, 0.0)
    strain = max(0.0, _cost_with_errors(scene, passed, trial.theta) - alone)
    score = trial.explained_px - PX_PER_MISSED_PX * missed_px - scene.unit * PX_PER_PRIOR * strain
    return replace(trial, score=score)


def _cost_with_errors(scene: NamingScene, association: Association, theta: Array) -> float:
    """Chi-square of the known markings, of lines under their names, of priors and of painters' errors, from a camera
    (P,).
    """
    problem = replace(scene.problem, curves=_curves_of(scene, association))
    fit = minimise(problem, theta[None], COARSE, ground_feet(problem.curves, theta[None], problem.model))
    return float(weigh_errors(problem, fit, scene.template)[0].cost[0])


def _curves_of(scene: NamingScene, association: Association) -> CurvePoints:
    """The known markings, and the lines that one hypothesis names, with those names."""
    parts = []
    for k, name in association.names.items():
        drawn, own = scene.template.line_by_name[name], scene.line == k
        ends, shift = scene.template.line_ends(drawn), scene.template.line_shift(drawn)
        parts.append(line_curve(name, scene.points_px[own], scene.sigma_px[own], ends, shift))
    return join_curves(scene.problem.curves, stack_curves(parts))


def select_trial(trials: list[Trial], width: int, size_sd_m: Array | None = None) -> Trial | None:
    """The best trial, where it explains enough, and clearly more than any that contradicts it, or that tells another
    size of the field where length and breadth have the prior deviations ``size_sd_m`` (2,), metres.
    """
    best = max(trials, key=lambda t: t.score)
    if best.explained_px < LEAST_EXPLAINED_WIDTHS * width:
        return None
    rivals = (t for t in trials if t is not best and t.score > best.score - MARGIN_WIDTHS * width)
    if any(
        t.association.contradicts(best.association) or (size_sd_m is not None and _tell_sizes_apart(t, best, size_sd_m))
        for t in rivals
    ):
        return None
    return None if best.score < LEAST_SCORE_WIDTHS * width else best


def _tell_sizes_apart(one: Trial, other: Trial, size_sd_m: Array) -> bool:
    """Whether two trials, both of which tell a size of the field that was open, tell different ones."""
    sizes_m = np.array([trial.theta[EXTENTS] for trial in (one, other)])
    information = np.array([np.diag(trial.normal)[EXTENTS] for trial in (one, other)])
    is_open = size_sd_m > SIZES_APART_M
    is_told = is_open & (information * (TOLD_SHARE * size_sd_m) ** 2 > 1.0).all(axis=0)
    return bool((is_told & (np.abs(sizes_m[0] - sizes_m[1]) > SIZES_APART_M)).any())

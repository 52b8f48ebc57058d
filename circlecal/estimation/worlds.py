"""Which field it may be: of the usual size or any, flat or crowned; the likeliest is taken, the others widen it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np

from circlecal.camera.noise import noise_of_misfit
from circlecal.camera.observed import with_model_noise
from circlecal.camera.priors import Priors
from circlecal.camera.problem import COARSE, FINAL, Problem, State, evaluate, minimise, resume, reweight, with_priors
from circlecal.camera.residuals import CurvePoints
from circlecal.camera.spike_and_slab import (
    OUT_OF_THE_QUESTION,
    UNLIKELY_SHARE,
    Answer,
    answers_in,
    bend_answers,
    depends_on_size,
    mix,
    possible_worlds,
    posterior_shares,
    share_noise,
    shares_of_sizes,
)
from circlecal.camera.valley import explore_valley
from circlecal.camera.world import CURVED_SHARE, World
from circlecal.estimation.completion import (
    close_sigma_px,
    recognise,
    shows_size_closely,
    strongest_barrel,
    take_in,
)
from circlecal.estimation.task import Fit, Task, is_dense
from circlecal.field import FieldTemplate
from circlecal.geometry.camera_parameters import INDEX, KAPPA_1, level_points
from circlecal.geometry.least_squares import StoppingRule
from circlecal.geometry.projective import Array
from circlecal.line_naming.broad_lines import hide_broad_lines
from circlecal.line_naming.hypotheses import find_nameless_lines
from circlecal.line_naming.reach import usual_step_px

LENS_STRAIN, LEAST_TOLD_SD = 1.0, 0.03
"""By how many standard deviations of the usual lens a likely answer has another one where worlds with any lens are
asked too, and the standard deviation, half-widths, from which on the options say so little of the lens that any is
usual. Of 33 real frames, calibrated by circle and halfway line, none has another answer with these worlds; of 350
rendered ones with lenses of all kinds eleven have, one of which was 109 px off and is refused.
"""

DOUBTED_SHARE = 0.1
"""Posterior probability of another size from which on the lines are named anew for such a field: below it the second
naming costs more time than it mends. Chosen without a measurement of its own.
"""

SETTLING_LINES, SETTLED_SHARE = 2, 0.5
"""So many further markings at their places on a usual field leave little doubt about its size, where lines without a
name are seen over less than this share of their length: on a rendered field 59 m wide edges of boards, 200 px long, lay
where one of 67 m has its far touchline, and 570 px of the true one had no name, 0.7 of what was named.
"""

TOLD_SHARE = 0.15
"""Posterior probability of another size, told with no more noise than the residuals show, from which on it counts: of
37 real frames of usual fields one has 0.11 and all others less than 0.03; of rendered fields of other sizes, whose
errors would not be covered, most have 0.2 to 1. With that noise any size is likelier than the usual one by -2.1 (the
logarithm of the evidence) in one of these real frames, by -3.5 in another and less in all others (but one whose lens
would make a field of 108 m width of it, which no rule allows), by 1 to 78 in eight rendered parts of a circle beside a
touchline. In a close view, whose one line beside the circle tells size and noise, it counts whatever it says: of 200
rendered parts of a circle on fields of all sizes 145 instead of 142 are within 5 px, and sigma follows the posterior.
"""

QUIET_SIGMA_PX = 0.05
"""What lens, crown and paint leave of a marking at the least, pixels at 1920 px width, where noise is told by what each
size of the field leaves: with six times as much a circle beside a touchline 42.5 m away fits a usual field's 34 m.
"""

BEYOND_RULES_M = 3.0
"""Metres by which an estimated size may lie outside of what the rules allow, since it has an error of its own, and be
the field's nevertheless: rendered fields 88.1 and 89.9 m wide come out 90.7 and 91.2 m wide, 90 m being the most. The
lens of one real frame would make a field of 108 m width of a usual one.
"""

NOISE_ROUNDS = 2
"""So often noise is told by residuals, and these by the noise, before sizes are compared: a third changes nothing."""

FINE = replace(COARSE, tolerance=0.05, contraction=0.1, last_step=True)
"""For roofs against parabolas, whose evidence differs by less than that of other worlds."""

ROUGH = StoppingRule(1e-3, unit=np.inf)
"""For the optimum whose residuals tell the noise: a thousandth of chi-square changes it by half as much. A loss that is
so narrow makes the last steps to the optimum many and short.
"""

NAMELESS_WIDTHS = 0.2
"""Length over which all lines without a name are seen, picture widths, from which on they ask for one: two lines of a
penalty area of a field of another length are 0.25 to 0.4 long together.
"""

ACROSS_SLOPE, ACROSS_WIDTHS = 0.1, 0.08
"""How far a line without a name may turn, on the field, from the direction of the goal lines, and the length from which
on it asks for one, picture widths: what runs as they do is a goal line or the front of an area, whose place the length
of the field decides, and no edge of boards. Of a rendered field 98.4 m long the front of a penalty area, 0.23 widths
long, was left without a name beside its side and a touchline, and the camera 5 px off instead of 0.3.
"""

_Case = tuple[Task, Fit]
_Asked = tuple[_Case, Sequence[World]]
_Noise = Callable[[_Case], tuple[Problem, State]]


def choose_world(task: Task, stated: CurvePoints, first: Fit, usual: tuple[Task, Fit]) -> tuple[Task, Fit]:
    """The best of the answers in all worlds, widened by the others.

    Parameters
    ----------
    task, stated, first : Task, CurvePoints, Fit
        Before further lines were named.
    usual : tuple of Task, Fit
        With the lines that a field of the usual size has.
    """
    config = task.config
    curved_share = CURVED_SHARE if config.crown_shape == "auto" else 0.0
    sizes = shares_of_sizes(config.usual_size_share, config.other_length_share, usual[1].problem)
    worlds = possible_worlds(task.template, first.problem.priors, sizes, config.flat_share, curved_share)
    if len(worlds) == 1:
        return usual[0], _explore(task, usual[1])
    question = _Question(task, stated, first, usual, worlds)
    alike = [usual, *_on_roof(usual)]
    found, reported = question.compare(_with_reported_noise, [(case, worlds) for case in alike]), _keep_noise
    others = question.name_anew(found)
    if others:
        found = question.compare(_with_reported_noise, [(case, worlds) for case in (*alike, *others)])
    if question.strains_lens(found):
        worlds = (*worlds, *(world.with_any_lens(config.other_lens_share) for world in worlds))
        found = question.compare(_with_reported_noise, [(case, worlds) for case in (*alike, *(others or ()))])
    if question.any_size is not None and _may_hide_misfit(usual, [a for a, _ in found]):
        resized = _resize(alike, found, question.any_size)
        told = question.compare(_with_noise_of_misfit, _by_size([*alike, *(others or ())], worlds, resized))
        if others is None and (others := question.name_anew(told)):
            told = question.compare(_with_noise_of_misfit, _by_size([*alike, *others], worlds, resized))
        is_doubted = _doubt([a for a, _ in told]) > max(TOLD_SHARE, _doubt([a for a, _ in found]))
        is_asked = is_doubted or shows_size_closely(usual[0], usual[1].problem.curves)
        if is_asked and _is_allowed(told, task.template) and _count_named(told) >= _count_named(found):
            found, reported = told, _tell_noise
    found = _without_needless([*alike[1:], *(others or ())[1:]], found)
    best, (chosen, fit) = max(found, key=lambda pair: pair[0].evidence)
    problem, state = reported(_reach(best, task.rule(COARSE)), chosen, fit)
    fit = _explore(task, replace(fit, problem=problem, state=resume(problem, state, task.rule(FINAL))))
    posterior = mix([answer for answer, _ in found], best, fit.state.theta[0])
    return chosen, replace(fit, posterior=posterior)


@dataclass(frozen=True, slots=True)
class _Question:
    """Which of the worlds it is; the other attributes are the parameters of :func:`choose_world`."""

    task: Task
    stated: CurvePoints
    first: Fit
    usual: _Case
    worlds: tuple[World, ...]

    @property
    def any_size(self) -> World | None:
        """The crowned field of any size, where that is possible."""
        return next((world for world in self.worlds if world.size == "any" and not world.is_flat), None)

    def compare(self, noise: _Noise, asked: Sequence[_Asked]) -> list[tuple[Answer, _Case]]:
        """The answers to what is asked of each naming of the lines, on roofs and parabolas where both are possible."""
        common = self.first.problem.priors, self.task.template, len(self.stated.keys)
        found = _compare_worlds(asked, noise, *common)
        if self.task.config.crown_shape == "auto":
            found = [*found, *_on_parabola(found, *common)]
        return [pair for pair in found if not _is_beyond_fisheye(pair[0])]

    def strains_lens(self, found: list[tuple[Answer, _Case]]) -> bool:
        """Whether a likely answer has another lens than the usual one. Clicked points are too few to tell."""
        usual_sd, share = self.first.problem.priors.sd[KAPPA_1], self.task.config.other_lens_share
        if not (0.0 < usual_sd < LEAST_TOLD_SD and share > 0.0 and is_dense(self.first.problem.curves)):
            return False
        least = max(answer.evidence for answer, _ in found) - OUT_OF_THE_QUESTION
        likely = [answer for answer, _ in found if answer.evidence >= least]
        off = [abs(answer.problem.priors.distortion_off(answer.state.theta[0])) for answer in likely]
        return max(off) > LENS_STRAIN * usual_sd

    def name_anew(self, found: list[tuple[Answer, _Case]]) -> list[_Case] | None:
        """The lines that a field of any size has, nothing where they are those of the usual one; None where the answers
        do not ask for them.
        """
        task, priors, any_size = self.task, self.first.problem.priors, self.any_size
        if any_size is None or not task.config.name_lines:
            return None
        if not _may_be_of_any_size(task, self.usual, [answer for answer, _ in found]):
            return None
        resized = any_size.priors(priors, priors, task.template)
        case = _name_on_any_size(task, self.stated, self.first, self.usual, resized)
        return [] if case is None else [case, *_on_roof(case)]


def _name_on_any_size(task: Task, stated: CurvePoints, first: Fit, usual: _Case, priors: Priors) -> _Case | None:
    """The lines that a field of any size has, with its priors; None where they are those of the usual one."""
    problem, state = with_priors(first.problem, first.state.best(), priors)
    start = replace(first, problem=problem, state=resume(problem, state, task.rule(COARSE)))
    more = recognise(task, stated, start)
    names = task.names if more is None else task.names | more.names
    curves = stated if more is None else more.problem.curves
    if names == usual[0].names or not depends_on_size(curves):
        return None
    return take_in(task, stated, start, more)


def _is_beyond_fisheye(answer: Answer) -> bool:
    """Whether an answer before any lens has one that bends lines more than a fisheye of its focal length."""
    theta = answer.state.theta[0]
    return answer.world.is_any_lens and theta[KAPPA_1] <= strongest_barrel(theta, answer.problem.model.width)


def _reach(answer: Answer, rule: StoppingRule) -> Answer:
    """The answer at the optimum that a linear model foretold."""
    if not answer.is_predicted:
        return answer
    state = evaluate(answer.problem, answer.state.theta, answer.state.feet)
    return replace(answer, state=resume(answer.problem, state, rule), is_predicted=False)


def _explore(task: Task, fit: Fit) -> Fit:
    """The fit at the optimum along its valley."""
    state, growth = explore_valley(fit.problem, fit.state, task.rule(FINAL))
    return replace(fit, state=state, growth=growth)


def _on_roof(case: _Case) -> list[_Case]:
    """The case on a roof, where its pitch is a parabola: what bends a roof may be the misfit of a field of another
    size.
    """
    named, fit = case
    surface = fit.problem.model.surface
    if named.config.crown_shape != "auto" or surface.shape != "parabola":
        return []
    roof = replace(fit.problem, model=replace(fit.problem.model, surface=replace(surface, shape="roof")))
    best = fit.state.best()
    return [(named, replace(fit, problem=roof, state=minimise(roof, best.theta, named.rule(COARSE), best.feet)))]


def _is_one_of(cases: list[_Case], case: _Case) -> bool:
    """Whether a case is itself among others, however alike these are."""
    return any(case is other for other in cases)


def _without_needless(roofs: list[_Case], found: list[tuple[Answer, _Case]]) -> list[tuple[Answer, _Case]]:
    """All answers, without those on roofs where a field of the usual size is the likeliest: its parabola was chosen
    between the two already.
    """
    best, _ = max(found, key=lambda pair: pair[0].evidence)
    if not best.world.is_usual_size:
        return found
    return [(answer, case) for answer, case in found if not _is_one_of(roofs, case)]


def _resize(usual: list[_Case], found: list[tuple[Answer, _Case]], world: World) -> list[_Case]:
    """The lines of a usual field on a field of the world that was found with them, with each profile of its pitch: what
    one of them leaves says nothing of the other.
    """
    best: dict[str, tuple[Answer, _Case]] = {}
    for answer, case in sorted(found, key=lambda pair: pair[0].evidence):
        if answer.world == world and _is_one_of(usual, case):
            best[answer.problem.model.surface.shape] = answer, case
    resized = []
    for answer, (named, own) in best.values():
        reached = _reach(answer, named.rule(COARSE))
        resized.append((named, replace(own, problem=reached.problem, state=reached.state)))
    return resized


def _by_size(cases: list[_Case], worlds: Sequence[World], resized: list[_Case]) -> list[_Asked]:
    """The cases, of which the usual one, the first, is asked for the usual width, and resized ones for any size."""
    usual, other = (tuple(w for w in worlds if (w.size == "any") == is_any) for is_any in (False, True))
    return [(cases[0], usual), *((case, worlds) for case in cases[1:]), *((case, other) for case in resized)]


def _compare_worlds(
    asked: Sequence[_Asked], noise: _Noise, usual: Priors, template: FieldTemplate, known: int
) -> list[tuple[Answer, _Case]]:
    """The answer in each world that is asked of each naming of the lines, and the case that it comes from.

    All are compared with the least noise that any of the cases leaves.
    """
    alike = share_noise([noise(case) for case, _ in asked])
    return [
        (answer, case)
        for (case, worlds), own in zip(asked, alike, strict=True)
        for answer in answers_in(worlds, own, usual, template, known, case[0].rule(COARSE))
    ]


def _on_parabola(
    found: list[tuple[Answer, _Case]], usual: Priors, template: FieldTemplate, known: int
) -> list[tuple[Answer, _Case]]:
    """The likely answers of each kind of size and naming on roofs again, on parabolas: where a frame does not show
    clearly which it is, sigma tells; and a field of another size may fit only with the profile that it has.
    """
    least = max(answer.evidence for answer, _ in found) - OUT_OF_THE_QUESTION
    likely = [
        (answer, case)
        for (answer, case), share in zip(found, _shares_of_their_kind(found), strict=True)
        if share > UNLIKELY_SHARE and not answer.world.is_flat and answer.problem.model.surface.shape == "roof"
    ]
    return [
        (bent, pairs[0][1])
        for pairs in (list(group) for _, group in groupby(likely, key=lambda pair: id(pair[1])))
        for bent in bend_answers(
            [answer for answer, _ in pairs], usual, template, known, pairs[0][1][0].rule(FINE), least
        )
    ]


def _shares_of_their_kind(found: list[tuple[Answer, _Case]]) -> list[float]:
    """Posterior probability of each answer if the field is of its kind of size and the lines have its names.

    On a roof the front of a penalty area named on a rendered field 94 m long was out of the question beside the same
    field on a parabola without that name (a logarithm of the evidence of -105 and -87); on a parabola it has -83, and
    the camera is 0.6 px off instead of 9.4.
    """
    shares = posterior_shares([answer for answer, _ in found]).tolist()
    kinds = [(answer.world.size, frozenset(named.names.items())) for answer, (named, _) in found]
    total = {kind: sum(q for q, k in zip(shares, kinds, strict=True) if k == kind) for kind in set(kinds)}
    return [q / max(total[kind], 1e-300) for q, kind in zip(shares, kinds, strict=True)]


def _with_reported_noise(case: _Case) -> tuple[Problem, State]:
    _, fit = case
    return fit.problem, fit.state.best()


def _with_noise_of_misfit(case: _Case) -> tuple[Problem, State]:
    """The case with no more noise than its own residuals show, however quiet."""
    task, fit = case
    problem, state = _with_reported_noise(case)
    if fit.given_px is None:
        return problem, state
    quiet_px = QUIET_SIGMA_PX * task.observations.width / 1920.0
    least_px = with_model_noise(problem.curves, fit.given_px, task.noise, quiet_px)
    problem, state = reweight(problem, state, least_px)
    for _ in range(NOISE_ROUNDS):
        problem, state = noise_of_misfit(problem, resume(problem, state, task.rule(ROUGH)), least_px)
    return problem, resume(problem, state, task.rule(COARSE))


def _may_hide_misfit(case: _Case, answers: list[Answer]) -> bool:
    """Whether noise was told by residuals where it may be the size of the field that does not fit."""
    task, fit = case
    if fit.given_px is None or not depends_on_size(fit.problem.curves):
        return False
    return shows_size_closely(task, fit.problem.curves) or _doubt(answers) > UNLIKELY_SHARE


def _count_named(found: list[tuple[Answer, _Case]]) -> int:
    """How many different markings the best answer names. Several hold each other by lens and surface, which noise that
    is told by what one of them leaves does not cover: it may not take names away.
    """
    _, (named, _) = max(found, key=lambda pair: pair[0].evidence)
    return len(set(named.names.values()))


def _doubt(answers: list[Answer]) -> float:
    """Posterior probability that the field is not of the usual size."""
    shares = posterior_shares(answers)
    return float(sum(q for a, q in zip(answers, shares, strict=True) if not a.world.is_usual_size))


def _is_allowed(found: list[tuple[Answer, _Case]], template: FieldTemplate) -> bool:
    """Whether the best answer on a field of any size is one that the rules allow: else the misfit is not the size's."""
    other = max((a for a, _ in found if not a.world.is_usual_size), key=lambda a: a.evidence)
    growth = other.state.theta[0, [INDEX["length"], INDEX["breadth"]]].tolist()
    return all(
        e.beyond_rules(e.size_m + grown) <= BEYOND_RULES_M for e, grown in zip(template.extents, growth, strict=True)
    )


def _keep_noise(best: Answer, task: Task, fit: Fit) -> tuple[Problem, State]:
    """The answer with the noise that the fit to the same lines has."""
    return reweight(best.problem, best.state, fit.problem.curves.sigma_px)


def _tell_noise(best: Answer, task: Task, fit: Fit) -> tuple[Problem, State]:
    """The answer with the noise that its own residuals show, where they show little that of a close view."""
    if fit.given_px is None:
        return _keep_noise(best, task, fit)
    least_px = with_model_noise(best.problem.curves, fit.given_px, task.noise, close_sigma_px(task))
    return noise_of_misfit(best.problem, best.state, least_px)


def _may_be_of_any_size(task: Task, usual: tuple[Task, Fit], answers: list[Answer]) -> bool:
    """Whether lines are worth a name on a field of another size: those named on the usual one fit such a field as well,
    or long ones have no name there, or one that runs as a goal line does.
    """
    named, fit = usual
    if depends_on_size(fit.problem.curves) and _doubt(answers) > DOUBTED_SHARE:
        return True
    observations = hide_broad_lines(task.observations, fit.problem, fit.state, task.template)
    seen = [line.points_px for line in observations.lines]
    length_px = {k: len(seen[k]) * usual_step_px(seen[k]) for k in find_nameless_lines(observations)}
    named_px = sum(length_px.pop(k, 0.0) for k in named.names)
    nameless_px = sum(length_px.values())
    least_px = ACROSS_WIDTHS * task.observations.width
    if any(length > least_px and _runs_across(fit, seen[k]) for k, length in length_px.items()):
        return True
    if len(set(named.names.values())) >= SETTLING_LINES and nameless_px < SETTLED_SHARE * named_px:
        return False
    return nameless_px > NAMELESS_WIDTHS * task.observations.width


def _runs_across(fit: Fit, points_px: Array) -> bool:
    """Whether a line seen at points (N, 2), in order, runs as the goal lines do before the camera of a fit."""
    places = level_points(fit.state.best().theta, points_px[[0, -1]], fit.problem.model)[0]
    along, across = np.abs(places[1] - places[0])
    return bool(along < ACROSS_SLOPE * across)

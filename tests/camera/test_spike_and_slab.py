"""Fields of any size and shape: how the optimum on each of them is looked for."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from circlecal.camera import problem as problems
from circlecal.camera import spike_and_slab
from circlecal.camera.field_evidence import (
    ANYWHERE_PX,
    END_PX,
    OTHER_END_SHARE,
    OTHER_LINE_SHARE,
    STRAY_SHARE,
    _log_agreement_with_reach,
    _log_evidence_of_others,
    _log_share_of_places,
    _log_share_of_sizes,
    log_evidence,
    log_evidences,
)
from circlecal.camera.observed import points_from_observations
from circlecal.camera.priors import ZoomLens
from circlecal.camera.problem import (
    COARSE,
    FINAL,
    HARDLY_ZOOMED,
    evaluate,
    minimise,
    predict_optima,
    resume,
    reweight,
    stack_hypotheses,
    with_priors,
)
from circlecal.camera.residuals import sample_feet
from circlecal.camera.spike_and_slab import (
    UNSHARED_SIGMA_PX,
    answers_in,
    bend_answers,
    mix,
    possible_worlds,
    share_noise,
)
from circlecal.camera.world import FLAT_RELIEF_SHARE
from circlecal.geometry.camera_parameters import INDEX, PARAMETERS, level_points, project
from circlecal.observations import LinePoints

from .test_problem import MODEL, SOCCER, observed, plain_theta, priors, problem_of

BROADER_M = 4.0
"""By how much the far touchline lies beyond its usual place."""


@pytest.mark.parametrize(("reach", "fits"), [(HARDLY_ZOOMED, 0), (0.0, 4)])
def test_a_world_that_the_linear_model_foretells_is_not_fitted(reach, fits, monkeypatch):
    """And weighs what it does at its optimum."""
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    usual = priors(crown=0.03, length=1.0, breadth=0.7)
    problem = problem_of(observed(theta, rng, sigma=0.3), usual)
    state = minimise(problem, theta[None])
    followed = []

    def follow(problem, start, rule):
        followed.append(problem)
        return resume(problem, start, rule)

    monkeypatch.setattr(spike_and_slab, "resume", follow)
    monkeypatch.setattr(spike_and_slab, "OUT_OF_THE_QUESTION", np.inf)
    monkeypatch.setattr(problems, "HARDLY_ZOOMED", reach)
    worlds, known = possible_worlds(SOCCER, usual, {"usual": 0.8, "any": 0.2}, 0.3), len(problem.curves.keys)
    found = answers_in(worlds, (problem, state), usual, SOCCER, known, FINAL)
    assert len(followed) == fits
    assert [answer.is_predicted for answer in found] == [fits == 0] * 4
    for answer in found:
        exact = resume(answer.problem, minimise(answer.problem, theta[None]), FINAL)
        expected = log_evidence(answer.world, answer.problem, exact, SOCCER, known)
        assert answer.evidence == pytest.approx(expected, abs=0.1)


def test_an_answer_is_weighed_at_its_optimum_with_the_noise_that_all_answers_share():
    """Where the halfway line had passed for noise, a usual field lost by 90 to one 12 m broader, 45 px off."""
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    usual = priors(crown=0.03, length=1.0, breadth=0.7)
    problem = problem_of(observed(theta, rng, sigma=0.3), usual)
    is_line = problem.curves.group == len(problem.curves.keys) - 1
    noisy, _ = reweight(problem, minimise(problem, theta[None]), np.where(is_line, 40.0, 1.0) * problem.curves.sigma_px)
    case = reweight(noisy, minimise(noisy, theta[None]), problem.curves.sigma_px)
    worlds, known = possible_worlds(SOCCER, usual, {"usual": 1.0}, 0.0), len(problem.curves.keys)
    (found,) = answers_in(worlds, case, usual, SOCCER, known, FINAL)
    exact = minimise(problem, theta[None])
    assert case[1].cost[0] > exact.cost[0] + 1.0
    assert found.evidence == pytest.approx(log_evidence(worlds[0], problem, exact, SOCCER, known), abs=0.1)


def test_a_parabola_is_looked_for_only_where_the_linear_model_foretells_enough():
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    usual = priors(crown=0.03, length=1.0, breadth=0.7)
    problem = problem_of(observed(theta, rng, sigma=0.3), usual)
    worlds, known = possible_worlds(SOCCER, usual, {"usual": 1.0}, 0.0, 0.3), len(problem.curves.keys)
    (roof,) = answers_in(worlds, (problem, minimise(problem, theta[None])), usual, SOCCER, known, FINAL)
    roof = replace(roof, problem=replace(problem, model=replace(MODEL, surface=replace(MODEL.surface, shape="roof"))))
    assert bend_answers([roof], usual, SOCCER, known, FINAL, np.inf) == []
    (bent,) = bend_answers([roof], usual, SOCCER, known, FINAL, -np.inf)
    assert bent.problem.model.surface.shape == "parabola"


def test_a_flat_field_begins_where_the_crowned_one_of_its_size_ended(monkeypatch):
    """And arrives where it would from the usual field, in fewer steps."""
    rng = np.random.default_rng(3)
    theta = plain_theta(rng)
    seen = observed(theta, rng, sigma=0.3)
    touchline = np.stack([np.linspace(-15.0, 15.0, 40), np.full(40, -34.0 - BROADER_M)], axis=-1)
    pixels = project(theta[None], touchline[None], MODEL).pixels[0] + rng.normal(0.0, 0.3, (40, 2))
    seen = replace(seen, lines=(*seen.lines, LinePoints("side_line_top", pixels, np.full(40, 0.3))))
    usual = priors(crown=0.03, length=1.0, breadth=0.7)
    problem = problem_of(seen, usual)
    state = minimise(problem, theta[None])
    worlds = possible_worlds(SOCCER, usual, {"usual": 0.8, "any": 0.2}, 0.3)
    assert [(w.size, w.is_flat) for w in worlds] == [(s, f) for f in (False, True) for s in ("usual", "any")]
    starts, ends = [], []

    def follow(problem, start, rule):
        starts.append(start.theta[0])
        ends.append(resume(problem, start, rule))
        return ends[-1]

    monkeypatch.setattr(spike_and_slab, "resume", follow)
    monkeypatch.setattr(spike_and_slab, "OUT_OF_THE_QUESTION", np.inf)
    found = answers_in(worlds, (problem, state), usual, SOCCER, len(problem.curves.keys), COARSE)
    _, any_crowned, _, any_flat = found
    np.testing.assert_array_equal(starts[-1], any_crowned.state.theta[0])
    alone = resume(any_flat.problem, minimise(any_flat.problem, theta[None]), FINAL)
    assert abs(any_flat.state.cost[0] - alone.cost[0]) < COARSE.tolerance


def test_a_mark_of_a_flat_field_lies_on_even_ground():
    """And the state of every world is the one that an evaluation of its own problem gives."""
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    seen, usual = observed(theta, rng, sigma=0.3), priors(crown=0.03, length=1.0, breadth=0.7)
    problem = replace(problem_of(seen, usual), points=points_from_observations(seen, SOCCER, relief_m=0.03))
    state = evaluate(problem, theta[None], minimise(problem, theta[None]).feet, updates=8)
    worlds = possible_worlds(SOCCER, usual, {"usual": 0.8, "any": 0.2}, 0.3)
    described = [world.describe(problem, usual, SOCCER) for world in worlds]
    _, entered = stack_hypotheses(problem, state, described)
    sigma, upright = problem.points.sigma_px, problem.points.upright_px
    even = np.hypot(sigma, FLAT_RELIEF_SHARE * np.sqrt(upright**2 - sigma**2))
    assert (even < 0.9 * upright).all()
    for k, (world, own) in enumerate(zip(worlds, described, strict=True)):
        np.testing.assert_allclose(own.points.upright_px, even if world.is_flat else upright)
        anew = evaluate(own, state.theta, state.feet, updates=8)
        for name in ("values", "jacobian", "prior_values", "prior_jacobian", "cost", "gradient", "normal"):
            np.testing.assert_allclose(getattr(entered, name)[k], getattr(anew, name)[0], rtol=1e-6, atol=1e-6)


def test_worlds_are_foretold_side_by_side_as_each_of_them_alone():
    """Under a zoom lens, whose distortion has a mean that follows the focal length, and one world before any lens."""
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    usual = replace(priors(crown=0.03, length=1.0, breadth=0.7), lens=ZoomLens(0.01, 0.1, MODEL.width))
    problem = problem_of(observed(theta, rng, sigma=0.3), usual)
    state = minimise(problem, theta[None])
    worlds = possible_worlds(SOCCER, usual, {"usual": 0.8, "any": 0.2}, 0.3)
    worlds = (*worlds, worlds[0].with_any_lens(0.1))
    described = [world.describe(problem, usual, SOCCER) for world in worlds]
    ahead, is_sure = predict_optima(*stack_hypotheses(problem, state, described))
    evidence = log_evidences(worlds, described, ahead, SOCCER, 2)
    assert np.ptp(evidence) > 0.1
    for k, (world, own) in enumerate(zip(worlds, described, strict=True)):
        alone, is_sure_alone = predict_optima(*with_priors(problem, state, own.priors))
        np.testing.assert_allclose(ahead.theta[k], alone.theta[0], rtol=1e-9, atol=1e-9)
        assert is_sure[k] == is_sure_alone[0]
        assert evidence[k] == pytest.approx(log_evidence(world, own, alone, SOCCER, 2), abs=1e-6)


def test_noise_is_shared_by_points_though_one_case_left_some_of_them_out():
    """A camera that explains the circle badly takes that for noise, and others would have to compete with it."""
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=0.3), priors())
    state = minimise(problem, theta[None])
    count = len(problem.curves.sigma_px)
    kept = np.delete(np.arange(count), [3, 17])
    fewer = replace(problem, curves=problem.curves.select(kept))
    fewer, its = reweight(fewer, minimise(fewer, theta[None]), np.full(len(kept), 4.0))
    (quiet, _), (loud, its) = share_noise([(problem, state), (fewer, its)])
    assert loud.curves.sigma_px == pytest.approx(problem.curves.sigma_px[kept])
    assert quiet.curves.sigma_px[kept] == pytest.approx(problem.curves.sigma_px[kept])
    # what one left out counts for neither
    assert (quiet.curves.sigma_px[[3, 17]] == UNSHARED_SIGMA_PX).all()
    assert np.square(200.0 / UNSHARED_SIGMA_PX) < 1e-4  # chi-square of a point that lies 200 px off
    assert its.residuals[0] == pytest.approx(evaluate(loud, its.theta, its.feet).residuals[0], abs=1e-3)


def test_a_marking_that_only_one_case_has_keeps_its_noise():
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    seen = observed(theta, rng, sigma=0.3)
    pixels = project(theta[None], np.stack([np.linspace(-15, 15, 40), np.full(40, -34.0)], axis=-1)[None], MODEL).pixels
    more = replace(seen, lines=(*seen.lines, LinePoints("side_line_top", pixels[0], np.full(40, 0.3))))
    cases = [(p, minimise(p, theta[None])) for p in (problem_of(seen, priors()), problem_of(more, priors()))]
    for (given, _), (shared, _) in zip(cases, share_noise(cases), strict=True):
        assert shared.curves.sigma_px == pytest.approx(given.curves.sigma_px)


def test_what_else_a_line_may_be_is_the_integral_over_all_places_of_its_ends():
    rng = np.random.default_rng(5)
    t, sigma, width = np.linspace(0.0, 1.0, 12), rng.uniform(0.8, 1.6, 12), 1280
    basis = np.stack([(1.0 - t) / sigma, t / sigma, t * (1.0 - t) / sigma], axis=1)
    scatter = rng.normal(size=12)
    scatter -= basis @ np.linalg.lstsq(basis, scatter, rcond=None)[0]  # what no straight and no bent line explains
    values = basis @ (3.0, -5.0, 2.0) + scatter
    first, second = np.meshgrid(np.linspace(-12.0, 12.0, 481), np.linspace(-12.0, 12.0, 481))
    places = np.stack([first.ravel(), second.ravel()])
    chi2 = np.square(scatter[:, None] + basis[:, :2] @ places).sum(axis=0)
    range_px = ANYWHERE_PX * width / 1920.0
    integral = np.exp(-0.5 * chi2).sum() * 0.05**2 / range_px**2
    end_sigma = 2.0  # of one point, where another line ends
    of_end = np.sqrt(2.0 * np.pi) * end_sigma / range_px
    expected = np.log(OTHER_LINE_SHARE / (1.0 - OTHER_LINE_SHARE) * integral)
    expected += np.log(OTHER_END_SHARE / (1.0 - OTHER_END_SHARE) * of_end)
    curves = SimpleNamespace(group=np.repeat([0, 1, 2], [5, 12, 1]), sigma_px=np.r_[np.ones(5), sigma, end_sigma])
    problem = SimpleNamespace(curves=curves, model=SimpleNamespace(width=width), loss_scale=1e6)
    state = SimpleNamespace(residuals=np.r_[np.full(5, 99.0), values, 7.0][None], feet=np.r_[np.zeros(5), t, 0.5][None])
    assert _log_evidence_of_others(problem, state, known=1) == pytest.approx(expected, abs=1e-3)


def test_a_mark_on_uneven_ground_is_evidence_by_its_density():
    """A mark that lies at its place speaks for a camera by so much less as the ground may be more uneven: the normal
    density of its residual has the standard deviation below.
    """
    rng = np.random.default_rng(4)
    theta = plain_theta(rng)
    usual = priors(crown=0.03, length=1.0, breadth=0.7)
    problem = problem_of(observed(theta, rng, sigma=0.3), usual)
    state, world = minimise(problem, theta[None]), possible_worlds(SOCCER, usual, {"usual": 1.0}, 0.0)[0]
    evidence = []
    for upright_px in (0.5, 4.0):
        points = replace(problem.points, upright_px=np.array([upright_px]))
        evidence.append(log_evidence(world, replace(problem, points=points), state, SOCCER, len(problem.curves.keys)))
    assert evidence[0] - evidence[1] == pytest.approx(np.log(4.0 / 0.5))


def test_a_mixture_is_as_wide_as_its_draws():
    """Two answers that lie apart: the second moment about the reported one is that of draws of either."""
    rng, count = np.random.default_rng(8), 400_000
    size = len(PARAMETERS)
    mean = np.zeros((2, size))
    mean[1, :2] = 3.0, -1.0
    problem = SimpleNamespace(priors=SimpleNamespace(sd=np.full(size, np.inf)))
    answers = []
    for k, (kind, spread, share) in enumerate((("usual", 1.0, 0.7), ("any", 0.5, 0.3))):
        state = SimpleNamespace(theta=mean[k : k + 1], normal=np.eye(size)[None] / spread**2)
        world, evidence = SimpleNamespace(size=kind), np.log(share)
        answers.append(SimpleNamespace(state=state, problem=problem, world=world, evidence=evidence))
    posterior = mix(answers, answers[0], mean[0])
    is_other = (rng.random(count) < 0.3)[:, None]
    draws = np.where(is_other, mean[1, :2], 0.0) + np.where(is_other, 0.5, 1.0) * rng.normal(size=(count, 2))
    np.testing.assert_allclose(posterior.widen(np.eye(size))[:2, :2], draws.T @ draws / len(draws), atol=0.03)
    assert posterior.usual_share == pytest.approx(0.7) and posterior.resized_share == pytest.approx(0.3)
    apart = np.outer(mean[1], mean[1]) + 0.25 * np.eye(size)
    np.testing.assert_allclose(posterior.resized, apart)


def test_a_mixture_of_cameras_on_both_sides_of_a_half_turn_is_narrow():
    size, pan = len(PARAMETERS), INDEX["pan"]
    theta = np.zeros((2, size))
    theta[:, pan] = np.pi - 0.01, 0.01 - np.pi
    problem = SimpleNamespace(priors=SimpleNamespace(sd=np.full(size, np.inf)))
    states = [SimpleNamespace(theta=row[None], normal=1e6 * np.eye(size)[None]) for row in theta]
    answers = [
        SimpleNamespace(state=s, problem=problem, world=SimpleNamespace(size="usual"), evidence=0.0) for s in states
    ]
    assert mix(answers, answers[0], theta[0]).others[pan, pan] == pytest.approx(0.5 * 0.02**2, rel=0.01)


def test_a_field_beyond_the_rules_has_less_evidence_than_one_within(monkeypatch):
    rng = np.random.default_rng(5)
    theta = plain_theta(rng)
    usual = priors(crown=0.03, length=8.0, breadth=6.0)
    problem = problem_of(observed(theta, rng, sigma=0.3), usual)
    state = minimise(problem, theta[None])
    world = next(w for w in possible_worlds(SOCCER, usual, {"usual": 0.5, "any": 0.5}, 0.0) if not w.is_usual_size)
    told = {}
    for share in (1.0, 1e-3):
        monkeypatch.setattr(
            "circlecal.camera.field_evidence._log_share_of_sizes", lambda *given, share=share: float(np.log(share))
        )
        told[share] = log_evidence(world, problem, state, SOCCER, 1)
    assert told[1e-3] - told[1.0] == pytest.approx(np.log(1e-3))


@pytest.mark.parametrize("beyond_m", [6.0, 9.0, 11.0])
def test_cameras_over_the_field_are_rare_by_the_share_of_places_beside_it(beyond_m):
    """How broad the field is and where the camera stands are known together."""
    y, z, breadth = INDEX["y"], INDEX["z"], INDEX["breadth"]
    theta, covariance = np.zeros(len(PARAMETERS)), np.zeros((len(PARAMETERS), len(PARAMETERS)))
    theta[[y, z]] = 34.0 + beyond_m, -10.0
    mixing = np.array([[1.5, 0.0, 0.0], [0.4, 0.5, 0.0], [2.0, 0.3, 1.0]])
    covariance[np.ix_([y, z, breadth], [y, z, breadth])] = mixing @ mixing.T
    draws = theta[[y, z, breadth]] + np.random.default_rng(6).normal(size=(200_000, 3)) @ mixing.T
    is_beside = draws[:, 0] - 0.5 * (68.0 + draws[:, 2]) > -draws[:, 1] - 2.0  # than a person's head
    expected = np.mean(np.where(is_beside, 1.0, 0.01))
    assert _log_share_of_places(theta, covariance, SOCCER) == pytest.approx(np.log(expected), abs=0.02)


@pytest.mark.parametrize(("length_m", "share"), [(105.0, 1.0), (120.0, 0.5), (120.3, 0.00135), (123.0, 1e-6)])
def test_fields_beyond_the_rules_are_unlikely_by_how_surely_they_are(length_m, share):
    theta, covariance = np.zeros(len(PARAMETERS)), np.zeros((len(PARAMETERS), len(PARAMETERS)))
    theta[INDEX["length"]] = length_m - 105.0  # known exactly, and taken as known to 0.1 m
    assert np.exp(_log_share_of_sizes(theta, covariance, SOCCER)) == pytest.approx(share, rel=0.01)


@pytest.mark.parametrize("reach_m", [30.0, 33.5, 34.5, 36.0, 40.0])
def test_a_field_is_unlikely_by_the_share_of_cameras_that_see_its_halfway_line_beyond_its_end(reach_m):
    """The camera and how broad the field is are known together; the last of forty places on the line counts as a stray
    one, and the picture is flat and without distortion, so that a pixel's place on the field is known in closed form.
    """
    rng = np.random.default_rng(7)
    theta = plain_theta(rng)
    seen = observed(theta, rng, sigma=0.0)
    places = np.stack([np.zeros(40), np.r_[np.linspace(-11.0, reach_m, 39), reach_m + 0.5]], axis=-1)
    pixels = project(theta[None], places[None], MODEL).pixels[0]
    seen = replace(seen, lines=(LinePoints("halfway_line", pixels, np.full(40, 0.3)),))
    problem = problem_of(seen, priors(breadth=1.0))
    state = evaluate(problem, theta[None], sample_feet(problem.curves, theta[None], MODEL), updates=12)
    varied = [INDEX[name] for name in ("tilt", "y", "breadth")]
    mixing = np.array([[2e-3, 0.0, 0.0], [0.2, 0.3, 0.0], [0.5, 0.3, 1.0]])
    covariance = np.zeros((len(PARAMETERS), len(PARAMETERS)))
    covariance[np.ix_(varied, varied)] = mixing @ mixing.T
    draws = np.tile(theta, (20_000, 1))
    draws[:, varied] += rng.normal(size=(20_000, 3)) @ mixing.T
    last_m = level_points(draws, pixels[38:39], MODEL)[:, 0, 1]
    around = places[38] + np.array([[0.0, -0.5], [0.0, 0.5]])
    metre_px = np.linalg.norm(np.diff(project(theta[None], around[None], MODEL).pixels[0], axis=0))
    last_m = last_m + rng.normal(size=len(last_m)) * END_PX / metre_px
    inside = np.mean(last_m < 34.0 + 0.5 * draws[:, INDEX["breadth"]])
    expected = np.log(STRAY_SHARE + (1.0 - STRAY_SHARE) * min(2.0 * inside, 1.0))
    assert _log_agreement_with_reach(problem, state, 0, covariance, SOCCER) == pytest.approx(expected, abs=0.1)

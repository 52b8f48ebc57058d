"""Which field it may be: what is asked of which naming of the lines, and where the answer that is taken ends."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from circlecal.camera.problem import COARSE, FINAL, minimise, predict_step
from circlecal.camera.spike_and_slab import Answer
from circlecal.camera.world import World
from circlecal.estimation import worlds as module
from circlecal.estimation.worlds import _by_size, _reach
from circlecal.field.template import Extent
from circlecal.geometry.camera_parameters import INDEX, project
from circlecal.observations import LinePoints, Observations
from tests.camera.test_problem import observed, plain_theta, priors, problem_of

WORLDS = tuple(World(size, is_flat, 1 / 6) for is_flat in (False, True) for size in ("usual", "other_length", "any"))

CONFIG = SimpleNamespace(
    crown_shape="roof",
    usual_size_share=0.9,
    other_length_share=0.5,
    flat_share=0.5,
    name_lines=True,
    other_lens_share=0.0,
)


def fit_without_lines() -> module.Fit:
    """Of a circle and its halfway line."""
    rng = np.random.default_rng(6)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=0.3), priors())
    return module.Fit(problem, minimise(problem, theta[None], FINAL))


def test_no_world_is_asked_twice_of_the_lines_of_a_usual_field():
    usual, other, resized = cast("list[Any]", ["usual", "other", "resized"])
    asked = _by_size([usual, other], WORLDS, [resized, resized])
    assert [case for case, _ in asked] == [usual, other, resized, resized]
    assert asked[1][1] == WORLDS
    assert {world.size for world in asked[0][1]} == {"usual", "other_length"}
    assert {world.size for _, worlds in asked[2:] for world in worlds} == {"any"}
    assert {*asked[0][1], *asked[2][1]} == set(WORLDS)


def test_an_answer_that_was_only_foretold_is_followed_to_its_optimum():
    rng = np.random.default_rng(6)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=0.3), priors())
    optimum = minimise(problem, theta[None], FINAL)
    start = minimise(problem, theta[None], COARSE)
    foretold = Answer(WORLDS[0], problem, predict_step(problem, start), 0.0, is_predicted=True)
    found = _reach(foretold, FINAL)
    assert not found.is_predicted
    assert found.state.cost[0] == pytest.approx(optimum.cost[0], abs=1e-3)
    assert _reach(found, FINAL) is found


@pytest.mark.parametrize(("names", "fits"), [({0: "side_line_top"}, 0), ({0: "side_line_bottom"}, 1)])
def test_lines_are_fitted_on_a_field_of_any_size_only_under_other_names(names, fits, monkeypatch):
    rng = np.random.default_rng(6)
    theta = plain_theta(rng)
    problem = problem_of(observed(theta, rng, sigma=0.3), priors())
    state = minimise(problem, theta[None], FINAL)
    recognised = SimpleNamespace(names=names, problem=problem)
    taken: list[dict[int, str]] = []

    def take_in(task, stated, fit, more):
        taken.append(more.names)
        return task, fit

    monkeypatch.setattr(module, "recognise", lambda task, stated, fit: recognised)
    monkeypatch.setattr(module, "take_in", take_in)
    monkeypatch.setattr(module, "depends_on_size", lambda curves: True)
    task = cast("Any", SimpleNamespace(names={}, rule=lambda rule: rule))
    usual = cast("Any", (SimpleNamespace(names={0: "side_line_top"}), None))
    found = module._name_on_any_size(task, problem.curves, module.Fit(problem, state), usual, problem.priors)
    assert len(taken) == fits
    assert (found is not None) == bool(fits)


def test_a_field_of_any_size_is_asked_of_both_profiles_of_its_pitch():
    fit = fit_without_lines()
    any_size = next(world for world in WORLDS if world.size == "any" and not world.is_flat)
    surface = fit.problem.model.surface
    problems = [
        replace(fit.problem, model=replace(fit.problem.model, surface=replace(surface, shape=shape)))
        for shape in ("parabola", "roof", "roof")
    ]
    own, others = (SimpleNamespace(rule=lambda rule: rule) for _ in range(2))
    case, stranger = cast("list[Any]", [(own, fit), (others, fit)])
    answers = [Answer(any_size, problem, fit.state, -float(k)) for k, problem in enumerate(problems)]
    found = [(answers[0], case), (answers[2], case), (answers[1], case), (answers[1], stranger)]
    resized = module._resize([case], found, any_size)
    assert [named for named, _ in resized] == [own, own]
    assert {id(new.problem) for _, new in resized} == {id(problem) for problem in problems[:2]}


@pytest.mark.parametrize(("beyond_m", "is_allowed"), [(-5.0, True), (1.2, True), (18.0, False)])
def test_a_size_may_lie_outside_of_the_rules_by_its_own_error(beyond_m, is_allowed):
    fit = fit_without_lines()
    extent = Extent(68.0, (45.0, 90.0))
    theta = fit.state.theta.copy()
    theta[0, INDEX["breadth"]] = 90.0 + beyond_m - extent.size_m
    any_size = next(world for world in WORLDS if world.size == "any" and not world.is_flat)
    answer = Answer(any_size, fit.problem, replace(fit.state, theta=theta), 0.0)
    template = cast("Any", SimpleNamespace(extents=(Extent(105.0, (90.0, 120.0)), extent)))
    assert module._is_allowed([(answer, cast("Any", None))], template) is is_allowed


@pytest.mark.parametrize(
    ("other_size", "other_names"), [("usual", {}), ("any", {0: "big_rect_left_main"})], ids=["size", "naming"]
)
def test_parabolas_are_asked_of_every_size_and_naming_however_unlikely_its_roof(monkeypatch, other_size, other_names):
    """On a roof a usual field lost by 37 to one 12 m broader, and on the parabola that it was it won by 14; and a field
    of another size lost with the name of a line by 18 to itself without that name, and won by 4 on a parabola.
    """
    fit = fit_without_lines()
    surface = replace(fit.problem.model.surface, shape="roof")
    problem = replace(fit.problem, model=replace(fit.problem.model, surface=surface))
    crowned = {world.size: world for world in WORLDS if not world.is_flat}
    cases = [(SimpleNamespace(rule=lambda rule: rule, names=names), fit) for names in ({}, other_names)]
    answers = [
        Answer(crowned[size], problem, fit.state, evidence) for size, evidence in (("any", 0.0), (other_size, -37.0))
    ]
    asked: list[tuple[str, float]] = []

    def bend(answers, usual, template, known, rule, least):
        asked.extend((answer.world.size, least) for answer in answers)
        return []

    monkeypatch.setattr(module, "bend_answers", bend)
    found = list(zip(answers, cast("list[Any]", cases), strict=True))
    module._on_parabola(found, problem.priors, cast("Any", None), 0)
    assert asked == [("any", -module.OUT_OF_THE_QUESTION), (other_size, -module.OUT_OF_THE_QUESTION)]


@pytest.mark.parametrize("takes_names", [True, False])
def test_noise_that_one_line_leaves_takes_no_names_away(takes_names, monkeypatch):
    fit = fit_without_lines()
    problem = fit.problem
    usual, other = (
        (SimpleNamespace(names=names, config=CONFIG, template=None, rule=lambda rule: rule), fit)
        for names in ({0: "side_line_top"}, {0: "side_line_top", 1: "big_rect_left_top"})
    )
    any_size = next(world for world in WORLDS if world.size == "any" and not world.is_flat)

    def compare(asked, noise, priors, template, known):
        """Two markings are the likelier, with the noise that one leaves perhaps not."""
        is_reverse = takes_names and noise is module._with_noise_of_misfit
        evidence = {1: 2.0 if is_reverse else 0.0, 2: 1.0}
        return [(Answer(any_size, problem, fit.state, evidence[len(case[0].names)]), case) for case, _ in asked]

    def report(how):
        def answer(best, task, fit):
            reported.append(how)
            return problem, fit.state

        return answer

    reported: list[str] = []

    monkeypatch.setattr(module, "possible_worlds", lambda *given: WORLDS)
    monkeypatch.setattr(module, "_compare_worlds", compare)
    monkeypatch.setattr(module, "_resize", lambda *given: [usual])
    monkeypatch.setattr(module, "_may_be_of_any_size", lambda *given: True)
    monkeypatch.setattr(module, "_name_on_any_size", lambda *given: other)
    monkeypatch.setattr(module, "_may_hide_misfit", lambda *given: True)
    monkeypatch.setattr(module, "_is_allowed", lambda *given: True)
    monkeypatch.setattr(module, "shows_size_closely", lambda *given: True)
    monkeypatch.setattr(module, "_tell_noise", report("of misfit"))
    monkeypatch.setattr(module, "_keep_noise", report("kept"))
    monkeypatch.setattr(module, "_explore", lambda task, fit: fit)
    monkeypatch.setattr(World, "priors", lambda self, *given: problem.priors)
    chosen, _ = module.choose_world(cast("Any", usual[0]), problem.curves, fit, cast("Any", usual))
    assert chosen is other[0]
    assert reported == ["kept" if takes_names else "of misfit"]


@pytest.mark.parametrize(("beyond_m", "reported"), [(1.0, "of misfit"), (18.0, "kept")])
def test_misfit_that_only_a_field_beyond_the_rules_explains_is_not_that_of_its_size(beyond_m, reported, monkeypatch):
    fit = fit_without_lines()
    problem, theta = fit.problem, fit.state.theta.copy()
    theta[0, INDEX["breadth"]] = 90.0 + beyond_m - 68.0
    large = replace(fit.state, theta=theta)
    template = SimpleNamespace(extents=(Extent(105.0, (90.0, 120.0)), Extent(68.0, (45.0, 90.0))))
    names = {0: "side_line_top"}
    usual = (SimpleNamespace(names=names, config=CONFIG, template=template, rule=lambda rule: rule), fit)
    usual_size, any_size = (
        next(world for world in WORLDS if world.size == size and not world.is_flat) for size in ("usual", "any")
    )
    told: list[str] = []

    def compare(asked, noise, *given):
        is_told = noise is module._with_noise_of_misfit
        (case, _), *_ = asked
        answers = (
            Answer(usual_size, problem, fit.state, 0.0),
            Answer(any_size, problem, large, 3.0 if is_told else -3.0),
        )
        return [(answer, case) for answer in answers]

    def report(how):
        return lambda best, task, fit: told.append(how) or (problem, best.state)

    monkeypatch.setattr(module, "possible_worlds", lambda *given: WORLDS)
    monkeypatch.setattr(module, "_compare_worlds", compare)
    monkeypatch.setattr(module, "_resize", lambda *given: [usual])
    monkeypatch.setattr(module, "_may_be_of_any_size", lambda *given: False)
    monkeypatch.setattr(module, "_may_hide_misfit", lambda *given: True)
    monkeypatch.setattr(module, "shows_size_closely", lambda *given: False)
    monkeypatch.setattr(module, "_tell_noise", report("of misfit"))
    monkeypatch.setattr(module, "_keep_noise", report("kept"))
    monkeypatch.setattr(module, "_explore", lambda task, fit: fit)
    _, found = module.choose_world(cast("Any", usual[0]), problem.curves, fit, cast("Any", usual))
    assert told == [reported]
    assert found.posterior.world.size == ("usual" if reported == "kept" else "any")


@pytest.mark.parametrize(
    ("size", "left"), [("usual", ["own"]), ("other_length", ["own", "roof"]), ("any", ["own", "roof"])]
)
def test_roofs_are_needless_only_where_a_field_of_the_usual_size_is_the_likeliest(size, left):
    """On another field the profile was not chosen yet: the roof tells how surely it is known."""
    own, roof = cast("list[Any]", [("own", None), ("roof", None)])
    best, other = (
        Answer(next(world for world in WORLDS if world.size == kind), cast("Any", None), cast("Any", None), evidence)
        for kind, evidence in ((size, 0.0), ("usual", -2.0))
    )
    found = [(best, own), (other, roof)]
    assert [case[0] for _, case in module._without_needless([roof], found)] == left


@pytest.mark.parametrize("asks_at_first", [True, False])
def test_lines_are_named_anew_once_whichever_noise_asks_for_it(asks_at_first, monkeypatch):
    fit = fit_without_lines()
    problem = fit.problem
    usual = (SimpleNamespace(names={0: "side_line_top"}, config=CONFIG, template=None, rule=lambda rule: rule), fit)
    usual_size = next(world for world in WORLDS if world.size == "usual" and not world.is_flat)
    answers = iter([asks_at_first, True, True])
    named: list[int] = []

    def name(*given):
        named.append(1)

    def compare(asked, *given):
        return [(Answer(usual_size, problem, fit.state, 0.0), case) for case, _ in asked]

    monkeypatch.setattr(module, "possible_worlds", lambda *given: WORLDS)
    monkeypatch.setattr(module, "_compare_worlds", compare)
    monkeypatch.setattr(module, "_resize", lambda *given: [usual])
    monkeypatch.setattr(module, "_may_be_of_any_size", lambda *given: next(answers))
    monkeypatch.setattr(module, "_name_on_any_size", name)
    monkeypatch.setattr(module, "_may_hide_misfit", lambda *given: True)
    monkeypatch.setattr(module, "_is_allowed", lambda *given: True)
    monkeypatch.setattr(module, "shows_size_closely", lambda *given: False)
    monkeypatch.setattr(module, "_explore", lambda task, fit: fit)
    monkeypatch.setattr(World, "priors", lambda self, *given: problem.priors)
    chosen, _ = module.choose_world(cast("Any", usual[0]), problem.curves, fit, cast("Any", usual))
    assert chosen is usual[0]
    assert len(named) == 1


@pytest.mark.parametrize(
    ("named_px", "nameless_px", "asks"),
    [(200.0, 500.0, True), (200.0, 90.0, False), (600.0, 400.0, True), (600.0, 280.0, False)],
)
def test_names_of_few_points_weigh_nothing_against_long_lines_without_a_name(named_px, nameless_px, asks, monkeypatch):
    def line(name, count, length_px):
        points_px = np.column_stack([np.linspace(0.0, length_px, count), np.zeros(count)])
        return LinePoints(name, points_px, np.ones(count))

    lines = (
        line("halfway_line", 50, 400.0),
        line(None, 5, 40.0),
        line(None, 40, named_px),
        line(None, 40, nameless_px),
    )
    task = SimpleNamespace(observations=Observations(1280, 720, (), lines), template=None)
    usual = (
        SimpleNamespace(names={1: "side_line_top", 2: "big_rect_left_top"}),
        SimpleNamespace(problem=SimpleNamespace(curves=None), state=None),
    )
    monkeypatch.setattr(module, "depends_on_size", lambda curves: False)
    monkeypatch.setattr(module, "_runs_across", lambda fit, points_px: False)
    assert module._may_be_of_any_size(cast("Any", task), cast("Any", usual), []) is asks
    # what runs as a goal line asks however short it is, but for the halfway line and lines of few points
    monkeypatch.setattr(module, "_runs_across", lambda fit, points_px: points_px[-1, 0] in (40.0, nameless_px, 400.0))
    usual[0].names[3] = "goal_line_left"
    assert not module._may_be_of_any_size(cast("Any", task), cast("Any", usual), [])
    del usual[0].names[3]
    assert module._may_be_of_any_size(cast("Any", task), cast("Any", usual), []) is (nameless_px > 0.08 * 1280)


@pytest.mark.parametrize(("turn_deg", "is_across"), [(90.0, True), (86.0, True), (80.0, False), (0.0, False)])
def test_a_line_that_runs_as_goal_lines_do_is_told_on_the_field(turn_deg, is_across):
    fit = fit_without_lines()
    along = np.array([np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))])
    places = np.array([3.0, -4.0]) + np.linspace(0.0, 8.0, 9)[:, None] * along
    pixels = project(fit.state.best().theta, places[None], fit.problem.model).pixels[0]
    assert module._runs_across(fit, pixels) is is_across

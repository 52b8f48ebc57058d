"""The one optimiser: where starts end, why, and that they do not disturb each other."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from circlecal.geometry.least_squares import (
    DenseProblem,
    End,
    NormalState,
    StoppingRule,
    minimise,
    predict_decrease,
    solve_damped,
)

RULE = StoppingRule(1e-9, iterations=200)


@dataclass(frozen=True, slots=True)
class Valley(DenseProblem):
    """Rosenbrock's valley with a floor, which lies higher where x < 0: residuals ``10 (y - x^2), 1 - x, floor``."""

    floor: float = 0.0
    ledge: float = 0.0

    def evaluate(self, parameters):
        x, y = parameters.T
        one = np.ones_like(x)
        residuals = np.stack([10 * (y - x * x), 1 - x, self.floor + self.ledge * (x < 0)], axis=-1)
        rows = np.stack([np.stack([-20 * x, 10 * one]), np.stack([-one, 0 * one]), np.zeros((2, len(x)))])
        J = np.moveaxis(rows, -1, 0)
        gradient = (residuals[:, None] @ J)[:, 0]
        return NormalState(parameters, (residuals**2).sum(axis=1), gradient, np.swapaxes(J, 1, 2) @ J)


@dataclass(frozen=True, slots=True)
class Wall(Valley):
    """The valley where nothing beyond the first parameters means anything."""

    start: float = -1.2

    def evaluate(self, parameters):
        state = super(Wall, self).evaluate(parameters)
        return replace(state, cost=np.where(parameters[:, 0] == self.start, state.cost, np.inf))


@dataclass(frozen=True, slots=True)
class KeptValley(Valley):
    """The valley with residuals that are kept: they depart from the linear model by ``-10 dx^2`` in the first one."""

    def bend(self, state, step, proposal):
        x = state.parameters[:, 0]
        off = -10 * step.change[:, 0] ** 2
        return replace(state, gradient=state.gradient + off[:, None] * np.stack([-20 * x, 10 + 0 * x], axis=-1))


@dataclass(frozen=True, slots=True)
class Cliff(Wall):
    """The wall, of a height that is a number, and steps that promise nothing."""

    def step(self, state, damping):
        found = super(Cliff, self).step(state, damping)
        return replace(found, promise=np.zeros(len(damping)))

    def evaluate(self, parameters):
        state = super(Cliff, self).evaluate(parameters)
        return replace(state, cost=np.minimum(state.cost, 1e150))


STARTS = np.array([[-1.2, 1.0], [0.0, 0.0], [3.0, -2.0], [1.0, 1.0]])


def solve(problem, starts, rule=RULE):
    return minimise(problem, problem.evaluate(np.asarray(starts, dtype=float)), rule)


def test_every_start_ends_in_the_valley_and_says_why():
    found = solve(Valley(2.0), STARTS)
    np.testing.assert_allclose(found.state.parameters, 1.0, atol=1e-4)
    assert found.ends == (End.SETTLED,) * 4
    assert 0 < found.iterations < 200
    assert solve(Valley(), STARTS).ends == (End.EXACT,) * 4


def test_steps_follow_the_bend_of_a_valley():
    straight, bent = (solve(valley, STARTS[:3]) for valley in (Valley(2.0), KeptValley(2.0)))
    np.testing.assert_allclose(bent.state.parameters, 1.0, atol=1e-4)
    assert bent.iterations < 0.8 * straight.iterations


def test_starts_do_not_disturb_each_other():
    together = solve(Valley(2.0), STARTS)
    for k, start in enumerate(STARTS):
        alone = solve(Valley(2.0), start[None])
        np.testing.assert_allclose(alone.state.parameters[0], together.state.parameters[k], atol=1e-4)


def test_cost_never_grows():
    costs = [solve(Valley(2.0), STARTS[:1], replace(RULE, iterations=n)).state.cost[0] for n in range(30)]
    assert (np.diff(costs) <= 0).all()
    assert solve(Valley(2.0), STARTS[:1], replace(RULE, iterations=3)).ends == (End.LIMIT,)


def test_a_start_that_no_step_helps_is_stuck():
    found = solve(Wall(), STARTS[:1])
    assert found.ends == (End.STUCK,)
    np.testing.assert_array_equal(found.state.parameters, STARTS[:1])


def test_a_step_that_promises_nothing_is_judged_by_numbers():
    problem = Cliff()
    with np.errstate(all="raise"):
        found = minimise(problem, problem.evaluate(STARTS[:1]), RULE)
    assert found.ends == (End.STUCK,)


def test_a_hopeless_start_is_given_up():
    found = solve(Valley(ledge=20.0), [[-1.0, 1.0], [1.0, 1.0]])
    assert found.ends == (End.BEATEN, End.EXACT)
    np.testing.assert_array_equal(found.state.parameters[0], [-1.0, 1.0])
    barred = solve(Valley(2.0), [[1.5, 2.25]], replace(RULE, bar=3.0))
    assert barred.ends == (End.BEATEN,)
    np.testing.assert_array_equal(barred.state.parameters, [[1.5, 2.25]])


def test_the_last_step_is_taken_in_the_linear_model():
    near = np.array([[1.0 + 1e-3, 1.0 + 2e-3]])
    loose = StoppingRule(0.1)
    stopped, stepped = (solve(Valley(2.0), near, replace(loose, last_step=last)) for last in (False, True))
    assert stopped.iterations == stepped.iterations == 0
    np.testing.assert_array_equal(stopped.state.parameters, near)
    np.testing.assert_allclose(stepped.state.parameters, 1.0, atol=2e-4)


def test_what_contracts_fast_is_not_evaluated_again():
    start = STARTS[1:2]
    careful, hasty = (solve(Valley(2.0), start, replace(RULE, contraction=c, last_step=True)) for c in (1.0, 0.01))
    assert hasty.iterations <= careful.iterations
    np.testing.assert_allclose(hasty.state.parameters, 1.0, atol=1e-3)


@pytest.mark.parametrize("damping", [0.0, 0.1])
def test_steps_solve_the_damped_normal_equations(damping):
    rng = np.random.default_rng(0)
    J, g = rng.normal(size=(5, 9, 4)), rng.normal(size=(5, 4))
    N = np.swapaxes(J, 1, 2) @ J
    found = solve_damped(N, g, np.full(5, damping))
    damped = N * (1 + damping * np.eye(4))
    np.testing.assert_allclose((damped @ found[..., None])[..., 0], g, atol=1e-9)
    expected = -(2 * (g * -found).sum(axis=1) + np.einsum("bi,bij,bj->b", found, N, found))
    np.testing.assert_allclose(predict_decrease(N, g, -found), expected)


def test_singular_normal_equations_are_solved_without_their_free_directions():
    found = solve_damped(np.diag([1.0, 0.0])[None], np.array([[2.0, 0.0]]), np.zeros(1))
    np.testing.assert_allclose(found, [[2.0, 0.0]])


def test_starts_that_have_ended_are_no_longer_looked_at():
    """Those that end early are left alone, and all come back in the order in which they were given."""
    counts, near = [], np.array([1.0 + 1e-6, 1.0 + 2e-6])

    class Watched(Valley):
        def evaluate(self, parameters):
            counts.append(len(parameters))
            return super().evaluate(parameters)

    starts = np.array([STARTS[0], near, STARTS[2], near])
    found = solve(Watched(2.0), starts)
    assert counts[0] == 4 and counts[-1] == 1 and counts == sorted(counts, reverse=True)
    np.testing.assert_array_equal(found.state.parameters[1], near)
    np.testing.assert_array_equal(found.state.parameters[3], near)
    for k in (0, 2):
        alone = solve(Valley(2.0), starts[k][None])
        np.testing.assert_allclose(found.state.parameters[k], alone.state.parameters[0], rtol=1e-12)

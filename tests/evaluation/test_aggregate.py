"""Figures of a set from frames with known scores."""

import numpy as np
import pytest

from circlecal.evaluation.aggregate import MethodComparisons, summarise_method
from circlecal.evaluation.bootstrap import bootstrap_mean
from circlecal.evaluation.soccernet_metric import Comparison, FrameComparison


def frame(errors, missed=None, invented=()):
    found = Comparison({k: np.array(v, dtype=float) for k, v in errors.items()}, missed or {}, invented)
    return FrameComparison(found, Comparison({}, {"x": 1}, ()))


@pytest.fixture
def method():
    annotated = {
        "a": {"Circle central": np.zeros((2, 2)), "Side line top": np.zeros((2, 2))},
        "b": {"Circle central": np.zeros((1, 2)), "Side line top": np.zeros((1, 2))},
        "c": {"Side line top": np.zeros((2, 2))},
    }
    answered = {
        "a": frame({"Circle central": [1, 2], "Side line top": [3, 7]}),
        "b": frame({"Circle central": [4]}, {"Side line top": 1}, ("Middle line",)),
    }
    return MethodComparisons(annotated, answered)


def test_summary_by_hand(method):
    summary = summarise_method(method, (5.0, 10.0), lambda name: name == "Side line top")
    five, ten = summary.accuracies
    assert (summary.frames, summary.answered) == (3, 2)
    assert summary.completeness == pytest.approx(2 / 3)
    assert five.answered == pytest.approx((1 / 2 + 1 / 3) / 2)
    assert five.final == pytest.approx(five.answered * summary.completeness)
    assert ten.answered == pytest.approx((1 + 1 / 3) / 2)
    assert five.precision == pytest.approx((1 / 2 + 1 / 2) / 2)
    assert five.recall == pytest.approx((1 + 1 / 2) / 2)
    assert five.strict == five.final
    assert summary.mean_error_px == pytest.approx(np.mean([1, 2, 3, 7, 4]))
    assert summary.median_error_px == 3
    assert summary.uncovered == pytest.approx(1 - 5 / 8)
    assert np.isinf(summary.held_out_px)  # 3, 7 and three points without an element
    circle, middle, side = summary.classes
    assert (circle.right, circle.wrong, circle.missed, circle.median_px) == (3, 0, 0, 2)
    assert (middle.right, middle.wrong, middle.missed) == (0, 2, 0)
    assert (side.right, side.wrong, side.missed) == (1, 1, 1)


def test_held_out_median_is_nan_without_any(method):
    assert np.isnan(summarise_method(method, (5.0,)).held_out_px)
    assert summarise_method(method, (5.0,), lambda name: name == "Circle central").held_out_px == 2


def test_no_answers_at_all():
    summary = summarise_method(MethodComparisons({"a": {"Middle line": np.zeros((1, 2))}}, {}), (5.0,))
    assert summary.accuracies[0].final == 0
    assert summary.uncovered == 1
    assert np.isnan(summary.mean_error_px)


def test_bootstrap_interval():
    rng = np.random.default_rng(3)
    values = rng.normal(0.4, 0.2, 200)
    found = bootstrap_mean(values, np.random.default_rng(0))
    assert found.mean == pytest.approx(values.mean())
    assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / np.sqrt(200), rel=0.1)
    assert found == bootstrap_mean(values, np.random.default_rng(0))
    with pytest.raises(ValueError, match="at least one"):
        bootstrap_mean(np.zeros(0), rng)

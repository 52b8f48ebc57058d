"""What the verdict's limits separate: counted by hand, and on a frame."""

import numpy as np
import pytest

from circlecal.evaluation.bench.constants import Answer, collect_answers, summarise_gates
from circlecal.results import Check


def answer(error_px, **values):
    checks = (Check(name, value, 2.0, value <= 2.0) for name, value in values.items())
    return Answer(error_px, tuple(checks))


def test_gates_are_counted():
    answers = [
        answer(1.0, sigma_px=1.0, height_m=1.0),
        answer(2.0, sigma_px=3.0, height_m=1.0),
        answer(10.0, sigma_px=9.0, height_m=9.0),  # neither right nor wrong
        answer(50.0, sigma_px=3.0, height_m=1.0),
        answer(60.0, sigma_px=3.0, height_m=4.0),
        answer(70.0, sigma_px=1.0),
    ]
    sigma, height = summarise_gates(answers)
    assert (sigma.name, sigma.right, sigma.wrong, sigma.stopped_alone) == ("sigma_px", 2, 3, 1)
    assert sigma.right_passed == 0.5
    assert sigma.wrong_stopped == pytest.approx(2 / 3)
    assert sigma.limit == 2.0
    assert sigma.right_quantiles[1] == 2.0
    assert (height.name, height.stopped_alone, height.wrong_stopped) == ("height_m", 0, 0.5)


def test_a_check_that_was_never_made_has_no_row():
    assert [row.name for row in summarise_gates([answer(1.0, roll_deg=np.nan)])] == ["roll_deg"]
    assert summarise_gates([]) == []


def test_answers_of_a_frame_hold_the_right_one_with_its_checks():
    (first, *_), seen = collect_answers(["easy"], 1, 3, width=960), []
    assert first.is_right and not first.is_wrong
    assert {check.name for check in first.checks} >= {"sigma_px", "circle_residual_px"}
    collect_answers(["negative"], 1, 3, seen.append, width=640)
    assert len(seen) == 1

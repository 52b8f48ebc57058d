from __future__ import annotations

import numpy as np
import pytest

from circlecal.detection.candidates import drop_ruled_out_segments, drop_segments_on, find_interpretations_of
from circlecal.detection.ellipse_batch import EllipseBatch, ellipse_conic
from circlecal.results import Interpretation, Segment


def ellipse(x: float, y: float, great: float = 100.0, small: float = 40.0) -> EllipseBatch:
    return EllipseBatch(np.array([[x, y]]), np.array([[great, 0.0]]), np.array([[0.0, small]]))


HALFWAY = Segment(np.array([200.0, 0.0]), np.array([200.0, 300.0]))


def test_the_same_circle_is_recognised_and_others_are_not() -> None:
    wrong = Interpretation(ellipse_conic(ellipse(200, 150)), HALFWAY)
    assert find_interpretations_of((wrong,), ellipse(202, 151, 102)) == (wrong,)
    assert find_interpretations_of((wrong,), ellipse(230, 150)) == ()
    assert find_interpretations_of((wrong,), ellipse(200, 150, 120)) == ()
    assert find_interpretations_of((), ellipse(200, 150)) == ()


def test_only_lines_that_were_not_tried_are_left() -> None:
    conic = ellipse_conic(ellipse(200, 150))
    segments = np.array([[[201.0, 10], [199, 200]], [[150, 0], [250, 300]], [[260, 0], [260, 300]]])
    left = drop_ruled_out_segments(segments, (Interpretation(conic, HALFWAY),), 1920)
    np.testing.assert_array_equal(left, segments[1:])
    np.testing.assert_array_equal(drop_ruled_out_segments(segments, (), 1920), segments)
    assert len(drop_ruled_out_segments(segments, (Interpretation(conic, None),), 1920)) == 0


@pytest.mark.parametrize("scale", [1.0, -20.0])
def test_segments_off_a_line(scale: float) -> None:
    segments = np.array([[[201.0, 10], [199, 200]], [[150, 0], [250, 300]], [[260, 0], [260, 300]]])
    np.testing.assert_array_equal(drop_segments_on(scale * np.array([1.0, 0.0, -200.0]), segments, 1920), segments[1:])

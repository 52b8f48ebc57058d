"""How broad the pitch is, by touchlines that no single place shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from circlecal.config import load_config
from circlecal.rig.tripod import PLACE, TripodEstimate
from circlecal.tracking import pitch, touchlines
from circlecal.tracking.frame_paint import HeadedFrame
from circlecal.tracking.looking import LookedAt
from tests.tracking.scenes import HEAD, draw, measure_ideal, template, tripod

WIDTHS = np.arange(45.0, 90.1, 0.1)


def _ridge(at_m: float, levels: float) -> np.ndarray:
    """How ridges of three frames rise, gray levels."""
    rise = levels * np.exp(-0.5 * ((WIDTHS - at_m) / 0.4) ** 2)
    return np.tile(rise, (3, 1))


def test_one_ridge_of_the_paints_strength_is_a_touchline() -> None:
    paint = np.full((3, len(WIDTHS)), 5.0)
    assert touchlines._choose_width(WIDTHS, _ridge(71.3, 4.0), paint) == pytest.approx(71.3, abs=0.05)
    assert touchlines._choose_width(WIDTHS, _ridge(71.3, 1.0), paint) is None
    assert touchlines._choose_width(WIDTHS, _ridge(71.3, 20.0), paint) is None


def test_two_ridges_or_one_frame_tell_no_width() -> None:
    paint, rise = np.full((3, len(WIDTHS)), 5.0), _ridge(71.3, 4.0)
    assert touchlines._choose_width(WIDTHS, rise + _ridge(80.0, 3.0), paint) is None
    rise[1:] = np.nan
    assert touchlines._choose_width(WIDTHS, rise, paint) is None


def _before_a_pitch_of_unknown_width() -> tuple[TripodEstimate, list[HeadedFrame], dict[str, LookedAt]]:
    """A tripod that has the pitch 10 m too narrow, with frames of a penalty area and of the far touchline."""
    heads = [HEAD + np.array([-0.1, 0.01 * k, 0.03]) for k in range(3)]
    drawn = [draw(head, np.random.default_rng(k)) for k, head in enumerate(heads)]
    pictures = {str(k): LookedAt.of(p, load_config().mask) for k, p in enumerate(drawn)}
    members = [HeadedFrame(str(k), head, measure_ideal(head, np.zeros(2), 0.1, np.random.default_rng(k)))
               for k, head in enumerate(heads)]  # fmt: skip
    known = tripod()
    mean, covariance = known.mean.copy(), known.covariance.copy()
    mean[PLACE["breadth"]], covariance[PLACE["breadth"], PLACE["breadth"]] = -10.0, 1.0
    return replace(known, mean=mean, covariance=covariance), members, pictures


def test_a_far_touchline_tells_a_width_that_was_open() -> None:
    wrong, members, pictures = _before_a_pitch_of_unknown_width()
    found = pitch.search_width(wrong, members, pictures, template())
    assert found is not None
    assert abs(found.mean[PLACE["breadth"]]) < 0.5
    assert found.sigma("breadth") == pytest.approx(pitch.WIDTH_SD_M)


def test_a_known_width_is_not_searched_for() -> None:
    wrong, members, pictures = _before_a_pitch_of_unknown_width()
    wrong.covariance[PLACE["breadth"], PLACE["breadth"]] = 0.1**2
    assert pitch.search_width(wrong, members, pictures, template()) is None
